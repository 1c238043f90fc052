//! The ledger: keeps account of every (tick, member) until its tick can be settled, and hands ticks out in order,
//! each once. The fuser and the recorder both stand on it.
//!
//! A member's tick ends in a row, in "no row" with a reason, or by a tombstone: the supervisor's word that an
//! incarnation of a service is dead. A tombstone is lifted, for one member, by the first message that a living
//! incarnation sends for it; from that message's tick on the member is waited for again. So nobody waits for
//! the dead, and whatever still comes of theirs in time counts.

use crate::member::{End, MemberSet, Reason};
use crate::message::{
    DescriptorHeader, FuseSettings, Life, ServiceHealth, ServiceState, TickHeader, TickKind,
};
use crate::plan::{Delivery, Plan, SliceMode};
use std::collections::VecDeque;

/// What is known of a tick.
#[derive(Debug, Clone, PartialEq)]
pub struct TickInfo {
    /// The tick.
    pub tick: u64,
    /// Sensor time of its start, µs.
    pub start_us: u64,
    /// Sensor time of its end, µs.
    pub end_us: u64,
    /// Where the camera was at its start: metres east and north; `None` where not known.
    pub position: Option<[f64; 2]>,
    /// Version of the control message in force.
    pub control_version: u64,
    /// Members enabled.
    pub members: MemberSet,
    /// Weight per member.
    pub weights: Vec<f64>,
    /// The fuser's settings.
    pub fuse: FuseSettings,
}

/// A row with the times of its life.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrived<T> {
    /// What the sink made of the row.
    pub value: T,
    /// Times.
    pub life: Life,
}

/// A tick that can be settled.
#[derive(Debug, Clone, PartialEq)]
pub struct Settled<T> {
    /// What is known of it.
    pub info: TickInfo,
    /// Per member of the plan: how its tick ended; `None` where it was not enabled.
    pub ends: Vec<Option<End<Arrived<T>>>>,
    /// Host monotonic time (ns) at which its last window closed; 0 when not known.
    pub closed_ns: u64,
    /// True when ingest never announced the tick: it was lost on the way.
    pub lost: bool,
}

/// What became of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// Entered.
    Accepted,
    /// There was one for this tick and member already (ingest went back after a death): the first counts.
    Duplicate,
    /// Its tick is settled already.
    Late,
    /// No such member, or a tick beyond reason.
    Refused,
}

#[derive(Debug)]
struct Pending<T> {
    info: Option<TickInfo>,
    /// Empty until the first end comes.
    ends: Vec<Option<End<Arrived<T>>>>,
    closed_ns: u64,
    closed: bool,
}

impl<T> Pending<T> {
    fn ended(&self, member: usize) -> bool {
        self.ends.get(member).is_some_and(Option::is_some)
    }

    fn slots(&mut self, members: usize) -> &mut Vec<Option<End<Arrived<T>>>> {
        if self.ends.is_empty() {
            self.ends.resize_with(members, || None);
        }
        &mut self.ends
    }
}

/// Waiting for a member: from which tick on, or not at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expect {
    /// From this tick on; the ones before fell to `was`.
    From {
        tick: u64,
        was: Reason,
    },
    Down(Reason),
}

/// Most ticks that may be under way at once; anything further ahead is refused as nonsense.
const MAX_AHEAD: u64 = 1 << 16;

/// See the module.
#[derive(Debug)]
pub struct Ledger<T> {
    next: u64,
    /// The first tick that does not exist, and when that was said (host monotonic ns).
    end: Option<(u64, u64)>,
    pending: VecDeque<Pending<T>>,
    expect: Vec<Expect>,
    /// Per member: the services its rows pass through (reconstruct, extract).
    services: Vec<(usize, usize)>,
    dead_through: Vec<u32>,
    /// Whether the supervisor's word has been heard: the first is where everybody stands.
    informed: bool,
    lossless: bool,
    deadline_ns: u64,
    tick_us: Option<u64>,
    last_opened: Option<TickInfo>,
}

