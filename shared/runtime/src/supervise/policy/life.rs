//! One process of the graph as the policy sees it: its lives, and when to start the next.

use super::{MS, Part, SECOND};
use evpr_core::message::{Doing, ServiceHealth, ServicePhase, ServiceState};
use evpr_core::plan::{ServiceKind, Supervision};
use std::collections::VecDeque;

/// Deaths within this time count against the budget.
pub(super) const BUDGET_PERIOD_NS: u64 = 60 * SECOND;
const FIRST_BACKOFF_NS: u64 = 100 * MS;
const LONGEST_BACKOFF_NS: u64 = 5 * SECOND;

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::supervise) enum Exit {
    /// In an orderly way.
    Clean,
    /// It said why (exit code 1 or 2): trying again is pointless.
    Failed,
    /// By a signal, a panic or without being asked to.
    Died,
}

/// What a process says of itself, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::supervise) struct Told {
    /// Number of a [`ServicePhase`].
    pub(in crate::supervise) phase: u32,
    /// Sinks: the first tick that is not settled.
    pub(in crate::supervise) next_tick: u64,
    /// Number of a [`Doing`].
    pub(in crate::supervise) doing: u32,
    /// How long it has been doing that with the same thing, ns.
    pub(in crate::supervise) for_ns: u64,
}

/// See the module. Times are host monotonic, ns.
#[derive(Debug)]
pub(in crate::supervise) struct Life {
    pub(in crate::supervise) name: String,
    pub(in crate::supervise) kind: ServiceKind,
    /// The rest goes on without it, whatever becomes of it.
    pub(super) optional: bool,
    /// A network is at work in it.
    network: bool,
    /// It has been started and not been seen to end.
    pub(super) running: bool,
    pub(in crate::supervise) incarnation: u32,
    pub(in crate::supervise) health: ServiceHealth,
    dead_through: u32,
    /// What the current incarnation has said last.
    phase: u32,
    /// What the newest incarnation to say anything has said last.
    pub(super) next_tick: u64,
    pub(in crate::supervise) restarts: u64,
    /// When to start it (again).
    pub(super) start_at_ns: Option<u64>,
    /// It was killed to make it go back; that is no fault of its own. Until it has ended.
    pub(super) sent_back: bool,
    /// It has died since it was last ready.
    pub(super) died: bool,
    /// It had done all it had to do before it ended: it is not needed again.
    pub(super) finished: bool,
    /// When it was last heard of or started.
    pub(in crate::supervise) heard_ns: u64,
    /// The last thing that the current incarnation has told of what it does, if it has told anything.
    busy: Option<(Doing, u64)>,
    /// It has been killed because it hung.
    hung: bool,
    deaths: VecDeque<u64>,
}

impl Life {
    pub(super) fn new(part: Part) -> Self {
        let Part {
            name,
            kind,
            optional,
            network,
        } = part;
        Self {
            name,
            kind,
            optional,
            network,
            running: false,
            incarnation: 0,
            health: ServiceHealth::Up,
            dead_through: 0,
            phase: ServicePhase::Starting as u32,
            next_tick: 0,
            restarts: 0,
            start_at_ns: None,
            sent_back: false,
            died: false,
            finished: false,
            heard_ns: 0,
            busy: None,
            hung: false,
            deaths: VecDeque::new(),
        }
    }

    pub(in crate::supervise) fn is_sink(&self) -> bool {
        matches!(self.kind, ServiceKind::Fuse | ServiceKind::Record)
    }

    /// Without it there is no run.
    pub(super) fn is_essential(&self) -> bool {
        self.is_sink() || self.kind == ServiceKind::Ingest
    }

    pub(in crate::supervise) fn in_phase(&self, phase: ServicePhase) -> bool {
        self.running && self.phase >= phase as u32
    }

    /// It is ready, or need not be.
    pub(super) fn is_settled(&self) -> bool {
        self.finished || self.health == ServiceHealth::Down || self.in_phase(ServicePhase::Ready)
    }

    /// It has nothing more to do.
    pub(in crate::supervise) fn is_done(&self) -> bool {
        self.finished || self.in_phase(ServicePhase::Done)
    }

    /// Whether it last said that it was asked to stop.
    pub(super) fn was_stopped(&self) -> bool {
        self.phase == ServicePhase::Stopped as u32
    }

    pub(super) fn state(&self) -> ServiceState {
        ServiceState {
            incarnation: self.incarnation,
            dead_through: self.dead_through,
            health: self.health as u32,
            _pad: 0,
        }
    }

    pub(super) fn started(&mut self, now_ns: u64) {
        self.running = true;
        self.finished = false;
        self.incarnation += 1;
        self.phase = ServicePhase::Starting as u32;
        self.start_at_ns = None;
        self.heard_ns = now_ns;
        self.busy = None;
        self.hung = false;
    }

    pub(super) fn told(&mut self, now_ns: u64, told: Told) {
        self.phase = told.phase;
        self.next_tick = told.next_tick;
        self.heard_ns = now_ns;
        self.busy = Doing::from_code(told.doing).map(|doing| (doing, told.for_ns));
    }

