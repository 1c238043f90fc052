//! The supervisor: tells the policy what happens, and does what it says.

use super::members::Members;
use super::policy::{Action, Event, Exit, Level, Part, Policy, Rules, Start, State, Told};
use super::ports::Ports;
use super::process::Process;
use super::profile::Profile;
use super::{CommandLine, Hooks, Outcome, RunSummary, ServiceReport, Spawn};
use crate::channel::{Ipc, SUPERVISOR_READER};
use crate::control::ControlServer;
use crate::domain::{RunFolder, RunSpec};
use crate::run::Identity;
use crate::stop::{SignalListener, Stop, wake_pair};
use crate::wait::{Waiter, wait_set};
use crate::{RuntimeError, now_ns, shm, trace};
use evpr_core::Plan;
use evpr_core::governor::Governor;
use evpr_core::message::{Header, Stamp, TickKind};
use evpr_core::plan::{Delivery, Member, ServiceKind};
use evpr_core::stage::OpenedTick;
use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use nix::sys::signal::Signal;
use std::fs::File;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tracing::{error, info, warn};

/// The supervisor looks after dead nodes at least this often, should a death notice be missed.
const ROUND: Duration = Duration::from_millis(250);

/// See the module.
pub struct Supervisor {
    pub(super) plan: Plan,
    folder: RunFolder,
    run_id: u64,
    command: CommandLine,
    pub(super) processes: Vec<Process>,
    pub(super) policy: Policy,
    /// The newest tick that ingest has opened.
    pub(super) newest_open: Option<OpenedTick>,
    pub(super) answers: u64,
    pub(super) members: Members,
    last_cleanup: Instant,
    pub(super) profile: Profile,
    pub(super) governor: Option<Governor>,
    /// Per member: whether its window is among the last of a tick to close.
    pub(super) late: Vec<bool>,
    /// Answers that the governor has not seen yet: latency, and version of their settings.
    pub(super) ungoverned: Vec<(u64, u64)>,
    pub(super) ports: Ports,
    wake: Listener<Ipc>,
    pub(super) control: ControlServer,
    stop: Stop,
    /// Requests to stop that the policy knows of.
    stops_told: u32,
    _signals: SignalListener,
    node: Node<Ipc>,
    _lock: Option<File>,
}

