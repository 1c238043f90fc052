//! Gives stages processes: channels over iceoryx2, run loops that block on events, stop signals, stats, and the
//! supervisor that starts the processes of a plan, buries the dead and starts them again.
//!
//! This is the only crate that names iceoryx2's ports. Stages know nothing of it.

mod channel;
#[cfg(test)]
mod channel_tests;
mod clock;
mod control;
mod domain;
mod gate;
mod placement;
mod profile;
mod run;
mod shm;
mod stop;
mod supervise;
mod telemetry;
mod trace;
mod wait;
mod watcher;

pub use clock::now_ns;
pub use control::{Change, ControlReply, ControlRequest, MemberState, request, request_for};
pub use domain::{RunFolder, RunSpec};
pub use evpr_core::plan::MAX_LENGTH;
pub use placement::use_processors;
pub use profile::{
    FuseStatus, GovernorStatus, LatencyStatus, MemberStatus, Quantiles, ServiceStatus, Status, Times,
};
pub use run::{
    Identity, ScoresSender, ServiceContext, Spectator, run_ingest, run_sink, run_stage, run_watcher,
};
pub use shm::{ShmRoom, room};
pub use stop::Stop;
pub use supervise::{CommandLine, Hooks, Outcome, Progress, RunSummary, ServiceReport, Spawn, Supervisor};
pub use trace::TraceReader;

/// What can go wrong around the stages: one line saying what was wrong and what to do.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// Shared memory, channels or their names.
    #[error("{0}")]
    Ipc(String),
    /// The run folder, its files and sockets.
    #[error("{0}")]
    Folder(String),
    /// A stage said that it cannot go on.
    #[error("{0}")]
    Stage(String),
    /// A process could not be started or signalled.
    #[error("{0}")]
    Process(String),
}

impl RuntimeError {
    pub(crate) fn ipc(what: impl std::fmt::Display, error: impl std::fmt::Debug) -> Self {
        Self::Ipc(format!("{what}: {error:?}"))
    }
}
