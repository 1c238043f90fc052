//! Ingest: reads a recording, checks its events, and cuts them into ticks, segments and chunks.
//!
//! The way of an event: an [`evpr_events::Recording`] decodes it, the [`Screen`] checks it against the sensor and the
//! order of time, [`Noise`] leaves it out if its pixel is hot or a filter says so, and the [`Slicer`] puts it into its
//! segment. [`Ingest`] runs the four, decoding ahead on a thread of its own, and paces the replay; [`Live`] does so with a
//! stream that waits for nobody.

mod driver;
#[cfg(test)]
mod driver_tests;
mod enabled;
mod frames;
mod live;
mod noise;
mod pace;
mod placed;
mod reader;
mod screen;
mod slicer;
#[cfg(test)]
mod slicer_tests;
pub mod source;
mod span;
pub mod tape;
#[cfg(test)]
mod testing;

pub use driver::{Ingest, IngestSummary};
pub use evpr_events::SourceError;
pub use frames::FrameIngest;
pub use live::{Live, LiveSummary};
pub use noise::{HotPixelsError, Noise, NoiseTally, find_hot_pixels};
pub use screen::{Screen, ScreenTally};
pub use slicer::{MAX_GAP_TICKS, SliceTally, Slicer};
pub use source::{open, probe};

use evpr_events::{MAX_TIME_NS, RawEvent};