impl<T> Ledger<T> {
    /// A ledger that begins with tick `next`.
    pub fn new(plan: &Plan, next: u64) -> Self {
        let services = plan
            .members
            .iter()
            .map(|m| {
                (
                    plan.reconstruct_service(m.reconstruction),
                    plan.extract_service(m.extractor),
                )
            })
            .collect();
        Self {
            next,
            end: None,
            pending: VecDeque::new(),
            expect: vec![
                Expect::From {
                    tick: next,
                    was: Reason::Lost
                };
                plan.members.len()
            ],
            services,
            dead_through: vec![0; plan.services().len()],
            informed: false,
            lossless: plan.delivery == Delivery::Lossless,
            deadline_ns: plan.deadline_ns,
            tick_us: (plan.slicing.mode == SliceMode::Time).then_some(plan.slicing.tick / 1_000),
            last_opened: None,
        }
    }

    /// The first tick not settled yet.
    pub fn next_tick(&self) -> u64 {
        self.next
    }

    /// True once the stream has ended and every tick before its end is settled.
    pub fn finished(&self) -> bool {
        self.end.is_some_and(|(end, _)| self.next >= end)
    }

    fn entry(&mut self, tick: u64) -> Result<&mut Pending<T>, Arrival> {
        if tick < self.next {
            return Err(Arrival::Late);
        }
        let ahead = tick - self.next;
        if ahead >= MAX_AHEAD {
            return Err(Arrival::Refused);
        }
        let members = self.expect.len();
        while self.pending.len() as u64 <= ahead {
            let ends = std::iter::repeat_with(|| None).take(members).collect();
            self.pending.push_back(Pending {
                info: None,
                ends,
                closed_ns: 0,
                closed: false,
            });
        }
        self.pending.get_mut(ahead as usize).ok_or(Arrival::Refused)
    }

    /// Takes a tick message.
    pub fn tick(&mut self, header: &TickHeader, weights: &[f64]) -> Arrival {
        match TickKind::from_code(header.kind) {
            Some(TickKind::Open) => {
                let info = TickInfo {
                    tick: header.tick,
                    start_us: header.start_us,
                    end_us: header.end_us,
                    position: header.position(),
                    control_version: header.control_version,
                    members: header.members,
                    weights: (0..self.expect.len())
                        .map(|m| weights.get(m).copied().unwrap_or(1.0))
                        .collect(),
                    fuse: header.fuse,
                };
                self.last_opened = Some(info.clone());
                match self.entry(header.tick) {
                    Ok(pending) => {
                        // Ingest went back: the members that it says now are the ones that rows will come of.
                        let known = pending.info.replace(info).is_some();
                        if known {
                            Arrival::Duplicate
                        } else {
                            Arrival::Accepted
                        }
                    }
                    Err(arrival) => arrival,
                }
            }
            Some(TickKind::Close) => match self.entry(header.tick) {
                Ok(pending) => {
                    pending.closed = true;
                    pending.closed_ns = header.closed_ns;
                    Arrival::Accepted
                }
                Err(arrival) => arrival,
            },
            Some(TickKind::End) => {
                let said_ns = self.end.map_or(header.stamp.sent_ns, |(_, said_ns)| said_ns);
                self.end = Some((header.tick, said_ns));
                Arrival::Accepted
            }
            None => Arrival::Refused,
        }
    }

    /// Asks whether a row for this tick and member would be accepted, before work is spent on it.
    pub fn wants(&self, header: &DescriptorHeader) -> bool {
        let member = header.member as usize;
        if member >= self.expect.len() || header.tick < self.next || header.tick - self.next >= MAX_AHEAD {
            return false;
        }
        let ahead = (header.tick - self.next) as usize;
        self.pending.get(ahead).is_none_or(|p| !p.ended(member))
    }

