//! The measures of one configuration, from what came of its queries.

use crate::confidence::{Bin, bins};
use crate::outcome::Outcome;
use crate::pair::Pair;
use crate::statistics::{Interval, recall_interval};
use serde::{Deserialize, Serialize};

/// The K of Recall@K.
pub const KS: [u32; 4] = [1, 5, 10, 20];
/// Distances within which an answer counts as right in "recall by tolerance", metres.
pub const TOLERANCES_M: [f64; 14] = [
    5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0, 55.0, 60.0, 65.0, 70.0,
];
/// Ticks of the map next to a right place within which an answer counts as right in "recall by frames".
pub const FRAMES: [usize; 8] = [0, 1, 2, 3, 5, 10, 15, 20];
/// How far in time an answer may be off in LENS's protocol, µs.
const LENS_US: u64 = 3_000_000;
/// Most points of a precision–recall curve that are kept.
const MAX_POINTS: usize = 101;

/// Right answers as a share of two different wholes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// Of all queries: one without a right place counts as wrong. The authors' code measures ensembles so.
    pub of_all: f64,
    /// Of the queries that have a right place. The authors' code measures single members so.
    pub of_matchable: f64,
}

impl Share {
    fn new(right: usize, queries: usize, matchable: usize) -> Self {
        Self {
            of_all: right as f64 / queries.max(1) as f64,
            of_matchable: right as f64 / matchable.max(1) as f64,
        }
    }
}

/// A point of a precision–recall curve: the answers of at least this confidence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PrecisionRecall {
    /// The least confidence.
    pub confidence: f64,
    /// Share of the answers of at least this confidence that are right.
    pub precision: f64,
    /// Those right answers as a share of the queries that have a right place.
    pub recall: f64,
}

/// What is measured of one configuration.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Queries.
    pub queries: usize,
    /// Queries that have a right place.
    pub matchable: usize,
    /// Queries with an answer.
    pub answered: usize,
    /// Queries whose answer is right.
    pub right: usize,
    /// The middle 95 % of Recall@1 by the bootstrap over blocks of queries.
    pub interval_95: Interval,
    /// Answers by their confidence.
    pub confidence: Vec<Bin>,
    /// Recall@K for each of [`KS`].
    pub recall_at: [Share; 4],
    /// Recall@1 if all ties were broken in favour of the right place.
    pub optimistic_at_1: Share,
    /// Recall@1 if all ties were broken against it.
    pub pessimistic_at_1: Share,
    /// Area under the precision–recall curve by confidence: Σ (rᵢ − rᵢ₋₁)·pᵢ, answers of one confidence taken together.
    pub precision_recall_area: f64,
    /// The most recall (of the queries that have a right place) at which every answer is right.
    pub recall_at_full_precision: f64,
    /// The curve, from the highest confidence down; points are left out where there are more than 101.
    pub precision_recall: Vec<PrecisionRecall>,
    /// Median distance from the query to the answered place, metres, of the answers of which both positions are known.
    pub error_median_m: Option<f64>,
    /// Mean of the same.
    pub error_mean_m: Option<f64>,
    /// Median distance from the answer to the nearest right place, ticks of the map.
    pub error_median_frames: Option<f64>,
    /// Ticks from the start of the query traverse to its first right answer, that one included.
    pub first_right_ticks: Option<usize>,
    /// Time from the start of the query traverse to the end of the first tick that was answered rightly, s.
    pub first_right_s: Option<f64>,
    /// Recall@1 within each of [`TOLERANCES_M`]; empty where positions are not known. Of the queries with a known position,
    /// and of those that have a place so near.
    pub by_tolerance_m: Vec<Share>,
    /// Recall@1 with places that the map passes within 3 s of the true one counted as right: of the place nearest to the
    /// query where positions are known, else of a right one (LENS's protocol). `None` in results of earlier versions.
    #[serde(default)]
    pub within_3s: Option<Share>,
    /// Recall@1 with places up to each of [`FRAMES`] ticks next to a right one counted as right too.
    pub by_frames: Vec<Share>,
}

