//! How a run ends: kind by kind, upstream first, so that each still hears what the one before it sent.

use super::{Action, Level, Policy, SECOND, State};
use evpr_core::message::ServicePhase;
use evpr_core::plan::ServiceKind;
use nix::sys::signal::Signal;

/// Time that a process has to end after SIGTERM.
const EXIT_NS: u64 = 10 * SECOND;
/// The same for a dashboard, which has nothing to finish.
const DASHBOARD_EXIT_NS: u64 = 2 * SECOND;
const ORDER: [ServiceKind; 6] = [
    ServiceKind::Ingest,
    ServiceKind::Reconstruct,
    ServiceKind::Extract,
    ServiceKind::Fuse,
    ServiceKind::Record,
    ServiceKind::Dashboard,
];

fn patience_ns(kind: Option<&ServiceKind>) -> u64 {
    match kind {
        Some(ServiceKind::Dashboard) => DASHBOARD_EXIT_NS,
        _ => EXIT_NS,
    }
}

/// Where the ending stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::supervise) struct Ending {
    /// Index into the order of kinds.
    turn: usize,
    /// When those whose turn it is are killed; `None` once they are.
    kill_at_ns: Option<u64>,
    /// Nobody had asked for an end, and nothing had failed.
    unasked: bool,
}

impl Ending {
    pub(super) fn due_ns(self) -> Option<u64> {
        self.kill_at_ns
    }

    pub(super) fn has_killed(self) -> bool {
        self.kill_at_ns.is_none()
    }

    /// Somebody cannot wait.
    pub(super) fn hurry(&mut self, now_ns: u64) {
        self.kill_at_ns = self.kill_at_ns.map(|t| t.min(now_ns));
    }
}

impl Policy {
    /// The run cannot go on, for this reason.
    pub(super) fn fail(&mut self, now_ns: u64, line: String) {
        self.failure.get_or_insert(line);
        self.failed = true;
        self.end(now_ns);
    }

    /// Begins to end the run.
    pub(super) fn end(&mut self, now_ns: u64) {
        if !matches!(self.state, State::Ending(_) | State::Over) {
            let unasked = !self.failed && self.stop_requests == 0;
            self.turn(now_ns, 0, unasked);
        }
    }

    /// It is the turn of the next kind.
    fn turn(&mut self, now_ns: u64, turn: usize, unasked: bool) {
        let patience_ns = match self.stop_requests {
            0 | 1 => patience_ns(ORDER.get(turn)),
            _ => 0,
        };
        self.state = State::Ending(Ending {
            turn,
            kill_at_ns: Some(now_ns + patience_ns),
            unasked,
        });
        for (service, life) in self.lives.iter().enumerate() {
            if !life.running || ORDER.get(turn) != Some(&life.kind) {
                continue;
            }
            let signal = Signal::SIGTERM;
            self.actions.push(Action::Signal { service, signal });
            // Ingest takes one request as a wish to end the stream in good order, and stays until the next.
            if life.kind == ServiceKind::Ingest && !life.in_phase(ServicePhase::Done) {
                let signal = Signal::SIGINT;
                self.actions.push(Action::Signal { service, signal });
            }
        }
    }

    /// Goes on with the end.
    pub(super) fn end_on(&mut self, now_ns: u64) {
        while let State::Ending(ending) = self.state {
            let Some(kind) = ORDER.get(ending.turn) else {
                return self.is_over(ending);
            };
            if !self.lives.iter().any(|l| l.running && l.kind == *kind) {
                self.actions.push(Action::CleanUp);
                self.turn(now_ns, ending.turn + 1, ending.unasked);
                continue;
            }
            if ending.kill_at_ns.is_some_and(|t| t <= now_ns) {
                self.kill_all(*kind);
                self.state = State::Ending(Ending {
                    kill_at_ns: None,
                    ..ending
                });
            }
            return;
        }
    }

    fn kill_all(&mut self, kind: ServiceKind) {
        for (service, life) in self.lives.iter().enumerate() {
            if !life.running || life.kind != kind {
                continue;
            }
            if self.stop_requests < 2 {
                let seconds = patience_ns(Some(&kind)) / SECOND;
                let line = format!("{} did not end within {seconds} s and is killed", life.name);
                self.actions.push(Action::Say(Level::Warn, line));
            }
            let signal = Signal::SIGKILL;
            self.actions.push(Action::Signal { service, signal });
        }
    }

    fn is_over(&mut self, ending: Ending) {
        self.state = State::Over;
        let mut ingest = self.lives.iter().filter(|l| l.kind == ServiceKind::Ingest);
        if ending.unasked && ingest.any(|l| l.was_stopped()) {
            self.failed = true;
            let line = "ingest was told to stop by somebody else; the run ended with the ticks so far";
            self.failure.get_or_insert(line.to_owned());
        }
    }
}