    /// Takes the end of one member's tick.
    pub fn arrive(&mut self, header: &DescriptorHeader, end: End<T>) -> Arrival {
        let member = header.member as usize;
        let Some((reconstruct, extract)) = self.services.get(member).copied() else {
            return Arrival::Refused;
        };
        let lives = |service: usize, incarnation: u32| {
            self.dead_through
                .get(service)
                .is_none_or(|dead| incarnation > *dead)
        };
        let alive =
            lives(reconstruct, header.reconstruct_incarnation) && lives(extract, header.stamp.incarnation);
        if let (true, Expect::Down(was)) = (alive, self.expect[member]) {
            self.expect[member] = Expect::From {
                tick: header.tick.max(self.next),
                was,
            };
        }
        let members = self.expect.len();
        match self.entry(header.tick) {
            Ok(pending) => {
                let slot = &mut pending.slots(members)[member];
                if slot.is_some() {
                    return Arrival::Duplicate;
                }
                *slot = Some(match end {
                    End::Row(value) => End::Row(Arrived {
                        value,
                        life: header.life,
                    }),
                    End::None(reason) => End::None(reason),
                });
                Arrival::Accepted
            }
            Err(arrival) => arrival,
        }
    }

    /// Takes the supervisor's word on who is dead. New tombstones take effect at once.
    pub fn lifecycle(&mut self, states: &[ServiceState]) {
        let mut fallen = vec![false; self.dead_through.len()];
        for (service, state) in states.iter().enumerate().take(self.dead_through.len()) {
            if state.dead_through > self.dead_through[service] {
                self.dead_through[service] = state.dead_through;
                // To a sink that joins late, whoever died before and is back has always been there.
                fallen[service] = self.informed || state.health != ServiceHealth::Up as u32;
            }
        }
        self.informed = true;
        for (expect, (reconstruct, extract)) in self.expect.iter_mut().zip(&self.services) {
            if fallen.get(*extract).copied().unwrap_or(false) {
                *expect = Expect::Down(Reason::ExtractDown);
            } else if fallen.get(*reconstruct).copied().unwrap_or(false) {
                *expect = Expect::Down(Reason::ReconstructDown);
            }
        }
    }

    /// Why the member's tick is over although nothing came, if it is.
    fn given_up(&self, member: usize, tick: u64, overdue: bool) -> Option<Reason> {
        match self.expect[member] {
            Expect::Down(reason) => Some(reason),
            Expect::From { tick: from, was } if tick < from => Some(was),
            Expect::From { .. } => overdue.then_some(Reason::Late),
        }
    }

    /// When the head's answer is due (host monotonic ns). Closings can be lost, but not overtaken: a later tick that is
    /// due, or the end, makes all before it due.
    fn due_ns(&self) -> Option<u64> {
        if self.lossless || self.finished() {
            return None;
        }
        let closed = self.pending.iter().find(|p| p.closed).map(|p| p.closed_ns);
        let known = closed.or(self.end.map(|(_, said_ns)| said_ns))?;
        let head = self
            .pending
            .front()
            .and_then(|p| p.info.as_ref())
            .map(|info| info.fuse.deadline_ns);
        let deadline_ns = head.filter(|ns| *ns > 0).unwrap_or(self.deadline_ns);
        Some(known.saturating_add(deadline_ns))
    }

    /// When [`Ledger::settle`] should be called again though nothing came (host monotonic ns).
    pub fn deadline_ns(&self) -> Option<u64> {
        self.due_ns()
    }

