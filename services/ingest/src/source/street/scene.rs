//! The street as it looks: façades on both sides, the road between them, lamps and trees, in the light of the pass.
//!
//! Luminance is in units in which a white wall in the sun has about 100.

use super::houses::{Houses, Surface};
use super::random::{Draws, Purpose, number, unit};
use super::sprites::{LAMP_HEIGHT_M, LAMP_REACH_M, LAMP_SPACING_M, Sprite, sprites};
use super::strip::{Strip, TEXEL_M};
use super::view::{FAR_M, LEFT, RIGHT, WALL_M};
use evpr_core::plan::{Street, StreetPass};

/// The street is drawn from here, metres before the start of the drive.
const BEFORE_M: f32 = 5.0;
/// And so far after its end, metres.
const AFTER_M: f32 = FAR_M + 5.0;
/// Façades are drawn up to here, metres; no house is higher.
const TOP_M: f32 = 16.0;
/// Illumination by everything that is no lamp, at night.
const NIGHT_GLOW: f32 = 0.04;
/// Light of a lamp: illumination at a distance of 1 m.
const LAMP: f32 = 160.0;
/// Lamps further away than this give no light, metres.
const LAMP_RANGE_M: f32 = 45.0;

/// The light of a pass.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    pub(super) sky: f32,
    /// Illumination of the façades and of the ground by day.
    facades: [f32; 2],
    pub(super) ground: f32,
    /// What distance fades to, and over what distance, metres.
    pub(super) haze: f32,
    pub(super) haze_m: f32,
    pub(super) night: bool,
}

impl Light {
    fn of(pass: StreetPass) -> Self {
        match pass {
            StreetPass::Day => Self {
                sky: 140.0,
                facades: [110.0, 65.0],
                ground: 80.0,
                haze: 110.0,
                haze_m: 180.0,
                night: false,
            },
            // Overcast.
            StreetPass::Day2 => Self {
                sky: 110.0,
                facades: [75.0, 70.0],
                ground: 70.0,
                haze: 90.0,
                haze_m: 150.0,
                night: false,
            },
            StreetPass::Night => Self {
                sky: 0.015,
                facades: [0.0; 2],
                ground: 0.0,
                haze: 0.015,
                haze_m: f32::INFINITY,
                night: true,
            },
        }
    }
}

/// A surface in the light of the pass; at night also what it reflects, for the headlights.
#[derive(Debug)]
pub(super) struct Layers {
    pub(super) lit: Strip,
    pub(super) reflectance: Option<Strip>,
}

#[derive(Debug)]
pub(super) struct Scene {
    pub(super) light: Light,
    /// Left and right; cells count from the ground up.
    pub(super) facades: [Layers; 2],
    /// Cells count from the right façade to the left.
    pub(super) ground: Layers,
    /// In the order along the street.
    pub(super) sprites: Vec<Sprite>,
}

impl Scene {
    pub(super) fn new(street: &Street) -> Self {
        let light = Light::of(street.pass);
        let end_m = street.length_m as f32 + AFTER_M;
        Self {
            light,
            facades: [LEFT, RIGHT].map(|side| facade(street, side, light, end_m)),
            ground: ground(street, light, end_m),
            sprites: sprites(street.seed, -BEFORE_M, end_m, |x, y, z| {
                if light.night {
                    lamp_light(x, y, z, Facing::Camera)
                } else {
                    light.ground
                }
            }),
        }
    }

    /// The column of the strips' texels at a place along the street.
    pub(super) fn column(along_m: f64) -> f64 {
        (along_m + f64::from(BEFORE_M)) / f64::from(TEXEL_M)
    }
}

fn columns(end_m: f32) -> usize {
    ((end_m + BEFORE_M) / TEXEL_M) as usize
}

fn along_m(column: usize) -> f32 {
    (column as f32 + 0.5) * TEXEL_M - BEFORE_M
}

/// Makes the layers of a surface. `look` gives, for a column, what is there in each cell and the light that falls on it.
fn layers(
    columns: usize,
    cells: usize,
    night: bool,
    mut look: impl FnMut(usize, usize) -> (Surface, f32),
) -> Layers {
    let lit = Strip::new(columns, cells, |column, out| {
        for (cell, value) in out.iter_mut().enumerate() {
            let (surface, light) = look(column, cell);
            let own = if night { surface.emission } else { 0.0 };
            *value = surface.reflectance * light + own;
        }
    });
    let reflectance = night.then(|| {
        Strip::new(columns, cells, |column, out| {
            for (cell, value) in out.iter_mut().enumerate() {
                *value = look(column, cell).0.reflectance;
            }
        })
    });
    Layers { lit, reflectance }
}

