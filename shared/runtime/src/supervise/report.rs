//! What the caller hears of a run, while it goes on and at its end.

use super::Spawn;
use evpr_core::message::{Candidate, MatchHeader, Span, StatsHeader};
use evpr_core::plan::{Service, ServiceKind};
use std::process::Command;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Its input ended and everything was answered.
    Finished,
    /// By SIGTERM, in an orderly way.
    Stopped,
    /// By Ctrl-C.
    Interrupted,
    /// A process failed; it has said why.
    Failed,
}

/// How far a run is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// Permille of the recording that is read; 0 when not known.
    pub permille: u64,
    /// Events sent so far.
    pub events: u64,
    /// Ticks answered so far.
    pub answers: u64,
    /// Ticks recorded so far.
    pub recorded: u64,
}

/// What one process did.
#[derive(Debug, Clone)]
pub struct ServiceReport {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: ServiceKind,
    /// Restarts after deaths.
    pub restarts: u64,
    /// Counters of its last incarnation.
    pub stats: StatsHeader,
}

/// What a run came to.
#[derive(Debug, Clone)]
pub struct RunSummary {
    /// How it ended.
    pub outcome: Outcome,
    /// Ticks answered.
    pub answers: u64,
    /// Why it failed, in one line; `None` where the process that failed has said so itself.
    pub failure: Option<String>,
    /// Per process.
    pub services: Vec<ServiceReport>,
}

/// Makes the command line of one process.
pub type CommandLine = Box<dyn Fn(&Service, &Spawn) -> Command>;

/// What the caller hears while the graph runs.
pub trait Hooks {
    /// One answer, in order of ticks, each tick once.
    ///
    /// # Errors
    /// One line; the run then ends as failed.
    fn answer(&mut self, header: &MatchHeader, candidates: &[Candidate]) -> Result<(), String>;

    /// A few times per second.
    fn progress(&mut self, progress: &Progress);

    /// Whether [`Hooks::spans`] is to be told. Asked once, at the start.
    fn wants_spans(&self) -> bool {
        false
    }

    /// What a process did when, by the index of its service in the plan.
    fn spans(&mut self, service: usize, spans: &[Span]) {
        let _ = (service, spans);
    }
}
