//! The ray-caster: what luminance each pixel sees from a place along the street.
//!
//! A column of pixels sees one façade at one depth, and a row sees the ground at one depth, so a picture needs one
//! mean over a stretch of the street per column and per row; within them pixels are differences of running sums. Each
//! pixel is the mean over the area that it sees, not the value at a point.

use super::scene::{Layers, Scene};
use super::sprites::{Seen, see};
use super::strip::{TEXEL_M, sum_to};
use super::view::{CAMERA_HEIGHT_M, View, WALL_M};
use rayon::prelude::*;

/// Light of the headlights: illumination at a distance of 1 m, in the middle of the beam.
const HEADLIGHT: f32 = 400.0;
/// Width and height of the beam, as tangents, and how far below the horizon it points.
const BEAM: (f32, f32) = (0.35, 0.12);
const BEAM_DOWN: f32 = 0.08;
/// Nearer than this, metres, the headlights shine over the road.
const HEADLIGHT_FROM_M: f32 = 3.0;

/// Makes pictures. See the module.
#[derive(Debug)]
pub(super) struct Renderer {
    scene: Scene,
    view: View,
    /// Beam of the headlights over columns (tangent to the side) and rows; all 0 by day.
    beam_columns: Vec<f32>,
    beam_rows: Vec<f32>,
    /// Part of the light that comes through the haze, per column and per row of the ground.
    clear_columns: Vec<f32>,
    clear_rows: Vec<f32>,
}

/// What all columns of one picture have in common.
#[derive(Debug, Default)]
pub(super) struct Frame {
    along_m: f64,
    /// Rows that see ground, from the first on.
    ground: Vec<f32>,
    sprites: Vec<Seen>,
}

/// Room for the sums of one column or row.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    lit: Vec<f32>,
    reflectance: Vec<f32>,
}

impl Scratch {
    /// Sums over a stretch that begins `near_m` and ends `far_m` ahead.
    fn fill(&mut self, layers: &Layers, along_m: f64, near_m: f32, far_m: f32) {
        let from = Scene::column(along_m + f64::from(near_m));
        let to = Scene::column(along_m + f64::from(far_m));
        self.lit.resize(layers.lit.cells() + 1, 0.0);
        layers.lit.profile(from, to, &mut self.lit);
        if let Some(strip) = &layers.reflectance {
            self.reflectance.resize(strip.cells() + 1, 0.0);
            strip.profile(from, to, &mut self.reflectance);
        }
    }
}

impl Renderer {
    pub(super) fn new(scene: Scene, view: View) -> Self {
        let bell = |x: f32| (-x * x).exp();
        let light = scene.light;
        let on = if light.night { 1.0 } else { 0.0 };
        let beam_row = |v: usize| {
            let up = (view.horizon - v as f32 - 0.5) / view.focal_px;
            on * bell((up + BEAM_DOWN) / BEAM.1)
        };
        let clear = |depth_m: f32| (-depth_m / light.haze_m).exp();
        Self {
            beam_columns: view
                .columns
                .iter()
                .map(|c| on * bell(c.tangent / BEAM.0))
                .collect(),
            beam_rows: (0..view.sensor.height).map(beam_row).collect(),
            clear_columns: view.columns.iter().map(|c| clear(c.depth_m)).collect(),
            clear_rows: view.ground.iter().map(|r| clear(r.depth_m)).collect(),
            scene,
            view,
        }
    }

    pub(super) fn view(&self) -> &View {
        &self.view
    }

