//! The supervisor's loop.

use super::Spawn;
use super::members::{Handled, Members};
use super::process::{Exit, Process};
use super::profile::Profile;
use crate::channel::{ChannelReceiver, ChannelSender, ChannelServices, Ipc, SUPERVISOR_READER};
use crate::control::{ControlReply, ControlRequest, ControlServer};
use crate::domain::{RunFolder, RunSpec};
use crate::profile::{FuseStatus, GovernorStatus, Status};
use crate::run::Identity;
use crate::stop::{SignalListener, Stop, wake_pair};
use crate::wait::{Waiter, wait_set};
use crate::{RuntimeError, now_ns, shm, trace};
use evpr_core::Plan;
use evpr_core::governor::{Decision, Governor, Priced};
use evpr_core::message::{
    Candidate, Chunks, Control, ControlHeader, Descriptors, Frames, Header, Lifecycle, LifecycleHeader,
    MatchHeader, Matches, Message, ServiceHealth, ServicePhase, Span, Spans, Stats, StatsHeader, TickKind,
    Ticks,
};
use evpr_core::plan::{Delivery, Fuse, Member, Service, ServiceKind, Topic};
use evpr_core::stage::{OpenedTick, Outlet};
use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use nix::sys::signal::Signal;
use std::any::Any;
use std::fs::File;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tracing::{info, warn};

/// The supervisor looks after dead nodes at least this often, should a death notice be missed.
const ROUND: Duration = Duration::from_millis(250);
/// Time that the graph has after Ctrl-C to finish the ticks under way.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(10);
/// Time that a process has to end after SIGTERM.
const EXIT_TIMEOUT: Duration = Duration::from_secs(10);
/// A process that says nothing for so long is worth a warning. They speak up a few times per second.
const SILENCE: Duration = Duration::from_secs(5);
/// The supervisor's own number in stamps.
const SUPERVISOR: u32 = u32::MAX;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Its input ended and everything was answered.
    Finished,
    /// By SIGTERM, in an orderly way.
    Stopped,
    /// By Ctrl-C.
    Interrupted,
    /// A process failed; it has said why.
    Failed,
}

/// How far a run is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// Permille of the recording that is read; 0 when not known.
    pub permille: u64,
    /// Events sent so far.
    pub events: u64,
    /// Ticks answered so far.
    pub answers: u64,
    /// Ticks recorded so far.
    pub recorded: u64,
}

/// What one process did.
#[derive(Debug, Clone)]
pub struct ServiceReport {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: ServiceKind,
    /// Restarts after deaths.
    pub restarts: u64,
    /// Counters of its last incarnation.
    pub stats: StatsHeader,
}

/// What a run came to.
#[derive(Debug, Clone)]
pub struct RunSummary {
    /// How it ended.
    pub outcome: Outcome,
    /// Ticks answered.
    pub answers: u64,
    /// Why it failed, in one line; `None` where the process that failed has said so itself.
    pub failure: Option<String>,
    /// Per process.
    pub services: Vec<ServiceReport>,
}

/// Makes the command line of one process.
pub type CommandLine = Box<dyn Fn(&Service, &Spawn) -> Command>;

/// What the caller hears while the graph runs.
pub trait Hooks {
    /// One answer, in order of ticks, each tick once.
    ///
    /// # Errors
    /// One line; the run then ends as failed.
    fn answer(&mut self, header: &MatchHeader, candidates: &[Candidate]) -> Result<(), String>;

    /// A few times per second.
    fn progress(&mut self, progress: &Progress);

    /// Whether [`Hooks::spans`] is to be told. Asked once, at the start.
    fn wants_spans(&self) -> bool {
        false
    }

    /// What a process did when, by the index of its service in the plan.
    fn spans(&mut self, service: usize, spans: &[Span]) {
        let _ = (service, spans);
    }
}

/// Where the run stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Ingest is held back until everybody else is ready.
    Starting,
    Running,
    /// Ingest was asked to end; the rest finishes what is under way.
    Draining {
        since: Instant,
    },
    /// Ending everything, upstream first.
    Stopping,
}

