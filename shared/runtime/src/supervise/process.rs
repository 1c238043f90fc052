//! One process of the graph as the supervisor sees it: its child, its lives and when to start the next.

use evpr_core::message::{MemberCost, ServiceHealth, ServicePhase, ServiceState, StatsHeader};
use evpr_core::plan::{Service, ServiceKind};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::collections::VecDeque;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

/// Deaths within this time count against the budget.
const BUDGET_PERIOD: Duration = Duration::from_secs(60);
/// With so many deaths in the period a process is given up.
const BUDGET_DEATHS: usize = 10;
const FIRST_BACKOFF: Duration = Duration::from_millis(100);
const LONGEST_BACKOFF: Duration = Duration::from_secs(5);

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Exit {
    /// In an orderly way.
    Clean,
    /// It said why (exit code 1 or 2): trying again is pointless.
    Failed,
    /// By a signal, a panic or without being asked to.
    Died,
}

#[derive(Debug)]
pub(super) struct Process {
    pub(super) service: Service,
    /// The rest goes on without it, whatever becomes of it.
    pub(super) optional: bool,
    pub(super) child: Option<Child>,
    pub(super) incarnation: u32,
    pub(super) health: ServiceHealth,
    pub(super) dead_through: u32,
    /// The newest stats of the current incarnation.
    pub(super) stats: StatsHeader,
    /// What members have cost, from sinks.
    pub(super) costs: Vec<MemberCost>,
    /// What the newest rows of each member cost, ns per row; 0 where that is not known.
    pub(super) newest_costs_ns: Vec<u64>,
    pub(super) restarts: u64,
    /// When to start it (again).
    pub(super) start_at: Option<Instant>,
    /// The supervisor kills it to make it go back; that is no fault of its own. Until it is reaped.
    pub(super) sent_back: bool,
    /// It has died since it was last ready.
    pub(super) died: bool,
    /// A sink that had done all it had to do before it died: it is not needed again.
    pub(super) finished: bool,
    /// When it was last heard of, and whether its silence has been reported.
    pub(super) heard_at: Instant,
    pub(super) silent: bool,
    deaths: VecDeque<Instant>,
}

impl Process {
    pub(super) fn new(service: Service, optional: bool) -> Self {
        Self {
            service,
            optional,
            child: None,
            incarnation: 0,
            health: ServiceHealth::Up,
            dead_through: 0,
            stats: StatsHeader::default(),
            costs: Vec::new(),
            newest_costs_ns: Vec::new(),
            restarts: 0,
            start_at: None,
            sent_back: false,
            died: false,
            finished: false,
            heard_at: Instant::now(),
            silent: false,
            deaths: VecDeque::new(),
        }
    }

    /// Takes what members have cost since the start of a sink.
    pub(super) fn take_costs(&mut self, costs: &[MemberCost]) {
        self.newest_costs_ns.resize(costs.len(), 0);
        self.costs.resize(costs.len(), MemberCost::default());
        for ((newest, old), now) in self.newest_costs_ns.iter_mut().zip(&mut self.costs).zip(costs) {
            let rows = now.rows.saturating_sub(old.rows);
            let all = |cost: &MemberCost| cost.reconstruct_ns.saturating_add(cost.extract_ns);
            if let Some(each) = all(now).saturating_sub(all(old)).checked_div(rows) {
                *newest = each;
            }
            *old = *now;
        }
    }

    pub(super) fn is_sink(&self) -> bool {
        matches!(self.service.kind, ServiceKind::Fuse | ServiceKind::Record)
    }

    /// Without it there is no run.
    pub(super) fn is_essential(&self) -> bool {
        self.is_sink() || self.service.kind == ServiceKind::Ingest
    }

    pub(super) fn in_phase(&self, phase: ServicePhase) -> bool {
        self.child.is_some()
            && self.stats.stamp.incarnation == self.incarnation
            && self.stats.phase >= phase as u32
    }

    /// A sink that has nothing more to do.
    pub(super) fn is_done(&self) -> bool {
        self.finished || self.in_phase(ServicePhase::Done)
    }

    pub(super) fn state(&self) -> ServiceState {
        ServiceState {
            incarnation: self.incarnation,
            dead_through: self.dead_through,
            health: self.health as u32,
            _pad: 0,
        }
    }

    pub(super) fn signal(&self, signal: Signal) {
        if let Some(child) = &self.child {
            // It may have ended in this moment: then the signal goes nowhere, as the child is not reaped yet.
            let _ = kill(Pid::from_raw(child.id() as i32), signal);
        }
    }

    /// Reaps the child if it has ended.
    pub(super) fn reap(&mut self) -> Option<(Exit, String)> {
        let status = self.child.as_mut()?.try_wait().ok()??;
        self.child = None;
        Some((judge(status), status.to_string()))
    }

    /// Notes a death and says how long to wait before the next start; `None` when it is given up.
    pub(super) fn backoff(&mut self, now: Instant) -> Option<Duration> {
        self.deaths.push_back(now);
        while self
            .deaths
            .front()
            .is_some_and(|t| now.duration_since(*t) > BUDGET_PERIOD)
        {
            self.deaths.pop_front();
        }
        match self.deaths.len() {
            n if n > BUDGET_DEATHS => None,
            1 => Some(Duration::ZERO),
            n => Some((FIRST_BACKOFF * 2u32.pow(n as u32 - 2)).min(LONGEST_BACKOFF)),
        }
    }
}

fn judge(status: ExitStatus) -> Exit {
    match (status.code(), status.signal()) {
        (Some(0), _) => Exit::Clean,
        (Some(1 | 2), _) => Exit::Failed,
        _ => Exit::Died,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backs_off_and_gives_up() {
        let service = Service {
            kind: ServiceKind::Extract,
            index: 0,
            name: "extract/x".to_owned(),
        };
        let mut p = Process::new(service, false);
        let start = Instant::now();
        let waits: Vec<_> = (0..11)
            .map(|i| p.backoff(start + Duration::from_millis(i)))
            .collect();
        assert_eq!(waits[0], Some(Duration::ZERO));
        assert_eq!(waits[1], Some(Duration::from_millis(100)));
        assert_eq!(waits[2], Some(Duration::from_millis(200)));
        assert_eq!(waits[9], Some(LONGEST_BACKOFF));
        assert_eq!(waits[10], None);
        assert_eq!(
            p.backoff(start + Duration::from_secs(120)),
            Some(Duration::ZERO),
            "old deaths are forgotten"
        );
    }
}