    /// Hands out the next tick, if it can be settled at `now_ns` (host monotonic).
    pub fn settle(&mut self, now_ns: u64) -> Option<Settled<T>> {
        if self.finished() {
            self.pending.clear();
            return None;
        }
        if self.pending.is_empty() && self.end.is_some() && !self.lossless {
            let _ = self.entry(self.next); // lost without a trace
        }
        let overdue = self.due_ns().is_some_and(|due| due <= now_ns);
        let head = self.pending.front()?;
        let later_known = || self.end.is_some() || self.pending.iter().skip(1).any(|p| p.info.is_some());
        if head.info.is_none() {
            // Ingest announces ticks in order on one channel: a later one without this one means it was lost. Without
            // loss this cannot happen in lossless delivery, where ingest goes back after a death.
            if self.lossless || !later_known() {
                return None;
            }
        } else {
            if self.lossless && !head.closed {
                return None;
            }
            let info = head.info.as_ref()?;
            let settled = |m: usize| {
                !info.members.contains(m) || head.ended(m) || self.given_up(m, self.next, overdue).is_some()
            };
            if !(0..self.expect.len()).all(settled) {
                return None;
            }
            if !self.lossless && !head.closed && !(0..self.expect.len()).any(|m| head.ended(m)) {
                // Everybody is off or down: the tick is still answered when it is over, not before it began.
                if !later_known() {
                    return None;
                }
            }
        }
        let tick = self.next;
        let Pending {
            info,
            mut ends,
            closed_ns,
            ..
        } = self.pending.pop_front()?;
        let lost = info.is_none();
        let info = info.unwrap_or_else(|| self.invent(tick));
        for (member, slot) in ends.iter_mut().enumerate() {
            if !info.members.contains(member) {
                *slot = None;
            } else if slot.is_none() {
                let reason = if lost {
                    Reason::Lost
                } else {
                    self.given_up(member, tick, overdue).unwrap_or(Reason::Late)
                };
                *slot = Some(End::None(reason));
            }
        }
        self.next += 1;
        Some(Settled {
            info,
            ends,
            closed_ns,
            lost,
        })
    }

