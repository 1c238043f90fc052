//! Hot pixels: counting events per pixel, and telling which pixels fire without cause
//! ([`HotPixelRule`] states the rule).

use crate::grid::Grid;
use crate::{BATCH_EVENTS, RawEvent, ReadOptions, SourceError, SourceInfo, agreed_sensor, open};
use evpr_core::plan::{HotPixelRule, Pixel, Sensor};
use std::path::Path;

/// A hot pixel never has fewer events.
const LEAST_EVENTS: f64 = 20.0;
/// So far around it its neighbours reach, pixels.
const REACH: isize = 2;

/// A pixel that fires without cause.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct HotPixel {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// Its events.
    pub events: u64,
    /// Its events per second.
    pub rate_hz: f64,
}

impl HotPixel {
    /// Where it is.
    pub fn pixel(&self) -> Pixel {
        Pixel { x: self.x, y: self.y }
    }
}

/// How many events each pixel had. Up to 64 MiB, whatever the coordinates.
#[derive(Debug)]
pub struct PixelCounts {
    grid: Grid<u32>,
    /// Of the events, where `None` stands for outside of what is counted.
    outside: u64,
}

impl PixelCounts {
    /// No events yet. A sensor that is not known is taken to be as large as the events tell.
    pub fn new(sensor: Option<Sensor>) -> Self {
        Self {
            grid: Grid::new(sensor, 0),
            outside: 0,
        }
    }

    /// Counts an event.
    #[inline]
    pub fn add(&mut self, event: &RawEvent) {
        match self.grid.at(event.x, event.y) {
            Some(count) => *count = count.saturating_add(1),
            None => self.outside += 1,
        }
    }

    /// Events outside the sensor, or beyond what fits the memory: these are in no count.
    pub fn outside(&self) -> u64 {
        self.outside
    }

    /// The hot pixels, given that this was counted over `length_ns`; by rows. None when that is 0.
    pub fn hot(&self, rule: &HotPixelRule, length_ns: u64) -> Vec<HotPixel> {
        let seconds = length_ns as f64 / 1e9;
        let (width, _) = self.grid.size();
        if length_ns == 0 || width == 0 {
            return Vec::new();
        }
        let least = (rule.min_rate_hz * seconds).max(LEAST_EVENTS);
        let busy = self.grid.cells().iter().enumerate();
        let busy = busy.filter(|(_, n)| f64::from(**n) >= least);
        let hot = busy.filter_map(|(at, n)| {
            let (x, y) = (at % width, at / width);
            (f64::from(*n) > rule.factor * f64::from(self.third_busiest(x, y))).then(|| HotPixel {
                x: x as u16,
                y: y as u16,
                events: u64::from(*n),
                rate_hz: f64::from(*n) / seconds,
            })
        });
        hot.collect()
    }

    /// The third largest count among the neighbours; beyond the border they are mirrored.
    fn third_busiest(&self, x: usize, y: usize) -> u32 {
        let (width, height) = self.grid.size();
        let (own, mut top) = (y * width + x, [0u32; 3]);
        for dy in -REACH..=REACH {
            let row = mirrored(y, dy, height) * width;
            // Mirrored, the pixel may meet itself.
            let columns = (-REACH..=REACH).map(|dx| mirrored(x, dx, width));
            for place in columns.map(|x| row + x).filter(|place| *place != own) {
                let mut n = self.grid.cells()[place];
                for place in &mut top {
                    if n > *place {
                        std::mem::swap(place, &mut n);
                    }
                }
            }
        }
        top[2]
    }
}

/// `at + by` within 0 to `len`, mirrored at the first and the last place.
fn mirrored(at: usize, by: isize, len: usize) -> usize {
    let place = at.saturating_add_signed(by);
    if by < 0 && at < by.unsigned_abs() {
        (by.unsigned_abs() - at).min(len - 1)
    } else if place >= len {
        (2 * (len - 1)).saturating_sub(place)
    } else {
        place
    }
}

/// What a recording says of its camera's hot pixels.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct HotPixelEstimate {
    /// Format, path and unit of time.
    pub source: SourceInfo,
    /// Rows of the sensor, where the recording or the caller says it.
    pub height: Option<usize>,
    /// Columns of the sensor.
    pub width: Option<usize>,
    /// Number of events.
    pub events: u64,
    /// From the earliest to the latest event, s.
    pub duration_s: f64,
    /// As [`HotPixelRule::factor`].
    pub factor: f64,
    /// As [`HotPixelRule::min_rate_hz`].
    pub min_rate_hz: f64,
    /// The hot pixels, by rows.
    pub hot_pixels: Vec<HotPixel>,
    /// How many of the events are theirs.
    pub hot_events: u64,
}