fn policy(plan: &Plan) -> Policy {
    let services_of = |m: &Member| {
        [
            plan.reconstruct_service(m.reconstruction),
            plan.extract_service(m.extractor),
        ]
    };
    let rules = Rules {
        lossless: plan.delivery == Delivery::Lossless,
        look_back: plan.slicing.segments().look_back_ticks(),
        from_the_start: plan.source.live.is_none() && plan.carries_memory(),
        limits: plan.supervision,
        members: plan.members.iter().map(services_of).collect(),
    };
    let services = plan.services().into_iter();
    let parts = services.map(|s| Part {
        optional: plan.is_optional(&s),
        network: plan.has_network(&s),
        name: s.name,
        kind: s.kind,
    });
    Policy::new(rules, parts)
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
            service: Stamp::SUPERVISOR,
            incarnation: 1,
        };
        let ports = Ports::create(&node, &plan, identity, &stop)?;
        let control = ControlServer::start(&folder, wake_sender)?;
        let segments = plan.slicing.segments();
        let closes = |m: &Member| segments.windows.get(m.window).map_or(0, |w| w.last);
        let last = plan.members.iter().map(closes).max().unwrap_or(0);
        let late = plan.members.iter().map(|m| closes(m) == last).collect();
        let governor = plan.governor.clone();
        let governor = governor.map(|budget| Governor::new(budget, plan.members.len()));
        let services = plan.services();
        let mut supervisor = Self {
            policy: policy(&plan),
            plan,
            folder,
            run_id,
            command,
            profile: Profile::new(services.len()),
            processes: services.into_iter().map(Process::new).collect(),
            newest_open: None,
            answers: 0,
            members,
            last_cleanup: Instant::now(),
            governor,
            late,
            ungoverned: Vec::new(),
            ports,
            wake,
            control,
            stop,
            stops_told: 0,
            _signals: signals,
            node,
            _lock: None,
        };
        supervisor.policy.set_history(supervisor.history_ticks());
        Ok(supervisor)
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
        let services = self.processes.iter().zip(self.policy.lives());
        let services = services.map(|(process, life)| ServiceReport {
            name: life.name.clone(),
            kind: life.kind,
            restarts: life.restarts,
            stats: process.stats,
        });
        let services = services.collect();
        let answers = self.answers;
        let failure = self.policy.failure().map(str::to_owned);
        let Self {
            folder,
            ports,
            wake,
            control,
            _signals,
            node,
            _lock,
            ..
        } = self;
        drop((control, ports, wake, _signals));
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
            let reader = trace::receiver(
                &self.node,
                &Arc::new(self.plan.clone()),
                self.run_id,
                SUPERVISOR_READER,
            );
            self.ports.spans = Some(reader?);
        }
        self.pass()?;
        while self.policy.state() != State::Over {
            self.wait()?;
            self.hear(hooks)?;
            self.reap(hooks)?;
            self.look_after();
            self.take_requests()?;
            self.pass()?;
        }
        let stop = &self.stop;
        Ok(
            match (self.policy.has_failed(), stop.requested(), stop.interrupted()) {
                (true, _, _) => Outcome::Failed,
                (_, _, true) => Outcome::Interrupted,
                (_, true, _) => Outcome::Stopped,
                _ => Outcome::Finished,
            },
        )
    }

    fn wait(&self) -> Result<(), RuntimeError> {
        let due = self.policy.due_ns().map_or(ROUND, |due| {
            Duration::from_nanos(due.saturating_sub(now_ns())).min(ROUND)
        });
        let set = wait_set()?;
        let mut listeners = self.ports.listeners();
        listeners.push(&self.wake);
        Waiter::new(&set, listeners)?.wait(due)
    }

    /// Tells the policy, and does what it says.
    fn tell(&mut self, event: Event) -> Result<(), RuntimeError> {
        let actions = self.policy.on(now_ns(), event);
        self.perform(actions)
    }

    /// Lets the policy do what is due.
    fn pass(&mut self) -> Result<(), RuntimeError> {
        let requests = self.stop.count();
        if requests != self.stops_told {
            self.stops_told = requests;
            self.tell(Event::Stop { requests })?;
        }
        let actions = self.policy.pass(now_ns());
        self.perform(actions)
    }

    fn perform(&mut self, actions: Vec<Action>) -> Result<(), RuntimeError> {
        for action in actions {
            match action {
                Action::Start(start) => self.start(start)?,
                Action::Signal { service, signal } => {
                    if let Some(process) = self.processes.get(service) {
                        process.signal(signal);
                    }
                }
                Action::TellStates => self.ports.tell_states(&self.policy.states())?,
                Action::TellSettings => self.ports.tell_settings(&self.members.settings)?,
                Action::CleanUp => self.clean_up_nodes(),
                Action::Say(Level::Info, line) => info!("{line}"),
                Action::Say(Level::Warn, line) => warn!("{line}"),
                Action::Say(Level::Error, line) => error!("{line}"),
            }
        }
        Ok(())
    }

    fn start(&mut self, start: Start) -> Result<(), RuntimeError> {
        let Some(process) = self.processes.get_mut(start.service) else {
            return Ok(());
        };
        if process.service.kind == ServiceKind::Ingest {
            let mut schedule = self.members.schedule(start.first_tick);
            schedule.newest = self.newest_open;
            self.folder.write_schedule(&schedule)?;
        }
        let spawn = Spawn {
            service: start.service,
            incarnation: start.incarnation,
            epoch: start.epoch,
            first_tick: start.first_tick,
            answer_from: start.answer_from,
            end_tick: start.end_tick,
        };
        let name = process.service.name.clone();
        let mut command = (self.command)(&process.service, &spawn);
        match command.spawn() {
            Ok(child) => process.child = Some(child),
            Err(e) => {
                let line = format!("cannot start {name} as {}: {e}", command.get_program().display());
                if !self.plan.is_optional(&process.service) {
                    return Err(RuntimeError::Process(line));
                }
                warn!("{line}");
                return self.tell(Event::Ended {
                    service: start.service,
                    exit: Exit::Failed,
                    status: e.to_string(),
                });
            }
        }
        Ok(())
    }

    /// Takes everything that has come: answers, spans, ticks, stats.
    fn hear(&mut self, hooks: &mut dyn Hooks) -> Result<(), RuntimeError> {
        self.take_answers(hooks)?;
        if let Some(spans) = &self.ports.spans {
            trace::drain(spans, &mut |service, spans| hooks.spans(service, spans))?;
        }
        while let Some(message) = self.ports.ticks.receive()? {
            let header = message.header();
            let tick = header.tick;
            match TickKind::from_code(header.kind) {
                Some(TickKind::Open) => {
                    if self.newest_open.is_none_or(|newest| tick > newest.tick) {
                        self.newest_open = Some(OpenedTick {
                            tick,
                            start_us: header.start_us,
                            sent_ns: header.stamp.sent_ns,
                        });
                    }
                    self.members.opened(tick, header.control_version);
                    drop(message);
                    self.tell(Event::Opened { tick })?;
                }
                Some(TickKind::End) => {
                    drop(message);
                    self.tell(Event::StreamEnds { tick })?;
                }
                _ => {}
            }
        }
        let mut heard = false;
        while let Some(message) = self.ports.stats.receive()? {
            heard = true;
            let stats = *message.header();
            let (service, incarnation) = (stats.stamp.service as usize, stats.stamp.incarnation);
            let alive = self.policy.lives().get(service);
            if alive.is_none_or(|life| life.incarnation != incarnation) {
                continue;
            }
            if let Some(process) = self.processes.get_mut(service) {
                process.stats = stats;
                if !message.payload().is_empty() {
                    process.take_costs(message.payload());
                }
            }
            drop(message);
            let told = Told {
                phase: stats.phase,
                next_tick: stats.next_tick,
                doing: stats.doing,
                for_ns: stats.stamp.sent_ns.saturating_sub(stats.progress_ns),
            };
            self.tell(Event::Told {
                service,
                incarnation,
                told,
            })?;
        }
        if heard {
            hooks.progress(&self.progress());
        }
        self.govern()
    }

    fn take_answers(&mut self, hooks: &mut dyn Hooks) -> Result<(), RuntimeError> {
        while let Some(matches) = &self.ports.matches {
            let Some(message) = matches.receive()? else { break };
            let (header, next) = (*message.header(), self.policy.next_answer());
            let tick = header.tick();
            if tick < next {
                continue; // answered by a fuser that has died since
            }
            if tick > next && self.answers > 0 {
                warn!(
                    from = next,
                    to = tick - 1,
                    "answers are missing: they were not made, or did not arrive"
                );
            }
            self.answers += 1;
            self.profile.answered(&header);
            if self.governor.is_some() {
                self.ungoverned.push((header.total_ns, header.control_version));
            }
            let count = (header.candidates as usize).min(message.payload().len());
            let taken = hooks.answer(&header, &message.payload()[..count]);
            drop(message);
            self.tell(Event::Answered { tick })?;
            if let Err(line) = taken {
                self.tell(Event::Failed { line })?;
            }
        }
        Ok(())
    }

    /// Looks who has ended.
    fn reap(&mut self, hooks: &mut dyn Hooks) -> Result<(), RuntimeError> {
        for service in 0..self.processes.len() {
            let Some((exit, status)) = self.processes[service].reap() else {
                continue;
            };
            // What the dead one had sent is taken before its memory is cleaned up.
            self.hear(hooks)?;
            self.tell(Event::Ended {
                service,
                exit,
                status,
            })?;
        }
        Ok(())
    }

    fn look_after(&mut self) {
        if self.last_cleanup.elapsed() >= ROUND {
            self.clean_up_nodes();
        }
        let now = Instant::now();
        self.members.expire(now);
        self.profile.remember(now, &self.processes);
    }

    /// Removes what dead processes left in shared memory, which also frees whoever waits for room with them.
    fn clean_up_nodes(&mut self) {
        self.last_cleanup = Instant::now();
        // Nodes that another process is cleaning up count as done.
        self.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
    }
}
