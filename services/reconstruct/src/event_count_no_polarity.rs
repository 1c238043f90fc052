//! `event_count_no_polarity`: events per pixel.

use crate::counters::Counters;
use crate::method::Method;
use crate::pixels::Levels;
use evpr_core::message::Event;
use evpr_core::plan::Sensor;

/// One channel. With n the count over both polarities: `truncate((tanh(n) + 1) / 2 · 255)` in f32; not scaled by the
/// frame's own range (the paper's authors' code).
#[derive(Debug)]
pub(crate) struct EventCountNoPolarity {
    counters: Counters<false>,
    map: Levels,
}

impl EventCountNoPolarity {
    /// For this sensor, with so many slots.
    pub(crate) fn new(sensor: Sensor, slots: usize) -> Self {
        Self {
            counters: Counters::new(sensor, slots),
            map: Levels::new(level, level),
        }
    }
}

/// Level of a count.
fn level(count: u8) -> u8 {
    ((f32::from(count).tanh() + 1.0) / 2.0 * 255.0) as u8
}

impl Method for EventCountNoPolarity {
    fn accumulate(&mut self, slot: usize, events: &[Event], _base_us: u64) -> usize {
        self.counters.count(slot, events)
    }

    fn clear(&mut self, slot: usize) {
        self.counters.clear(slot);
    }

    fn render(&mut self, slots: &[usize], out: &mut [u8]) {
        self.map.apply(self.counters.sum(slots), out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_the_reference_list() {
        let list: Vec<u8> = (0..=255).map(level).collect();
        assert_eq!(list[..10], [127, 224, 250, 254, 254, 254, 254, 254, 254, 255]);
        assert!(list[9..].iter().all(|l| *l == 255));
    }
}