/// See the module.
pub struct Supervisor {
    plan: Plan,
    folder: RunFolder,
    run_id: u64,
    command: CommandLine,
    processes: Vec<Process>,
    state: State,
    epoch: u32,
    next_answer: u64,
    /// The first tick that ingest has never opened.
    next_open: u64,
    /// The newest tick that it has opened.
    newest_open: Option<OpenedTick>,
    /// Where ingest has said that the stream ends.
    end_tick: Option<u64>,
    answers: u64,
    failed: bool,
    failure: Option<String>,
    members: Members,
    lifecycle_version: u64,
    last_cleanup: Instant,
    profile: Profile,
    governor: Option<Governor>,
    /// Per member: whether its window is among the last of a tick to close.
    late: Vec<bool>,
    /// Answers that the governor has not seen yet: latency, and version of their settings.
    ungoverned: Vec<(u64, u64)>,
    ports: Ports,
    wake: Listener<Ipc>,
    control: ControlServer,
    stop: Stop,
    _signals: SignalListener,
    // Channels without a port of the supervisor's: held so that their sizes are the plan's.
    _held: Vec<Box<dyn Any>>,
    node: Node<Ipc>,
    _lock: Option<File>,
}

struct Ports {
    stats: ChannelReceiver<Stats>,
    /// When a trace is made.
    spans: Option<ChannelReceiver<Spans>>,
    ticks: ChannelReceiver<Ticks>,
    matches: Option<ChannelReceiver<Matches>>,
    lifecycle: ChannelSender<Lifecycle>,
    control: ChannelSender<Control>,
}

fn hold<M: Message>(
    node: &Node<Ipc>,
    plan: &Plan,
    topic: &Topic,
) -> Result<ChannelServices<M>, RuntimeError> {
    let channel = plan
        .channel(topic)
        .ok_or_else(|| RuntimeError::Ipc(format!("no channel {topic}")))?;
    ChannelServices::open(node, &channel)
}

fn publish_control(control: &mut ChannelSender<Control>, members: &Members) -> Result<(), RuntimeError> {
    let settings = members.settings.messages();
    let header = ControlHeader {
        version: members.settings.version,
        fuse: members.settings.fuse.message(),
        ..ControlHeader::default()
    };
    let sent = control.emit(header, settings.len(), &mut |slots| {
        slots.copy_from_slice(&settings)
    });
    sent.map_err(|e| RuntimeError::Ipc(e.to_string()))
}

impl Supervisor {
    /// Takes the run folder, checks the room in shared memory and creates the channels. `command` makes the command
    /// line of one process.
    ///
    /// # Errors
    /// When an instance of this name runs, shared memory is too small, or the folder cannot be used.
    pub fn new(plan: Plan, folder: RunFolder, command: CommandLine) -> Result<Self, RuntimeError> {
        let lock = folder.lock()?;
        let swept = folder.sweep();
        if swept > 0 {
            warn!(
                "an earlier run of this instance was cut short; removed the {swept} files it had left in shared memory"
            );
        }
        match Self::assemble(plan, folder.clone(), command) {
            Ok(supervisor) => Ok(Self {
                _lock: Some(lock),
                ..supervisor
            }),
            Err(e) => {
                folder.sweep();
                folder.remove();
                Err(e)
            }
        }
    }

