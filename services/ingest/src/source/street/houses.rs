//! Houses: nine kinds that follow each other along each side of the street, always in the same order, so that places
//! resemble each other; and what tells one house of a kind from another.

use super::random::{Draws, Purpose};
use evpr_core::plan::{Street, StreetPass};

/// Kinds of houses.
pub(super) const KINDS: usize = 9;
/// Where the row on the right begins in the order of kinds: so the sides differ.
const RIGHT_STARTS_AT: usize = 4;
/// The kind that is only a garden wall.
const GARDEN: usize = 7;
/// How many windows are lit at night, as a part.
const LIT: f32 = 0.25;
/// What glass reflects.
const GLASS: f32 = 0.06;

/// What a point of a surface sends back of the light that falls on it (0 to 1), and what light it sends out by itself.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Surface {
    pub(super) reflectance: f32,
    pub(super) emission: f32,
}

/// What all houses of a kind have in common. Lengths are metres.
#[derive(Debug, Clone)]
struct Kind {
    width: f32,
    storeys: usize,
    storey: f32,
    wall: f32,
    /// Windows side by side.
    windows: usize,
    window_width: f32,
    window_height: f32,
    shop: bool,
    /// Left edge of the door, as a part of the width.
    door: f32,
    /// Bright bands between the storeys.
    bands: bool,
}

impl Kind {
    fn new(seed: u64, kind: usize) -> Self {
        let mut d = Draws::new(seed, Purpose::HouseKind, &[kind as u64]);
        let width = d.between(9.0, 15.0);
        Self {
            width,
            storeys: if kind == GARDEN {
                0
            } else {
                2 + (3.0 * d.unit()) as usize
            },
            storey: d.between(3.0, 3.8),
            wall: d.between(0.2, 0.75),
            windows: (width / d.between(2.0, 3.4)) as usize,
            window_width: d.between(0.9, 1.4),
            window_height: d.between(1.2, 1.8),
            shop: d.chance(0.35),
            door: d.between(0.05, 0.8),
            bands: d.chance(0.4),
        }
    }

    /// Up to the roof.
    fn height(&self) -> f32 {
        if self.storeys == 0 {
            2.0
        } else {
            self.storeys as f32 * self.storey + 0.6
        }
    }
}

/// One house.
#[derive(Debug, Clone)]
struct House {
    start_m: f32,
    kind: usize,
    /// The wall is so much brighter than its kind's.
    paint: f32,
    door: f32,
    /// Left edge and width of a sign over the ground floor.
    sign: Option<(f32, f32)>,
    shop_lit: bool,
}

/// The houses of one side.
#[derive(Debug)]
pub(super) struct Houses {
    seed: u64,
    side: usize,
    pass: StreetPass,
    kinds: Vec<Kind>,
    houses: Vec<House>,
}

impl Houses {
    /// Houses from `from_m` to beyond `to_m` along the street.
    pub(super) fn new(street: &Street, side: usize, from_m: f32, to_m: f32) -> Self {
        let kinds: Vec<Kind> = (0..KINDS).map(|kind| Kind::new(street.seed, kind)).collect();
        let mut houses = Vec::new();
        let mut start_m = from_m;
        while start_m < to_m {
            let index = houses.len();
            let kind = (index + side * RIGHT_STARTS_AT) % KINDS;
            let mut d = Draws::new(street.seed, Purpose::House, &[side as u64, index as u64]);
            let mut lit = Draws::new(
                street.seed,
                Purpose::LitWindow,
                &[side as u64, index as u64, street.pass as u64],
            );
            houses.push(House {
                start_m,
                kind,
                paint: d.between(0.6, 1.4),
                door: d.between(0.1, 0.6),
                sign: d.chance(0.5).then(|| (d.between(0.1, 0.5), d.between(1.5, 4.0))),
                shop_lit: lit.chance(0.5),
            });
            start_m += kinds[kind].width;
        }
        Self {
            seed: street.seed,
            side,
            pass: street.pass,
            kinds,
            houses,
        }
    }

    /// The house at a place along the street: its index, for [`Houses::surface`].
    pub(super) fn at(&self, along_m: f32) -> usize {
        self.houses
            .partition_point(|h| h.start_m <= along_m)
            .saturating_sub(1)
    }

    /// What is to be seen at a height of a house; `None` is the sky above it.
    pub(super) fn surface(&self, index: usize, along_m: f32, z: f32) -> Option<Surface> {
        let house = self.houses.get(index)?;
        let kind = &self.kinds[house.kind];
        if z > kind.height() {
            return None;
        }
        let x = along_m - house.start_m;
        let wall = (kind.wall * house.paint).min(0.9);
        if kind.storeys == 0 {
            // Bricks, and a dark gap in the middle.
            let gate = (x - 0.5 * kind.width).abs() < 0.8;
            return Some(plain(if gate { 0.08 } else { 0.8 * wall }));
        }
        if z > kind.height() - 0.3 {
            return Some(plain(0.85));
        }
        if !(0.15..kind.width - 0.05).contains(&x) {
            return Some(plain(0.08));
        }
        if let Some(sign) = self.sign(house, kind, x, z) {
            return Some(sign);
        }
        let storey = ((z / kind.storey) as usize).min(kind.storeys - 1);
        let up = z - storey as f32 * kind.storey;
        if storey == 0
            && let Some(ground) = ground_floor(house, kind, x, up)
        {
            return Some(ground);
        }
        if kind.bands && storey > 0 && up < 0.2 {
            return Some(plain((1.5 * wall).min(0.9)));
        }
        let window = self.window(index, kind, storey, x, up);
        Some(window.unwrap_or(plain(wall)))
    }

