//! Runs of graphs in which anything happens in any order.

use super::life::BUDGET_PERIOD_NS;
use super::*;
use evpr_core::message::Doing;
use evpr_core::plan::Supervision;
use proptest::prelude::*;
use std::collections::VecDeque;

const KINDS: [(ServiceKind, bool); 8] = [
    (ServiceKind::Ingest, false),
    (ServiceKind::Reconstruct, false),
    (ServiceKind::Reconstruct, true),
    (ServiceKind::Extract, false),
    (ServiceKind::Extract, true),
    (ServiceKind::Fuse, false),
    (ServiceKind::Record, false),
    (ServiceKind::Dashboard, true),
];
const BUDGET_DEATHS: usize = 10;
const INGEST: usize = 0;
const SINKS: [usize; 2] = [5, 6];
const DASHBOARD: usize = 7;

/// What happens to the graph.
#[derive(Debug, Clone)]
enum Fate {
    /// A process comes as far as this.
    Tells(usize, ServicePhase),
    /// Word of a life before, or of nobody.
    TellsLate(usize, u32),
    Ends(usize, Exit),
    /// Whoever has been sent a signal obeys.
    Obeys(usize),
    Answers,
    Opens,
    StreamEnds,
    Stop,
    Fails,
    Waits(u64),
}

fn fate() -> impl Strategy<Value = Fate> {
    let service = 0..KINDS.len();
    let phase = prop_oneof![
        Just(ServicePhase::Ready),
        Just(ServicePhase::Ready),
        Just(ServicePhase::Done),
        Just(ServicePhase::Stopped)
    ];
    let exit = prop_oneof![
        6 => Just(Exit::Died),
        1 => Just(Exit::Clean),
        1 => Just(Exit::Failed)
    ];
    prop_oneof![
        12 => (service.clone(), phase).prop_map(|(s, p)| Fate::Tells(s, p)),
        2 => (0..KINDS.len() + 2, 0..4u32).prop_map(|(s, i)| Fate::TellsLate(s, i)),
        6 => (service.clone(), exit).prop_map(|(s, e)| Fate::Ends(s, e)),
        6 => service.prop_map(Fate::Obeys),
        4 => Just(Fate::Answers),
        4 => Just(Fate::Opens),
        1 => Just(Fate::StreamEnds),
        1 => Just(Fate::Stop),
        1 => Just(Fate::Fails),
        8 => (0..20_000u64).prop_map(Fate::Waits),
    ]
}

/// A process of the simulated system.
#[derive(Debug, Clone, Copy, Default)]
struct Child {
    /// The incarnation that runs.
    runs: Option<u32>,
    incarnations: u32,
    asked: u32,
    killed: bool,
}

/// The system that the policy looks after, and what must hold in it.
struct World {
    policy: Policy,
    now_ns: u64,
    children: [Child; KINDS.len()],
    /// Per process: when it was started after a death that counts.
    counted_starts: [VecDeque<u64>; KINDS.len()],
    /// The process whose ending is being told, and whether it must be buried in this step.
    ended: Option<(usize, u32)>,
    answer: u64,
    open: u64,
    stops: u32,
    overs: u32,
}

impl World {
    fn new(lossless: bool) -> Self {
        let rules = Rules {
            lossless,
            look_back: 1,
            from_the_start: false,
            limits: Supervision::default(),
            members: vec![[1, 3], [1, 4], [2, 3], [2, 4]],
        };
        let services = KINDS.iter().enumerate();
        let parts = services.map(|(i, (kind, optional))| Part {
            name: format!("{}/{i}", kind.name()),
            kind: *kind,
            optional: *optional,
            network: *kind == ServiceKind::Extract,
        });
        let mut policy = Policy::new(rules, parts);
        policy.set_history(4);
        let mut world = Self {
            policy,
            now_ns: SECOND,
            children: Default::default(),
            counted_starts: Default::default(),
            ended: None,
            answer: 0,
            open: 0,
            stops: 0,
            overs: 0,
        };
        world.pass();
        world
    }