    /// Everything but the lock, which is held by the caller.
    fn assemble(plan: Plan, folder: RunFolder, command: CommandLine) -> Result<Self, RuntimeError> {
        shm::check(&plan)?;
        let run_id = now_ns() ^ (u64::from(std::process::id()) << 40);
        folder.write_spec(&RunSpec {
            run_id,
            supervisor: std::process::id(),
            plan: plan.clone(),
        })?;
        let members = Members::new(&plan);
        let node = folder.node("supervisor")?;
        let (wake_sender, wake) = wake_pair(&node, "supervisor")?;
        let (stop, signals) = Stop::listen(wake_sender.clone(), true)?;
        let identity = Identity {
            run_id,
            service: SUPERVISOR,
            incarnation: 1,
        };
        let mut held: Vec<Box<dyn Any>> = vec![Box::new(hold::<Chunks>(&node, &plan, &Topic::Events)?)];
        for r in &plan.reconstructions {
            held.push(Box::new(hold::<Frames>(
                &node,
                &plan,
                &Topic::Frames(r.id.clone()),
            )?));
        }
        for e in &plan.extractors {
            held.push(Box::new(hold::<Descriptors>(
                &node,
                &plan,
                &Topic::Descriptors(e.id.clone()),
            )?));
        }
        let has_fuse = plan.map.is_some();
        let matches = if has_fuse {
            Some(ChannelReceiver::new(
                hold(&node, &plan, &Topic::Matches)?,
                run_id,
                SUPERVISOR_READER,
            )?)
        } else {
            None
        };
        held.push(Box::new(hold::<Spans>(&node, &plan, &Topic::Spans)?));
        let ports = Ports {
            spans: None,
            stats: ChannelReceiver::new(hold(&node, &plan, &Topic::Stats)?, run_id, SUPERVISOR_READER)?,
            ticks: ChannelReceiver::new(hold(&node, &plan, &Topic::Ticks)?, run_id, SUPERVISOR_READER)?,
            matches,
            lifecycle: ChannelSender::new(
                hold(&node, &plan, &Topic::Lifecycle)?,
                identity,
                &stop,
                1,
                Arc::default(),
            )?,
            control: ChannelSender::new(
                hold(&node, &plan, &Topic::Control)?,
                identity,
                &stop,
                1,
                Arc::default(),
            )?,
        };
        let control = ControlServer::start(&folder, wake_sender)?;
        let segments = plan.slicing.segments();
        let closes = |m: &Member| segments.windows.get(m.window).map_or(0, |w| w.last);
        let last = plan.members.iter().map(closes).max().unwrap_or(0);
        let late = plan.members.iter().map(|m| closes(m) == last).collect();
        let governor = plan.governor.clone();
        let governor = governor.map(|budget| Governor::new(budget, plan.members.len()));
        let services = plan.services().len();
        let processes = plan
            .services()
            .into_iter()
            .map(|s| {
                let optional = plan.is_optional(&s);
                Process::new(s, optional)
            })
            .collect();
        Ok(Self {
            plan,
            folder,
            run_id,
            command,
            processes,
            state: State::Starting,
            epoch: 0,
            next_answer: 0,
            next_open: 0,
            newest_open: None,
            end_tick: None,
            answers: 0,
            failed: false,
            failure: None,
            members,
            lifecycle_version: 0,
            last_cleanup: Instant::now(),
            profile: Profile::new(services),
            governor,
            late,
            ungoverned: Vec::new(),
            ports,
            wake,
            control,
            stop,
            _signals: signals,
            _held: held,
            node,
            _lock: None,
        })
    }

    /// Runs the graph to its end.
    ///
    /// # Errors
    /// When shared memory fails or a process cannot be started; everything is taken down then too.
    pub fn run(mut self, hooks: &mut dyn Hooks) -> Result<RunSummary, RuntimeError> {
        let outcome = self.supervise(hooks);
        if outcome.is_err() {
            for process in &self.processes {
                process.signal(Signal::SIGKILL);
            }
        }
        // Whatever is still there is waited for, so that the sweep below finds nobody at work.
        for process in &mut self.processes {
            if let Some(mut child) = process.child.take() {
                let _ = child.wait();
            }
        }
        self.clean_up_nodes();
        self.members.dismiss();
        let services = self.processes.iter().map(|p| ServiceReport {
            name: p.service.name.clone(),
            kind: p.service.kind,
            restarts: p.restarts,
            stats: p.stats,
        });
        let services = services.collect();
        let answers = self.answers;
        let failure = self.failure.take();
        let Self {
            folder,
            ports,
            wake,
            control,
            _signals,
            _held,
            node,
            _lock,
            ..
        } = self;
        drop((control, ports, wake, _signals, _held));
        drop(node);
        folder.sweep();
        folder.remove();
        drop(_lock);
        Ok(RunSummary {
            outcome: outcome?,
            answers,
            failure,
            services,
        })
    }