    fn sign(&self, house: &House, kind: &Kind, x: f32, z: f32) -> Option<Surface> {
        let (at, width) = house.sign?;
        let along = x - at * kind.width;
        if !(0.0..width).contains(&along) || !(kind.storey - 0.4..kind.storey + 0.3).contains(&z) {
            return None;
        }
        // Letters.
        Some(plain(if ((along / 0.3) as usize).is_multiple_of(2) {
            0.85
        } else {
            0.1
        }))
    }

    /// A window with its frame and curtains, if there is one.
    fn window(&self, index: usize, kind: &Kind, storey: usize, x: f32, up: f32) -> Option<Surface> {
        if kind.windows == 0 || (kind.shop && storey == 0) {
            return None;
        }
        let pitch = kind.width / kind.windows as f32;
        let number = (x / pitch) as usize;
        let from_middle = (x - (number as f32 + 0.5) * pitch).abs() / (0.5 * kind.window_width);
        let height = (up - 0.8) / kind.window_height;
        if from_middle > 1.0 || !(0.0..1.0).contains(&height) {
            return None;
        }
        if !(0.08..=0.85).contains(&from_middle) {
            return Some(plain(0.8));
        }
        let place = [self.side as u64, index as u64, storey as u64, number as u64];
        let mut d = Draws::new(self.seed, Purpose::Window, &place);
        let (curtain, drawn, sideways) = (d.between(0.1, 0.6), d.unit(), d.chance(0.5));
        let covered = if sideways {
            from_middle > drawn
        } else {
            height > drawn
        };
        let reflectance = if covered { curtain } else { GLASS };
        let [side, index, storey, number] = place;
        let mut lit = Draws::new(
            self.seed,
            Purpose::LitWindow,
            &[side, index, storey, number, self.pass as u64],
        );
        let emission = if lit.chance(LIT) {
            let light = lit.between(0.6, 4.0);
            if covered { 0.5 * light } else { light }
        } else {
            0.0
        };
        Some(Surface {
            reflectance,
            emission,
        })
    }
}

fn plain(reflectance: f32) -> Surface {
    Surface {
        reflectance,
        emission: 0.0,
    }
}

/// Doors and shop windows.
fn ground_floor(house: &House, kind: &Kind, x: f32, up: f32) -> Option<Surface> {
    let beside_door = x - kind.door * kind.width;
    if (0.0..1.1).contains(&beside_door) && up < 2.2 {
        return Some(plain(house.door));
    }
    if kind.shop && (0.5..2.4).contains(&up) && (0.5..kind.width - 0.5).contains(&x) {
        let goods = ((x / 0.7) as usize).is_multiple_of(3) && up < 1.6;
        let emission = if house.shop_lit { 3.0 } else { 0.0 };
        return Some(Surface {
            reflectance: if goods { 0.5 } else { GLASS },
            emission: if goods { 0.3 * emission } else { emission },
        });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn houses(pass: StreetPass, side: usize) -> Houses {
        let street = Street {
            pass,
            ..Street::default()
        };
        Houses::new(&street, side, -10.0, 700.0)
    }

    #[test]
    fn kinds_repeat_and_houses_of_a_kind_differ() {
        let row = houses(StreetPass::Day, 0);
        let period: f32 = row.kinds.iter().map(|k| k.width).sum();
        assert!((72.0..117.0).contains(&period), "{period}");
        let (mut alike, mut all) = (0, 0);
        for i in 0..3_000 {
            let (x, z) = (-9.5 + 0.1 * (i % 600) as f32, 0.25 + 2.0 * (i / 600) as f32);
            let (here, there) = (row.at(x), row.at(x + period));
            assert_eq!(there, here + KINDS);
            let (a, b) = (row.surface(here, x, z), row.surface(there, x + period, z));
            all += 1;
            alike += usize::from(a == b);
            assert_eq!(a.is_none(), b.is_none(), "houses of a kind are equally high");
        }
        assert!(alike > all / 20 && alike < all / 2, "{alike} of {all}");
    }

    #[test]
    fn passes_share_walls_but_not_lights() {
        let (day, night) = (houses(StreetPass::Day, 1), houses(StreetPass::Night, 1));
        let (mut lit, mut differ) = (0, 0);
        for i in 0..20_000 {
            let (x, z) = (0.17 * (i % 4_000) as f32, 0.5 + 2.0 * (i / 4_000) as f32);
            let (a, b) = (
                day.surface(day.at(x), x, z).unwrap_or_default(),
                night.surface(night.at(x), x, z).unwrap_or_default(),
            );
            assert_eq!(a.reflectance, b.reflectance);
            assert!((0.0..=1.0).contains(&a.reflectance) && (0.0..5.0).contains(&a.emission));
            lit += usize::from(b.emission > 0.0);
            differ += usize::from(a.emission != b.emission);
        }
        assert!(lit > 200 && differ > 200, "{lit} {differ}");
    }
}
