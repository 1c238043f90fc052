//! The voxel grid of a window: what E2VID and its like see of events.
//!
//! As in `rpg_e2vid` (Rebecq et al., "High Speed and High Dynamic Range Video with an Event Camera", section 3): with B
//! bins, an event of polarity p = ±1 at time t counts p·(1 − f) in bin ⌊t*⌋ and p·f in the next one, if there is one,
//! where t* = (B − 1)(t − t_first)/(t_last − t_first) and f its fraction. Hot pixels are then zero; what is not zero is
//! shifted and scaled to mean 0 and standard deviation 1; and the borders are filled by reflection.

use evpr_core::message::Event;
use evpr_core::plan::{Pixel, Sensor};

/// The most events that a segment may have: 512 MiB.
const MAX_EVENTS: usize = 64 << 20;

/// The events of a segment, in stream order, within the sensor.
#[derive(Debug, Clone, Default)]
pub(crate) struct KeptEvents {
    /// `t_us` counts from `base_us`.
    events: Vec<Event>,
    base_us: u64,
    /// Why there are not all of them, once there are not.
    lost: Option<&'static str>,
}

impl KeptEvents {
    /// Forgets all; keeps the memory.
    pub(crate) fn clear(&mut self) {
        self.events.clear();
        self.lost = None;
    }

    /// Keeps the events that lie in the sensor; returns how many.
    pub(crate) fn keep(&mut self, events: &[Event], base_us: u64, sensor: Sensor) -> usize {
        if self.events.is_empty() {
            self.base_us = base_us;
        }
        let inside = |e: &&Event| usize::from(e.x) < sensor.width && usize::from(e.y()) < sensor.height;
        let inside = events.iter().filter(inside);
        // How much later this chunk's base is; times within a segment may step back a little.
        let later = i128::from(base_us) - i128::from(self.base_us);
        let mut entered = 0;
        for event in inside {
            entered += 1;
            let Ok(t_us) = u32::try_from(later + i128::from(event.t_us)) else {
                self.lost = Some("its times are more than 71 minutes apart");
                continue;
            };
            if self.events.len() == MAX_EVENTS {
                self.lost = Some("it has more than 67108864 events in a segment; write shorter windows");
                continue;
            }
            self.events.push(Event { t_us, ..*event });
        }
        entered
    }

    /// Time of an event, µs.
    fn time_us(&self, event: &Event) -> u64 {
        self.base_us.saturating_add(event.t_us.into())
    }
}

/// Puts voxel grids together for one sensor.
#[derive(Debug)]
pub(crate) struct VoxelGrid {
    sensor: Sensor,
    bins: usize,
    /// Height and width, padding included.
    padded: Sensor,
    /// Rows and columns of padding before the first pixel.
    top: usize,
    left: usize,
    /// bins × padded height × padded width.
    grid: Vec<f32>,
    masked: Vec<Pixel>,
}

impl VoxelGrid {
    /// Grids of so many bins, padded by reflection to this size.
    ///
    /// # Errors
    /// One line, when the sensor is too small to be reflected so far.
    pub(crate) fn new(sensor: Sensor, bins: usize, padded: Sensor) -> Result<Self, String> {
        // As rpg_e2vid's CropParameters: the larger half before.
        let before = |padded: usize, side: usize| (padded - side).div_ceil(2);
        let top = before(padded.height, sensor.height);
        let left = before(padded.width, sensor.width);
        if top >= sensor.height || left >= sensor.width {
            return Err(format!(
                "a sensor of {sensor} is too small to be padded to {padded} by reflection"
            ));
        }
        Ok(Self {
            sensor,
            bins,
            padded,
            top,
            left,
            grid: vec![0.0; bins * padded.pixels()],
            masked: Vec::new(),
        })
    }

    /// These pixels are to be zero.
    pub(crate) fn mask(&mut self, pixels: &[Pixel]) {
        self.masked = pixels.to_vec();
    }

    /// The grid that was filled last: bins × padded height × padded width.
    pub(crate) fn values(&self) -> &[f32] {
        &self.grid
    }