    fn supervise(&mut self, hooks: &mut dyn Hooks) -> Result<Outcome, RuntimeError> {
        if hooks.wants_spans() {
            let reader = trace::receiver(&self.node, &self.plan, self.run_id, SUPERVISOR_READER);
            self.ports.spans = Some(reader?);
        }
        let now = Instant::now();
        for process in &mut self.processes {
            process.start_at = (process.service.kind != ServiceKind::Ingest).then_some(now);
        }
        self.start_due()?;
        while self.state != State::Stopping {
            self.wait(self.next_timer())?;
            self.hear(hooks)?;
            for (index, exit, status) in self.reap() {
                self.ended(index, exit, &status, hooks)?;
            }
            self.start_due()?;
            self.look_after_nodes();
            self.take_requests()?;
            self.advance();
        }
        let unasked = !self.failed && !self.stop.requested();
        self.take_down(hooks)?;
        let mut ingest = self
            .processes
            .iter()
            .filter(|p| p.service.kind == ServiceKind::Ingest);
        if unasked && ingest.any(|p| p.stats.phase == ServicePhase::Stopped as u32) {
            self.fail(
                "ingest was told to stop by somebody else; the run ended with the ticks so far".to_owned(),
            );
        }
        Ok(
            match (self.failed, self.stop.requested(), self.stop.interrupted()) {
                (true, _, _) => Outcome::Failed,
                (_, _, true) => Outcome::Interrupted,
                (_, true, _) => Outcome::Stopped,
                _ => Outcome::Finished,
            },
        )
    }

    fn wait(&self, timeout: Duration) -> Result<(), RuntimeError> {
        let set = wait_set()?;
        let mut listeners = vec![
            &self.wake,
            self.ports.stats.listener(),
            self.ports.ticks.listener(),
        ];
        listeners.extend(self.ports.spans.as_ref().map(ChannelReceiver::listener));
        listeners.extend(self.ports.matches.as_ref().map(ChannelReceiver::listener));
        Waiter::new(&set, listeners)?.wait(timeout)
    }

    fn next_timer(&self) -> Duration {
        let now = Instant::now();
        let due = self
            .processes
            .iter()
            .filter_map(|p| p.start_at)
            .map(|t| t.saturating_duration_since(now));
        due.min().unwrap_or(ROUND).min(ROUND)
    }

    /// Takes everything that has come: answers, stats, ticks.
    fn hear(&mut self, hooks: &mut dyn Hooks) -> Result<(), RuntimeError> {
        self.take_answers(hooks)?;
        if let Some(spans) = &self.ports.spans {
            trace::drain(spans, &mut |service, spans| hooks.spans(service, spans))?;
        }
        while let Some(message) = self.ports.ticks.receive()? {
            let header = message.header();
            match TickKind::from_code(header.kind) {
                Some(TickKind::Open) => {
                    if header.tick >= self.next_open {
                        self.next_open = header.tick + 1;
                        self.newest_open = Some(OpenedTick {
                            tick: header.tick,
                            start_us: header.start_us,
                            sent_ns: header.stamp.sent_ns,
                        });
                    }
                    self.members.opened(header.tick, header.control_version);
                }
                Some(TickKind::End) => self.end_tick = Some(header.tick),
                _ => {}
            }
        }
        let mut heard = false;
        while let Some(message) = self.ports.stats.receive()? {
            heard = true;
            let stats = *message.header();
            let index = stats.stamp.service as usize;
            let Some(process) = self.processes.get_mut(index) else {
                continue;
            };
            if stats.stamp.incarnation != process.incarnation {
                continue;
            }
            let was_ready = process.in_phase(ServicePhase::Ready);
            process.stats = stats;
            if !message.payload().is_empty() {
                process.take_costs(message.payload());
            }
            process.heard_at = Instant::now();
            if std::mem::take(&mut process.silent) {
                info!("{} is heard again", process.service.name);
            }
            if !was_ready && process.in_phase(ServicePhase::Ready) {
                self.became_ready(index)?;
            }
        }
        if heard {
            hooks.progress(&self.progress());
        }
        self.govern()
    }

