//! Greedy forward selection, and the exact search as a check of it.
//!
//! From the empty set on, each step adds the member that, of all that still fit the budget, leads to the highest recall
//! ([`Criterion::Recall`]) or to the most recall gained per added ms ([`Criterion::PerMs`]), until none fits. A step may
//! lose: the best set on the way is taken, and of the two criteria the better one. Equals are decided by the lower cost,
//! then by fewer members, then by the members' order.

use super::cost::Prices;
use super::judge::{Judge, Queries, Set};
use serde::Serialize;
use std::cmp::Ordering;

/// Slack of sums of times, ms: a set of exactly the budget fits.
const SLACK_MS: f64 = 1e-9;

/// What the next member is chosen by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Criterion {
    Recall,
    PerMs,
}

impl Criterion {
    pub(crate) const ALL: [Self; 2] = [Self::Recall, Self::PerMs];
}

/// How a choice grew.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step {
    /// The member that was added.
    pub member: String,
    /// Time per tick of the set with it, ms.
    pub cost_ms: f64,
    /// Fitted recall of the set with it.
    pub recall: f64,
}

/// One greedy search under way.
#[derive(Debug)]
pub(crate) struct Search {
    members: usize,
    criterion: Criterion,
    budget_ms: f64,
    queries: Queries,
    /// The members in the order they were added, with cost and recall of the set up to each.
    path: Vec<(usize, f64, f64)>,
    ended: bool,
}

impl Search {
    pub(crate) fn new(members: usize, criterion: Criterion, budget_ms: f64, queries: Queries) -> Self {
        Self {
            members,
            criterion,
            budget_ms,
            queries,
            path: Vec::new(),
            ended: false,
        }
    }

    fn with(&self, member: usize) -> Set {
        let mut set: Set = self.path.iter().map(|(m, ..)| *m).collect();
        set.push(member);
        set.sort_unstable();
        set
    }

    fn next(&self, prices: &Prices) -> impl Iterator<Item = (usize, Set, f64)> {
        let free = |m: &usize| !self.ended && self.path.iter().all(|(taken, ..)| taken != m);
        (0..self.members).filter(free).filter_map(|m| {
            let set = self.with(m);
            let cost = prices.cost(&set);
            (cost <= self.budget_ms + SLACK_MS).then_some((m, set, cost))
        })
    }

    /// The sets that the next step chooses among; none when it has ended.
    pub(crate) fn candidates(&self, prices: &Prices) -> Vec<Set> {
        self.next(prices).map(|(_, set, _)| set).collect()
    }

    /// Takes the next step. The judge must have looked at the candidates.
    pub(crate) fn advance(&mut self, prices: &Prices, judge: &Judge<'_>) {
        let (before_ms, before) = self
            .path
            .last()
            .map_or((0.0, 0.0), |(_, cost, recall)| (*cost, *recall));
        let worth = |cost: f64, recall: f64| match self.criterion {
            Criterion::Recall => recall,
            // What is gained for nothing is worth most.
            Criterion::PerMs => (recall - before) / (cost - before_ms).max(SLACK_MS),
        };
        let best = self
            .next(prices)
            .map(|(m, set, cost)| (m, cost, judge.recall(&set, &self.queries)))
            .max_by(|a, b| {
                let by_worth = worth(a.1, a.2).total_cmp(&worth(b.1, b.2));
                by_worth.then(b.1.total_cmp(&a.1)).then(b.0.cmp(&a.0))
            });
        match best {
            Some(step) => self.path.push(step),
            None => self.ended = true,
        }
    }

    /// How many members lead to the best set on the way; with its cost and recall.
    fn best(&self) -> Option<(usize, f64, f64)> {
        let sets = self
            .path
            .iter()
            .enumerate()
            .map(|(i, (_, cost, recall))| (i + 1, *cost, *recall));
        sets.max_by(|a, b| compare((a.2, a.1, a.0), (b.2, b.1, b.0)))
    }

    /// The first steps.
    pub(crate) fn steps(&self, members: &[String], count: usize) -> Vec<Step> {
        let step = |(m, cost_ms, recall): &(usize, f64, f64)| Step {
            member: members[*m].clone(),
            cost_ms: *cost_ms,
            recall: *recall,
        };
        self.path.iter().take(count).map(step).collect()
    }
}

/// Which of two sets, given as recall, cost and number of members, is the better one (greater).
fn compare(a: (f64, f64, usize), b: (f64, f64, usize)) -> Ordering {
    let by_recall = a.0.total_cmp(&b.0);
    by_recall.then(b.1.total_cmp(&a.1)).then(b.2.cmp(&a.2))
}

/// The best set of these searches, and which of them found it.
pub(crate) fn better_of(searches: &[Search], prices: &Prices) -> (Set, usize) {
    let found = searches.iter().enumerate().filter_map(|(at, search)| {
        let (count, cost, recall) = search.best()?;
        Some((at, count, cost, recall))
    });
    // Of equals the first, so the search by recall.
    let best = found
        .rev()
        .max_by(|a, b| compare((a.3, a.2, a.1), (b.3, b.2, b.1)));
    let Some((at, count, ..)) = best else {
        return (Set::new(), 0);
    };
    let mut set: Set = searches[at].path.iter().take(count).map(|(m, ..)| *m).collect();
    set.sort_unstable();
    debug_assert!(prices.cost(&set) <= searches[at].budget_ms + SLACK_MS);
    (set, at)
}

/// All sets that fit the budget.
pub(crate) fn all_within(members: usize, prices: &Prices, budget_ms: f64) -> Vec<Set> {
    let sets =
        (1u64..1 << members.min(63)).map(|bits| (0..members).filter(|m| bits >> m & 1 == 1).collect::<Set>());
    sets.filter(|set| prices.cost(set) <= budget_ms + SLACK_MS)
        .collect()
}

/// The best of these sets.
pub(crate) fn best_of(sets: &[Set], prices: &Prices, recall: impl Fn(&Set) -> f64) -> Option<Set> {
    let judged = sets.iter().map(|set| (recall(set), prices.cost(set), set));
    let best = judged.max_by(|a, b| compare((a.0, a.1, a.2.len()), (b.0, b.1, b.2.len())).then(b.2.cmp(a.2)));
    best.map(|(.., set)| set.clone())
}

/// The sets that recall more than every cheaper one, cheapest first.
pub(crate) fn front<'a>(
    sets: impl Iterator<Item = &'a Set>,
    prices: &Prices,
    recall: impl Fn(&Set) -> f64,
) -> Vec<Set> {
    let mut all: Vec<(f64, f64, &Set)> = sets.map(|set| (prices.cost(set), recall(set), set)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(b.2)));
    let mut most = 0.0;
    all.retain(|(_, recall, _)| {
        let more = *recall > most;
        most = if more { *recall } else { most };
        more
    });
    all.into_iter().map(|(.., set)| set.clone()).collect()
}