    fn happens(&mut self, fate: &Fate) {
        match *fate {
            Fate::Tells(service, phase) => {
                if let Some(incarnation) = self.children[service].runs {
                    self.told(service, incarnation, phase as u32);
                }
            }
            Fate::TellsLate(service, incarnation) => {
                let runs = self.children.get(service).and_then(|c| c.runs);
                if runs != Some(incarnation) {
                    self.told(service, incarnation, ServicePhase::Ready as u32);
                }
            }
            Fate::Ends(service, exit) => self.ends(service, exit),
            Fate::Obeys(service) => self.obeys(service),
            Fate::Answers => {
                let tick = self.answer;
                self.answer += 1;
                self.on(Event::Answered { tick });
            }
            Fate::Opens => {
                let tick = self.open;
                self.open += 1;
                self.on(Event::Opened { tick });
            }
            Fate::StreamEnds => self.on(Event::StreamEnds { tick: self.open }),
            Fate::Stop => {
                self.stops += 1;
                let requests = self.stops;
                self.on(Event::Stop { requests });
            }
            Fate::Fails => self.on(Event::Failed {
                line: "disk full".to_owned(),
            }),
            Fate::Waits(ms) => self.now_ns += ms * MS,
        }
        self.pass();
        self.check();
    }

    fn told(&mut self, service: usize, incarnation: u32, phase: u32) {
        let told = Told {
            phase,
            next_tick: self.answer,
            doing: Doing::Waiting as u32,
            for_ns: 0,
        };
        self.on(Event::Told {
            service,
            incarnation,
            told,
        });
    }

    fn obeys(&mut self, service: usize) {
        let child = self.children[service];
        if child.killed {
            self.ends(service, Exit::Died);
        } else if child.asked > 0 {
            self.ends(service, Exit::Clean);
        }
    }

    fn ends(&mut self, service: usize, exit: Exit) {
        let Some(incarnation) = self.children[service].runs.take() else {
            return;
        };
        self.ended = Some((service, incarnation));
        let status = "as told".to_owned();
        self.on(Event::Ended {
            service,
            exit,
            status,
        });
        self.ended = None;
    }

    fn on(&mut self, event: Event) {
        let was_over = self.policy.state() == State::Over;
        let actions = self.policy.on(self.now_ns, event);
        assert!(
            !was_over || actions.is_empty(),
            "nothing after the end: {actions:?}"
        );
        if let (Some((service, incarnation)), true) = (self.ended, self.policy.is_open()) {
            let life = &self.policy.lives()[service];
            if !life.finished {
                let state = self.policy.states()[service];
                assert_eq!(state.dead_through, incarnation, "{} is not buried", life.name);
                assert!(
                    actions.contains(&Action::TellStates),
                    "nobody heard that {} died",
                    life.name
                );
                assert_ne!(state.health, ServiceHealth::Up as u32);
            }
        }
        self.perform(&actions);
    }

    fn pass(&mut self) {
        let was_over = self.policy.state() == State::Over;
        let actions = self.policy.pass(self.now_ns);
        assert!(
            !was_over || actions.is_empty(),
            "nothing after the end: {actions:?}"
        );
        self.perform(&actions);
        self.overs += u32::from(!was_over && self.policy.state() == State::Over);
    }

    fn perform(&mut self, actions: &[Action]) {
        for action in actions {
            match action {
                Action::Start(start) => self.start(start),
                Action::Signal { service, signal } => {
                    let child = &mut self.children[*service];
                    assert!(child.runs.is_some(), "{signal} for {service}, which is gone");
                    match signal {
                        Signal::SIGKILL => child.killed = true,
                        _ => child.asked += 1,
                    }
                }
                Action::TellStates | Action::TellSettings | Action::CleanUp | Action::Say(..) => {}
            }
        }
    }

    fn start(&mut self, start: &Start) {
        let child = &mut self.children[start.service];
        assert_eq!(child.runs, None, "{} runs already", start.service);
        assert_eq!(start.incarnation, child.incarnations + 1);
        assert!(start.first_tick <= self.answer, "nothing is skipped: {start:?}");
        assert_eq!(start.answer_from, self.answer);
        let sent_back = start.service == INGEST && child.killed;
        *child = Child {
            runs: Some(start.incarnation),
            incarnations: start.incarnation,
            ..Child::default()
        };
        if start.incarnation > 1 && !sent_back {
            let starts = &mut self.counted_starts[start.service];
            starts.push_back(self.now_ns);
            let longest = BUDGET_PERIOD_NS - 10 * SECOND; // deaths come before the starts that follow them
            while self.now_ns - starts[0] > longest {
                starts.pop_front();
            }
            assert!(
                starts.len() <= BUDGET_DEATHS + 1,
                "{} has spent its budget",
                start.service
            );
        }
        let others_ready =
            |l: &Life| l.kind == ServiceKind::Ingest || l.health == ServiceHealth::Down || l.incarnation > 0;
        assert!(start.service != INGEST || self.policy.lives().iter().all(others_ready));
    }

