//! The mask of hot pixels, and learning it while events go by.

use crate::RawEvent;
use evpr_core::plan::{HotPixelRule, Pixel, Sensor};
use evpr_events::PixelCounts;

/// A bit per pixel.
#[derive(Debug)]
pub(super) struct Mask {
    width: usize,
    bits: Vec<u64>,
}

impl Mask {
    pub(super) fn new(sensor: Sensor, pixels: &[Pixel]) -> Self {
        let mut mask = Self {
            width: sensor.width,
            bits: vec![0; sensor.pixels().div_ceil(64)],
        };
        for pixel in pixels {
            let (word, bit) = mask.place(pixel.x, pixel.y);
            if let Some(word) = mask.bits.get_mut(word) {
                *word |= bit;
            }
        }
        mask
    }

    #[inline]
    fn place(&self, x: u16, y: u16) -> (usize, u64) {
        let at = usize::from(y) * self.width + usize::from(x);
        (at / 64, 1 << (at % 64))
    }

    /// Takes events of masked pixels out, from this one of the batch on; gives how many.
    pub(super) fn apply(&self, batch: &mut Vec<RawEvent>, from: usize) -> u64 {
        let before = batch.len();
        let mut kept = from;
        for at in from..batch.len() {
            let event = batch[at];
            let (word, bit) = self.place(event.x, event.y);
            // Written in any case: what is masked is written over by the next.
            batch[kept] = event;
            kept += usize::from(self.bits.get(word).is_none_or(|word| word & bit == 0));
        }
        batch.truncate(kept.min(before));
        (before - batch.len()) as u64
    }
}

/// Learns which pixels are hot from the events that go by.
#[derive(Debug)]
pub(super) struct Learner {
    sensor: Sensor,
    period_ns: u64,
    rule: HotPixelRule,
    counts: PixelCounts,
    end_ns: Option<u64>,
    learned_at: usize,
}

impl Learner {
    pub(super) fn new(sensor: Sensor, period_ns: u64, rule: HotPixelRule) -> Self {
        Self {
            sensor,
            period_ns,
            rule,
            counts: PixelCounts::new(Some(sensor)),
            end_ns: None,
            learned_at: 0,
        }
    }

    /// Counts the events of the period. Once the first one after it comes: the hot pixels, by rows.
    pub(super) fn learn(&mut self, batch: &[RawEvent]) -> Option<(Sensor, Vec<Pixel>)> {
        let first = batch.first()?;
        let end_ns = *self
            .end_ns
            .get_or_insert_with(|| first.t_ns.saturating_add(self.period_ns));
        let within = batch.partition_point(|e| e.t_ns < end_ns);
        batch[..within].iter().for_each(|e| self.counts.add(e));
        (within < batch.len()).then(|| {
            self.learned_at = within;
            (self.sensor, self.hot(self.period_ns))
        })
    }

    /// The place in the latest batch of the first event after the period.
    pub(super) fn learned_at(&self) -> usize {
        self.learned_at
    }

    /// What is hot by what was counted so far, over this length.
    pub(super) fn hot(&self, length_ns: u64) -> Vec<Pixel> {
        let hot = self.counts.hot(&self.rule, length_ns);
        hot.iter().map(|hot| hot.pixel()).collect()
    }
}