    /// Begins the picture from `along_m`.
    pub(super) fn begin(&self, along_m: f64, frame: &mut Frame, parallel: bool) {
        frame.along_m = along_m;
        let width = self.view.sensor.width;
        frame.ground.resize(self.view.ground.len() * width, 0.0);
        if parallel {
            let rows = frame.ground.par_chunks_mut(width).enumerate();
            rows.for_each_init(Scratch::default, |scratch, (row, out)| {
                self.ground_row(along_m, row, scratch, out);
            });
        } else {
            let mut scratch = Scratch::default();
            for (row, out) in frame.ground.chunks_mut(width).enumerate() {
                self.ground_row(along_m, row, &mut scratch, out);
            }
        }
        let night = self.scene.light.night;
        let headlight = |depth_m: f32, tangent: f32| {
            let beam = (tangent / BEAM.0).powi(2);
            if night {
                headlight(depth_m) * (-beam).exp()
            } else {
                0.0
            }
        };
        see(
            &self.scene.sprites,
            &self.view,
            along_m,
            headlight,
            &mut frame.sprites,
        );
    }

    fn ground_row(&self, along_m: f64, row: usize, scratch: &mut Scratch, out: &mut [f32]) {
        let at = self.view.ground[row];
        scratch.fill(&self.scene.ground, along_m, at.near_m, at.far_m);
        let light = self.scene.light;
        let head = headlight(at.depth_m) * self.beam_rows[self.view.first_ground_row + row];
        let cells = self.scene.ground.lit.cells() as f32;
        // Cells from the right façade to a place along the row.
        let cell = |column: usize| {
            let y = self.view.lateral_m + self.view.tangent(column as f32) * at.depth_m;
            ((y + WALL_M) / TEXEL_M).clamp(0.0, cells)
        };
        let clear = self.clear_rows[row];
        let mut left = cell(0);
        let sums = |cell: f32| {
            let reflected = if light.night {
                sum_to(&scratch.reflectance, cell)
            } else {
                0.0
            };
            (sum_to(&scratch.lit, cell), reflected)
        };
        let mut left_sums = sums(left);
        for (k, pixel) in out.iter_mut().enumerate() {
            let right = cell(k + 1);
            let right_sums = sums(right);
            let over = 1.0 / (left - right).max(0.01);
            let lit = (left_sums.0 - right_sums.0) * over;
            let reflected = (left_sums.1 - right_sums.1) * over;
            let luminance = lit + head * self.beam_columns[k] * reflected;
            *pixel = clear * luminance + (1.0 - clear) * light.haze;
            (left, left_sums) = (right, right_sums);
        }
    }

    /// Draws column `k` of the picture, from above.
    pub(super) fn column(&self, frame: &Frame, k: usize, scratch: &mut Scratch, out: &mut [f32]) {
        let at = self.view.columns[k];
        let light = self.scene.light;
        let layers = &self.scene.facades[at.side];
        scratch.fill(layers, frame.along_m, at.near_m, at.far_m);
        let head = headlight(at.depth_m) * self.beam_columns[k];
        let clear = self.clear_columns[k];
        let (width, first_ground) = (self.view.sensor.width, self.view.first_ground_row);
        let top = layers.lit.cells() as f32;
        // Cells up from the ground at a row's upper edge; negative below the ground.
        let per_row = at.depth_m / self.view.focal_px / TEXEL_M;
        let cell = |v: usize| CAMERA_HEIGHT_M / TEXEL_M + (self.view.horizon - v as f32) * per_row;
        let sums = |cell: f32| {
            let sky = light.sky * (cell - top).max(0.0);
            let reflected = if light.night {
                sum_to(&scratch.reflectance, cell)
            } else {
                0.0
            };
            (sum_to(&scratch.lit, cell) + sky, reflected)
        };
        let mut upper = cell(0);
        let mut upper_sums = sums(upper.max(0.0));
        for (v, pixel) in out.iter_mut().enumerate() {
            let ground = || {
                let row = v.checked_sub(first_ground);
                row.and_then(|row| frame.ground.get(row * width + k))
                    .copied()
                    .unwrap_or(light.haze)
            };
            if upper <= 0.0 {
                *pixel = ground();
                continue;
            }
            let lower = cell(v + 1);
            let lower_sums = sums(lower.max(0.0));
            let over = 1.0 / per_row;
            let lit = (upper_sums.0 - lower_sums.0) * over;
            let reflected = (upper_sums.1 - lower_sums.1) * over;
            // What the façade does not fill of the last pixel is ground.
            let filled = (upper - lower.max(0.0)) * over;
            let luminance = lit + head * self.beam_rows[v] * reflected;
            *pixel = clear * luminance + (1.0 - clear) * light.haze * filled;
            if lower < 0.0 {
                *pixel += (1.0 - filled) * ground();
            }
            (upper, upper_sums) = (lower, lower_sums);
        }
        for seen in &frame.sprites {
            seen.draw(&self.view, k, light.night, out);
        }
    }
}

