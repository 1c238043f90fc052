//! The filters: refractory, and background activity after Delbruck ("Frame-free dynamic digital vision", 2008, the
//! `BackgroundActivityFilter`).

use super::{Memory, NoiseTally};
use crate::RawEvent;
use evpr_core::plan::{Filters, Sensor};

/// Both filters, with one table: per pixel the time of its latest event that the refractory filter kept. That is what
/// either of them asks for.
#[derive(Debug)]
pub(super) struct FilterTable {
    refractory_ns: Option<u64>,
    background_activity_ns: Option<u64>,
    /// Times in the table are so much later, which leaves 0 for "never": that is longer ago than either length.
    shift_ns: u64,
    /// Columns of the table: one more on each side than the sensor has.
    stride: usize,
    latest: Vec<u64>,
}

impl FilterTable {
    /// `None` when both are off.
    pub(super) fn new(sensor: Sensor, filters: &Filters) -> Option<Self> {
        let Filters {
            refractory_ns,
            background_activity_ns,
        } = *filters;
        let longest_ns = refractory_ns.max(background_activity_ns)?;
        let stride = sensor.width + 2;
        Some(Self {
            refractory_ns,
            background_activity_ns,
            shift_ns: longest_ns.saturating_add(1),
            stride,
            latest: vec![0; stride * (sensor.height + 2)],
        })
    }

    pub(super) fn memory(&self) -> Memory {
        match self.refractory_ns {
            Some(_) => Memory::All,
            None => Memory::Ns(self.background_activity_ns.unwrap_or(0)),
        }
    }

    pub(super) fn apply(&mut self, batch: &mut Vec<RawEvent>, tally: &mut NoiseTally) {
        match (self.refractory_ns, self.background_activity_ns) {
            (Some(r), Some(b)) => self.pass::<true, true>(r, b, batch, tally),
            (Some(r), None) => self.pass::<true, false>(r, 0, batch, tally),
            (None, Some(b)) => self.pass::<false, true>(0, b, batch, tally),
            (None, None) => {}
        }
    }

    fn pass<const REFRACTORY: bool, const BACKGROUND: bool>(
        &mut self,
        refractory_ns: u64,
        background_ns: u64,
        batch: &mut Vec<RawEvent>,
        tally: &mut NoiseTally,
    ) {
        let stride = self.stride;
        let mut kept = 0;
        for at in 0..batch.len() {
            let event = batch[at];
            let t = event.t_ns.saturating_add(self.shift_ns);
            let above = usize::from(event.y) * stride + usize::from(event.x);
            // Rows above, of and below the pixel, each from the column to the left.
            let Some(around) = self.latest.get_mut(above..above + 2 * stride + 3) else {
                debug_assert!(false, "the screen lets nothing pass from outside the sensor");
                continue;
            };
            let own = stride + 1;
            if REFRACTORY && t.saturating_sub(around[own]) < refractory_ns {
                tally.refractory += 1;
                continue;
            }
            if BACKGROUND {
                let row = |at: usize| around[at].max(around[at + 1]).max(around[at + 2]);
                let latest = row(0)
                    .max(row(2 * stride))
                    .max(around[stride])
                    .max(around[stride + 2]);
                around[own] = t;
                if t.saturating_sub(latest) > background_ns {
                    tally.background_activity += 1;
                    continue;
                }
            } else {
                around[own] = t;
            }
            batch[kept] = event;
            kept += 1;
        }
        batch.truncate(kept);
    }
}
