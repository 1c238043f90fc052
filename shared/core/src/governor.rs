//! The latency governor: which members are off so that answers keep within their budget. A pure state machine.
//!
//! It judges the 95th percentile of the answers since its last decision took effect, 20 of them at most. Above the
//! budget it sheds members until what they were measured to cost makes up for the excess, down to 80 % of the budget,
//! but always one and never the last. After `hold` answers, and with the 95th percentile below 80 % of the budget, it takes
//! back the member that it shed last: what a member costs that is off can only be found out by trying. One that has to be
//! shed again soon after waits twice as long before its next trial, up to 64 times as long.

use crate::plan::Governor as Budget;
use std::collections::VecDeque;

/// Answers that are judged at most.
const JUDGED: usize = 20;
/// Share of the budget that it aims at, percent.
const AIM: u64 = 80;
/// Most doublings of the time before a trial.
const MAX_DOUBLINGS: u32 = 6;

/// What it decided.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decision {
    /// These members go off.
    Shed(Vec<usize>),
    /// This member goes on again.
    TakeBack(usize),
}

/// A member as the governor sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Priced {
    /// Somebody wants it, and it is not shed.
    pub enabled: bool,
    /// Its weight.
    pub weight: f64,
    /// What it costs per tick, ns; 0 when that is not known.
    pub cost_ns: u64,
    /// Its window is among the last of the tick to close: what it costs comes between closing and answer. Without a
    /// backlog the others have been computed by then.
    pub late: bool,
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Governor {
    budget: Budget,
    /// In the order in which they were shed.
    shed: Vec<usize>,
    latencies: VecDeque<u64>,
    /// Answers that the newest decision has been in force for.
    since: u64,
    /// Per member: how often it was shed soon after it had been taken back.
    doublings: Vec<u32>,
    /// The member taken back last, while it is on trial.
    on_trial: Option<usize>,
    /// Answers before this version of the settings say nothing about the newest decision.
    from_version: u64,
}

impl Governor {
    /// For so many members.
    pub fn new(budget: Budget, members: usize) -> Self {
        Self {
            budget,
            shed: Vec::new(),
            latencies: VecDeque::with_capacity(JUDGED),
            since: 0,
            doublings: vec![0; members],
            on_trial: None,
            from_version: 0,
        }
    }

    /// The budget, ns.
    pub fn budget_ns(&self) -> u64 {
        self.budget.budget_ns
    }

    /// The members that are off because of it, in the order in which they went.
    pub fn shed(&self) -> &[usize] {
        &self.shed
    }

    /// The 95th percentile (nearest rank) of the answers that are judged, ns; none without any.
    pub fn p95_ns(&self) -> Option<u64> {
        let mut sorted: Vec<u64> = self.latencies.iter().copied().collect();
        sorted.sort_unstable();
        let rank = (sorted.len() * 95).div_ceil(100);
        sorted.get(rank.checked_sub(1)?).copied()
    }

    /// Somebody has set this member by hand: it is the governor's no longer.
    pub fn forget(&mut self, member: usize) {
        self.shed.retain(|m| *m != member);
        self.on_trial = self.on_trial.filter(|m| *m != member);
    }

    /// The settings have got this version by its decision: what was answered before it is not judged.
    pub fn decided(&mut self, version: u64) {
        self.from_version = version;
        self.latencies.clear();
        self.since = 0;
    }

    /// Takes in an answer: `latency_ns` from window close, under settings of this version. Gives what is to be done; then
    /// [`Governor::decided`] is to be called. `members` has an entry per member of the plan.
    pub fn answered(&mut self, latency_ns: u64, version: u64, members: &[Priced]) -> Option<Decision> {
        if version < self.from_version || latency_ns == 0 {
            return None;
        }
        if self.latencies.len() == JUDGED {
            self.latencies.pop_front();
        }
        self.latencies.push_back(latency_ns);
        self.since += 1;
        let p95 = self.p95_ns()?;
        // The newest answer has to bear out what the others say: things may have changed since.
        if p95.min(latency_ns) > self.budget.budget_ns {
            return self.relieve(p95, members);
        }
        self.take_back(p95.max(latency_ns))
    }

