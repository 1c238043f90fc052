//! What is wanted of members and of the fuser, and who waits to hear from which tick on it holds.

use crate::control::{Asked, Change, ControlReply, ControlRequest, MAX_DEADLINE_NS, MAX_LENGTH, MemberState};
use crate::domain::{Schedule, Settings};
use crate::profile::FuseStatus;
use crossbeam::channel::Sender;
use evpr_core::Plan;
use evpr_core::plan::{Delivery, Fuse, Rule};
use std::collections::VecDeque;
use std::time::{Duration, Instant, SystemTime};
use tracing::info;

/// If no tick opens for this long, a change is confirmed without its tick.
const CONFIRM_TIMEOUT: Duration = Duration::from_secs(3);
/// Changes that are kept for the status.
const KEPT_CHANGES: usize = 20;

#[derive(Debug)]
struct Waiting {
    version: u64,
    /// Nobody waits for a change of the governor's.
    reply: Option<Sender<ControlReply>>,
    change: Change,
    until: Instant,
}

#[derive(Debug)]
pub(super) struct Members {
    names: Vec<String>,
    planned: Fuse,
    delivery: Delivery,
    deadline_ns: u64,
    /// Per member: whether somebody wants it, shed or not.
    wanted: Vec<bool>,
    /// Per member: whether the governor has shed it.
    shed: Vec<bool>,
    /// As they are to be, from the next tick on.
    pub(super) settings: Settings,
    /// What has been in force, from which tick on.
    schedule: Schedule,
    /// Wanted, and not yet seen in force.
    unseen: Vec<Settings>,
    waiting: Vec<Waiting>,
    changes: VecDeque<Change>,
}

/// What came of a request.
pub(super) enum Handled {
    /// It is answered.
    Answered,
    /// The settings changed and are to be published. These members were set by hand.
    Changed(Vec<usize>),
}

impl Members {
    pub(super) fn new(plan: &Plan) -> Self {
        Self {
            names: plan.members.iter().map(|m| m.name.clone()).collect(),
            planned: plan.fuse.clone(),
            delivery: plan.delivery,
            deadline_ns: plan.deadline_ns,
            wanted: plan.members.iter().map(|m| m.enabled).collect(),
            shed: vec![false; plan.members.len()],
            settings: Settings::of_plan(plan),
            schedule: Schedule::default(),
            unseen: Vec::new(),
            waiting: Vec::new(),
            changes: VecDeque::new(),
        }
    }

    pub(super) fn states(&self) -> Vec<MemberState> {
        let state = |index: usize| MemberState {
            name: self.names[index].clone(),
            enabled: self.settings.members[index].enabled,
            shed: self.shed[index],
            weight: self.settings.members[index].weight,
        };
        (0..self.names.len()).map(state).collect()
    }

    pub(super) fn name(&self, member: usize) -> &str {
        self.names.get(member).map_or("?", String::as_str)
    }

    /// The fuser's settings that are wanted now.
    pub(super) fn fuse(&self) -> FuseStatus {
        let fuse = &self.settings.fuse;
        FuseStatus {
            length: fuse.length.unwrap_or(self.planned.length as u32),
            rule: fuse.rule.unwrap_or(self.planned.rule).name().to_owned(),
            deadline_ms: fuse.deadline_ns.unwrap_or(self.deadline_ns) as f64 / 1e6,
            min_confidence: fuse.min_confidence.unwrap_or(self.planned.min_confidence),
        }
    }

