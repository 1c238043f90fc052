//! `event_count`: events per pixel and polarity.

use crate::counters::Counters;
use crate::method::Method;
use crate::pixels::{Levels, largest, render_pairs};
use evpr_core::message::Event;
use evpr_core::plan::Sensor;

/// Channels OFF, ON, 0. Per channel, with n the count and T = tanh(n) in f32:
/// `truncate(clip(T / (max T + 1e-6) · 255, 0, 255))`; all 0 where no event is (the paper's authors' code, which
/// scales by the largest only).
#[derive(Debug)]
pub(crate) struct EventCount {
    counters: Counters<true>,
    /// tanh of every count.
    tanh: [f32; 256],
    /// The levels of the frame before, and the largest counts they are for: those of most frames.
    levels: Levels,
    levels_for: [u8; 2],
}

impl EventCount {
    /// For this sensor, with so many slots.
    pub(crate) fn new(sensor: Sensor, slots: usize) -> Self {
        Self {
            counters: Counters::new(sensor, slots),
            tanh: std::array::from_fn(|count| (count as f32).tanh()),
            levels: Levels::new(|_| 0, |_| 0),
            levels_for: [0; 2],
        }
    }
}

/// From here on the levels are those of u8::MAX, whatever the channel's largest count.
const SETTLED: u8 = 4;

/// Level of a count in a channel whose largest count is `largest`.
fn level(tanh: &[f32; 256], largest: u8, count: u8) -> u8 {
    if largest == 0 {
        return 0;
    }
    let scale = tanh[usize::from(largest)] + 1e-6;
    (tanh[usize::from(count)] / scale * 255.0).clamp(0.0, 255.0) as u8
}

impl Method for EventCount {
    fn accumulate(&mut self, slot: usize, events: &[Event], _base_us: u64) -> usize {
        self.counters.count(slot, events)
    }

    fn clear(&mut self, slot: usize) {
        self.counters.clear(slot);
    }

    fn render(&mut self, slots: &[usize], out: &mut [u8]) {
        let counts = self.counters.sum(slots);
        let largest = largest(counts, SETTLED).map(|n| if n < SETTLED { n } else { u8::MAX });
        if largest != self.levels_for {
            let tanh = &self.tanh;
            let map = |largest| move |count| level(tanh, largest, count);
            self.levels = Levels::new(map(largest[0]), map(largest[1]));
            self.levels_for = largest;
        }
        render_pairs(counts, out, |counts, out| self.levels.apply(counts, out));
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
            let counts = 0..=largest;
            counts
                .map(|count| level(&method.tanh, largest, count))
                .collect::<Vec<_>>()
        };
        assert_eq!(list(0), [0]);
        assert_eq!(list(1), [0, 254]);
        assert_eq!(list(2), [0, 201, 254]);
        assert_eq!(list(3), [0, 195, 247, 254]);
        let longest = list(255);
        for largest in SETTLED..=255 {
            let list = list(largest);
            assert_eq!(list, longest[..list.len()]);
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

    /// The levels kept from one frame do not show in the next, whose largest count is another.
    #[test]
    fn frames_of_different_largest_counts_follow_each_other() {
        let mut m = EventCount::new(Sensor { height: 1, width: 1 }, 3);
        let (off, on) = (Event::new(0, 0, 0, false), Event::new(0, 0, 0, true));
        m.accumulate(0, &[off], 0);
        m.accumulate(1, &[on; 9], 0);
        m.accumulate(1, &[off; 2], 0);
        let mut out = [9; 3];
        for (slot, expected) in [
            (0, [254, 0, 0]),
            (1, [254, 254, 0]),
            (2, [0; 3]),
            (0, [254, 0, 0]),
        ] {
            m.render(&[slot], &mut out);
            assert_eq!(out, expected, "slot {slot}");
        }
    }
}
