//! `event_count`: events per pixel and polarity.

use crate::counters::Counters;
use crate::method::Method;
use crate::pixels::{Levels, interleave};
use evpr_core::message::Event;
use evpr_core::plan::Sensor;

/// Channels OFF, ON, 0. Per channel, with n the count and T = tanh(n) in f32:
/// `truncate(clip(T / (max T + 1e-6) · 255, 0, 255))`; all 0 where no event is (the paper's authors' code, which
/// scales by the largest only).
#[derive(Debug)]
pub(crate) struct EventCount {
    width: usize,
    counters: Counters<true>,
    /// tanh of every count.
    tanh: [f32; 256],
    off_levels: Vec<u8>,
    on_levels: Vec<u8>,
}

impl EventCount {
    /// For this sensor, with so many slots.
    pub(crate) fn new(sensor: Sensor, slots: usize) -> Self {
        Self {
            width: sensor.width,
            counters: Counters::new(sensor, slots),
            tanh: std::array::from_fn(|count| (count as f32).tanh()),
            off_levels: vec![0; sensor.width],
            on_levels: vec![0; sensor.width],
        }
    }
}

/// Levels of the counts in a channel whose largest count is `largest`.
fn levels(tanh: &[f32; 256], largest: u8) -> Levels {
    if largest == 0 {
        return Levels::new(|_| 0);
    }
    let scale = tanh[usize::from(largest)] + 1e-6;
    Levels::new(|count| (tanh[usize::from(count)] / scale * 255.0).clamp(0.0, 255.0) as u8)
}

/// `iter().max()` does not vectorise; a fold does.
fn largest(counts: &[u8], at_least: u8) -> u8 {
    counts.iter().fold(at_least, |a, b| a.max(*b))
}

impl Method for EventCount {
    fn accumulate(&mut self, slot: usize, events: &[Event], _base_us: u64) -> usize {
        self.counters.count(slot, events)
    }

    fn clear(&mut self, slot: usize) {
        self.counters.clear(slot);
    }

    fn render(&mut self, slots: &[usize], out: &mut [u8]) {
        let width = self.width;
        let counts = self.counters.sum(slots);
        let (mut off_largest, mut on_largest) = (0, 0);
        for rows in counts.chunks_exact(2 * width) {
            let (off, on) = rows.split_at(width);
            off_largest = largest(off, off_largest);
            on_largest = largest(on, on_largest);
        }
        let off_map = levels(&self.tanh, off_largest);
        let on_map = levels(&self.tanh, on_largest);
        for (rows, out) in counts
            .chunks_exact(2 * width)
            .zip(out.chunks_exact_mut(3 * width))
        {
            let (off, on) = rows.split_at(width);
            off_map.apply(off, &mut self.off_levels);
            on_map.apply(on, &mut self.on_levels);
            interleave(&self.off_levels, &self.on_levels, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The levels of the reference, by the channel's largest count.
    #[test]
    fn levels_are_the_reference_lists() {
        let method = EventCount::new(Sensor { height: 1, width: 1 }, 1);
        let list = |largest: u8| {
            let counts: Vec<u8> = (0..=largest).collect();
            let mut list = vec![9; counts.len()];
            levels(&method.tanh, largest).apply(&counts, &mut list);
            list
        };
        assert_eq!(list(0), [0]);
        assert_eq!(list(1), [0, 254]);
        assert_eq!(list(2), [0, 201, 254]);
        assert_eq!(list(3), [0, 195, 247, 254]);
        for largest in 4..=255 {
            let list = list(largest);
            assert_eq!(list[..5], [0, 194, 245, 253, 254], "largest {largest}");
            assert!(list[4..].iter().all(|l| *l == 254), "largest {largest}");
        }
    }

    #[test]
    fn a_channel_without_events_is_black() {
        let mut m = EventCount::new(Sensor { height: 1, width: 2 }, 1);
        m.accumulate(0, &[Event::new(0, 1, 0, true)], 0);
        let mut out = [9; 6];
        m.render(&[0], &mut out);
        assert_eq!(out, [0, 0, 0, 0, 254, 0]);
    }
}
