//! Fusion: compares the rows of a tick with a reference map, matches sequences, and makes one answer per tick of all
//! members.
//!
//! The way of a row, with the file that does each step:
//! 1. [`similarity`]: the row against every row of the map, S\[q, j\];
//! 2. [`sequence`]: the last L similarity rows of a member, with holes, S̃\[q, j\];
//! 3. [`ensemble`]: E = Σ w·S̃ over the members that have a row, or another rule of [`fusion`]; the best place, its
//!    rivals and its confidence.
//!
//! [`Fuser`] runs them as a [`Sink`](evpr_core::stage::Sink) on live messages, [`offline`] on stored traverses; both
//! stand on the same engine. [`sequence_match`] is step 2 alone, on a whole matrix.

mod engine;
pub mod ensemble;
mod error;
mod fuser;
pub mod fusion;
mod history;
mod map;
pub mod offline;
mod order;
mod overview;
pub mod sequence;
mod simd;
pub mod similarity;

pub use error::FuseError;
pub use fuser::{Clock, FusedMember, FusedTick, Fuser, Observer};
pub use history::History;
pub use map::{Map, MapMember, Rows};
pub use overview::write_overview;
pub use sequence::{SequenceMatcher, sequence_match};