    fn aim_ns(&self) -> u64 {
        (u128::from(self.budget.budget_ns) * u128::from(AIM) / 100) as u64
    }

    /// Who may go, first to last.
    fn candidates(&self, members: &[Priced]) -> Vec<usize> {
        let may = |m: &usize| members.get(*m).is_some_and(|p| p.enabled);
        if !self.budget.order.is_empty() {
            return self.budget.order.iter().copied().filter(may).collect();
        }
        let mut all: Vec<usize> = (0..members.len()).filter(may).collect();
        let price = |m: &usize| match members[*m].weight.abs() {
            0.0 => f64::INFINITY,
            weight => members[*m].cost_ns as f64 / weight,
        };
        // Of the late ones first, as only they are sure to bring relief.
        let late = |m: &usize| members[*m].late;
        all.sort_by(|a, b| late(b).cmp(&late(a)).then(price(b).total_cmp(&price(a))));
        all
    }

    fn relieve(&mut self, p95: u64, members: &[Priced]) -> Option<Decision> {
        let enabled = members.iter().filter(|p| p.enabled).count();
        let excess = p95.saturating_sub(self.aim_ns());
        let (mut relief, mut going) = (0u64, Vec::new());
        for member in self.candidates(members) {
            if relief >= excess && !going.is_empty() || going.len() + 1 >= enabled {
                break;
            }
            relief = relief.saturating_add(members[member].cost_ns);
            going.push(member);
        }
        if going.is_empty() {
            return None;
        }
        if let Some(tried) = self.on_trial.take()
            && let Some(doublings) = self.doublings.get_mut(tried)
            && going.contains(&tried)
        {
            *doublings = (*doublings + 1).min(MAX_DOUBLINGS);
        }
        self.shed.extend(&going);
        Some(Decision::Shed(going))
    }

