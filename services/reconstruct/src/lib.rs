//! Reconstructions: the stages that turn events into frames.
//!
//! One [`Reconstruct`] is one method of the plan with all its windows. The edges of all windows cut the tick into
//! segments; every event is entered once, into its segment, and a window is put together from its segments when it
//! closes. (Where all windows begin with their tick, the segments so far share one slot, and are the window.) So all windows, both polarities and any alignment cost one pass over the events.
//!
//! A method is one file and one row of the `registry`: it knows how to enter events into a slot and how to
//! render consecutive slots; segments, completeness and members are the driver's affair.

mod age_levels;
mod avx2;
mod counters;
mod decay;
mod driver;
mod event_count;
mod event_count_no_polarity;
mod frames;
mod held;
mod last_times;
mod method;
mod network;
mod pixels;
mod registry;
mod time_surface;
mod voxels;

pub use driver::{BuildError, Reconstruct, build};
pub use frames::{ReadFrames, build_frames};
pub use registry::{ALL_KINDS, KINDS, kinds};
