//! What the policy hears and what it says.

use super::{Exit, Told};
use evpr_core::plan::{ServiceKind, Supervision};
use nix::sys::signal::Signal;

/// What does not change while the run goes on.
#[derive(Debug, Clone)]
pub(in crate::supervise) struct Rules {
    /// Lossless delivery: whoever goes back sends ingest back too.
    pub(in crate::supervise) lossless: bool,
    /// How many ticks windows reach back.
    pub(in crate::supervise) look_back: u64,
    /// Ingest always begins with the first tick: what comes of a tick depends on all before it.
    pub(in crate::supervise) from_the_start: bool,
    /// How long processes may stand still, and how often they may die.
    pub(in crate::supervise) limits: Supervision,
    /// Per member: the services that its rows pass through.
    pub(in crate::supervise) members: Vec<[usize; 2]>,
}

/// What there is to run.
#[derive(Debug, Clone)]
pub(in crate::supervise) struct Part {
    pub(in crate::supervise) name: String,
    pub(in crate::supervise) kind: ServiceKind,
    /// The rest goes on without it, whatever becomes of it.
    pub(in crate::supervise) optional: bool,
    /// A network is at work in it.
    pub(in crate::supervise) network: bool,
}

/// What has happened.
#[derive(Debug, Clone)]
pub(in crate::supervise) enum Event {
    /// A process has told how it is.
    Told {
        service: usize,
        incarnation: u32,
        told: Told,
    },
    /// A process has ended, in the words of the system.
    Ended {
        service: usize,
        exit: Exit,
        status: String,
    },
    /// A tick was answered.
    Answered { tick: u64 },
    /// A tick was opened.
    Opened { tick: u64 },
    /// Ingest has said that the stream ends before this tick.
    StreamEnds { tick: u64 },
    /// So many requests to stop have come so far.
    Stop { requests: u32 },
    /// The run cannot go on, for this reason.
    Failed { line: String },
}

/// What is to be done about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::supervise) enum Action {
    /// Start a process.
    Start(Start),
    /// Send a signal to a process.
    Signal { service: usize, signal: Signal },
    /// Tell the sinks who is dead: [`super::Policy::states`].
    TellStates,
    /// Tell everybody the settings.
    TellSettings,
    /// Remove what the dead left in shared memory.
    CleanUp,
    /// Log a line.
    Say(Level, String),
}

/// How grave a line of the log is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::supervise) enum Level {
    Info,
    Warn,
    Error,
}

/// How a process is to be started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::supervise) struct Start {
    pub(in crate::supervise) service: usize,
    pub(in crate::supervise) incarnation: u32,
    /// Ingest: how often it has been started or sent back.
    pub(in crate::supervise) epoch: u32,
    /// Ingest: the tick to begin with. Fuse: the tick to begin with, for history.
    pub(in crate::supervise) first_tick: u64,
    /// Fuse: the first tick to answer.
    pub(in crate::supervise) answer_from: u64,
    /// Ingest: the tick at which the stream ends, when the run is ending already.
    pub(in crate::supervise) end_tick: Option<u64>,
}
