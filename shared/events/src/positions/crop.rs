//! The part of a track that an evaluation uses.

use super::track::{Position, Track, distance_m};
use evpr_core::plan::Crop;
use std::collections::HashMap;

/// A loop is closed where the camera comes this close to an earlier position, metres.
const LOOP_M: f64 = 10.0;
/// That position must lie more than so many positions back.
const LOOP_APART: usize = 20;
/// Who has gone this far from the first position has begun to move, metres: further than a standing receiver drifts.
const MOTION_M: f64 = 2.0;

/// Cuts the track. As the authors' code does it, each recorded position counts for a loop and any change of place is
/// motion; else a loop is searched among positions that are at least 10 m apart, so that a stop does not close one, and
/// motion begins 2 m from the first position.
///
/// # Errors
/// When there is no loop or no motion.
pub(super) fn crop(track: Track, what: Crop, as_the_paper: bool) -> Result<Track, String> {
    let positions = track.positions();
    let last = positions.len().saturating_sub(1);
    match what {
        Crop::None | Crop::Track => Ok(track),
        Crop::FirstLoop => {
            let apart = if as_the_paper { 0.0 } else { LOOP_M };
            let (from, to) = first_loop(positions, apart).ok_or_else(|| {
                format!(
                    "never comes within {LOOP_M} m of an earlier position, so it has no loop; write another \
                     positions.crop, or none"
                )
            })?;
            Ok(track.part(from..=to))
        }
        Crop::FirstMotion => {
            let moves = |at: usize| match (positions.first(), positions.get(at - 1), positions.get(at)) {
                (_, Some(before), Some(here)) if as_the_paper => before.place != here.place,
                (Some(first), _, Some(here)) => distance_m(first.place, here.place) > MOTION_M,
                _ => false,
            };
            let from = (1..positions.len())
                .find(|at| moves(*at))
                .ok_or("never moves; write another positions.crop, or none")?;
            Ok(track.part(from..=last))
        }
    }
}

/// Indices of the first position that lies less than 10 m from one more than 20 positions before it, and of the nearest
/// of those, which comes first. Only positions count that are at least `apart_m` from the one that counted before.
fn first_loop(positions: &[Position], apart_m: f64) -> Option<(usize, usize)> {
    let mut counted: Vec<usize> = Vec::new();
    // Positions by squares of the loop's size: what is near lies in the same or a neighbouring one.
    let mut squares: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
    let square = |place: [f64; 2]| place.map(|v| (v / LOOP_M).floor() as i64);
    for (index, position) in positions.iter().enumerate() {
        let place = position.place;
        if counted
            .last()
            .is_some_and(|last| distance_m(positions[*last].place, place) < apart_m)
        {
            continue;
        }
        let order = counted.len();
        counted.push(index);
        // One enters the squares only when it is far enough back.
        if let Some(back) = order.checked_sub(LOOP_APART + 1) {
            let entered = positions[counted[back]].place;
            squares.entry(square(entered)).or_default().push(counted[back]);
        }
        let [x, y] = square(place);
        let around =
            (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x.saturating_add(dx), y.saturating_add(dy)]));
        let near = around
            .filter_map(|at| squares.get(&at))
            .flatten()
            .map(|earlier| (distance_m(positions[*earlier].place, place), *earlier))
            .filter(|(distance, _)| *distance < LOOP_M);
        if let Some((_, earlier)) = near.min_by(|a, b| a.0.total_cmp(&b.0)) {
            return Some((earlier, index));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn track(places: impl IntoIterator<Item = [f64; 2]>) -> Track {
        let position = |(t_ns, place)| Position { t_ns, place };
        Track::new((0..).zip(places).map(position), u64::MAX)
    }

    /// A straight way towards it of 30 positions, then twice round a circle of 100 positions, 11 m apart.
    fn lead_in_and_circle() -> Vec<[f64; 2]> {
        let radius = 11.0 * 100.0 / std::f64::consts::TAU;
        let lead = (0..30).map(|i| [radius + 11.0 * f64::from(30 - i), 0.0]);
        let circle = (0..200).map(|i| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 100.0).sin_cos();
            [radius * cos, radius * sin]
        });
        lead.chain(circle).collect()
    }

    #[test]
    fn the_first_loop_begins_at_the_position_that_is_met_again() {
        for as_the_paper in [true, false] {
            // Position 30 is the circle's first; 130 the same place again, the one before it is 11 m short.
            let cut = crop(track(lead_in_and_circle()), Crop::FirstLoop, as_the_paper).unwrap();
            assert_eq!(cut.span_ns(), Some((30, 130)), "{as_the_paper}");
        }
    }

    #[test]
    fn a_stop_closes_a_loop_only_as_in_the_paper() {
        let mut places = lead_in_and_circle();
        let stop = places[10];
        places.splice(10..10, std::iter::repeat_n(stop, 40));
        let cut = |paper| {
            crop(track(places.clone()), Crop::FirstLoop, paper)
                .unwrap()
                .span_ns()
        };
        assert_eq!(cut(false), Some((70, 170)));
        // Of the equally near ones the search may take any: here the first that stands.
        assert_eq!(cut(true), Some((10, 31)));
    }

    #[test]
    fn positions_at_the_limits_do_not_close_a_loop() {
        // Exactly 10 m, and exactly 20 positions back.
        let there_and_back = |aside: f64, count: i32| {
            let there = (0..count).map(|i| [20.0 * f64::from(i), 0.0]);
            let back = (0..count).rev().map(move |i| [20.0 * f64::from(i), aside]);
            track(there.chain(back).collect::<Vec<_>>())
        };
        assert!(crop(there_and_back(10.0, 40), Crop::FirstLoop, true).is_err());
        // The last comes back to position 0 after 2·11−1 = 21 positions, or 19.
        let closed = crop(there_and_back(9.9, 11), Crop::FirstLoop, true).unwrap();
        assert_eq!(closed.span_ns(), Some((0, 21)));
        let error = crop(there_and_back(9.9, 10), Crop::FirstLoop, true).unwrap_err();
        assert!(error.contains("no loop"), "{error}");
    }

    #[test]
    fn motion_begins_where_the_first_place_is_left() {
        let places = [
            [0.0, 0.0],
            [0.0, 0.0],
            [0.3, 0.0],
            [0.4, 0.0],
            [1.0, 2.0],
            [9.0, 9.0],
        ];
        let from = |paper| crop(track(places), Crop::FirstMotion, paper).unwrap().span_ns();
        assert_eq!((from(true), from(false)), (Some((2, 5)), Some((4, 5))));
        assert!(crop(track([[1.0, 1.0]; 3]), Crop::FirstMotion, false).is_err());
        assert!(crop(track([]), Crop::FirstMotion, false).is_err());
        assert_eq!(crop(track(places), Crop::Track, false).unwrap(), track(places));
    }

    proptest! {
        /// Against all pairs.
        #[test]
        fn the_loop_is_the_one_that_all_pairs_give(
            places in proptest::collection::vec([-60.0..60.0f64, -60.0..60.0f64], 0..80),
        ) {
            let positions = track(places.clone());
            let expected = (0..places.len()).find_map(|j| {
                let earlier = (0..j.saturating_sub(20)).filter(|i| i + 20 < j);
                let near = earlier
                    .map(|i| (distance_m(places[i], places[j]), i))
                    .filter(|(distance, _)| *distance < 10.0);
                near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i)| (i, j))
            });
            prop_assert_eq!(first_loop(positions.positions(), 0.0), expected);
        }
    }
}
