//! Wanted member settings, and who waits to hear from which tick on they hold.

use crate::control::{Asked, ControlReply, ControlRequest, MemberState};
use crate::domain::{Schedule, Settings};
use crossbeam::channel::Sender;
use evpr_core::Plan;
use std::time::{Duration, Instant};

/// If no tick opens for this long, a change is confirmed without its tick.
const CONFIRM_TIMEOUT: Duration = Duration::from_secs(3);

#[derive(Debug)]
struct Waiting {
    version: u64,
    reply: Sender<ControlReply>,
    until: Instant,
}

#[derive(Debug)]
pub(super) struct Members {
    names: Vec<String>,
    /// As they are wanted now.
    pub(super) settings: Settings,
    /// What has been in force, from which tick on.
    schedule: Schedule,
    /// Wanted, and not yet seen in force.
    unseen: Vec<Settings>,
    waiting: Vec<Waiting>,
}

impl Members {
    pub(super) fn new(plan: &Plan) -> Self {
        Self {
            names: plan.members.iter().map(|m| m.name.clone()).collect(),
            settings: Settings::of_plan(plan),
            schedule: Schedule::default(),
            unseen: Vec::new(),
            waiting: Vec::new(),
        }
    }

    pub(super) fn states(&self) -> Vec<MemberState> {
        let state = |(name, (enabled, weight)): (&String, &(bool, f64))| MemberState {
            name: name.clone(),
            enabled: *enabled,
            weight: *weight,
        };
        self.names.iter().zip(&self.settings.members).map(state).collect()
    }

    fn find(&self, wanted: &[String]) -> Result<Vec<usize>, String> {
        let mut found = Vec::new();
        for name in wanted {
            if name == "all" {
                found.extend(0..self.names.len());
                continue;
            }
            let index = self.names.iter().position(|n| n == name).ok_or_else(|| {
                format!(
                    "there is no member \"{name}\"; `evpr member list` shows the {} there are",
                    self.names.len()
                )
            })?;
            found.push(index);
        }
        if found.is_empty() {
            return Err("name at least one member, or \"all\"".to_owned());
        }
        Ok(found)
    }

    /// Answers or enters a request; true when the settings changed and are to be published.
    pub(super) fn handle(&mut self, asked: Asked, now: Instant) -> bool {
        let Asked { request, reply } = asked;
        match request {
            ControlRequest::List => {
                let _ = reply.send(ControlReply {
                    members: self.states(),
                    ..ControlReply::default()
                });
                false
            }
            // The supervisor answers this one itself.
            ControlRequest::Status => false,
            ControlRequest::Set {
                members,
                enabled,
                weight,
            } => {
                if enabled.is_none() && weight.is_none() {
                    let _ = reply.send(ControlReply::refusal("there is nothing to change".to_owned()));
                    return false;
                }
                if let Some(weight) = weight.filter(|w| !w.is_finite() || *w < 0.0) {
                    let text = format!("{weight} is not a weight; give a number of 0 or more");
                    let _ = reply.send(ControlReply::refusal(text));
                    return false;
                }
                match self.find(&members) {
                    Err(text) => {
                        let _ = reply.send(ControlReply::refusal(text));
                        false
                    }
                    Ok(indices) => {
                        for index in indices {
                            let setting = &mut self.settings.members[index];
                            setting.0 = enabled.unwrap_or(setting.0);
                            setting.1 = weight.unwrap_or(setting.1);
                        }
                        self.settings.version += 1;
                        self.unseen.push(self.settings.clone());
                        let until = now + CONFIRM_TIMEOUT;
                        self.waiting.push(Waiting {
                            version: self.settings.version,
                            reply,
                            until,
                        });
                        true
                    }
                }
            }
        }
    }

    /// A tick opened with this version in force: whoever waited for it hears from which tick on.
    pub(super) fn opened(&mut self, tick: u64, version: u64) {
        if tick < self.schedule.opened_before {
            return; // ingest went back
        }
        self.schedule.opened_before = tick + 1;
        if let Some(seen) = self.unseen.iter().position(|s| s.version == version) {
            let settings = self.unseen.drain(..=seen).next_back();
            self.schedule.entries.extend(settings.map(|s| (tick, s)));
        }
        self.confirm(|w| w.version <= version, Some(tick));
    }

    /// What an ingest that starts now has to know to open the ticks from `first` on as they were opened before.
    pub(super) fn schedule(&mut self, first: u64) -> Schedule {
        // Of what held before, only the last matters.
        let before = self
            .schedule
            .entries
            .iter()
            .take_while(|(from, _)| *from <= first)
            .count();
        self.schedule.entries.drain(..before.saturating_sub(1));
        let mut schedule = self.schedule.clone();
        let next = schedule.opened_before;
        schedule
            .entries
            .extend(self.unseen.last().map(|s| (next, s.clone())));
        schedule
    }

    /// Sends everybody away: the run is ending.
    pub(super) fn dismiss(&mut self) {
        for w in self.waiting.drain(..) {
            let _ = w
                .reply
                .send(ControlReply::refusal("the instance is stopping".to_owned()));
        }
    }

    /// Sends those away who have waited too long.
    pub(super) fn expire(&mut self, now: Instant) {
        self.confirm(|w| w.until <= now, None);
    }

    fn confirm(&mut self, due: impl Fn(&Waiting) -> bool, from_tick: Option<u64>) {
        if !self.waiting.iter().any(&due) {
            return;
        }
        let members = self.states();
        self.waiting.retain(|w| {
            if due(w) {
                let _ = w.reply.send(ControlReply {
                    members: members.clone(),
                    from_tick,
                    ..ControlReply::default()
                });
            }
            !due(w)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crossbeam::channel::{Receiver, bounded};
    use evpr_core::plan::test_plan;

    fn set(members: &mut Members, enabled: bool) -> Receiver<ControlReply> {
        let (reply, answer) = bounded(1);
        let request = ControlRequest::Set {
            members: vec!["all".to_owned()],
            enabled: Some(enabled),
            weight: None,
        };
        assert!(members.handle(Asked { request, reply }, Instant::now()));
        answer
    }

    #[test]
    fn an_ingest_that_goes_back_opens_each_tick_as_it_was_opened() {
        let mut members = Members::new(&test_plan());
        (0..10).for_each(|t| members.opened(t, 0));
        let off = set(&mut members, false);
        members.opened(10, 1);
        assert_eq!(off.try_recv().unwrap().from_tick, Some(10));
        members.opened(11, 1);
        let on = set(&mut members, true);
        // Back to tick 8: off from 10 on, and on only from the first tick that was never opened.
        let schedule = members.schedule(8);
        let entries: Vec<_> = schedule
            .entries
            .iter()
            .map(|(t, s)| (*t, s.version, s.members[0].0))
            .collect();
        assert_eq!(entries, [(10, 1, false), (12, 2, true)]);
        assert_eq!(schedule.opened_before, 12);
        (8..12).for_each(|t| members.opened(t, u64::from(t >= 10)));
        assert!(on.try_recv().is_err(), "not in force yet");
        members.opened(12, 2);
        assert_eq!(on.try_recv().unwrap().from_tick, Some(12));
        // What is no longer needed goes.
        assert_eq!(members.schedule(20).entries.len(), 1);
    }
}
