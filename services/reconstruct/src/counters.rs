//! Saturating event counters per pixel, for the counting methods.

use evpr_core::message::Event;
use evpr_core::plan::Sensor;

/// Slots of u8 counters, row-major. With `BY_POLARITY` a slot has a pair per pixel, OFF then ON; without, one counter for
/// both.
///
/// Counters stop at 255. That is exact: from 10 events on, tanh of a count is 1 in f32.
#[derive(Debug)]
pub(crate) struct Counters<const BY_POLARITY: bool> {
    width: usize,
    slots: Vec<Vec<u8>>,
    sum: Vec<u8>,
}

impl<const BY_POLARITY: bool> Counters<BY_POLARITY> {
    /// Empty counters.
    pub(crate) fn new(sensor: Sensor, slots: usize) -> Self {
        let len = sensor.pixels() * if BY_POLARITY { 2 } else { 1 };
        Self {
            width: sensor.width,
            slots: vec![vec![0; len]; slots],
            sum: vec![0; len],
        }
    }

    /// Counts events into a slot; returns how many lie in the sensor.
    pub(crate) fn count(&mut self, slot: usize, events: &[Event]) -> usize {
        let width = self.width;
        let counters = self.slots[slot].as_mut_slice();
        let mut counted = 0;
        for event in events {
            let x = usize::from(event.x);
            let pixel = usize::from(event.y()) * width + x;
            let index = if BY_POLARITY {
                2 * pixel + usize::from(event.on())
            } else {
                pixel
            };
            // With x in its row, an index inside the slot means that the row is there too.
            if x < width
                && let Some(counter) = counters.get_mut(index)
            {
                *counter = counter.saturating_add(1);
                counted += 1;
            }
        }
        counted
    }

    /// Sets a slot to 0.
    pub(crate) fn clear(&mut self, slot: usize) {
        self.slots[slot].fill(0);
    }

    /// The saturating sum of these slots.
    pub(crate) fn sum(&mut self, slots: &[usize]) -> &[u8] {
        match slots {
            [] => self.sum.fill(0),
            [only] => return &self.slots[*only],
            [first, rest @ ..] => {
                self.sum.copy_from_slice(&self.slots[*first]);
                for slot in rest {
                    for (sum, count) in self.sum.iter_mut().zip(&self.slots[*slot]) {
                        *sum = sum.saturating_add(*count);
                    }
                }
            }
        }
        &self.sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor { height: 2, width: 3 };

    fn event(x: u16, y: u16, on: bool) -> Event {
        Event::new(0, x, y, on)
    }

    #[test]
    fn counts_by_polarity_and_saturates() {
        let mut c = Counters::<true>::new(SENSOR, 2);
        assert_eq!(c.count(0, &vec![event(1, 1, true); 300]), 300);
        assert_eq!(c.count(1, &[event(1, 1, true), event(1, 1, false)]), 2);
        assert_eq!(c.sum(&[0]), [0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 0, 0]);
        assert_eq!(c.sum(&[0, 1]), [0, 0, 0, 0, 0, 0, 0, 0, 1, 255, 0, 0]);
        c.clear(0);
        assert_eq!(c.sum(&[1, 0]), [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 0, 0]);
        assert_eq!(c.sum(&[]), [0; 12]);
    }

    #[test]
    fn counts_both_polarities_together() {
        let mut c = Counters::<false>::new(SENSOR, 1);
        c.count(0, &[event(2, 0, true), event(2, 0, false), event(0, 1, true)]);
        assert_eq!(c.sum(&[0]), [0, 0, 2, 1, 0, 0]);
    }

    #[test]
    fn events_outside_the_sensor_are_left_out() {
        let outside = [
            event(3, 0, false),
            event(0, 2, true),
            event(u16::MAX, Event::Y_MAX, true),
        ];
        let mut c = Counters::<true>::new(SENSOR, 1);
        assert_eq!(c.count(0, &outside), 0);
        assert_eq!(c.sum(&[0]), [0; 12]);
        let mut c = Counters::<false>::new(SENSOR, 1);
        assert_eq!(c.count(0, &outside), 0);
        assert_eq!(c.sum(&[0]), [0; 6]);
    }
}
