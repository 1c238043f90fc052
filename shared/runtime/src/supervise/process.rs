//! One process of the graph as the system sees it: its child, and what it has told of itself.

use super::policy::Exit;
use evpr_core::message::{MemberCost, StatsHeader};
use evpr_core::plan::Service;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, ExitStatus};

#[derive(Debug)]
pub(super) struct Process {
    pub(super) service: Service,
    pub(super) child: Option<Child>,
    /// The newest stats there are; those of an earlier incarnation until the newest has told some.
    pub(super) stats: StatsHeader,
    /// What members have cost, from sinks.
    pub(super) costs: Vec<MemberCost>,
    /// What the newest rows of each member cost, ns per row; 0 where that is not known.
    pub(super) newest_costs_ns: Vec<u64>,
}

impl Process {
    pub(super) fn new(service: Service) -> Self {
        Self {
            service,
            child: None,
            stats: StatsHeader::default(),
            costs: Vec::new(),
            newest_costs_ns: Vec::new(),
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
}

fn judge(status: ExitStatus) -> Exit {
    match (status.code(), status.signal()) {
        (Some(0), _) => Exit::Clean,
        (Some(1 | 2), _) => Exit::Failed,
        _ => Exit::Died,
    }
}
