//! The supervisor: starts one process per service, downstream first; buries the dead at once and starts them again;
//! tells the sinks who is dead; hands answers on; and ends everything upstream first, leaving nothing behind.
//!
//! What happens at a death:
//! - Its node is cleaned up, which frees whoever waited for room with it.
//! - Its incarnation is declared dead (the tombstone), so that no sink waits for it. It is restarted with back-off.
//! - Lossless: when ingest died it goes on at the first tick that a sink still needs (earlier by as much as windows reach
//!   back), and opens each tick with the members that it had. When a sink died, ingest is
//!   sent back to the tick that the new one needs; the other sink sees those ticks again and ignores them.
//! - A process that hangs (see [`evpr_core::plan::Supervision`]) is killed, and has died.
//! - A process that dies too often is given up. Reconstructions and extractors are then missing from the ensemble;
//!   without ingest, a sink, or any member there is no run, and it ends.
//!
//! `policy` decides all this without doing anything; `graph` does it.

mod graph;
mod members;
mod policy;
mod ports;
mod process;
mod profile;
mod report;
mod status;
mod steer;

pub use graph::Supervisor;
pub use report::{CommandLine, Hooks, Outcome, Progress, RunSummary, ServiceReport};

/// What a process is told on its command line, beside the run folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Spawn {
    /// Index of the service in the plan.
    pub service: usize,
    /// How often it has been started, this time included.
    pub incarnation: u32,
    /// Ingest: how often it has been started or sent back.
    pub epoch: u32,
    /// Ingest: the tick to begin with. Fuse: the tick to begin with, for history.
    pub first_tick: u64,
    /// Fuse: the first tick to answer.
    pub answer_from: u64,
    /// Ingest: the tick at which the stream ends, when the run is ending already.
    pub end_tick: Option<u64>,
}