/// Measures what came of the queries of a pair, one outcome each. `length` is that of the sequences, ticks.
pub fn measure(pair: &Pair, outcomes: &[Outcome], length: usize) -> Measures {
    let is_right: Vec<bool> = outcomes.iter().map(Outcome::is_right).collect();
    let is_matchable: Vec<bool> = (0..outcomes.len())
        .map(|q| !pair.truth.matches(q).is_empty())
        .collect();
    let (queries, matchable) = (pair.queries(), pair.truth.with_match());
    let count = |is: &dyn Fn(&Outcome) -> bool| outcomes.iter().filter(|o| is(o)).count();
    let share = |is: &dyn Fn(&Outcome) -> bool| Share::new(count(is), queries, matchable);
    let curve = curve(outcomes, matchable);
    let first = outcomes.iter().position(Outcome::is_right);
    let distances = distances_m(pair, outcomes);
    let frames = frames_off(pair, outcomes);
    let by_frames = FRAMES.map(|limit| {
        let near = frames.iter().flatten().filter(|off| **off <= limit).count();
        Share::new(near, queries, matchable)
    });
    let near = |(query, outcome): &(usize, &Outcome)| is_within_3s(pair, *query, outcome.answer);
    let within_3s = outcomes.iter().enumerate().filter(near).count();
    let known: Vec<f64> = distances.iter().copied().flatten().collect();
    Measures {
        queries,
        matchable,
        answered: count(&|o| o.answer.is_some()),
        right: count(&Outcome::is_right),
        interval_95: recall_interval(&is_right, &is_matchable, length),
        confidence: bins(outcomes),
        recall_at: KS.map(|k| share(&|o| o.is_within(k))),
        optimistic_at_1: share(&|o| o.is_within_at_best(1)),
        pessimistic_at_1: share(&|o| o.is_within_at_worst(1)),
        precision_recall_area: area(&curve),
        recall_at_full_precision: curve
            .iter()
            .filter(|p| p.precision == 1.0)
            .map(|p| p.recall)
            .fold(0.0, f64::max),
        precision_recall: thinned(curve),
        error_median_m: median(known.clone()),
        error_mean_m: (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64),
        error_median_frames: median(frames.iter().flatten().map(|f| *f as f64).collect()),
        first_right_ticks: first.map(|at| at + 1),
        first_right_s: first.and_then(|at| {
            let (start, end) = (pair.times_us.first()?.0, pair.times_us.get(at)?.1);
            Some(end.saturating_sub(start) as f64 / 1e6)
        }),
        by_tolerance_m: by_tolerance(pair, &distances),
        within_3s: Some(Share::new(within_3s, queries, matchable)),
        by_frames: by_frames.into(),
    }
}

/// All points, highest confidence first; answers of one confidence are one point.
fn curve(outcomes: &[Outcome], matchable: usize) -> Vec<PrecisionRecall> {
    let mut answers: Vec<(f64, bool)> = outcomes
        .iter()
        .filter(|o| o.answer.is_some())
        .map(|o| (o.confidence, o.is_right()))
        .collect();
    answers.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut points, mut right) = (Vec::new(), 0usize);
    for (index, (confidence, is_right)) in answers.iter().enumerate() {
        right += usize::from(*is_right);
        if answers.get(index + 1).is_none_or(|next| next.0 < *confidence) {
            points.push(PrecisionRecall {
                confidence: *confidence,
                precision: right as f64 / (index + 1) as f64,
                recall: right as f64 / matchable.max(1) as f64,
            });
        }
    }
    points
}

fn area(curve: &[PrecisionRecall]) -> f64 {
    let mut before = 0.0;
    let step = |p: &PrecisionRecall| {
        let gained = p.recall - std::mem::replace(&mut before, p.recall);
        gained * p.precision
    };
    curve.iter().map(step).sum()
}

fn thinned(curve: Vec<PrecisionRecall>) -> Vec<PrecisionRecall> {
    if curve.len() <= MAX_POINTS {
        return curve;
    }
    let at = |i: usize| i * (curve.len() - 1) / (MAX_POINTS - 1);
    (0..MAX_POINTS).map(|i| curve[at(i)]).collect()
}

/// The middle number; of an even number of them the mean of the two in the middle.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    let upper = *values.get(half)?;
    Some(if values.len().is_multiple_of(2) {
        f64::midpoint(upper, values[half - 1])
    } else {
        upper
    })
}

