//! What the supervisor does, and when: a state machine without I/O. Events go in with their time, actions come out.
//!
//! Whatever happens, in whatever order:
//! - Whoever has died is buried in the same step: nobody waits for the dead.
//! - Every process runs, is about to be started, has done its work, or is marked down.
//! - Signals go only to incarnations that run.
//! - The run ends once, and nothing is asked for after that.

mod ending;
mod life;
#[cfg(test)]
mod tests;
mod words;

pub(super) use life::{Exit, Life, Told};
pub(super) use words::{Action, Event, Level, Part, Rules, Start};

use ending::Ending;
use evpr_core::message::{ServiceHealth, ServicePhase, ServiceState};
use evpr_core::plan::ServiceKind;
use nix::sys::signal::Signal;

const MS: u64 = 1_000_000;
const SECOND: u64 = 1_000 * MS;
/// Time that the graph has after a request to stop to finish the ticks under way.
const DRAIN_NS: u64 = 10 * SECOND;
/// When the policy has not been asked for so long, the supervisor itself was held up, and nobody else is to blame.
const AWAY_NS: u64 = SECOND;

/// Where the run stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum State {
    /// Ingest is held back until everybody else is ready.
    Starting,
    Running,
    /// Ingest was asked to end; the rest finishes what is under way.
    Draining {
        since_ns: u64,
    },
    /// Ending everything, upstream first.
    Ending(Ending),
    /// Nothing runs any more.
    Over,
}

/// See the module. Times are host monotonic, ns.
#[derive(Debug)]
pub(super) struct Policy {
    rules: Rules,
    lives: Vec<Life>,
    state: State,
    epoch: u32,
    next_answer: u64,
    /// The first tick that ingest has never opened.
    next_open: u64,
    /// Where ingest has said that the stream ends.
    end_tick: Option<u64>,
    /// Ticks before an answer that a new fuser has to see.
    history: u64,
    stop_requests: u32,
    failed: bool,
    failure: Option<String>,
    /// When it was last asked what is due.
    passed_ns: Option<u64>,
    actions: Vec<Action>,
}

impl Policy {
    /// `parts` are the services of the plan, in its order.
    pub(super) fn new(rules: Rules, parts: impl IntoIterator<Item = Part>) -> Self {
        let mut lives: Vec<Life> = parts.into_iter().map(Life::new).collect();
        for life in &mut lives {
            life.start_at_ns = (life.kind != ServiceKind::Ingest).then_some(0);
        }
        Self {
            rules,
            lives,
            state: State::Starting,
            epoch: 0,
            next_answer: 0,
            next_open: 0,
            end_tick: None,
            history: 0,
            stop_requests: 0,
            failed: false,
            failure: None,
            passed_ns: None,
            actions: Vec::new(),
        }
    }

    pub(super) fn lives(&self) -> &[Life] {
        &self.lives
    }

    pub(super) fn state(&self) -> State {
        self.state
    }

    /// The first tick that is not answered yet.
    pub(super) fn next_answer(&self) -> u64 {
        self.next_answer
    }

    /// The run did not end as it should.
    pub(super) fn has_failed(&self) -> bool {
        self.failed
    }

    /// Why it failed, where the process that failed has not said so itself.
    pub(super) fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// What the sinks are told.
    pub(super) fn states(&self) -> Vec<ServiceState> {
        self.lives.iter().map(Life::state).collect()
    }

    /// From now on a new fuser has to see so many ticks before the first that it answers.
    pub(super) fn set_history(&mut self, ticks: u64) {
        self.history = ticks;
    }

    /// When [`Policy::pass`] has something to do though nothing happens.
    pub(super) fn due_ns(&self) -> Option<u64> {
        match self.state {
            State::Over => None,
            State::Ending(ending) => ending.due_ns(),
            State::Draining { since_ns } => {
                let starts = self.lives.iter().filter_map(|l| l.start_at_ns);
                Some(starts.fold(since_ns + DRAIN_NS, u64::min))
            }
            State::Starting | State::Running => self.lives.iter().filter_map(|l| l.start_at_ns).min(),
        }
    }

    /// Takes what has happened and says what to do about it.
    pub(super) fn on(&mut self, now_ns: u64, event: Event) -> Vec<Action> {
        if self.state != State::Over {
            self.take(now_ns, event);
        }
        std::mem::take(&mut self.actions)
    }

    /// Does what is due. Called whenever all that has happened has been told.
    pub(super) fn pass(&mut self, now_ns: u64) -> Vec<Action> {
        self.advance(now_ns);
        for index in 0..self.lives.len() {
            let due = self.lives[index].start_at_ns.is_some_and(|t| t <= now_ns);
            if due && self.is_open() {
                self.start(now_ns, index);
            }
        }
        if self.is_open() {
            self.look_for_hangs(now_ns);
        }
        std::mem::take(&mut self.actions)
    }

    /// Processes are still started.
    fn is_open(&self) -> bool {
        matches!(
            self.state,
            State::Starting | State::Running | State::Draining { .. }
        )
    }

