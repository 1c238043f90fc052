//! How a run is and how far.

use super::Progress;
use super::graph::Supervisor;
use super::policy::State;
use crate::profile::{GovernorStatus, Status};
use evpr_core::plan::{Delivery, ServiceKind};

impl Supervisor {
    /// How far the run is.
    pub(super) fn progress(&self) -> Progress {
        let of = |kind| {
            self.processes
                .iter()
                .find(|p| p.service.kind == kind)
                .map(|p| &p.stats)
        };
        let ingest = of(ServiceKind::Ingest);
        Progress {
            permille: ingest.map_or(0, |s| s.progress_permille),
            events: ingest.map_or(0, |s| s.events),
            answers: self.answers,
            recorded: of(ServiceKind::Record).map_or(0, |s| s.next_tick),
        }
    }

    /// How things are.
    pub(super) fn status(&self) -> Status {
        let state = match self.policy.state() {
            State::Starting => "starting",
            State::Running => "running",
            State::Draining { .. } => "draining",
            State::Ending(_) | State::Over => "stopping",
        };
        let delivery = match self.plan.delivery {
            Delivery::Lossless => "lossless",
            Delivery::Latest => "latest",
        };
        Status {
            name: self.plan.name.clone(),
            state: state.to_owned(),
            delivery: delivery.to_owned(),
            uptime_s: self.profile.started.elapsed().as_secs_f64(),
            tick: self.newest_open.map(|o| o.tick),
            progress_permille: self.progress().permille,
            answers: self.answers,
            matches: self.profile.matches(),
            latency: self.profile.latency(),
            refused: self.ports.refused(),
            services: self.profile.services(&self.processes, self.policy.lives()),
            members: self.profile.members(self.members.states(), &self.processes),
            fuse: self.members.fuse(),
            governor: self.governor.as_ref().map(|governor| GovernorStatus {
                budget_ms: governor.budget_ns() as f64 / 1e6,
                p95_ms: governor.p95_ns().map(|ns| ns as f64 / 1e6),
                shed: governor
                    .shed()
                    .iter()
                    .map(|m| self.members.name(*m).to_owned())
                    .collect(),
            }),
            changes: self.members.changes(),
        }
    }
}