/// Per query how far the answered place is, where both positions are known.
pub(crate) fn distances_m(pair: &Pair, outcomes: &[Outcome]) -> Vec<Option<f64>> {
    let distance = |(outcome, query): (&Outcome, &Option<[f64; 2]>)| {
        let query = (*query)?;
        let place = (*pair.reference_positions.get(outcome.answer? as usize)?)?;
        Some((query[0] - place[0]).hypot(query[1] - place[1]))
    };
    outcomes.iter().zip(&pair.query_positions).map(distance).collect()
}

/// Per query how many ticks of the map lie between the answer and the nearest right place.
pub(crate) fn frames_off(pair: &Pair, outcomes: &[Outcome]) -> Vec<Option<usize>> {
    let off = |(query, outcome): (usize, &Outcome)| {
        let (answer, right) = (outcome.answer?, pair.truth.matches(query));
        let after = right.partition_point(|r| *r < answer);
        let next = right.get(after).map(|r| r - answer);
        let before = after
            .checked_sub(1)
            .and_then(|i| right.get(i))
            .map(|r| answer - r);
        next.into_iter().chain(before).min().map(|f| f as usize)
    };
    outcomes.iter().enumerate().map(off).collect()
}

/// Whether the map passes the answered place within 3 s of the true one; never where no place is right.
fn is_within_3s(pair: &Pair, query: usize, answer: Option<u32>) -> bool {
    let start = |place: u32| pair.reference_starts_us.get(place as usize).copied();
    let right = pair.truth.matches(query);
    let Some(at) = answer.and_then(start).filter(|_| !right.is_empty()) else {
        return false;
    };
    let near = |place: &u32| start(*place).is_some_and(|s| s.abs_diff(at) <= LENS_US);
    let distance = |place: &u32| {
        let position = pair.reference_positions.get(*place as usize).copied().flatten()?;
        let query = pair.query_positions.get(query).copied().flatten()?;
        Some((*place, (query[0] - position[0]).hypot(query[1] - position[1])))
    };
    let known = right.iter().filter_map(distance);
    match known.min_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((nearest, _)) => near(&nearest),
        None => right.iter().any(near),
    }
}

fn by_tolerance(pair: &Pair, distances: &[Option<f64>]) -> Vec<Share> {
    let known = |positions: &[Option<[f64; 2]>]| positions.iter().any(Option::is_some);
    if !known(&pair.query_positions) || !known(&pair.reference_positions) {
        return Vec::new();
    }
    let queries = pair.query_positions.iter().flatten().count();
    let share = |limit: f64| {
        let near = distances.iter().flatten().filter(|d| **d <= limit).count();
        let matchable = pair.nearest_m.iter().flatten().filter(|d| **d <= limit).count();
        Share::new(near, queries, matchable)
    };
    TOLERANCES_M.iter().map(|limit| share(*limit)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(confidence: f64, right: bool) -> Outcome {
        Outcome {
            answer: Some(0),
            confidence,
            rank: if right { 0 } else { 3 },
            ..Outcome::NONE
        }
    }

    #[test]
    fn precision_and_recall_by_confidence() {
        let outcomes = [
            outcome(0.9, true),
            outcome(0.2, false),
            outcome(0.7, true),
            outcome(0.5, false),
            outcome(0.5, true),
            Outcome::NONE,
        ];
        let curve = curve(&outcomes, 5);
        let points: Vec<(f64, f64, f64)> = curve
            .iter()
            .map(|p| (p.confidence, p.precision, p.recall))
            .collect();
        assert_eq!(
            points,
            [
                (0.9, 1.0, 0.2),
                (0.7, 1.0, 0.4),
                (0.5, 0.75, 0.6),
                (0.2, 0.6, 0.6)
            ]
        );
        let want = 0.2 + 0.2 + 0.2 * 0.75;
        assert!((area(&curve) - want).abs() < 1e-12);
    }

    #[test]
    fn curves_keep_both_ends_when_thinned() {
        let outcomes: Vec<Outcome> = (0..1000).map(|i| outcome(f64::from(i), i % 2 == 0)).collect();
        let all = curve(&outcomes, 1000);
        let thin = thinned(all.clone());
        assert_eq!((all.len(), thin.len()), (1000, 101));
        assert_eq!((thin[0], thin[100]), (all[0], all[999]));
    }

    #[test]
    fn medians() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![3.0, 1.0]), Some(2.0));
    }
}