    fn say(&mut self, level: Level, line: String) {
        self.actions.push(Action::Say(level, line));
    }

    fn take(&mut self, now_ns: u64, event: Event) {
        match event {
            Event::Told {
                service,
                incarnation,
                told,
            } => self.told(now_ns, service, incarnation, told),
            Event::Ended {
                service,
                exit,
                status,
            } => self.ended(now_ns, service, exit, &status),
            Event::Answered { tick } => self.next_answer = self.next_answer.max(tick + 1),
            Event::Opened { tick } => self.next_open = self.next_open.max(tick + 1),
            Event::StreamEnds { tick } => self.end_tick = Some(tick),
            Event::Stop { requests } => {
                self.stop_requests = requests;
                if let (State::Ending(ending), true) = (&mut self.state, requests > 1) {
                    ending.hurry(now_ns);
                }
            }
            Event::Failed { line } => self.fail(now_ns, line),
        }
    }

    fn told(&mut self, now_ns: u64, index: usize, incarnation: u32, told: Told) {
        let Some(life) = self.lives.get_mut(index) else {
            return;
        };
        if incarnation != life.incarnation || !life.running {
            return; // of one that is dead
        }
        let was_ready = life.in_phase(ServicePhase::Ready);
        life.told(now_ns, told);
        if life.in_phase(ServicePhase::Ready) && !was_ready {
            self.became_ready(now_ns, index);
        }
    }

    fn became_ready(&mut self, now_ns: u64, index: usize) {
        let life = &mut self.lives[index];
        life.health = ServiceHealth::Up;
        let back = std::mem::take(&mut life.died);
        let (kind, sink, again) = (life.kind, life.is_sink(), life.incarnation > 1);
        let name = life.name.clone();
        if back {
            self.say(Level::Info, format!("{name} is back"));
        }
        if sink || back || kind == ServiceKind::Dashboard {
            self.actions.push(Action::TellStates);
        }
        if !sink {
            self.actions.push(Action::TellSettings);
        }
        let under_way = matches!(self.state, State::Running | State::Draining { .. });
        if sink && again && self.rules.lossless && under_way {
            self.send_ingest_back(now_ns);
        }
    }

    /// The first tick that some sink still needs.
    fn needed_tick(&self) -> u64 {
        let needs = self.lives.iter().filter(|l| l.is_sink()).map(|l| {
            let rebuilding = l.incarnation > 1 && l.next_tick < self.next_answer;
            if l.kind == ServiceKind::Fuse && !rebuilding {
                l.next_tick.max(self.next_answer)
            } else {
                l.next_tick
            }
        });
        needs.min().unwrap_or(0)
    }

    /// Kills ingest, to be started again at the tick that is needed. SIGKILL, because an orderly stop would tell
    /// everybody that the stream has ended.
    fn send_ingest_back(&mut self, now_ns: u64) {
        let mut lives = self.lives.iter_mut().enumerate();
        if let Some((service, ingest)) = lives.find(|(_, l)| l.kind == ServiceKind::Ingest) {
            if ingest.running {
                ingest.sent_back = true;
                let signal = Signal::SIGKILL;
                self.actions.push(Action::Signal { service, signal });
            } else {
                ingest.start_at_ns = Some(now_ns);
            }
        }
    }

    fn ended(&mut self, now_ns: u64, index: usize, exit: Exit, status: &str) {
        let Some(life) = self.lives.get_mut(index).filter(|l| l.running) else {
            return;
        };
        let done = life.is_done();
        life.running = false;
        let name = life.name.clone();
        if let State::Ending(ending) = self.state {
            self.failed |= exit == Exit::Failed && !life.optional;
            if exit == Exit::Died && !ending.has_killed() {
                self.say(Level::Warn, format!("{name} ended badly ({status})"));
            }
            return;
        }
        self.actions.push(Action::CleanUp);
        if exit == Exit::Failed {
            return self.cannot_go_on(now_ns, index);
        }
        let draining = matches!(self.state, State::Draining { .. });
        if done && life.is_sink() {
            life.finished = true;
            return;
        }
        if exit == Exit::Clean && life.kind == ServiceKind::Ingest && draining {
            life.finished = true; // it was asked to
            return;
        }
        if exit == Exit::Clean && life.is_essential() {
            let line = format!("{name} was told to stop by somebody else; the run ends with what it has");
            return self.fail(now_ns, line);
        }
        self.died(now_ns, index, status);
        self.actions.push(Action::TellStates);
    }

    /// A process has said that it cannot go on, and why.
    fn cannot_go_on(&mut self, now_ns: u64, index: usize) {
        let under_way = self.state != State::Starting;
        let life = &mut self.lives[index];
        // A replay that cannot be whole is better repeated; live there is nothing to go back to.
        let spared = life.optional || (under_way && !self.rules.lossless && !life.is_essential());
        if !spared {
            self.failed = true;
            return self.end(now_ns);
        }
        life.bury(ServiceHealth::Down);
        let (name, optional) = (life.name.clone(), life.optional);
        let why = if optional {
            "it is optional, and the"
        } else {
            "the"
        };
        let line = format!("{name} cannot go on; {why} run goes on without it");
        self.say(if optional { Level::Warn } else { Level::Error }, line);
        self.actions.push(Action::TellStates);
        self.check_members(now_ns);
    }