    /// The newest changes, oldest first; those that wait for their tick come last.
    pub(super) fn changes(&self) -> Vec<Change> {
        let waiting = self.waiting.iter().map(|w| &w.change);
        self.changes.iter().chain(waiting).cloned().collect()
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

    /// Enters what a request wants: says what changes, and which members were set by hand.
    fn enter(&mut self, request: &ControlRequest) -> Result<(String, Vec<usize>), String> {
        match request {
            ControlRequest::List | ControlRequest::Status => Err("there is nothing to change".to_owned()),
            ControlRequest::Set {
                members,
                enabled,
                weight,
                unload,
            } => {
                if enabled.is_none() && weight.is_none() {
                    return Err("there is nothing to change".to_owned());
                }
                if let Some(weight) = weight.filter(|w| !w.is_finite() || *w < 0.0) {
                    return Err(format!("{weight} is not a weight; give a number of 0 or more"));
                }
                if *unload && *enabled != Some(false) {
                    return Err("only what is disabled can be unloaded".to_owned());
                }
                let indices = self.find(members)?;
                for index in &indices {
                    let setting = &mut self.settings.members[*index];
                    if let Some(enabled) = *enabled {
                        self.wanted[*index] = enabled;
                        self.shed[*index] = false;
                        setting.enabled = enabled;
                        setting.unload = *unload;
                    }
                    setting.weight = weight.unwrap_or(setting.weight);
                }
                let mut what = match enabled {
                    Some(true) => "enabled".to_owned(),
                    Some(false) if *unload => "disabled and unloaded".to_owned(),
                    Some(false) => "disabled".to_owned(),
                    None => String::new(),
                };
                if let Some(weight) = weight {
                    what += &format!("{}weight {weight}", if what.is_empty() { "" } else { ", " });
                }
                let by_hand = if enabled.is_some() { indices } else { Vec::new() };
                Ok((format!("{}: {what}", members.join(" ")), by_hand))
            }
            ControlRequest::Configure {
                length,
                rule,
                deadline_ns,
                min_confidence,
            } => self
                .configure(*length, rule.as_deref(), *deadline_ns, *min_confidence)
                .map(|what| (what, Vec::new())),
        }
    }

    fn configure(
        &mut self,
        length: Option<u32>,
        rule: Option<&str>,
        deadline_ns: Option<u64>,
        min_confidence: Option<f64>,
    ) -> Result<String, String> {
        let mut fuse = self.settings.fuse;
        let mut what = Vec::new();
        if let Some(length) = length {
            if !self.planned.sequence.has_length() {
                return Err("the sequence method of this run has no length".to_owned());
            }
            if !(1..=MAX_LENGTH).contains(&length) {
                return Err(format!(
                    "{length} is not a sequence length; give 1 to {MAX_LENGTH} ticks"
                ));
            }
            fuse.length = Some(length);
            what.push(format!("length {length}"));
        }
        if let Some(name) = rule {
            let named = match (Rule::named(name), self.planned.rule) {
                // The configuration's own trim counts for its own rule.
                (Some(Rule::TrimmedMean { .. }), planned @ Rule::TrimmedMean { .. }) => Some(planned),
                (named, _) => named,
            };
            let all = (1..).map_while(|code| Rule::from_code(code, Rule::TRIM));
            let rule = named.ok_or_else(|| {
                let names: Vec<&str> = all.map(|r| r.name()).collect();
                format!("there is no rule \"{name}\"; there are {}", names.join(", "))
            })?;
            fuse.rule = Some(rule);
            what.push(format!("rule {name}"));
        }
        if let Some(ns) = deadline_ns {
            if self.delivery != Delivery::Latest {
                return Err(
                    "lossless delivery has no deadline: every answer waits for its members".to_owned(),
                );
            }
            if !(1..=MAX_DEADLINE_NS).contains(&ns) {
                return Err("that is not a deadline; give a time above 0 and up to an hour".to_owned());
            }
            fuse.deadline_ns = Some(ns);
            what.push(format!("deadline {} ms", ns as f64 / 1e6));
        }
        if let Some(least) = min_confidence {
            if !(0.0..=1.0).contains(&least) {
                return Err(format!("{least} is not a confidence; give a number from 0 to 1"));
            }
            fuse.min_confidence = Some(least);
            what.push(format!("min_confidence {least}"));
        }
        if what.is_empty() {
            return Err("there is nothing to change".to_owned());
        }
        self.settings.fuse = fuse;
        Ok(what.join(", "))
    }

    /// Answers or enters a request.
    pub(super) fn handle(&mut self, asked: Asked, now: Instant) -> Handled {
        if asked.request == ControlRequest::List {
            let reply = ControlReply {
                members: self.states(),
                ..ControlReply::default()
            };
            asked.answer(reply);
            return Handled::Answered;
        }
        match self.enter(&asked.request) {
            Err(text) => {
                info!("{} was refused: {text}", asked.peer);
                asked.answer(ControlReply::refusal(text));
                Handled::Answered
            }
            Ok((what, by_hand)) => {
                self.commit(Some(asked.reply), asked.peer.to_string(), what, now);
                Handled::Changed(by_hand)
            }
        }
    }

    /// The governor has these members off, and no others. Gives the new version of the settings.
    pub(super) fn govern(&mut self, shed: &[usize], what: String, now: Instant) -> u64 {
        for (index, setting) in self.settings.members.iter_mut().enumerate() {
            self.shed[index] = shed.contains(&index);
            setting.enabled = self.wanted[index] && !self.shed[index];
        }
        self.commit(None, "governor".to_owned(), what, now);
        self.settings.version
    }

    fn commit(&mut self, reply: Option<Sender<ControlReply>>, who: String, what: String, now: Instant) {
        self.settings.version += 1;
        self.unseen.push(self.settings.clone());
        let at = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let change = Change {
            at_unix_ms: at.map_or(0, |t| t.as_millis() as u64),
            who,
            what,
            from_tick: None,
        };
        self.waiting.push(Waiting {
            version: self.settings.version,
            reply,
            change,
            until: now + CONFIRM_TIMEOUT,
        });
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
            if let Some(reply) = w.reply {
                let _ = reply.send(ControlReply::refusal("the instance is stopping".to_owned()));
            }
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
        let (heard, waiting) = std::mem::take(&mut self.waiting).into_iter().partition(&due);
        self.waiting = waiting;
        let heard: Vec<Waiting> = heard;
        for w in heard {
            let change = Change {
                from_tick,
                ..w.change
            };
            let when = from_tick.map_or("from the next tick that opens".to_owned(), |t| {
                format!("from tick {t}")
            });
            // The audit log: who changed what, and from when on it holds.
            info!("{}: {} {when} on", change.who, change.what);
            if self.changes.len() == KEPT_CHANGES {
                self.changes.pop_front();
            }
            self.changes.push_back(change);
            if let Some(reply) = w.reply {
                let _ = reply.send(ControlReply {
                    members: members.clone(),
                    from_tick,
                    ..ControlReply::default()
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Peer;
    use crossbeam::channel::{Receiver, bounded};
    use evpr_core::plan::test_plan;

    fn peer() -> Peer {
        Peer {
            uid: 1,
            pid: 2,
            on_behalf_of: None,
        }
    }

    fn set(members: &mut Members, enabled: bool) -> Receiver<ControlReply> {
        let (reply, answer) = bounded(1);
        let request = ControlRequest::Set {
            members: vec!["all".to_owned()],
            enabled: Some(enabled),
            weight: None,
            unload: false,
        };
        let peer = peer();
        let handled = members.handle(Asked { request, peer, reply }, Instant::now());
        assert!(matches!(handled, Handled::Changed(_)));
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
            .map(|(t, s)| (*t, s.version, s.members[0].enabled))
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

    fn ask(members: &mut Members, request: ControlRequest) -> Result<(), String> {
        let (reply, answer) = bounded(1);
        let peer = peer();
        match members.handle(Asked { request, peer, reply }, Instant::now()) {
            Handled::Changed(_) => Ok(()),
            Handled::Answered => Err(answer.try_recv().unwrap().error.unwrap()),
        }
    }

    #[test]
    fn what_cannot_be_is_refused_and_changes_nothing() {
        let mut members = Members::new(&test_plan());
        let before = members.settings.members.clone();
        let configure = |length, rule: Option<&str>, deadline_ns| ControlRequest::Configure {
            length,
            rule: rule.map(str::to_owned),
            deadline_ns,
            min_confidence: None,
        };
        let confident = |least| ControlRequest::Configure {
            length: None,
            rule: None,
            deadline_ns: None,
            min_confidence: Some(least),
        };
        let set = |members: &[&str], enabled, weight, unload| ControlRequest::Set {
            members: members.iter().map(|m| (*m).to_owned()).collect(),
            enabled,
            weight,
            unload,
        };
        for (request, words) in [
            (configure(None, None, None), "nothing to change"),
            (configure(Some(0), None, None), "not a sequence length"),
            (configure(Some(1_001), None, None), "not a sequence length"),
            (
                configure(Some(5), Some("best"), None),
                "no rule \"best\"; there are sum, mean",
            ),
            (configure(None, None, Some(1)), "no deadline"),
            (confident(1.1), "1.1 is not a confidence"),
            (confident(-0.1), "not a confidence"),
            (confident(f64::NAN), "not a confidence"),
            (set(&[], Some(true), None, false), "at least one"),
            (
                set(&["all", "b@1ms/y"], Some(true), None, false),
                "no member \"b@1ms/y\"",
            ),
            (set(&["all"], None, Some(f64::NAN), false), "not a weight"),
            (set(&["all"], None, Some(-1.0), false), "not a weight"),
            (set(&["all"], Some(true), None, true), "only what is disabled"),
            (set(&["all"], None, None, false), "nothing to change"),
        ] {
            let error = ask(&mut members, request.clone()).unwrap_err();
            assert!(error.contains(words), "{request:?}: {error}");
        }
        assert_eq!(
            (members.settings.version, members.settings.members.clone()),
            (0, before)
        );
        assert_eq!(members.settings.fuse, Default::default());
        ask(&mut members, configure(Some(20), Some("median"), None)).unwrap();
        let fuse = members.fuse();
        assert_eq!((fuse.length, fuse.rule.as_str()), (20, "median"));
        members.opened(4, 1);
        let change = members.changes().pop().unwrap();
        assert_eq!(
            (change.from_tick, change.what.as_str()),
            (Some(4), "length 20, rule median")
        );
        assert_eq!(change.who, "uid 1 pid 2");
    }

    #[test]
    fn whoever_is_shed_is_still_wanted_and_a_hand_outweighs_the_governor() {
        let mut members = Members::new(&test_plan());
        members.govern(&[1], "b off".to_owned(), Instant::now());
        let states = members.states();
        assert!(states[0].enabled && !states[0].shed);
        assert!(!states[1].enabled && states[1].shed);
        members.govern(&[], "b on".to_owned(), Instant::now());
        assert!(members.states().iter().all(|m| m.enabled && !m.shed));
        members.govern(&[1], "b off".to_owned(), Instant::now());
        set(&mut members, false);
        members.govern(&[], "nobody off".to_owned(), Instant::now());
        assert!(
            members.states().iter().all(|m| !m.enabled && !m.shed),
            "switched off by hand"
        );
    }
}