fn facade(street: &Street, side: usize, light: Light, end_m: f32) -> Layers {
    let houses = Houses::new(street, side, -BEFORE_M - 1.0, end_m);
    let y = if side == LEFT { WALL_M } else { -WALL_M };
    let cells = (TOP_M / TEXEL_M) as usize;
    layers(columns(end_m), cells, light.night, |column, cell| {
        let (x, z) = (along_m(column), (cell as f32 + 0.5) * TEXEL_M);
        match houses.surface(houses.at(x), x, z) {
            Some(surface) if light.night => (surface, lamp_light(x, y, z, Facing::Street)),
            Some(surface) => (surface, light.facades[side]),
            None if light.night => {
                let emission = light.sky;
                (
                    Surface {
                        reflectance: 0.0,
                        emission,
                    },
                    0.0,
                )
            }
            None => (
                Surface {
                    reflectance: 1.0,
                    emission: 0.0,
                },
                light.sky,
            ),
        }
    })
}

fn ground(street: &Street, light: Light, end_m: f32) -> Layers {
    let cells = (2.0 * WALL_M / TEXEL_M) as usize;
    layers(columns(end_m), cells, light.night, |column, cell| {
        let (x, y) = (along_m(column), (cell as f32 + 0.5) * TEXEL_M - WALL_M);
        let grain = number(street.seed, Purpose::Ground, &[column as u64, cell as u64]);
        let grain = 0.9 + 0.2 * unit(grain as u32);
        let surface = Surface {
            reflectance: (grain * road(street.seed, x, y)).min(1.0),
            emission: 0.0,
        };
        let light = if light.night {
            lamp_light(x, y, 0.0, Facing::Up)
        } else {
            light.ground
        };
        (surface, light)
    })
}

/// What the ground reflects: asphalt with patches, a dashed line, crossings, kerbs and pavements.
fn road(seed: u64, x: f32, y: f32) -> f32 {
    /// Half the width of the carriageway, metres.
    const KERB_M: f32 = 5.5;
    let side = y.abs();
    if side > KERB_M + 0.2 {
        // Slabs of a metre.
        let joint = x.rem_euclid(1.0) < 0.1 || side.rem_euclid(1.0) < 0.1;
        return if joint { 0.2 } else { 0.35 };
    }
    if side > KERB_M {
        return 0.55;
    }
    let mut crossing = Draws::new(seed, Purpose::Crossing, &[(x / 60.0).floor() as i64 as u64]);
    let from = crossing.between(0.0, 56.0);
    if crossing.chance(0.6) && (from..from + 3.5).contains(&x.rem_euclid(60.0)) && y.rem_euclid(1.0) < 0.5 {
        return 0.75;
    }
    if side < 0.08 && x.rem_euclid(6.0) < 3.0 {
        return 0.7;
    }
    // Mended asphalt: patches of 4 m by a lane.
    let patch = [(x / 4.0).floor() as i64 as u64, u64::from(y > 0.0)];
    let mut patch = Draws::new(seed, Purpose::Ground, &patch);
    if patch.chance(0.12) {
        patch.between(0.08, 0.14)
    } else {
        0.19
    }
}

/// Which way a surface looks.
#[derive(Debug, Clone, Copy)]
enum Facing {
    Up,
    /// Towards the street's middle.
    Street,
    /// Along the street, or every way.
    Camera,
}

/// Illumination at night: by the lamps and the glow of the sky. Lamps shine downwards.
fn lamp_light(x: f32, y: f32, z: f32, facing: Facing) -> f32 {
    let below = LAMP_HEIGHT_M - z;
    let mut light = NIGHT_GLOW;
    if below <= 0.0 {
        return light;
    }
    let first = ((x - LAMP_RANGE_M) / LAMP_SPACING_M).ceil() as i64;
    let last = ((x + LAMP_RANGE_M) / LAMP_SPACING_M).floor() as i64;
    for lamp in first..=last {
        let along = x - lamp as f32 * LAMP_SPACING_M;
        let across = y - LAMP_REACH_M;
        let square = along * along + across * across + below * below;
        let distance = square.sqrt();
        let facing = match facing {
            Facing::Up => below / distance,
            Facing::Street => across.abs() / distance,
            Facing::Camera => 0.5,
        };
        light += LAMP * facing * (below / distance) / square;
    }
    light
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_light_what_is_near_and_below_them() {
        let under = lamp_light(26.0, LAMP_REACH_M, 0.0, Facing::Up);
        let between = lamp_light(39.0, LAMP_REACH_M, 0.0, Facing::Up);
        assert!(under > 2.0 && under < 4.0, "{under}");
        assert!(between > NIGHT_GLOW && between < 0.3 * under, "{between}");
        assert_eq!(lamp_light(26.0, 8.0, 10.0, Facing::Street), NIGHT_GLOW);
    }

    #[test]
    fn night_is_darker_by_decades() {
        let mean = |pass| {
            let street = Street {
                pass,
                length_m: 100.0,
                ..Street::default()
            };
            let scene = Scene::new(&street);
            let mut profile = vec![0.0; scene.ground.lit.cells() + 1];
            scene.ground.lit.profile(0.0, 1_000.0, &mut profile);
            profile[profile.len() - 1] / scene.ground.lit.cells() as f32
        };
        let (day, night) = (mean(StreetPass::Day), mean(StreetPass::Night));
        assert!((10.0..40.0).contains(&day), "{day}");
        assert!((0.02..0.5).contains(&night), "{night}");
    }
}