    /// Nobody is to wait for it from now on.
    pub(super) fn bury(&mut self, health: ServiceHealth) {
        self.dead_through = self.incarnation;
        self.health = health;
    }

    /// Why it has to be killed, if it hangs. Said once.
    pub(super) fn hangs(&mut self, now_ns: u64, limits: &Supervision) -> Option<String> {
        if !self.running || self.hung {
            return None;
        }
        let silent_ns = now_ns.saturating_sub(self.heard_ns);
        let busy_ns = if self.network {
            limits.network_ns
        } else {
            limits.hang_ns
        };
        let seconds = |ns: u64| ns as f64 / SECOND as f64;
        let why = match self.busy {
            None if silent_ns > limits.loading_ns => {
                format!(
                    "has said nothing for {} s since its start",
                    seconds(limits.loading_ns)
                )
            }
            Some(_) if silent_ns > limits.hang_ns => {
                format!("has said nothing for {} s", seconds(limits.hang_ns))
            }
            Some((Doing::Loading, for_ns)) if for_ns > limits.loading_ns => {
                format!("has been loading for {} s", seconds(limits.loading_ns))
            }
            Some((Doing::Working, for_ns)) if for_ns > busy_ns => {
                format!("has been busy with one message for {} s", seconds(busy_ns))
            }
            // Whoever waits for input or for room does as it should, and a disk may be slow.
            _ => return None,
        };
        self.hung = true;
        Some(format!("{} {why} and is killed", self.name))
    }

    /// The supervisor was away itself, and has not heard anybody.
    pub(super) fn forgive_silence(&mut self, now_ns: u64) {
        self.heard_ns = self.heard_ns.max(now_ns);
    }

    /// Notes a death and says how long to wait before the next start, ns; `None` when it is given up: with more than
    /// `budget` deaths in a minute.
    pub(super) fn backoff(&mut self, now_ns: u64, budget: u32) -> Option<u64> {
        self.deaths.push_back(now_ns);
        while self
            .deaths
            .front()
            .is_some_and(|t| now_ns.saturating_sub(*t) > BUDGET_PERIOD_NS)
        {
            self.deaths.pop_front();
        }
        match self.deaths.len() {
            n if n > budget as usize => None,
            1 => Some(0),
            n => Some((FIRST_BACKOFF_NS << (n - 2).min(16)).min(LONGEST_BACKOFF_NS)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backs_off_and_gives_up() {
        let mut life = life(false);
        let waits: Vec<_> = (0..11).map(|i| life.backoff(SECOND + i * MS, 10)).collect();
        assert_eq!(waits[0], Some(0));
        assert_eq!(waits[1], Some(100 * MS));
        assert_eq!(waits[2], Some(200 * MS));
        assert_eq!(waits[9], Some(LONGEST_BACKOFF_NS));
        assert_eq!(waits[10], None);
        assert_eq!(
            life.backoff(120 * SECOND, 10),
            Some(0),
            "old deaths are forgotten"
        );
    }

    fn life(network: bool) -> Life {
        Life::new(Part {
            name: "extract/x".to_owned(),
            kind: ServiceKind::Extract,
            optional: false,
            network,
        })
    }

    /// Whether it counts as hanging, `silent_s` after it was last heard of.
    fn hangs(network: bool, told: Option<(Doing, u64)>, silent_s: u64) -> bool {
        let mut life = life(network);
        life.started(SECOND);
        if let Some((doing, for_s)) = told {
            let told = Told {
                phase: ServicePhase::Ready as u32,
                next_tick: 0,
                doing: doing as u32,
                for_ns: for_s * SECOND,
            };
            life.told(SECOND, told);
        }
        life.hangs((1 + silent_s) * SECOND, &Supervision::default())
            .is_some()
    }

    #[test]
    fn whoever_says_nothing_hangs() {
        assert!(!hangs(false, Some((Doing::Waiting, 0)), 10));
        assert!(hangs(false, Some((Doing::Waiting, 0)), 11));
        assert!(hangs(true, Some((Doing::Blocked, 900)), 11));
    }

    #[test]
    fn whoever_is_busy_for_long_hangs_a_network_later() {
        assert!(!hangs(false, Some((Doing::Working, 10)), 1));
        assert!(hangs(false, Some((Doing::Working, 11)), 1));
        assert!(!hangs(true, Some((Doing::Working, 59)), 1));
        assert!(hangs(true, Some((Doing::Working, 61)), 1));
    }

    #[test]
    fn whoever_waits_or_keeps_what_is_to_be_kept_does_not_hang() {
        for doing in [Doing::Waiting, Doing::Blocked, Doing::Writing] {
            assert!(!hangs(false, Some((doing, 9_999)), 1), "{doing:?}");
        }
    }

    #[test]
    fn loading_has_a_limit_of_its_own() {
        assert!(!hangs(false, None, 119));
        assert!(hangs(false, None, 121));
        assert!(!hangs(false, Some((Doing::Loading, 119)), 1));
        assert!(hangs(false, Some((Doing::Loading, 121)), 1));
    }
}