    /// Shows the governor what has been answered, and does what it decides.
    fn govern(&mut self) -> Result<(), RuntimeError> {
        let Some(governor) = &mut self.governor else {
            return Ok(());
        };
        for (latency_ns, version) in std::mem::take(&mut self.ungoverned) {
            if self.state != State::Running {
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
            publish_control(&mut self.ports.control, &self.members)?;
        }
        Ok(())
    }

    fn progress(&self) -> Progress {
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

    fn take_answers(&mut self, hooks: &mut dyn Hooks) -> Result<(), RuntimeError> {
        let Some(matches) = &mut self.ports.matches else {
            return Ok(());
        };
        while let Some(message) = matches.receive()? {
            let header = message.header();
            if header.tick() < self.next_answer {
                continue; // answered by a fuser that has died since
            }
            if header.tick() > self.next_answer && self.answers > 0 {
                warn!(
                    from = self.next_answer,
                    to = header.tick() - 1,
                    "answers are missing: they were not made, or did not arrive"
                );
            }
            self.next_answer = header.tick() + 1;
            self.answers += 1;
            self.profile.answered(header);
            if self.governor.is_some() {
                self.ungoverned.push((header.total_ns, header.control_version));
            }
            let count = (header.candidates as usize).min(message.payload().len());
            if let Err(line) = hooks.answer(header, &message.payload()[..count]) {
                self.failure.get_or_insert(line);
                self.failed = true;
                self.state = State::Stopping;
            }
        }
        Ok(())
    }

    fn became_ready(&mut self, index: usize) -> Result<(), RuntimeError> {
        let process = &mut self.processes[index];
        process.health = ServiceHealth::Up;
        if std::mem::take(&mut process.died) {
            info!("{} is back", process.service.name);
        }
        let (sink, kind, again) = (process.is_sink(), process.service.kind, process.incarnation > 1);
        if sink {
            self.publish_lifecycle()?;
        }
        if matches!(
            kind,
            ServiceKind::Ingest | ServiceKind::Reconstruct | ServiceKind::Extract
        ) {
            self.publish_control()?;
        }
        let under_way = matches!(self.state, State::Running | State::Draining { .. });
        if sink && again && self.plan.delivery == Delivery::Lossless && under_way {
            self.send_ingest_back();
        }
        Ok(())
    }

    /// The first tick that some sink still needs.
    fn needed_tick(&self) -> u64 {
        let needs = self.processes.iter().filter(|p| p.is_sink()).map(|p| {
            let next = p.stats.next_tick;
            let rebuilding =
                p.service.kind == ServiceKind::Fuse && p.incarnation > 1 && next < self.next_answer;
            if p.service.kind == ServiceKind::Fuse && !rebuilding {
                next.max(self.next_answer)
            } else {
                next
            }
        });
        needs.min().unwrap_or(0)
    }

    /// Kills ingest, to be started again at the tick that is needed. SIGKILL, because an orderly stop would tell
    /// everybody that the stream has ended.
    fn send_ingest_back(&mut self) {
        if let Some(ingest) = self
            .processes
            .iter_mut()
            .find(|p| p.service.kind == ServiceKind::Ingest)
        {
            if ingest.child.is_some() {
                ingest.sent_back = true;
                ingest.signal(Signal::SIGKILL);
            } else {
                ingest.start_at = Some(Instant::now());
            }
        }
    }

    /// The run cannot go on, for this reason.
    fn fail(&mut self, line: String) {
        self.failure.get_or_insert(line);
        self.failed = true;
        self.state = State::Stopping;
    }

    fn reap(&mut self) -> Vec<(usize, Exit, String)> {
        let reaped = self.processes.iter_mut().enumerate();
        reaped
            .filter_map(|(i, p)| p.reap().map(|(exit, status)| (i, exit, status)))
            .collect()
    }

    /// A process has ended although nobody asked it to.
    fn ended(
        &mut self,
        index: usize,
        exit: Exit,
        status: &str,
        hooks: &mut dyn Hooks,
    ) -> Result<(), RuntimeError> {
        // What the dead one had sent is taken before its memory is cleaned up.
        self.hear(hooks)?;
        self.clean_up_nodes();
        if exit == Exit::Failed && self.processes[index].optional {
            let process = &mut self.processes[index];
            process.dead_through = process.incarnation;
            process.health = ServiceHealth::Down;
            warn!(
                "{} cannot go on; it is optional, and the run goes on without it",
                process.service.name
            );
            return self.publish_lifecycle();
        }
        if exit == Exit::Failed {
            self.failed = true;
            self.state = State::Stopping;
            return Ok(());
        }
        let draining = matches!(self.state, State::Draining { .. });
        let process = &mut self.processes[index];
        if process.is_done() && process.is_sink() {
            process.finished = true;
            return Ok(());
        }
        if exit == Exit::Clean && process.service.kind == ServiceKind::Ingest && draining {
            return Ok(()); // it was asked to
        }
        let name = process.service.name.clone();
        if exit == Exit::Clean && process.is_essential() {
            self.fail(format!(
                "{name} was told to stop by somebody else; the run ends with what it has"
            ));
            return Ok(());
        }
        let now = Instant::now();
        process.dead_through = process.incarnation;
        process.health = ServiceHealth::Restarting;
        let sent_back = std::mem::take(&mut process.sent_back);
        process.died |= !sent_back;
        let wait = if sent_back {
            Some(Duration::ZERO)
        } else {
            process.backoff(now)
        };
        match wait {
            Some(wait) => {
                process.start_at = Some(now + wait);
                if !sent_back {
                    process.restarts += 1;
                    warn!(
                        "{name} died ({status}); starting it again in {} ms",
                        wait.as_millis()
                    );
                }
            }
            None if process.is_essential() => {
                self.fail(format!(
                    "{name} died too often ({status}); without it the run cannot go on"
                ));
            }
            None => {
                process.health = ServiceHealth::Down;
                tracing::error!(
                    "{name} died too often ({status}) and is given up; the run goes on without it"
                );
            }
        }
        self.publish_lifecycle()
    }

    fn start_due(&mut self) -> Result<(), RuntimeError> {
        let now = Instant::now();
        for index in 0..self.processes.len() {
            if self.processes[index].start_at.is_some_and(|t| t <= now) {
                self.start(index)?;
            }
        }
        Ok(())
    }

    fn start(&mut self, index: usize) -> Result<(), RuntimeError> {
        let needed = self.needed_tick();
        let history = match self.plan.delivery {
            Delivery::Lossless => {
                let longest = self.plan.fuse.length.max(self.members.fuse().0 as usize);
                let fuse = Fuse {
                    length: longest,
                    ..self.plan.fuse.clone()
                };
                fuse.history_ticks().unwrap_or(u64::MAX)
            }
            Delivery::Latest => 0,
        };
        let first_tick = match self.processes[index].service.kind {
            ServiceKind::Ingest => {
                self.epoch += 1;
                let whole = self.plan.source.live.is_none() && self.plan.carries_memory();
                let first = match whole {
                    true => 0,
                    false => needed.saturating_sub(self.plan.slicing.segments().look_back_ticks()),
                };
                let mut schedule = self.members.schedule(first);
                schedule.newest = self.newest_open;
                self.folder.write_schedule(&schedule)?;
                first
            }
            _ => self.next_answer.saturating_sub(history),
        };
        let draining = matches!(self.state, State::Draining { .. });
        let end_tick = draining.then(|| self.end_tick.unwrap_or(self.next_open));
        let process = &mut self.processes[index];
        process.start_at = None;
        process.heard_at = Instant::now();
        process.silent = false;
        process.incarnation += 1;
        let spawn = Spawn {
            service: index,
            incarnation: process.incarnation,
            epoch: self.epoch,
            first_tick,
            answer_from: self.next_answer,
            end_tick,
        };
        let child = (self.command)(&process.service, &spawn).spawn();
        let child = child
            .map_err(|e| RuntimeError::Process(format!("cannot start {}: {e}", process.service.name)))?;
        process.child = Some(child);
        Ok(())
    }

    fn look_after_nodes(&mut self) {
        if self.last_cleanup.elapsed() >= ROUND {
            self.clean_up_nodes();
        }
        self.members.expire(Instant::now());
        self.profile.remember(Instant::now(), &self.processes);
        for process in &mut self.processes {
            if process.child.is_some() && !process.silent && process.heard_at.elapsed() > SILENCE {
                process.silent = true;
                warn!(
                    "{} has not been heard of for {} s",
                    process.service.name,
                    SILENCE.as_secs()
                );
            }
        }
    }

    /// Removes what dead processes left in shared memory, which also frees whoever waits for room with them.
    fn clean_up_nodes(&mut self) {
        self.last_cleanup = Instant::now();
        // Nodes that another process is cleaning up count as done.
        self.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
    }

    fn publish_lifecycle(&mut self) -> Result<(), RuntimeError> {
        self.lifecycle_version += 1;
        let states: Vec<_> = self.processes.iter().map(Process::state).collect();
        let header = LifecycleHeader {
            version: self.lifecycle_version,
            ..LifecycleHeader::default()
        };
        let sent = self
            .ports
            .lifecycle
            .emit(header, states.len(), &mut |slots| slots.copy_from_slice(&states));
        sent.map_err(|e| RuntimeError::Ipc(e.to_string()))
    }

    fn publish_control(&mut self) -> Result<(), RuntimeError> {
        publish_control(&mut self.ports.control, &self.members)
    }

    fn take_requests(&mut self) -> Result<(), RuntimeError> {
        while let Ok(asked) = self.control.requests.try_recv() {
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
                self.publish_control()?;
            }
        }
        Ok(())
    }

    /// How things are.
    fn status(&self) -> Status {
        let state = match self.state {
            State::Starting => "starting",
            State::Running => "running",
            State::Draining { .. } => "draining",
            State::Stopping => "stopping",
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
            services: self.profile.services(&self.processes),
            members: self.profile.members(self.members.states(), &self.processes),
            fuse: {
                let (length, rule, deadline_ns) = self.members.fuse();
                FuseStatus {
                    length,
                    rule: rule.name().to_owned(),
                    deadline_ms: deadline_ns as f64 / 1e6,
                }
            },
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

    /// Moves the run on to its next state when it is time.
    fn advance(&mut self) {
        if self.stop.count() > 1 {
            self.state = State::Stopping;
            return;
        }
        let sinks_done = self
            .processes
            .iter()
            .filter(|p| p.is_sink())
            .all(Process::is_done);
        match self.state {
            State::Starting if self.stop.requested() => self.state = State::Stopping,
            State::Starting => {
                let awaited =
                    |p: &&Process| p.service.kind != ServiceKind::Ingest && p.health != ServiceHealth::Down;
                if self
                    .processes
                    .iter()
                    .filter(awaited)
                    .all(|p| p.in_phase(ServicePhase::Ready))
                {
                    self.state = State::Running;
                    self.send_ingest_back();
                }
            }
            State::Running | State::Draining { .. } if sinks_done => self.state = State::Stopping,
            State::Running if self.stop.requested() => {
                let ingest = self
                    .processes
                    .iter()
                    .find(|p| p.service.kind == ServiceKind::Ingest);
                // An ingest that is being started again is told then where to end.
                if let Some(ingest) = ingest {
                    ingest.signal(Signal::SIGTERM);
                }
                self.state = State::Draining {
                    since: Instant::now(),
                };
            }
            State::Draining { since } if since.elapsed() > DRAIN_TIMEOUT => {
                let seconds = DRAIN_TIMEOUT.as_secs();
                self.fail(format!(
                    "the ticks under way did not finish within {seconds} s and are left out"
                ));
            }
            _ => {}
        }
    }

    /// Ends the processes, upstream first.
    fn take_down(&mut self, hooks: &mut dyn Hooks) -> Result<(), RuntimeError> {
        const ORDER: [ServiceKind; 5] = [
            ServiceKind::Ingest,
            ServiceKind::Reconstruct,
            ServiceKind::Extract,
            ServiceKind::Fuse,
            ServiceKind::Record,
        ];
        let patience = if self.stop.count() > 1 {
            Duration::ZERO
        } else {
            EXIT_TIMEOUT
        };
        for kind in ORDER {
            let deadline = Instant::now() + patience;
            for process in self.processes.iter().filter(|p| p.service.kind == kind) {
                process.signal(Signal::SIGTERM);
                // Ingest takes one request as a wish to end the stream in good order, and stays until the next.
                if kind == ServiceKind::Ingest && !process.in_phase(ServicePhase::Done) {
                    process.signal(Signal::SIGINT);
                }
            }
            let mut killed = false;
            loop {
                self.hear(hooks)?;
                self.members.dismiss();
                while let Ok(asked) = self.control.requests.try_recv() {
                    asked.refuse();
                }
                for (index, exit, status) in self.reap() {
                    self.failed |= exit == Exit::Failed;
                    if exit == Exit::Died && !killed {
                        warn!("{} ended badly ({status})", self.processes[index].service.name);
                    }
                }
                if !self
                    .processes
                    .iter()
                    .any(|p| p.service.kind == kind && p.child.is_some())
                {
                    break;
                }
                let now = Instant::now();
                if now >= deadline && !killed {
                    killed = true;
                    for process in self.processes.iter().filter(|p| p.service.kind == kind) {
                        if process.child.is_some() && patience > Duration::ZERO {
                            warn!(
                                "{} did not end within {} s and is killed",
                                process.service.name,
                                patience.as_secs()
                            );
                        }
                        process.signal(Signal::SIGKILL);
                    }
                }
                self.wait(
                    deadline
                        .saturating_duration_since(now)
                        .clamp(Duration::from_millis(1), ROUND),
                )?;
            }
            self.clean_up_nodes();
        }
        self.hear(hooks)
    }
}