    fn take_back(&mut self, p95: u64) -> Option<Decision> {
        let hold = u64::from(self.budget.hold.max(1));
        if let Some(tried) = self.on_trial.filter(|_| self.since >= hold) {
            // It has stood its trial.
            self.on_trial = None;
            if let Some(doublings) = self.doublings.get_mut(tried) {
                *doublings = 0;
            }
        }
        let member = *self.shed.last()?;
        let doublings = self.doublings.get(member).copied().unwrap_or(0);
        if self.since < hold << doublings || p95 > self.aim_ns() {
            return None;
        }
        self.shed.pop();
        self.on_trial = Some(member);
        Some(Decision::TakeBack(member))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    fn governor(order: &[usize], hold: u32, members: usize) -> Governor {
        let budget = Budget {
            budget_ns: 100 * MS,
            order: order.to_vec(),
            hold,
        };
        Governor::new(budget, members)
    }

    /// A graph whose answers take 10 ms and what its members cost.
    struct Graph {
        governor: Governor,
        costs_ms: Vec<u64>,
        version: u64,
    }

    impl Graph {
        fn enabled(&self, member: usize) -> bool {
            !self.governor.shed().contains(&member)
        }

        fn latency_ms(&self) -> u64 {
            let on = (0..self.costs_ms.len()).filter(|m| self.enabled(*m));
            10 + on.map(|m| self.costs_ms[m]).sum::<u64>()
        }

        fn tick(&mut self) -> (u64, Option<Decision>) {
            let latency = self.latency_ms();
            let members: Vec<_> = (0..self.costs_ms.len())
                .map(|m| Priced {
                    enabled: self.enabled(m),
                    weight: 1.0,
                    cost_ns: self.costs_ms[m] * MS,
                    late: true,
                })
                .collect();
            let decision = self.governor.answered(latency * MS, self.version, &members);
            if decision.is_some() {
                self.version += 1;
                self.governor.decided(self.version);
            }
            (latency, decision)
        }
    }

    #[test]
    fn the_dearest_goes_first_and_comes_back_when_it_is_cheap_again() {
        let mut graph = Graph {
            governor: governor(&[], 5, 3),
            costs_ms: vec![10, 20, 15],
            version: 0,
        };
        assert!(
            (0..50).all(|_| graph.tick().1.is_none()),
            "within its budget nothing happens"
        );
        graph.costs_ms[1] = 200;
        let first = (0..).find_map(|_| graph.tick().1).unwrap();
        assert_eq!(first, Decision::Shed(vec![1]));
        assert_eq!(graph.governor.shed(), [1]);
        // Tried after 5, then 10, then 20 answers, and shed at once each time.
        let mut trials = Vec::new();
        for tick in 0..60 {
            match graph.tick().1 {
                Some(Decision::TakeBack(1)) => trials.push(tick),
                Some(Decision::Shed(members)) => assert_eq!(members, [1]),
                Some(other) => panic!("{other:?}"),
                None => {}
            }
        }
        assert_eq!(trials, [4, 15, 36]);
        graph.costs_ms[1] = 20;
        assert!((0..200).any(|_| graph.tick().1 == Some(Decision::TakeBack(1))));
        assert!((0..200).all(|_| graph.tick().1.is_none()), "and stays");
    }

    #[test]
    fn the_order_of_the_configuration_counts_and_others_stay() {
        let mut governor = governor(&[2, 0], 5, 3);
        let members = [Priced {
            enabled: true,
            weight: 1.0,
            cost_ns: MS,
            late: true,
        }; 3];
        let decision = governor.answered(101 * MS, 0, &members);
        assert_eq!(
            decision,
            Some(Decision::Shed(vec![2, 0])),
            "not enough by far, but member 1 is never shed"
        );
    }

    #[test]
    fn one_slow_answer_in_twenty_is_nothing_and_old_answers_are_not_judged() {
        let mut governor = governor(&[], 5, 2);
        let members = [Priced {
            enabled: true,
            weight: 1.0,
            cost_ns: MS,
            late: true,
        }; 2];
        for i in 0..100 {
            let latency = if i % 20 == 19 { 500 } else { 50 };
            assert_eq!(governor.answered(latency * MS, 0, &members), None, "{i}");
        }
        governor.decided(3);
        assert_eq!(governor.answered(500 * MS, 2, &members), None);
        assert!(governor.answered(500 * MS, 3, &members).is_some());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn someone_is_always_left_and_every_decision_is_sound(
            costs in proptest::collection::vec(0u64..80, 1..8),
            hold in 1u32..10,
            spikes in proptest::collection::vec((0usize..8, 0u64..400), 1..6),
        ) {
            let count = costs.len();
            let mut graph = Graph { governor: governor(&[], hold, count), costs_ms: costs.clone(), version: 0 };
            for (member, cost) in spikes {
                graph.costs_ms = costs.clone();
                graph.costs_ms[member % count] = cost;
                for _ in 0..50 {
                    let before = graph.governor.shed().to_vec();
                    let (latency, decision) = graph.tick();
                    prop_assert!(graph.governor.shed().len() < count);
                    match decision {
                        Some(Decision::Shed(members)) => {
                            prop_assert!(latency > 100);
                            prop_assert!(!members.is_empty() && members.iter().all(|m| !before.contains(m)));
                        }
                        Some(Decision::TakeBack(member)) => {
                            prop_assert!(latency <= 80);
                            prop_assert_eq!(before.last(), Some(&member));
                        }
                        None => prop_assert_eq!(graph.governor.shed(), &before[..]),
                    }
                }
            }
        }

        #[test]
        fn within_three_answers_it_is_within_the_budget_where_it_can_be(
            costs in proptest::collection::vec(1u64..80, 2..8),
            member in 0usize..8,
        ) {
            let mut graph = Graph { governor: governor(&[], 20, costs.len()), costs_ms: costs, version: 0 };
            let member = member % graph.costs_ms.len();
            graph.costs_ms[member] = 300;
            let reachable = 10 + graph.costs_ms.iter().min().unwrap() <= 100;
            (0..3).for_each(|_| { graph.tick(); });
            prop_assert!(!reachable || graph.latency_ms() <= 100, "{} ms", graph.latency_ms());
        }
    }
}
