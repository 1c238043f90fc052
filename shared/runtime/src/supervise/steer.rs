//! Settings that change while the run goes on: what is asked for, and what the governor decides.

use super::graph::Supervisor;
use super::members::Handled;
use super::policy::State;
use crate::RuntimeError;
use crate::control::{ControlReply, ControlRequest};
use evpr_core::governor::{Decision, Priced};
use evpr_core::plan::{Delivery, Fuse};
use std::time::Instant;

impl Supervisor {
    /// Ticks before an answer that a new fuser has to see.
    pub(super) fn history_ticks(&self) -> u64 {
        if self.plan.delivery == Delivery::Latest {
            return 0;
        }
        let longest = self.plan.fuse.length.max(self.members.fuse().length as usize);
        let fuse = Fuse {
            length: longest,
            ..self.plan.fuse.clone()
        };
        fuse.history_ticks().unwrap_or(u64::MAX)
    }

    /// Tells everybody.
    fn settings_changed(&mut self) -> Result<(), RuntimeError> {
        self.policy.set_history(self.history_ticks());
        self.ports.tell_settings(&self.members.settings)
    }

    /// Answers whoever asks.
    pub(super) fn take_requests(&mut self) -> Result<(), RuntimeError> {
        let ending = matches!(self.policy.state(), State::Ending(_) | State::Over);
        if ending {
            self.members.dismiss();
        }
        while let Ok(asked) = self.control.requests.try_recv() {
            if ending {
                asked.refuse();
                continue;
            }
            if asked.request == ControlRequest::Status {
                let reply = ControlReply {
                    status: Some(Box::new(self.status())),
                    ..ControlReply::default()
                };
                asked.answer(reply);
                continue;
            }
            if let Handled::Changed(by_hand) = self.members.handle(asked, Instant::now()) {
                if let Some(governor) = &mut self.governor {
                    by_hand.into_iter().for_each(|member| governor.forget(member));
                }
                self.settings_changed()?;
            }
        }
        Ok(())
    }

    /// Shows the governor what has been answered, and does what it decides.
    pub(super) fn govern(&mut self) -> Result<(), RuntimeError> {
        let Some(governor) = &mut self.governor else {
            return Ok(());
        };
        for (latency_ns, version) in std::mem::take(&mut self.ungoverned) {
            if self.policy.state() != State::Running {
                continue;
            }
            let mut sinks = self.processes.iter().map(|p| p.newest_costs_ns.as_slice());
            let costs = sinks.find(|costs| !costs.is_empty()).unwrap_or(&[]);
            let settings = self.members.settings.members.iter().enumerate();
            let priced: Vec<Priced> = settings
                .map(|(member, wanted)| Priced {
                    enabled: wanted.enabled,
                    weight: wanted.weight,
                    cost_ns: costs.get(member).copied().unwrap_or(0),
                    late: self.late.get(member).copied().unwrap_or(true),
                })
                .collect();
            let Some(decision) = governor.answered(latency_ns, version, &priced) else {
                continue;
            };
            let ms = |ns: u64| ns as f64 / 1e6;
            let p95 = ms(governor.p95_ns().unwrap_or(0));
            let judged = format!("p95 {p95:.1} ms of {:.1} ms", ms(governor.budget_ns()));
            let what = match &decision {
                Decision::Shed(members) => {
                    let names: Vec<&str> = members.iter().map(|m| self.members.name(*m)).collect();
                    format!("{judged}: shed {}", names.join(" "))
                }
                Decision::TakeBack(member) => format!("{judged}: took {} back", self.members.name(*member)),
            };
            let version = self.members.govern(governor.shed(), what, Instant::now());
            governor.decided(version);
            self.ports.tell_settings(&self.members.settings)?;
        }
        Ok(())
    }
}