    /// Makes the grid of these segments, given in stream order.
    ///
    /// # Errors
    /// One line, when not all of their events could be kept.
    pub(crate) fn fill<'s>(
        &mut self,
        segments: impl Iterator<Item = &'s KeptEvents> + Clone,
    ) -> Result<(), String> {
        if let Some(lost) = segments.clone().find_map(|s| s.lost) {
            return Err(format!("no voxel grid of this window: {lost}"));
        }
        self.grid.fill(0.0);
        let with_events = segments.filter(|s| !s.events.is_empty());
        let first = with_events
            .clone()
            .find_map(|s| Some(s.time_us(s.events.first()?)));
        let last = with_events
            .clone()
            .filter_map(|s| Some(s.time_us(s.events.last()?)))
            .last();
        let (Some(first), Some(last)) = (first, last) else {
            return Ok(());
        };
        for segment in with_events {
            self.enter(segment, first, last);
        }
        self.zero_masked();
        self.normalise();
        self.reflect();
        Ok(())
    }

    /// Enters a segment of a window whose first and last events are at these times, µs.
    fn enter(&mut self, segment: &KeptEvents, first_us: u64, last_us: u64) {
        let span = last_us.saturating_sub(first_us).max(1) as f64;
        let steps = (self.bins - 1) as f64;
        let plane = self.padded.pixels();
        let offset = self.top * self.padded.width + self.left;
        // A time before the first event's (stream order need not be that of times) counts as the first.
        let since_first = segment.base_us as i128 - i128::from(first_us);
        for event in &segment.events {
            let since = (since_first + i128::from(event.t_us)).max(0) as f64;
            let position = (steps * since / span).min(steps);
            let bin = position as usize;
            let fraction = position - bin as f64;
            let polarity = if event.on() { 1.0 } else { -1.0 };
            let pixel = offset + usize::from(event.y()) * self.padded.width + usize::from(event.x);
            if let Some(value) = self.grid.get_mut(bin * plane + pixel) {
                *value += (polarity * (1.0 - fraction)) as f32;
            }
            if let Some(value) = self.grid.get_mut((bin + 1) * plane + pixel) {
                *value += (polarity * fraction) as f32;
            }
        }
    }

    fn zero_masked(&mut self) {
        let (plane, width) = (self.padded.pixels(), self.padded.width);
        for pixel in &self.masked {
            let at = (self.top + usize::from(pixel.y)) * width + self.left + usize::from(pixel.x);
            for bin in 0..self.bins {
                if let Some(value) = self.grid.get_mut(bin * plane + at) {
                    *value = 0.0;
                }
            }
        }
    }

    /// Shifts and scales what is not zero to mean 0 and standard deviation 1. Where all of it is equal it becomes 0
    /// (the published code divides by 0 there).
    fn normalise(&mut self) {
        let (count, sum, squares) = moments(&self.grid);
        if count == 0 {
            return;
        }
        let mean = sum / count as f64;
        let variance = squares / count as f64 - mean * mean;
        // Below this a difference is what rounding leaves.
        let equal = variance <= 1e-12 * (squares / count as f64);
        let scale = if equal { 0.0 } else { 1.0 / variance.sqrt() };
        for value in &mut self.grid {
            let normal = ((f64::from(*value) - mean) * scale) as f32;
            *value = if *value == 0.0 { 0.0 } else { normal };
        }
    }

    /// Fills the padding: row −1 is row 1, and so on.
    fn reflect(&mut self) {
        let (height, width) = (self.sensor.height, self.sensor.width);
        let (top, left, stride) = (self.top, self.left, self.padded.width);
        for plane in self.grid.chunks_exact_mut(self.padded.pixels()) {
            for row in plane.chunks_exact_mut(stride).skip(top).take(height) {
                for column in (0..left).chain(left + width..stride) {
                    row[column] = row[left + reflected(column as isize - left as isize, width)];
                }
            }
            for row in (0..top).chain(top + height..self.padded.height) {
                let from = top + reflected(row as isize - top as isize, height);
                plane.copy_within(from * stride..(from + 1) * stride, row * stride);
            }
        }
    }

    /// Writes the part of a frame of the padded size that is the sensor's, as levels: × 255, clamped, truncated.
    pub(crate) fn crop(&self, frame: &[f32], levels: &mut [u8]) {
        let rows = frame.chunks_exact(self.padded.width).skip(self.top);
        for (row, out) in rows.zip(levels.chunks_exact_mut(self.sensor.width)) {
            for (value, out) in row[self.left..].iter().zip(out) {
                *out = (value * 255.0).clamp(0.0, 255.0) as u8;
            }
        }
    }
}

/// How many of these values are not zero, their sum, and the sum of their squares. Several sums at once: one alone would
/// wait for each of its additions.
fn moments(values: &[f32]) -> (u64, f64, f64) {
    const LANES: usize = 8;
    let (mut counts, mut sums, mut squares) = ([0u64; LANES], [0.0f64; LANES], [0.0f64; LANES]);
    let (groups, rest) = values.as_chunks::<LANES>();
    let mut enter = |lane: usize, value: f32| {
        let v = f64::from(value);
        counts[lane] += u64::from(value != 0.0);
        sums[lane] += v;
        squares[lane] += v * v;
    };
    for group in groups {
        (0..LANES).for_each(|lane| enter(lane, group[lane]));
    }
    rest.iter()
        .enumerate()
        .for_each(|(lane, value)| enter(lane, *value));
    (counts.iter().sum(), sums.iter().sum(), squares.iter().sum())
}