/// Reads a recording through and tells its hot pixels. A sensor among the options must be the one that
/// the recording says, if it says it. `progress` is told the permille read.
///
/// # Errors
/// When the recording cannot be opened or read to its end, is of another sensor than the options say, or its
/// coordinates are beyond any.
pub fn estimate_hot_pixels(
    path: &Path,
    options: &ReadOptions,
    rule: &HotPixelRule,
    progress: &mut dyn FnMut(u64),
) -> Result<HotPixelEstimate, SourceError> {
    let mut recording = open(path, options)?;
    let sensor = agreed_sensor(path, recording.sensor(), options.sensor)?;
    let mut counts = PixelCounts::new(sensor);
    let (mut events, mut earliest, mut latest) = (0u64, u64::MAX, 0u64);
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    while recording.next_batch(&mut batch)? {
        for event in &batch {
            counts.add(event);
            (earliest, latest) = (earliest.min(event.t_ns), latest.max(event.t_ns));
        }
        events += batch.len() as u64;
        progress(recording.progress_permille());
    }
    if sensor.is_none() && counts.outside() > 0 {
        let what = format!(
            "has {} events with coordinates beyond any sensor; give the sensor's size, or repair the recording",
            counts.outside()
        );
        return Err(SourceError::malformed(path, what));
    }
    let length_ns = latest.saturating_sub(earliest);
    let hot_pixels = counts.hot(rule, length_ns);
    Ok(HotPixelEstimate {
        source: recording.describe(),
        height: sensor.map(|s| s.height),
        width: sensor.map(|s| s.width),
        events,
        duration_s: length_ns as f64 / 1e9,
        factor: rule.factor,
        min_rate_hz: rule.min_rate_hz,
        hot_events: hot_pixels.iter().map(|hot| hot.events).sum(),
        hot_pixels,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SENSOR: Sensor = Sensor {
        height: 12,
        width: 16,
    };
    const SECOND: u64 = 1_000_000_000;

    fn counted(pixels: &[(u16, u16, u32)]) -> PixelCounts {
        let mut counts = PixelCounts::new(Some(SENSOR));
        for (x, y, n) in pixels {
            for _ in 0..*n {
                let (t_ns, on) = (0, true);
                counts.add(&RawEvent {
                    t_ns,
                    x: *x,
                    y: *y,
                    on,
                });
            }
        }
        counts
    }

    fn found(pixels: &[(u16, u16, u32)], length_ns: u64) -> Vec<(u16, u16)> {
        let hot = counted(pixels).hot(&HotPixelRule::default(), length_ns);
        hot.iter().map(|hot| (hot.x, hot.y)).collect()
    }

    #[test]
    fn lone_busy_pixels_are_hot_and_lines_are_not() {
        // In corners too; by rows.
        assert_eq!(
            found(&[(15, 11, 100), (1, 0, 100), (0, 0, 100), (7, 5, 100)], SECOND),
            [(0, 0), (1, 0), (7, 5), (15, 11)]
        );
        assert_eq!(found(&[(1, 1, 100), (14, 10, 100)], SECOND).len(), 2);
        let line: Vec<_> = (0..16).map(|x| (x, 4, 100)).collect();
        assert!(found(&line, SECOND).is_empty());
        let diagonal: Vec<_> = (0..12).map(|i| (i, i, 100)).collect();
        assert!(found(&diagonal, SECOND).is_empty());
        // Three side by side are hot, four may be something.
        assert_eq!(found(&[(3, 3, 90), (4, 3, 80), (4, 4, 85)], SECOND).len(), 3);
        assert!(found(&[(3, 3, 90), (4, 3, 80), (4, 4, 85), (3, 4, 90)], SECOND).is_empty());
    }

    #[test]
    fn the_limits_are_exact() {
        // 20 events at least, and 5 per second.
        assert!(found(&[(7, 5, 19)], SECOND).is_empty());
        assert_eq!(found(&[(7, 5, 20)], SECOND).len(), 1);
        assert_eq!(found(&[(7, 5, 20)], 4 * SECOND).len(), 1);
        assert!(found(&[(7, 5, 20)], 4 * SECOND + 1).is_empty());
        // More than three times the third of the neighbours.
        let around = |n| [(7, 5, n), (8, 5, 50), (9, 5, 40), (5, 3, 20), (6, 5, 10)];
        assert!(!found(&around(60), SECOND).contains(&(7, 5)));
        assert!(found(&around(61), SECOND).contains(&(7, 5)));
        assert!(found(&[(7, 5, 1000)], 0).is_empty());
        let hot = counted(&[(7, 5, 30)]).hot(&HotPixelRule::default(), SECOND / 2);
        assert_eq!((hot[0].events, hot[0].rate_hz), (30, 60.0));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        /// Against the rule as it reads: all neighbours sorted.
        #[test]
        fn it_is_the_rule(raw in proptest::collection::vec((0u16..16, 0u16..12, 0u32..120), 0..40)) {
            let counts = counted(&raw);
            let count = |x: i32, y: i32| -> u32 {
                let at = |p: &&(u16, u16, u32)| (i32::from(p.0), i32::from(p.1)) == (x, y);
                raw.iter().filter(at).map(|p| p.2).sum()
            };
            let mut wanted = Vec::new();
            for y in 0..12 {
                for x in 0..16 {
                    let mirror = |at: i32, last: i32| if at > last { 2 * last - at } else { at.abs() };
                    let mut around: Vec<u32> = (-2..=2)
                        .flat_map(|dy| (-2..=2).map(move |dx| (dx, dy)))
                        .map(|(dx, dy)| (mirror(x + dx, 15), mirror(y + dy, 11)))
                        .filter(|place| *place != (x, y))
                        .map(|(x, y)| count(x, y))
                        .collect();
                    around.sort_unstable();
                    let n = count(x, y);
                    if n >= 20 && n > 3 * around[around.len() - 3] {
                        wanted.push((x as u16, y as u16));
                    }
                }
            }
            let hot = counts.hot(&HotPixelRule::default(), SECOND);
            prop_assert_eq!(hot.iter().map(|h| (h.x, h.y)).collect::<Vec<_>>(), wanted);
        }
    }
}