    fn check(&self) {
        let state = self.policy.state();
        for (life, child) in self.policy.lives().iter().zip(&self.children) {
            assert_eq!(life.running, child.runs.is_some(), "{}", life.name);
            let waits_for_the_others = life.kind == ServiceKind::Ingest && state == State::Starting;
            let accounted = life.running
                || life.start_at_ns.is_some()
                || life.finished
                || life.health == ServiceHealth::Down
                || waits_for_the_others;
            assert!(
                accounted || !self.policy.is_open(),
                "{} is forgotten in {state:?}",
                life.name
            );
            let overdue = life.start_at_ns.is_some_and(|t| t < self.now_ns);
            assert!(
                !overdue || !self.policy.is_open(),
                "{} should have been started",
                life.name
            );
        }
        if state == State::Over {
            assert!(
                self.children.iter().all(|c| c.runs.is_none()),
                "somebody was left behind"
            );
            assert_eq!(self.policy.due_ns(), None);
        }
    }

    /// Passes this time, looked at every quarter of a second.
    fn lets_pass(&mut self, seconds: u64) {
        (0..4 * seconds).for_each(|_| self.happens(&Fate::Waits(250)));
    }

    /// From now on nothing goes wrong any more, and the recording comes to its end.
    fn comes_to_its_end(&mut self) {
        for _ in 0..10_000 {
            if self.policy.state() == State::Over {
                return;
            }
            let next = self.now_ns + 100 * MS;
            self.now_ns = self
                .policy
                .due_ns()
                .map_or(next, |due| due.clamp(self.now_ns, next));
            for service in 0..KINDS.len() {
                self.happens(&Fate::Obeys(service));
                let done = service == INGEST || SINKS.contains(&service);
                self.happens(&Fate::Tells(service, ServicePhase::Ready));
                if done {
                    self.happens(&Fate::Tells(service, ServicePhase::Done));
                }
            }
        }
        panic!("the run does not end: {:#?}", self.policy);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn whatever_happens_nobody_is_forgotten_and_the_run_ends_once(
        lossless in any::<bool>(),
        fates in prop::collection::vec(fate(), 0..200),
    ) {
        let mut world = World::new(lossless);
        for fate in &fates {
            world.happens(fate);
        }
        world.comes_to_its_end();
        prop_assert_eq!(world.overs, 1);
        // And after its end nothing happens any more.
        for fate in &fates {
            world.happens(fate);
        }
        prop_assert_eq!(world.overs, 1);
    }
}

fn ready(world: &mut World) {
    for service in (0..KINDS.len()).rev() {
        world.happens(&Fate::Tells(service, ServicePhase::Ready));
    }
    world.happens(&Fate::Tells(INGEST, ServicePhase::Ready));
    assert_eq!(world.policy.state(), State::Running);
}

#[test]
fn ingest_is_started_when_everybody_else_is_ready() {
    let mut world = World::new(true);
    for service in 1..DASHBOARD {
        assert_eq!(world.children[INGEST].runs, None);
        world.happens(&Fate::Tells(service, ServicePhase::Ready));
    }
    assert_eq!(
        world.children[INGEST].runs,
        Some(1),
        "nobody waits for a dashboard"
    );
}

#[test]
fn a_dashboard_ends_last_and_ends_no_run() {
    let mut world = World::new(true);
    ready(&mut world);
    world.happens(&Fate::Ends(DASHBOARD, Exit::Died));
    world.happens(&Fate::Tells(DASHBOARD, ServicePhase::Ready));
    assert_eq!(world.policy.lives()[DASHBOARD].restarts, 1);
    world.happens(&Fate::Ends(DASHBOARD, Exit::Clean));
    assert_eq!(
        world.policy.lives()[DASHBOARD].restarts,
        2,
        "nobody had asked it to end"
    );
    // The second time, it waits a little before the next start.
    world.happens(&Fate::Waits(1_000));
    world.happens(&Fate::Ends(DASHBOARD, Exit::Failed));
    assert_eq!(world.policy.lives()[DASHBOARD].health, ServiceHealth::Down);
    assert_eq!(world.policy.state(), State::Running);
    world.comes_to_its_end();
    assert!(!world.policy.has_failed());
}

#[test]
fn a_new_sink_sends_ingest_back_in_lossless_delivery_only() {
    for lossless in [true, false] {
        let mut world = World::new(lossless);
        ready(&mut world);
        world.happens(&Fate::Ends(SINKS[0], Exit::Died));
        world.happens(&Fate::Tells(SINKS[0], ServicePhase::Ready));
        assert_eq!(world.children[INGEST].killed, lossless);
        world.happens(&Fate::Obeys(INGEST));
        assert_eq!(world.children[INGEST].runs, Some(if lossless { 2 } else { 1 }));
        assert_eq!(world.policy.lives()[INGEST].restarts, 0, "no fault of its own");
    }
}

#[test]
fn what_dies_too_often_is_marked_down_and_without_a_sink_the_run_fails() {
    for (service, ends) in [(3, false), (SINKS[1], true)] {
        let mut world = World::new(true);
        ready(&mut world);
        for _ in 0..=BUDGET_DEATHS {
            assert!(world.policy.is_open());
            world.happens(&Fate::Ends(service, Exit::Died));
            world.happens(&Fate::Waits(5_000));
        }
        let life = &world.policy.lives()[service];
        assert_eq!(life.health, ServiceHealth::Down);
        assert_eq!(life.restarts, BUDGET_DEATHS as u64);
        assert_eq!(matches!(world.policy.state(), State::Ending(_)), ends);
        assert_eq!(world.policy.has_failed(), ends);
    }
}

#[test]
fn a_sink_that_dies_with_its_work_done_is_not_needed_again() {
    let mut world = World::new(true);
    ready(&mut world);
    world.happens(&Fate::Tells(SINKS[0], ServicePhase::Done));
    world.happens(&Fate::Ends(SINKS[0], Exit::Died));
    assert_eq!(world.children[SINKS[0]].runs, None);
    world.happens(&Fate::Tells(SINKS[1], ServicePhase::Done));
    assert!(matches!(world.policy.state(), State::Ending(_)));
    assert!(!world.policy.has_failed());
}

#[test]
fn a_second_request_to_stop_kills_at_once() {
    let mut world = World::new(true);
    ready(&mut world);
    world.happens(&Fate::Stop);
    assert!(matches!(world.policy.state(), State::Draining { .. }));
    assert!(!world.children[INGEST].killed);
    world.happens(&Fate::Stop);
    world.pass(); // which is due at once
    assert!(world.children[INGEST].killed);
    world.comes_to_its_end();
}

#[test]
fn whoever_falls_silent_is_killed_once_and_started_again() {
    let mut world = World::new(true);
    ready(&mut world);
    world.lets_pass(9);
    for service in (0..KINDS.len()).filter(|s| *s != 3) {
        world.happens(&Fate::Tells(service, ServicePhase::Ready));
    }
    world.lets_pass(2);
    let killed: Vec<usize> = (0..KINDS.len()).filter(|s| world.children[*s].killed).collect();
    assert_eq!(killed, [3]);
    world.happens(&Fate::Obeys(3));
    assert_eq!(world.children[3].runs, Some(2));
    assert_eq!(world.policy.lives()[3].restarts, 1, "a hang is a death");
}

#[test]
fn when_the_supervisor_itself_was_held_up_nobody_is_to_blame() {
    let mut world = World::new(true);
    ready(&mut world);
    world.happens(&Fate::Waits(60_000));
    assert!(world.children.iter().all(|c| !c.killed));
}

#[test]
fn a_required_stage_that_cannot_go_on_ends_a_replay_and_not_a_live_run() {
    for lossless in [true, false] {
        let mut world = World::new(lossless);
        ready(&mut world);
        world.happens(&Fate::Ends(3, Exit::Failed));
        assert_eq!(world.policy.is_open(), !lossless);
        assert_eq!(world.policy.has_failed(), lossless);
        // And with the last of its kind the last member goes.
        world.happens(&Fate::Ends(4, Exit::Failed));
        assert!(world.policy.has_failed() && !world.policy.is_open());
        world.comes_to_its_end();
    }
}

#[test]
fn a_required_stage_that_cannot_start_ends_any_run() {
    let mut world = World::new(false);
    world.happens(&Fate::Ends(3, Exit::Failed));
    assert!(world.policy.has_failed() && !world.policy.is_open());
}
