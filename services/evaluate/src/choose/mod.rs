//! Which members to run for a given time per tick: those that recognise most on labelled pairs.
//!
//! The recall of a set of members is the mean over the pairs of its Recall@1 of the queries that have a right place. Sets
//! are found by greedy forward selection ([`search`]); where there are few members, all sets are tried as a check. What a
//! set recalls on the pairs that it was chosen by is *fitted*: it flatters. So the choice is made again without each pair
//! (with one pair: without each of five blocks of consecutive queries, and the queries whose sequences reach into it), and
//! measured on what was left out: the *cross-validated* recall.

mod cost;
mod judge;
mod search;

pub use cost::Costs;
pub use search::Step;

use crate::error::EvaluateError;
use crate::evaluate::Progress;
use crate::pair::Pair;
use crate::spec::Spec;
use evpr_core::plan::{Rule, SequenceMethod, Similarity};
use judge::{Judge, Queries, Set};
use search::{Criterion, Search};
use serde::Serialize;

/// Blocks that the queries of a single pair are cut into.
const BLOCKS: usize = 5;

/// What is wanted.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// Time per tick, ms.
    pub budget_ms: f64,
    /// Similarity.
    pub similarity: Similarity,
    /// Sequence method.
    pub method: SequenceMethod,
    /// Sequence length, ticks.
    pub length: usize,
    /// Fusion rule.
    pub rule: Rule,
    /// Up to so many members all sets are tried as a check.
    pub exact_up_to: usize,
    /// Memory for scores and sequences, bytes.
    pub memory_bytes: u64,
}

/// A set of members with its price and its worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Choice {
    /// Members, in the map's order.
    pub members: Vec<String>,
    /// Time per tick, ms.
    pub cost_ms: f64,
    /// Mean over the pairs of Recall@1 of the queries that have a right place.
    pub recall: f64,
}

/// What was chosen without one part of the queries, and how it does there.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fold {
    /// What was left out: a pair, or queries of the only one.
    pub left_out: String,
    /// What was chosen by the rest, with its recall there.
    pub choice: Choice,
    /// Its recall on what was left out.
    pub recall: f64,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Chosen {
    /// Time per tick that was allowed, ms.
    pub budget_ms: f64,
    /// What was chosen by all queries. Its recall is fitted.
    pub choice: Choice,
    /// Mean recall of the folds' choices on what they were not chosen by.
    pub cross_validated: f64,
    /// The folds.
    pub folds: Vec<Fold>,
    /// How the choice grew, member by member.
    pub steps: Vec<Step>,
    /// The best set there is within the budget (fitted), where all were tried.
    pub exact: Option<Choice>,
    /// The same chosen and measured fold by fold.
    pub exact_cross_validated: Option<f64>,
    /// All members together, whatever they cost.
    pub all: Choice,
    /// Of the sets that were tried, those that recall more than every cheaper one (fitted).
    pub front: Vec<Choice>,
    /// How many sets were tried.
    pub tried: usize,
}

/// Queries that a choice is made by, and those it is measured on.
struct Part {
    left_out: String,
    fit: Queries,
    test: Queries,
}