/// Light of the headlights at a depth, in the middle of the beam.
fn headlight(depth_m: f32) -> f32 {
    let depth_m = depth_m.max(HEADLIGHT_FROM_M);
    HEADLIGHT / (depth_m * depth_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::{Sensor, Street, StreetPass};

    /// A picture, row by row.
    fn picture(pass: StreetPass, sensor: Sensor, along_m: f64, parallel: bool) -> Vec<f32> {
        let street = Street {
            pass,
            length_m: 60.0,
            sensor,
            ..Street::default()
        };
        let renderer = Renderer::new(Scene::new(&street), View::new(sensor, -1.75));
        let (mut frame, mut scratch) = (Frame::default(), Scratch::default());
        renderer.begin(along_m, &mut frame, parallel);
        let mut picture = vec![0.0; sensor.pixels()];
        let mut column = vec![0.0; sensor.height];
        for k in 0..sensor.width {
            renderer.column(&frame, k, &mut scratch, &mut column);
            for (v, value) in column.iter().enumerate() {
                picture[v * sensor.width + k] = *value;
            }
        }
        picture
    }

    const SMALL: Sensor = Sensor {
        height: 60,
        width: 80,
    };

    #[test]
    fn pictures_are_within_the_range_of_light() {
        for sensor in [
            SMALL,
            Sensor { height: 1, width: 1 },
            Sensor { height: 40, width: 7 },
        ] {
            for along in [0.0, 33.3, 60.0] {
                let day = picture(StreetPass::Day, sensor, along, false);
                assert!(day.iter().all(|v| (2.0..145.0).contains(v)), "{day:?}");
                let night = picture(StreetPass::Night, sensor, along, false);
                assert!(night.iter().all(|v| (1e-4..80.0).contains(v)), "{night:?}");
            }
        }
    }

    #[test]
    fn a_picture_changes_little_over_a_centimetre_and_much_over_metres() {
        let mean_step = |metres: f64| {
            let (a, b) = (
                picture(StreetPass::Day, SMALL, 20.0, false),
                picture(StreetPass::Day, SMALL, 20.0 + metres, false),
            );
            let steps = a.iter().zip(&b).map(|(a, b)| (a.ln() - b.ln()).abs());
            steps.sum::<f32>() / a.len() as f32
        };
        let (near, far) = (mean_step(0.01), mean_step(3.0));
        assert!(near < 0.01 && far > 0.1, "{near} {far}");
    }

    #[test]
    fn the_sky_is_above_and_the_headlights_light_the_road() {
        let day = picture(StreetPass::Day, SMALL, 20.0, false);
        assert!(day[40] > 100.0, "straight ahead and up is sky: {}", day[40]);
        let night = picture(StreetPass::Night, SMALL, 20.0, false);
        let row = |v: usize| night[v * 80 + 30..v * 80 + 50].iter().sum::<f32>() / 20.0;
        assert!(row(42) > 5.0 * row(2), "{} {}", row(42), row(2));
    }

    #[test]
    fn threads_change_nothing() {
        let one = picture(StreetPass::Night, SMALL, 12.0, false);
        assert_eq!(one, picture(StreetPass::Night, SMALL, 12.0, true));
    }
}