    /// Without any member there is no run.
    fn check_members(&mut self, now_ns: u64) {
        let down = |service: &usize| {
            let life = self.lives.get(*service);
            life.is_some_and(|l| l.health == ServiceHealth::Down)
        };
        let mut members = self.rules.members.iter();
        if !self.rules.members.is_empty() && members.all(|services| services.iter().any(down)) {
            let line = "no member is left: each needs a process that is down for good; the run ends";
            self.fail(now_ns, line.to_owned());
        }
    }

    fn died(&mut self, now_ns: u64, index: usize, status: &str) {
        let life = &mut self.lives[index];
        let name = life.name.clone();
        life.bury(ServiceHealth::Restarting);
        if std::mem::take(&mut life.sent_back) {
            life.start_at_ns = Some(now_ns);
            return;
        }
        life.died = true;
        match life.backoff(now_ns, self.rules.limits.deaths_per_minute) {
            Some(wait_ns) => {
                life.start_at_ns = Some(now_ns + wait_ns);
                life.restarts += 1;
                let line = format!("{name} died ({status}); starting it again in {} ms", wait_ns / MS);
                self.say(Level::Warn, line);
            }
            None if life.is_essential() => {
                life.health = ServiceHealth::Down;
                let line = format!("{name} died too often ({status}); without it the run cannot go on");
                self.fail(now_ns, line);
            }
            None => {
                life.health = ServiceHealth::Down;
                let line =
                    format!("{name} died too often ({status}) and is given up; the run goes on without it");
                self.say(Level::Error, line);
                self.check_members(now_ns);
            }
        }
    }

    fn start(&mut self, now_ns: u64, index: usize) {
        let first_tick = if self.lives[index].kind == ServiceKind::Ingest {
            self.epoch += 1;
            match self.rules.from_the_start {
                true => 0,
                false => self.needed_tick().saturating_sub(self.rules.look_back),
            }
        } else {
            self.next_answer.saturating_sub(self.history)
        };
        let draining = matches!(self.state, State::Draining { .. });
        let life = &mut self.lives[index];
        life.started(now_ns);
        self.actions.push(Action::Start(Start {
            service: index,
            incarnation: life.incarnation,
            epoch: self.epoch,
            first_tick,
            answer_from: self.next_answer,
            end_tick: draining.then(|| self.end_tick.unwrap_or(self.next_open)),
        }));
    }

    fn look_for_hangs(&mut self, now_ns: u64) {
        let passed_ns = self.passed_ns.replace(now_ns).unwrap_or(now_ns);
        let away = now_ns.saturating_sub(passed_ns) > AWAY_NS;
        for (service, life) in self.lives.iter_mut().enumerate() {
            if away {
                life.forgive_silence(now_ns);
            }
            if let Some(line) = life.hangs(now_ns, &self.rules.limits) {
                let signal = Signal::SIGKILL;
                self.actions.push(Action::Say(Level::Warn, line));
                self.actions.push(Action::Signal { service, signal });
            }
        }
    }

    /// Moves the run on to its next state when it is time.
    fn advance(&mut self, now_ns: u64) {
        let stop = self.stop_requests > 0;
        match self.state {
            State::Over => {}
            State::Ending(_) => self.end_on(now_ns),
            _ if self.stop_requests > 1 => self.end(now_ns),
            State::Starting if stop => self.end(now_ns),
            State::Starting => {
                // Ingest is the one that is held back, and nobody waits for a dashboard.
                let awaited = |l: &&Life| !matches!(l.kind, ServiceKind::Ingest | ServiceKind::Dashboard);
                let mut others = self.lives.iter().filter(awaited);
                if others.all(Life::is_settled) {
                    self.state = State::Running;
                    self.send_ingest_back(now_ns);
                }
            }
            State::Running | State::Draining { .. }
                if self.lives.iter().filter(|l| l.is_sink()).all(Life::is_done) =>
            {
                self.end(now_ns);
            }
            State::Running if stop => {
                // An ingest that is being started again is told then where to end.
                let mut lives = self.lives.iter().enumerate();
                let ingest = lives.find(|(_, l)| l.kind == ServiceKind::Ingest && l.running);
                if let Some((service, _)) = ingest {
                    let signal = Signal::SIGTERM;
                    self.actions.push(Action::Signal { service, signal });
                }
                self.state = State::Draining { since_ns: now_ns };
            }
            State::Draining { since_ns } if now_ns.saturating_sub(since_ns) > DRAIN_NS => {
                let seconds = DRAIN_NS / SECOND;
                let line = format!("the ticks under way did not finish within {seconds} s and are left out");
                self.fail(now_ns, line);
            }
            State::Running | State::Draining { .. } => {}
        }
    }
}
