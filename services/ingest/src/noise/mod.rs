//! Noise of the camera: hot pixels and filters, between the screen and the slicer.
//!
//! The order is: outside the sensor and backward times (the [`crate::Screen`]), hot pixels, refractory, background
//! activity. Ticks do not move when events are left out: their origin is the first event that passes the screen, and
//! the recording ends with the last one. In count mode, though, ticks count the events that are left.

mod filters;
mod find;
mod mask;
#[cfg(test)]
mod tests;

pub use find::{HotPixelsError, find_hot_pixels};

use crate::{RawEvent, SourceError};
use evpr_core::plan::{HotPixels, HotPixelsFrom, MaskedBy, Plan};
use filters::FilterTable;
use mask::{Learner, Mask};

/// What was left out as noise.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NoiseTally {
    /// Events of masked pixels.
    pub hot_pixels: u64,
    /// Events too soon after one of the same pixel.
    pub refractory: u64,
    /// Events without one of a neighbour shortly before.
    pub background_activity: u64,
}

impl NoiseTally {
    /// Events left out.
    pub fn dropped(&self) -> u64 {
        self.hot_pixels + self.refractory + self.background_activity
    }

    /// Says in the log what was left out, if anything was.
    pub(crate) fn log(&self) {
        if *self != Self::default() {
            tracing::info!(
                hot_pixels = self.hot_pixels,
                refractory = self.refractory,
                background_activity = self.background_activity,
                "events left out as noise"
            );
        }
    }
}

/// How much of what came before decides what becomes of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Memory {
    /// The events of this long before, ns.
    Ns(u64),
    /// Every event since the start: a chain of events, each too soon after the one before, is as long as it likes.
    All,
}

/// Leaves out noise. Expects what the screen lets pass; how it comes in batches changes nothing.
#[derive(Debug, Default)]
pub struct Noise {
    mask: Option<Mask>,
    learner: Option<Learner>,
    filters: Option<FilterTable>,
    tally: NoiseTally,
}

impl Noise {
    /// As the plan says. A mask that is to be learned and is not in the plan yet ([`find_hot_pixels`] puts it there) is
    /// learned under way: it holds from the first event after its period on.
    ///
    /// # Errors
    /// When the mask is that of a file, and not in the plan.
    pub fn new(plan: &Plan) -> Result<Self, SourceError> {
        let hot = plan.source.hot_pixels.as_ref();
        let hot = hot.filter(|hot| hot.masked_by == MaskedBy::Ingest);
        let learner = match hot {
            Some(HotPixels {
                pixels: None, from, ..
            }) => match from {
                HotPixelsFrom::Learn { period_ns, rule } => {
                    Some(Learner::new(plan.sensor, *period_ns, *rule))
                }
                HotPixelsFrom::File(path) => {
                    return Err(SourceError::Setup(format!(
                        "the hot pixels of {} are not in the plan; make it anew from its configuration",
                        path.display()
                    )));
                }
            },
            _ => None,
        };
        Ok(Self {
            mask: hot
                .and_then(|hot| hot.pixels.as_deref())
                .filter(|pixels| !pixels.is_empty())
                .map(|pixels| Mask::new(plan.sensor, pixels)),
            learner,
            filters: FilterTable::new(plan.sensor, &plan.source.filters),
            tally: NoiseTally::default(),
        })
    }

    /// What it has left out.
    pub fn tally(&self) -> NoiseTally {
        self.tally
    }

    /// What it has to see before the first event that counts.
    pub(crate) fn memory(&self) -> Memory {
        if self.learner.is_some() {
            return Memory::All;
        }
        self.filters.as_ref().map_or(Memory::Ns(0), FilterTable::memory)
    }

    /// Takes noise out of the batch.
    pub fn apply(&mut self, batch: &mut Vec<RawEvent>) {
        if let Some(learner) = &mut self.learner
            && let Some((sensor, pixels)) = learner.learn(batch)
        {
            // What is learned holds for the rest of the batch; the events before it pass.
            let rest = learner.learned_at();
            tracing::info!(
                hot_pixels = pixels.len(),
                "hot pixels learned, masked from now on"
            );
            let mask = Mask::new(sensor, &pixels);
            self.tally.hot_pixels += mask.apply(batch, rest);
            self.mask = Some(mask);
            self.learner = None;
        } else if let Some(mask) = &self.mask {
            self.tally.hot_pixels += mask.apply(batch, 0);
        }
        if let Some(filters) = &mut self.filters {
            filters.apply(batch, &mut self.tally);
        }
    }
}