/// Chooses members for a budget. All pairs must have the same members.
///
/// # Errors
/// The pairs' members differ, a member has no cost, none fits the budget, or the memory is too small.
pub fn choose(
    pairs: &[Pair],
    wanted: &Wanted,
    costs: &Costs,
    progress: &dyn Progress,
) -> Result<Chosen, EvaluateError> {
    let members = same_members(pairs)?;
    for pair in pairs {
        pair.check_length(wanted.method, wanted.length)?;
    }
    let prices = costs.of(members)?;
    let (cheapest, least_ms) = (0..members.len())
        .map(|m| (m, prices.cost(&[m])))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .ok_or_else(|| EvaluateError::Asked("there are no members to choose from".to_owned()))?;
    if least_ms > wanted.budget_ms {
        return Err(EvaluateError::Asked(format!(
            "no member fits {} ms: the cheapest, {}, takes {least_ms:.3} ms; allow more",
            wanted.budget_ms, members[cheapest]
        )));
    }
    let mut judge = Judge::new(pairs, wanted);
    let whole = judge.all_queries();
    let parts = parts(pairs, wanted, &judge);
    let searches_of = |fit: &Queries, budget: f64| {
        Criterion::ALL.map(|criterion| Search::new(members.len(), criterion, budget, fit.clone()))
    };
    // All searches go step by step together, so that each pass over the queries serves all of them.
    let mut searches: Vec<Search> = searches_of(&whole, wanted.budget_ms).into();
    searches.extend(searches_of(&whole, f64::INFINITY));
    for part in &parts {
        searches.extend(searches_of(&part.fit, wanted.budget_ms));
    }
    loop {
        let sets: Vec<Set> = searches.iter().flat_map(|s| s.candidates(&prices)).collect();
        if sets.is_empty() {
            break;
        }
        judge.look_at(sets, progress)?;
        for search in &mut searches {
            search.advance(&prices, &judge);
        }
    }
    let everything: Set = (0..members.len()).collect();
    judge.look_at(vec![everything.clone()], progress)?;
    let greedy = |searches: &[Search]| search::better_of(searches, &prices);
    let choice = |set: &Set, queries: &Queries| Choice {
        members: set.iter().map(|m| members[*m].clone()).collect(),
        cost_ms: prices.cost(set),
        recall: judge.recall(set, queries),
    };
    let (found, of_search) = greedy(&searches[..2]);
    let folds: Vec<Fold> = parts
        .iter()
        .zip(searches[4..].chunks(2))
        .map(|(part, searches)| {
            let (set, _) = greedy(searches);
            Fold {
                left_out: part.left_out.clone(),
                choice: choice(&set, &part.fit),
                recall: judge.recall(&set, &part.test),
            }
        })
        .collect();
    let steps = searches[of_search].steps(members, found.len());
    let chosen = choice(&found, &whole);
    let all = choice(&everything, &whole);
    let (mut exact, mut exact_cross_validated) = (None, None);
    if members.len() <= wanted.exact_up_to {
        let sets = search::all_within(members.len(), &prices, wanted.budget_ms);
        judge.look_at(sets.clone(), progress)?;
        let best = |queries: &Queries| search::best_of(&sets, &prices, |set| judge.recall(set, queries));
        exact = best(&whole).map(|set| Choice {
            members: set.iter().map(|m| members[*m].clone()).collect(),
            cost_ms: prices.cost(&set),
            recall: judge.recall(&set, &whole),
        });
        let folds = parts
            .iter()
            .filter_map(|part| Some(judge.recall(&best(&part.fit)?, &part.test)));
        exact_cross_validated = Some(mean(folds));
    }
    let front = search::front(judge.sets(), &prices, |set| judge.recall(set, &whole));
    let front = front.into_iter().map(|set| Choice {
        members: set.iter().map(|m| members[*m].clone()).collect(),
        cost_ms: prices.cost(&set),
        recall: judge.recall(&set, &whole),
    });
    Ok(Chosen {
        budget_ms: wanted.budget_ms,
        choice: chosen,
        cross_validated: mean(folds.iter().map(|f| f.recall)),
        folds,
        steps,
        exact,
        exact_cross_validated,
        all,
        front: front.collect(),
        tried: judge.sets().count(),
    })
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), v| (sum + v, count + 1));
    sum / count.max(1) as f64
}

fn same_members(pairs: &[Pair]) -> Result<&[String], EvaluateError> {
    let first = pairs
        .first()
        .ok_or_else(|| EvaluateError::Asked("there is no pair to choose by".to_owned()))?;
    for pair in pairs {
        if pair.members != first.members {
            return Err(EvaluateError::pair(
                &pair.name,
                format!(
                    "its members are not those of pair {}; name those that both have with --members",
                    first.name
                ),
            ));
        }
    }
    Ok(&first.members)
}

/// What is left out in turn.
fn parts(pairs: &[Pair], wanted: &Wanted, judge: &Judge<'_>) -> Vec<Part> {
    if let [pair] = pairs {
        let queries = pair.queries();
        let blocks = BLOCKS.min(queries);
        let history = wanted.length.saturating_sub(1);
        let block = |b: usize| {
            let (from, to) = (b * queries / blocks, (b + 1) * queries / blocks);
            // The queries around the block share ticks of their sequences with it.
            let apart = |q: usize| q + history < from || q >= to + history;
            Part {
                left_out: format!("queries {from} to {}", to - 1),
                fit: judge.queries(|_, q| apart(q)),
                test: judge.queries(|_, q| (from..to).contains(&q)),
            }
        };
        // A block without a query that can be recognised says nothing, nor can be chosen without any.
        let says = |part: &Part| part.fit.count() > 0 && part.test.count() > 0;
        return (0..blocks).map(block).filter(says).collect();
    }
    let without = |(at, pair): (usize, &Pair)| Part {
        left_out: pair.name.clone(),
        fit: judge.queries(|p, _| p != at),
        test: judge.queries(|p, _| p == at),
    };
    pairs.iter().enumerate().map(without).collect()
}

impl Wanted {
    fn spec(&self) -> Spec {
        Spec {
            subsets: Vec::new(),
            similarities: vec![self.similarity],
            methods: vec![self.method],
            lengths: vec![self.length],
            rules: vec![self.rule],
            exclusion: 0,
            weights: None,
            memory_bytes: self.memory_bytes,
        }
    }
}
