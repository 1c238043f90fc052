//! A track: where the camera was, over time.

use crate::Trajectory;

/// Most positions in a track: three hours at 200 Hz. It bounds the memory to 50 MB.
pub(super) const MAX_POSITIONS: usize = 1 << 21;

/// A place at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Position {
    /// Sensor time, ns; negative before the sensor's clock began.
    pub t_ns: i64,
    /// Metres east and north (in compatibility with the authors' code: earth-centred x and y).
    pub place: [f64; 2],
}

/// Positions in the order of time, each time once.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    positions: Vec<Position>,
    max_gap_ns: u64,
}

/// How far apart two positions are, metres.
pub fn distance_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

impl Track {
    /// A track of these positions, whose times must grow; what does not is left out. Between two that are more than
    /// `max_gap_ns` apart nothing is known.
    pub fn new(positions: impl IntoIterator<Item = Position>, max_gap_ns: u64) -> Self {
        let mut kept: Vec<Position> = Vec::new();
        for position in positions {
            let finite = position.place.iter().all(|v| v.is_finite());
            if finite && kept.last().is_none_or(|last| position.t_ns > last.t_ns) {
                kept.push(position);
            }
        }
        Self {
            positions: kept,
            max_gap_ns,
        }
    }

    /// The positions.
    pub fn positions(&self) -> &[Position] {
        &self.positions
    }

    /// Sensor times of the first and the last position, ns; `None` when there are none.
    pub fn span_ns(&self) -> Option<(i64, i64)> {
        Some((self.positions.first()?.t_ns, self.positions.last()?.t_ns))
    }

    /// Metres east and north at a sensor time, on the straight line between the positions before and after it. `None`
    /// before the first, after the last, and inside a gap.
    pub fn at(&self, t_ns: i64) -> Option<[f64; 2]> {
        let after = self.positions.partition_point(|p| p.t_ns <= t_ns);
        let before = self.positions.get(after.checked_sub(1)?)?;
        if before.t_ns == t_ns {
            return Some(before.place);
        }
        let after = self.positions.get(after)?;
        let gap = after.t_ns.abs_diff(before.t_ns);
        if gap > self.max_gap_ns {
            return None;
        }
        let part = t_ns.abs_diff(before.t_ns) as f64 / gap as f64;
        Some([0, 1].map(|i| before.place[i] + (after.place[i] - before.place[i]) * part))
    }

    /// Only the positions of this range of indices.
    pub(super) fn part(mut self, range: std::ops::RangeInclusive<usize>) -> Self {
        self.positions.truncate(range.end().saturating_add(1));
        self.positions.drain(..(*range.start()).min(self.positions.len()));
        self
    }
}

impl Trajectory for Track {
    fn position(&mut self, t_ns: u64) -> Option<[f64; 2]> {
        self.at(i64::try_from(t_ns).ok()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(crate) fn track(positions: &[(i64, f64, f64)], max_gap_ns: u64) -> Track {
        let position = |&(t_ns, east, north): &(i64, f64, f64)| Position {
            t_ns,
            place: [east, north],
        };
        Track::new(positions.iter().map(position), max_gap_ns)
    }

    #[test]
    fn between_positions_is_the_straight_line() {
        let track = track(&[(-10, 0.0, 5.0), (10, 4.0, 5.0), (30, 4.0, -5.0)], 20);
        for (t_ns, expected) in [
            (-11, None),
            (-10, Some([0.0, 5.0])),
            (0, Some([2.0, 5.0])),
            (9, Some([3.8, 5.0])),
            (10, Some([4.0, 5.0])),
            (25, Some([4.0, -2.5])),
            (30, Some([4.0, -5.0])),
            (31, None),
        ] {
            assert_eq!(track.at(t_ns), expected, "{t_ns}");
        }
    }

    #[test]
    fn nothing_is_known_inside_a_gap() {
        let track = track(&[(0, 0.0, 0.0), (20, 2.0, 0.0), (41, 4.0, 0.0)], 20);
        assert_eq!(track.at(19), Some([1.9, 0.0]));
        assert_eq!(track.at(20), Some([2.0, 0.0]));
        assert_eq!(track.at(21), None);
        assert_eq!(track.at(41), Some([4.0, 0.0]));
    }

    #[test]
    fn times_that_do_not_grow_and_places_that_are_none_are_left_out() {
        let all = [
            (5, 1.0, 1.0),
            (5, 2.0, 2.0),
            (4, 3.0, 3.0),
            (6, f64::NAN, 0.0),
            (7, 4.0, 4.0),
        ];
        let track = track(&all, 100);
        assert_eq!(track.positions().len(), 2);
        assert_eq!((track.at(5), track.at(6)), (Some([1.0, 1.0]), Some([2.5, 2.5])));
        assert_eq!(track.span_ns(), Some((5, 7)));
        assert_eq!(Track::new([], 1).at(0), None);
    }

    #[test]
    fn a_part_keeps_its_ends() {
        let all = track(&[(0, 0.0, 0.0), (1, 1.0, 0.0), (2, 2.0, 0.0), (3, 3.0, 0.0)], 9);
        assert_eq!(all.clone().part(1..=2).span_ns(), Some((1, 2)));
        assert_eq!(all.clone().part(0..=usize::MAX), all);
    }

    proptest! {
        #[test]
        fn a_steady_drive_is_known_everywhere(t in 0i64..1_000_000) {
            let steady = Track::new((0..=100).map(|i| Position { t_ns: i * 10_000, place: [i as f64, -2.0 * i as f64] }), 10_000);
            let [east, north] = steady.at(t).unwrap();
            prop_assert!((east - t as f64 / 1e4).abs() < 1e-9 && (north + t as f64 / 5e3).abs() < 1e-9);
        }
    }
}
