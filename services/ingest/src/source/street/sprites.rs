//! What stands in the street: lamps and trees, drawn over façades and ground.

use super::random::{Draws, Purpose, number, unit};
use super::view::{CAMERA_HEIGHT_M, View};

/// From lamp to lamp, metres.
pub(super) const LAMP_SPACING_M: f32 = 26.0;
/// Height of a lamp's light, metres.
pub(super) const LAMP_HEIGHT_M: f32 = 8.0;
/// Where a lamp's light hangs, metres to the left of the street's middle.
pub(super) const LAMP_REACH_M: f32 = 6.0;
/// Where its pole stands.
const POLE_M: f32 = 7.4;
/// What poles, trunks and leaves reflect.
const POLE: f32 = 0.12;
const TRUNK: f32 = 0.1;
const LEAVES: f32 = 0.16;
/// Luminance of a lamp that is on.
const LAMP_LIGHT: f32 = 60.0;
/// Trees stand so far from the street's middle, metres.
const TREES_M: f32 = 8.0;
/// Nearer and further than this nothing is drawn, metres.
const NEAREST_M: f32 = 1.0;
const FURTHEST_M: f32 = 90.0;
/// Edge of a tuft of leaves, metres.
const TUFT_M: f32 = 0.5;

#[derive(Debug, Clone, Copy)]
enum Kind {
    Lamp,
    /// With the radius of its crown, metres.
    Tree(f32),
}

/// A thing in the street.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sprite {
    along_m: f32,
    lateral_m: f32,
    kind: Kind,
    /// The light that falls on it.
    light: f32,
    seed: u64,
}

/// All lamps, and trees at irregular distances on both sides, in the order along the street. `light` is what falls on a
/// thing at a place (along, to the left, up).
pub(super) fn sprites(
    seed: u64,
    from_m: f32,
    to_m: f32,
    light: impl Fn(f32, f32, f32) -> f32,
) -> Vec<Sprite> {
    let mut all = Vec::new();
    for lamp in (from_m / LAMP_SPACING_M).ceil() as i64..=(to_m / LAMP_SPACING_M) as i64 {
        let along_m = lamp as f32 * LAMP_SPACING_M;
        all.push(Sprite {
            along_m,
            lateral_m: POLE_M,
            kind: Kind::Lamp,
            light: light(along_m, POLE_M, 3.0),
            seed: 0,
        });
    }
    for (side, lateral_m) in [TREES_M, -TREES_M].into_iter().enumerate() {
        let mut draws = Draws::new(seed, Purpose::Tree, &[side as u64]);
        let mut along_m = from_m + draws.between(2.0, 20.0);
        let mut tree = 0;
        while along_m < to_m {
            all.push(Sprite {
                along_m,
                lateral_m,
                kind: Kind::Tree(draws.between(1.0, 1.9)),
                light: light(along_m, lateral_m, 3.5),
                seed: number(seed, Purpose::Tree, &[side as u64, tree]),
            });
            along_m += draws.between(9.0, 34.0);
            tree += 1;
        }
    }
    all.sort_by(|a, b| a.along_m.total_cmp(&b.along_m));
    all
}

/// A thing as the camera sees it now.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    sprite: Sprite,
    /// Column of its middle, and pixels per metre.
    middle: f32,
    scale: f32,
    /// The columns that it covers.
    first: f32,
    last: f32,
    /// Light by the headlights.
    headlight: f32,
}

/// Fills `out` with what is to be seen from `along_m`, the furthest first. `headlight`: light at a depth and a tangent.
pub(super) fn see(
    sprites: &[Sprite],
    view: &View,
    along_m: f64,
    headlight: impl Fn(f32, f32) -> f32,
    out: &mut Vec<Seen>,
) {
    out.clear();
    let from = along_m as f32 + NEAREST_M;
    let begin = sprites.partition_point(|s| s.along_m < from);
    let near = sprites.get(begin..).unwrap_or_default();
    for sprite in near {
        let depth_m = (f64::from(sprite.along_m) - along_m) as f32;
        if depth_m > FURTHEST_M {
            break;
        }
        let scale = view.focal_px / depth_m;
        let aside = sprite.lateral_m - view.lateral_m;
        let middle = 0.5 * view.sensor.width as f32 - scale * aside;
        let (left_m, right_m) = match sprite.kind {
            Kind::Lamp => (0.1, POLE_M - LAMP_REACH_M + 0.3),
            Kind::Tree(radius) => (radius, radius),
        };
        let (first, last) = (middle - scale * left_m, middle + scale * right_m);
        if last > 0.0 && first < view.sensor.width as f32 {
            out.push(Seen {
                sprite: *sprite,
                middle,
                scale,
                first,
                last,
                headlight: headlight(depth_m, aside / depth_m),
            });
        }
    }
    out.reverse();
}