    /// What a tick that was never announced must have been, from its neighbour.
    fn invent(&self, tick: u64) -> TickInfo {
        let known = self
            .pending
            .iter()
            .find_map(|p| p.info.as_ref())
            .or(self.last_opened.as_ref());
        match known {
            Some(known) => {
                let length = self.tick_us.unwrap_or(0);
                let (back, on) = (known.tick.saturating_sub(tick), tick.saturating_sub(known.tick));
                let shift = |us: u64| us.saturating_sub(back * length).saturating_add(on * length);
                TickInfo {
                    tick,
                    start_us: shift(known.start_us),
                    end_us: shift(known.end_us),
                    position: None,
                    ..known.clone()
                }
            }
            None => TickInfo {
                tick,
                start_us: 0,
                end_us: 0,
                position: None,
                control_version: 0,
                members: MemberSet::default(),
                weights: vec![1.0; self.expect.len()],
                fuse: FuseSettings::default(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Stamp;
    use crate::plan::test_plan;

    const R: Reason = Reason::ReconstructDown;

    /// Two reconstructions (services 1 and 2), one extractor (service 3), one window: members 0 and 1.
    fn ledger(delivery: Delivery) -> Ledger<u32> {
        let mut plan = test_plan();
        plan.delivery = delivery;
        plan.deadline_ns = 100;
        Ledger::new(&plan, 0)
    }

    fn tick(l: &mut Ledger<u32>, tick: u64, kind: TickKind) -> Arrival {
        let members = [0, 1].into_iter().collect();
        let h = TickHeader {
            tick,
            start_us: tick * 1000,
            end_us: tick * 1000 + 1000,
            closed_ns: if kind == TickKind::Close {
                1000 * (tick + 1)
            } else {
                0
            },
            members,
            kind: kind as u32,
            ..TickHeader::default()
        };
        l.tick(&h, &[1.0, 2.0])
    }

    fn row(l: &mut Ledger<u32>, tick: u64, member: u32, reconstruct: u32, extract: u32) -> Arrival {
        let stamp = Stamp {
            service: 3,
            incarnation: extract,
            ..Stamp::default()
        };
        let h = DescriptorHeader {
            stamp,
            tick,
            member,
            reconstruct_service: 1 + member,
            reconstruct_incarnation: reconstruct,
            ..DescriptorHeader::default()
        };
        l.arrive(&h, End::Row((tick as u32).wrapping_mul(10) + member))
    }

    fn dead(l: &mut Ledger<u32>, service: usize, through: u32) {
        let mut states = vec![ServiceState::default(); 4];
        states[service].dead_through = through;
        states[service].health = ServiceHealth::Restarting as u32;
        l.lifecycle(&states);
    }

    fn reasons(s: &Settled<u32>) -> Vec<Option<Reason>> {
        s.ends
            .iter()
            .map(|e| {
                if let Some(End::None(r)) = e {
                    Some(*r)
                } else {
                    None
                }
            })
            .collect()
    }

    #[test]
    fn lossless_waits_for_rows_and_for_the_close() {
        let mut l = ledger(Delivery::Lossless);
        tick(&mut l, 0, TickKind::Open);
        row(&mut l, 0, 1, 1, 1);
        assert_eq!(l.settle(u64::MAX), None);
        row(&mut l, 0, 0, 1, 1);
        assert_eq!(l.settle(u64::MAX), None, "not known to be whole yet");
        tick(&mut l, 0, TickKind::Close);
        let s = l.settle(0).unwrap();
        assert_eq!(
            (s.info.tick, s.info.weights.as_slice()),
            (0, [1.0, 2.0].as_slice())
        );
        assert_eq!(reasons(&s), [None, None]);
        assert_eq!(row(&mut l, 0, 0, 1, 1), Arrival::Late);
    }

    #[test]
    fn a_tick_that_is_not_whole_is_never_answered() {
        let mut l = ledger(Delivery::Lossless);
        tick(&mut l, 0, TickKind::Open);
        row(&mut l, 0, 0, 1, 1);
        row(&mut l, 0, 1, 1, 1);
        tick(&mut l, 0, TickKind::End);
        assert_eq!(l.settle(0), None);
        assert!(l.finished());
    }

    #[test]
    fn a_tombstone_ends_the_waiting_and_the_first_message_of_the_next_life_lifts_it() {
        let mut l = ledger(Delivery::Lossless);
        for t in 0..4 {
            tick(&mut l, t, TickKind::Open);
            tick(&mut l, t, TickKind::Close);
            row(&mut l, t, 1, 1, 1);
        }
        assert_eq!(l.settle(0), None);
        dead(&mut l, 1, 1);
        assert_eq!(reasons(&l.settle(0).unwrap()), [Some(R), None]);
        // A row that the dead one had sent still counts, and lifts nothing.
        assert_eq!(row(&mut l, 1, 0, 1, 1), Arrival::Accepted);
        assert_eq!(reasons(&l.settle(0).unwrap()), [None, None]);
        // The next life begins with tick 3: tick 2 is not waited for, tick 3 is there, tick 4 is waited for.
        row(&mut l, 3, 0, 2, 1);
        assert_eq!(reasons(&l.settle(0).unwrap()), [Some(R), None]);
        assert_eq!(reasons(&l.settle(0).unwrap()), [None, None]);
        tick(&mut l, 4, TickKind::Open);
        tick(&mut l, 4, TickKind::Close);
        row(&mut l, 4, 1, 1, 1);
        assert_eq!(l.settle(u64::MAX), None);
    }

    #[test]
    fn the_same_tombstone_twice_does_not_fell_the_living() {
        let mut l = ledger(Delivery::Lossless);
        dead(&mut l, 3, 1);
        row(&mut l, 0, 0, 1, 2);
        row(&mut l, 0, 1, 1, 2);
        dead(&mut l, 3, 1);
        tick(&mut l, 0, TickKind::Open);
        tick(&mut l, 0, TickKind::Close);
        assert_eq!(reasons(&l.settle(0).unwrap()), [None, None]);
        tick(&mut l, 1, TickKind::Open);
        tick(&mut l, 1, TickKind::Close);
        assert_eq!(l.settle(u64::MAX), None, "both are waited for");
    }

    #[test]
    fn to_a_sink_that_joins_late_the_returned_have_always_been_there() {
        let mut l = ledger(Delivery::Lossless);
        let back = ServiceState {
            incarnation: 2,
            dead_through: 1,
            ..ServiceState::default()
        };
        l.lifecycle(&[
            ServiceState::default(),
            back,
            ServiceState::default(),
            ServiceState::default(),
        ]);
        tick(&mut l, 0, TickKind::Open);
        tick(&mut l, 0, TickKind::Close);
        row(&mut l, 0, 1, 1, 1);
        assert_eq!(l.settle(u64::MAX), None, "member 0 is waited for");
        dead(&mut l, 1, 2);
        assert_eq!(reasons(&l.settle(0).unwrap()), [Some(R), None]);
    }

    #[test]
    fn going_back_after_a_death_counts_each_tick_once() {
        let mut l = ledger(Delivery::Lossless);
        for _ in 0..2 {
            tick(&mut l, 0, TickKind::Open);
            row(&mut l, 0, 0, 1, 1);
        }
        assert_eq!(row(&mut l, 0, 0, 1, 1), Arrival::Duplicate);
        assert_eq!(tick(&mut l, 0, TickKind::Open), Arrival::Duplicate);
    }

    #[test]
    fn a_member_switched_off_while_ingest_goes_back_is_not_waited_for() {
        let mut l = ledger(Delivery::Lossless);
        tick(&mut l, 0, TickKind::Open);
        row(&mut l, 0, 1, 1, 1);
        let again = TickHeader {
            members: [1].into_iter().collect(),
            epoch: 2,
            ..TickHeader::default()
        };
        assert_eq!(l.tick(&again, &[1.0, 2.0]), Arrival::Duplicate);
        tick(&mut l, 0, TickKind::Close);
        assert!(l.settle(0).unwrap().ends[0].is_none());
    }

    #[test]
    fn latest_answers_at_the_deadline_and_names_what_is_late() {
        let mut l = ledger(Delivery::Latest);
        tick(&mut l, 0, TickKind::Open);
        row(&mut l, 0, 0, 1, 1);
        assert_eq!(l.deadline_ns(), None);
        tick(&mut l, 0, TickKind::Close);
        assert_eq!(l.deadline_ns(), Some(1100));
        assert_eq!(l.settle(1099), None);
        assert_eq!(reasons(&l.settle(1100).unwrap()), [None, Some(Reason::Late)]);
    }

    #[test]
    fn latest_answers_as_soon_as_all_rows_are_there() {
        let mut l = ledger(Delivery::Latest);
        tick(&mut l, 0, TickKind::Open);
        row(&mut l, 0, 0, 1, 1);
        row(&mut l, 0, 1, 1, 1);
        assert!(l.settle(0).is_some());
    }

    #[test]
    fn latest_answers_lost_ticks_in_order() {
        let mut l = ledger(Delivery::Latest);
        tick(&mut l, 2, TickKind::Open);
        for t in 0..2 {
            let s = l.settle(0).unwrap();
            assert!(s.lost);
            assert_eq!((s.info.tick, s.info.start_us), (t, t * 1000));
            assert_eq!(reasons(&s), [Some(Reason::Lost), Some(Reason::Lost)]);
        }
        assert_eq!(l.settle(0), None);
    }

    #[test]
    fn latest_does_not_wait_for_a_closing_that_was_lost() {
        let mut l = ledger(Delivery::Latest);
        tick(&mut l, 0, TickKind::Open);
        tick(&mut l, 1, TickKind::Open);
        tick(&mut l, 1, TickKind::Close);
        assert_eq!(l.deadline_ns(), Some(2100));
        assert_eq!(l.settle(2099), None);
        assert_eq!(l.settle(2100).unwrap().info.tick, 0);
        assert_eq!(l.settle(2100).unwrap().info.tick, 1);
    }

    #[test]
    fn latest_answers_every_tick_before_the_end_whatever_was_lost() {
        let mut l = ledger(Delivery::Latest);
        tick(&mut l, 1, TickKind::Open);
        row(&mut l, 1, 0, 1, 1);
        tick(&mut l, 4, TickKind::End);
        assert!(l.settle(0).unwrap().lost);
        assert_eq!(l.settle(99), None, "tick 1 may still be completed");
        let ticks: Vec<_> = std::iter::from_fn(|| l.settle(100))
            .map(|s| (s.info.tick, s.lost))
            .collect();
        assert_eq!(ticks, [(1, false), (2, true), (3, true)]);
        assert!(l.finished());
        assert_eq!(l.deadline_ns(), None);
    }

    #[test]
    fn nonsense_is_refused() {
        let mut l = ledger(Delivery::Latest);
        assert_eq!(row(&mut l, u64::MAX, 0, 1, 1), Arrival::Refused);
        assert_eq!(row(&mut l, 0, 9, 1, 1), Arrival::Refused);
    }
}
