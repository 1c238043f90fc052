//! Recordings of event cameras, one file per format.
//!
//! [`open`] knows a recording's format by its content and gives a [`Recording`], which decodes it batch by batch:
//! memory does not grow with the recording. What arrives is never trusted: every length is capped and every failure is
//! one line ([`SourceError`]). Coordinates and the order of time are checked later, by whoever knows the sensor.

mod error;
mod event;
pub mod formats;
mod grid;
mod hot_pixels;
mod info;
mod input;
mod pixel_list;
pub mod positions;
mod rates;
mod recording;
pub mod writers;
mod zip;

pub use error::SourceError;
pub use event::{BATCH_EVENTS, MAX_TIME_NS, RawEvent, rough_seconds, seconds};
pub use formats::{ReadOptions, open, open_input};
pub use hot_pixels::{HotPixel, HotPixelEstimate, PixelCounts, estimate_hot_pixels};
pub use info::{HotPixelsFound, RecordingInfo, info};
pub use input::Input;
pub use pixel_list::{PixelListErrors, read_pixel_list};
pub use rates::{Gap, RateOverTime};
pub use recording::{Recording, Skipped, SourceInfo, Trajectory, agreed_sensor};