impl Seen {
    /// Draws what falls into column `k`. `night`: lamps are on.
    pub(super) fn draw(&self, view: &View, k: usize, night: bool, out: &mut [f32]) {
        let edge = k as f32;
        if self.last <= edge || self.first >= edge + 1.0 {
            return;
        }
        let light = self.sprite.light + self.headlight;
        let row = |z: f32| view.horizon - self.scale * (z - CAMERA_HEIGHT_M);
        // A rectangle from `left` to `right`, metres to the right of the middle, and between two heights.
        let mut rectangle = |left: f32, right: f32, low: f32, high: f32, luminance: f32| {
            let (from, to) = (self.middle + self.scale * left, self.middle + self.scale * right);
            let cover = to.min(edge + 1.0) - from.max(edge);
            if cover > 0.0 {
                blend(out, row(high), row(low), cover, |_| luminance);
            }
        };
        match self.sprite.kind {
            Kind::Lamp => {
                let reach = POLE_M - LAMP_REACH_M;
                rectangle(-0.08, 0.08, 0.0, LAMP_HEIGHT_M, POLE * light);
                rectangle(0.0, reach, LAMP_HEIGHT_M - 0.1, LAMP_HEIGHT_M, POLE * light);
                let head = if night { LAMP_LIGHT } else { 0.5 * light };
                rectangle(
                    reach - 0.3,
                    reach + 0.3,
                    LAMP_HEIGHT_M - 0.3,
                    LAMP_HEIGHT_M - 0.1,
                    head,
                );
            }
            Kind::Tree(radius) => {
                rectangle(-0.15, 0.15, 0.0, 2.6, TRUNK * light);
                self.crown(view, edge + 0.5, radius, light, out);
            }
        }
    }

    fn crown(&self, view: &View, column: f32, radius: f32, light: f32, out: &mut [f32]) {
        let aside = (column - self.middle) / self.scale;
        let half = (radius * radius - aside * aside).max(0.0).sqrt();
        let height = 2.3 + radius;
        let row = |z: f32| view.horizon - self.scale * (z - CAMERA_HEIGHT_M);
        // Tufts smaller than two pixels run into each other.
        let contrast = (0.5 * TUFT_M * self.scale).min(1.0);
        blend(out, row(height + half), row(height - half), 0.9, |v| {
            let z = CAMERA_HEIGHT_M + (view.horizon - v - 0.5) / self.scale;
            let tuft = [(aside / TUFT_M).floor(), (z / TUFT_M).floor()].map(|i| i as i64 as u64);
            let tuft = unit(number(self.sprite.seed, Purpose::Tree, &tuft) as u32);
            LEAVES * light * (1.0 + contrast * (1.4 * tuft - 0.7))
        });
    }
}

/// Lays a luminance over the rows from `top` to `bottom`, which may lie within pixels; `cover` is 0 to 1.
fn blend(out: &mut [f32], top: f32, bottom: f32, cover: f32, luminance: impl Fn(f32) -> f32) {
    let end = out.len() as f32;
    let (top, bottom) = (top.clamp(0.0, end), bottom.clamp(0.0, end));
    let rows = out
        .iter_mut()
        .enumerate()
        .take(bottom.ceil() as usize)
        .skip(top as usize);
    for (v, pixel) in rows {
        let v = v as f32;
        let part = cover * (bottom.min(v + 1.0) - top.max(v)).max(0.0);
        *pixel += part * (luminance(v) - *pixel);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::Sensor;

    #[test]
    fn a_lamp_is_where_perspective_puts_it() {
        let view = View::new(
            Sensor {
                height: 120,
                width: 160,
            },
            0.0,
        );
        let all = sprites(1, 0.0, 400.0, |_, _, _| 10.0);
        assert!(all.windows(2).all(|s| s[0].along_m <= s[1].along_m));
        let lamps: Vec<Sprite> = all.into_iter().filter(|s| matches!(s.kind, Kind::Lamp)).collect();
        let mut seen = Vec::new();
        see(&lamps, &view, 36.0, |_, _| 0.0, &mut seen);
        // At 52, 78 and 104 m, the furthest first; the one at 130 m is too far.
        let depths: Vec<f32> = seen.iter().map(|s| s.sprite.along_m - 36.0).collect();
        assert_eq!(depths, [68.0, 42.0, 16.0]);
        let nearest = seen[2];
        let column = 80.0 - view.focal_px * POLE_M / 16.0;
        assert!((nearest.middle - column).abs() < 1e-3);
        let mut out = vec![50.0; 120];
        nearest.draw(&view, column as usize, true, &mut out);
        assert!(out[60] < 20.0, "the pole covers most of a pixel: {}", out[60]);
        assert_eq!(out[5], 50.0, "above the lamp is sky");
        let mut beside = vec![50.0; 120];
        nearest.draw(&view, column as usize - 3, true, &mut beside);
        assert!(beside.iter().all(|v| *v == 50.0));
    }

    #[test]
    fn blending_covers_parts_of_pixels() {
        let mut out = [0.0; 4];
        blend(&mut out, 0.5, 2.25, 1.0, |_| 8.0);
        assert_eq!(out, [4.0, 8.0, 2.0, 0.0]);
        blend(&mut out, -5.0, 99.0, 0.5, |_| 0.0);
        assert_eq!(out, [2.0, 4.0, 1.0, 0.0]);
    }
}