/// The index within `len` that an index outside it is a reflection of; the border itself is not repeated.
fn reflected(index: isize, len: usize) -> usize {
    let last = len as isize - 1;
    let from_start = index.abs();
    let inside = if from_start > last {
        2 * last - from_start
    } else {
        from_start
    };
    inside.clamp(0, last) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor { height: 2, width: 3 };

    fn event(t_us: u32, x: u16, y: u16, on: bool) -> Event {
        Event::new(t_us, x, y, on)
    }

    fn kept(events: &[Event], base_us: u64) -> KeptEvents {
        let mut kept = KeptEvents::default();
        kept.keep(events, base_us, SENSOR);
        kept
    }

    fn grid() -> VoxelGrid {
        VoxelGrid::new(SENSOR, 5, SENSOR).unwrap()
    }

    /// The value of a bin and pixel before normalisation.
    fn raw(segments: &[KeptEvents]) -> Vec<f32> {
        let mut grid = grid();
        let first = segments[0].time_us(&segments[0].events[0]);
        let last = segments.last().unwrap();
        let last = last.time_us(last.events.last().unwrap());
        for segment in segments {
            grid.enter(segment, first, last);
        }
        grid.grid
    }

    #[test]
    fn events_are_split_between_two_bins() {
        // 100 … 500 µs over 5 bins: 100 µs a bin.
        let events = [
            event(100, 0, 0, true),
            event(225, 1, 0, false),
            event(500, 2, 1, true),
        ];
        let got = raw(&[kept(&events, 7_000)]);
        let mut expected = vec![0.0; 30];
        expected[0] = 1.0;
        expected[6 + 1] = -0.75;
        expected[12 + 1] = -0.25;
        expected[24 + 5] = 1.0;
        assert_eq!(got, expected);
    }

    #[test]
    fn one_window_of_several_segments_and_bases_is_the_same() {
        let events = [
            event(100, 0, 0, true),
            event(225, 1, 0, false),
            event(500, 2, 1, true),
        ];
        let whole = raw(&[kept(&events, 7_000)]);
        let parts = [
            kept(&events[..1], 7_000),
            kept(&[event(25, 1, 0, false)], 7_200),
            kept(&[event(0, 2, 1, true)], 7_500),
        ];
        assert_eq!(raw(&parts), whole);
        let mut later = kept(&events[..1], 7_000);
        later.keep(&[event(25, 1, 0, false), event(300, 2, 1, true)], 7_200, SENSOR);
        assert_eq!(raw(&[later]), whole);
    }

    #[test]
    fn what_is_not_zero_gets_mean_0_and_deviation_1() {
        let events = [
            event(0, 0, 0, true),
            event(0, 1, 0, true),
            event(0, 1, 0, true),
            event(0, 2, 1, false),
        ];
        let mut grid = grid();
        grid.fill([kept(&events, 0)].iter()).unwrap();
        let got = grid.values();
        // 1, 2 and −1: mean 2/3, variance 2 − 4/9.
        let deviation = (2.0f64 - 4.0 / 9.0).sqrt();
        let expected = |v: f64| ((v - 2.0 / 3.0) / deviation) as f32;
        let close = |a: f32, b: f32| (a - b).abs() < 1e-6;
        assert!(
            close(got[0], expected(1.0)) && close(got[1], expected(2.0)) && close(got[5], expected(-1.0))
        );
        assert!(
            got.iter()
                .enumerate()
                .all(|(i, v)| [0, 1, 5].contains(&i) || *v == 0.0)
        );
    }

    #[test]
    fn equal_values_become_zero_and_not_infinite() {
        let mut grid = grid();
        grid.fill([kept(&[event(5, 0, 0, true)], 0)].iter()).unwrap();
        assert!(grid.values().iter().all(|v| *v == 0.0));
        grid.fill([KeptEvents::default()].iter()).unwrap();
        assert!(grid.values().iter().all(|v| *v == 0.0));
    }

    #[test]
    fn masked_pixels_do_not_count() {
        let events = [
            event(0, 0, 0, true),
            event(0, 1, 0, true),
            event(0, 1, 0, true),
            event(0, 2, 1, false),
        ];
        let mut masked = grid();
        masked.mask(&[Pixel { x: 1, y: 0 }]);
        masked.fill([kept(&events, 0)].iter()).unwrap();
        let got = masked.values();
        let mut without = grid();
        let others = [events[0], events[3]];
        without.fill([kept(&others, 0)].iter()).unwrap();
        assert_eq!(got, without.values());
        assert_eq!((got[0], got[5]), (1.0, -1.0));
    }

    /// Grids made by `scripts/make_voxel_golden.py`.
    #[test]
    fn grids_are_those_of_the_golden_arrays() {
        use ndarray::{Array2, Array3};
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden_voxels");
        for (name, height, width) in [("odd", 13, 21), ("whole", 16, 24)] {
            let sensor = Sensor { height, width };
            let read = |what: &str| -> Array2<i64> {
                ndarray_npy::read_npy(folder.join(format!("{name}.{what}.npy"))).unwrap()
            };
            let expected: Array3<f32> =
                ndarray_npy::read_npy(folder.join(format!("{name}.voxels.npy"))).unwrap();
            let padded = Sensor {
                height: expected.shape()[1],
                width: expected.shape()[2],
            };
            // In three segments, each with a base of its own.
            let events = read("events");
            let rows: Vec<_> = events.rows().into_iter().collect();
            let segments: Vec<KeptEvents> = rows
                .chunks(rows.len().div_ceil(3))
                .map(|rows| {
                    let base_us = rows[0][0] as u64 - 7;
                    let events = rows.iter().map(|row| {
                        event(
                            (row[0] as u64 - base_us) as u32,
                            row[1] as u16,
                            row[2] as u16,
                            row[3] == 1,
                        )
                    });
                    let mut kept = KeptEvents::default();
                    kept.keep(&events.collect::<Vec<_>>(), base_us, sensor);
                    kept
                })
                .collect();
            let mut grid = VoxelGrid::new(sensor, 5, padded).unwrap();
            let hot = read("hot");
            let hot: Vec<Pixel> = hot
                .rows()
                .into_iter()
                .map(|p| Pixel {
                    x: p[0] as u16,
                    y: p[1] as u16,
                })
                .collect();
            grid.mask(&hot);
            grid.fill(segments.iter()).unwrap();
            let expected = expected.as_slice().unwrap();
            let worst = grid
                .values()
                .iter()
                .zip(expected)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            assert!(worst < 2e-5, "{name}: they differ by {worst}");
        }
    }

    #[test]
    fn borders_are_reflected_and_cropped_back() {
        let padded = Sensor { height: 4, width: 6 };
        let mut grid = VoxelGrid::new(SENSOR, 1, padded).unwrap();
        assert_eq!((grid.top, grid.left), (1, 2));
        for (i, value) in [1.0, 2.0, 3.0, 4.0, 5.0, 6.0].into_iter().enumerate() {
            grid.grid[(1 + i / 3) * 6 + 2 + i % 3] = value;
        }
        grid.reflect();
        // As torch.nn.ReflectionPad2d((2, 1, 1, 1)).
        let expected = [
            [6.0, 5.0, 4.0, 5.0, 6.0, 5.0],
            [3.0, 2.0, 1.0, 2.0, 3.0, 2.0],
            [6.0, 5.0, 4.0, 5.0, 6.0, 5.0],
            [3.0, 2.0, 1.0, 2.0, 3.0, 2.0],
        ];
        assert_eq!(grid.grid, expected.concat());
        let frame: Vec<f32> = grid.grid.iter().map(|v| v / 4.0 - 0.5).collect();
        let mut levels = [9; 6];
        grid.crop(&frame, &mut levels);
        // −.25, 0, .25, .5, .75 and 1 times 255.
        assert_eq!(levels, [0, 0, 63, 127, 191, 255]);
    }

    #[test]
    fn a_sensor_too_small_to_be_reflected_is_refused() {
        let tiny = Sensor { height: 5, width: 5 };
        assert!(VoxelGrid::new(tiny, 5, Sensor { height: 8, width: 8 }).is_ok());
        let tiny = Sensor { height: 2, width: 8 };
        let problem = VoxelGrid::new(tiny, 5, Sensor { height: 8, width: 8 }).unwrap_err();
        assert!(problem.contains("too small"), "{problem}");
    }

    #[test]
    fn times_too_far_apart_give_no_grid() {
        let mut far = kept(&[event(0, 0, 0, true)], 0);
        assert_eq!(far.keep(&[event(0, 1, 1, true)], 1 << 33, SENSOR), 1);
        let problem = grid().fill([far.clone()].iter()).unwrap_err();
        assert!(problem.contains("71 minutes"), "{problem}");
        far.clear();
        assert!(grid().fill([far].iter()).is_ok());
    }
}
