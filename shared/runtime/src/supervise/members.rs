//! Wanted member settings, and who waits to hear from which tick on they hold.

use crate::control::{Asked, ControlReply, ControlRequest, MemberState};
use crate::domain::Settings;
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
    pub(super) settings: Settings,
    waiting: Vec<Waiting>,
}

impl Members {
    pub(super) fn new(plan: &Plan) -> Self {
        Self {
            names: plan.members.iter().map(|m| m.name.clone()).collect(),
            settings: Settings::of_plan(plan),
            waiting: Vec::new(),
        }
    }

    fn states(&self) -> Vec<MemberState> {
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
        self.confirm(|w| w.version <= version, Some(tick));
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
                    error: None,
                    members: members.clone(),
                    from_tick,
                });
            }
            !due(w)
        });
    }
}
