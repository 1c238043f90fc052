//! One process of the graph as the policy sees it: its lives, and when to start the next.

use super::{MS, SECOND};
use evpr_core::message::{ServiceHealth, ServicePhase, ServiceState};
use evpr_core::plan::ServiceKind;
use std::collections::VecDeque;

/// Deaths within this time count against the budget.
pub(super) const BUDGET_PERIOD_NS: u64 = 60 * SECOND;
/// With more deaths than this in the period a process is given up.
pub(super) const BUDGET_DEATHS: usize = 10;
const FIRST_BACKOFF_NS: u64 = 100 * MS;
const LONGEST_BACKOFF_NS: u64 = 5 * SECOND;

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::supervise) enum Exit {
    /// In an orderly way.
    Clean,
    /// It said why (exit code 1 or 2): trying again is pointless.
    Failed,
    /// By a signal, a panic or without being asked to.
    Died,
}

/// What a process says of itself, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::supervise) struct Told {
    /// Number of a [`ServicePhase`].
    pub(in crate::supervise) phase: u32,
    /// Sinks: the first tick that is not settled.
    pub(in crate::supervise) next_tick: u64,
}

/// See the module. Times are host monotonic, ns.
#[derive(Debug)]
pub(in crate::supervise) struct Life {
    pub(in crate::supervise) name: String,
    pub(in crate::supervise) kind: ServiceKind,
    /// The rest goes on without it, whatever becomes of it.
    pub(super) optional: bool,
    /// It has been started and not been seen to end.
    pub(super) running: bool,
    pub(in crate::supervise) incarnation: u32,
    pub(in crate::supervise) health: ServiceHealth,
    dead_through: u32,
    /// What the current incarnation has said last.
    phase: u32,
    /// What the newest incarnation to say anything has said last.
    pub(super) next_tick: u64,
    pub(in crate::supervise) restarts: u64,
    /// When to start it (again).
    pub(super) start_at_ns: Option<u64>,
    /// It was killed to make it go back; that is no fault of its own. Until it has ended.
    pub(super) sent_back: bool,
    /// It has died since it was last ready.
    pub(super) died: bool,
    /// It had done all it had to do before it ended: it is not needed again.
    pub(super) finished: bool,
    /// When it was last heard of or started, and whether its silence has been reported.
    pub(in crate::supervise) heard_ns: u64,
    pub(super) silent: bool,
    deaths: VecDeque<u64>,
}

impl Life {
    pub(super) fn new(name: String, kind: ServiceKind, optional: bool) -> Self {
        Self {
            name,
            kind,
            optional,
            running: false,
            incarnation: 0,
            health: ServiceHealth::Up,
            dead_through: 0,
            phase: ServicePhase::Starting as u32,
            next_tick: 0,
            restarts: 0,
            start_at_ns: None,
            sent_back: false,
            died: false,
            finished: false,
            heard_ns: 0,
            silent: false,
            deaths: VecDeque::new(),
        }
    }

    pub(in crate::supervise) fn is_sink(&self) -> bool {
        matches!(self.kind, ServiceKind::Fuse | ServiceKind::Record)
    }

    /// Without it there is no run.
    pub(super) fn is_essential(&self) -> bool {
        self.is_sink() || self.kind == ServiceKind::Ingest
    }

    pub(in crate::supervise) fn in_phase(&self, phase: ServicePhase) -> bool {
        self.running && self.phase >= phase as u32
    }

    /// It is ready, or need not be.
    pub(super) fn is_settled(&self) -> bool {
        self.finished || self.health == ServiceHealth::Down || self.in_phase(ServicePhase::Ready)
    }

    /// It has nothing more to do.
    pub(in crate::supervise) fn is_done(&self) -> bool {
        self.finished || self.in_phase(ServicePhase::Done)
    }

    /// Whether it last said that it was asked to stop.
    pub(super) fn was_stopped(&self) -> bool {
        self.phase == ServicePhase::Stopped as u32
    }

    pub(super) fn state(&self) -> ServiceState {
        ServiceState {
            incarnation: self.incarnation,
            dead_through: self.dead_through,
            health: self.health as u32,
            _pad: 0,
        }
    }

    pub(super) fn started(&mut self, now_ns: u64) {
        self.running = true;
        self.finished = false;
        self.incarnation += 1;
        self.phase = ServicePhase::Starting as u32;
        self.start_at_ns = None;
        self.heard_ns = now_ns;
        self.silent = false;
    }

    pub(super) fn told(&mut self, now_ns: u64, told: Told) {
        self.phase = told.phase;
        self.next_tick = told.next_tick;
        self.heard_ns = now_ns;
    }

    /// Nobody is to wait for it from now on.
    pub(super) fn bury(&mut self, health: ServiceHealth) {
        self.dead_through = self.incarnation;
        self.health = health;
    }

    /// Notes a death and says how long to wait before the next start, ns; `None` when it is given up.
    pub(super) fn backoff(&mut self, now_ns: u64) -> Option<u64> {
        self.deaths.push_back(now_ns);
        while self
            .deaths
            .front()
            .is_some_and(|t| now_ns.saturating_sub(*t) > BUDGET_PERIOD_NS)
        {
            self.deaths.pop_front();
        }
        match self.deaths.len() {
            n if n > BUDGET_DEATHS => None,
            1 => Some(0),
            n => Some((FIRST_BACKOFF_NS << (n - 2)).min(LONGEST_BACKOFF_NS)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backs_off_and_gives_up() {
        let mut life = Life::new("extract/x".to_owned(), ServiceKind::Extract, false);
        let waits: Vec<_> = (0..11).map(|i| life.backoff(SECOND + i * MS)).collect();
        assert_eq!(waits[0], Some(0));
        assert_eq!(waits[1], Some(100 * MS));
        assert_eq!(waits[2], Some(200 * MS));
        assert_eq!(waits[9], Some(LONGEST_BACKOFF_NS));
        assert_eq!(waits[10], None);
        assert_eq!(life.backoff(120 * SECOND), Some(0), "old deaths are forgotten");
    }
}
