//! Weights of members, learnt from a labelled pair.
//!
//! A member's weight is how much more often it is right than chance, as log odds: ln(p / (1 − p)) − ln(c / (1 − c)), and 0
//! where that is below 0. p = (right + 1) / (n + 2), over the n queries of the pair that have a right place; c is the mean
//! share of the map's places that is right for them. So weighed, the sum over members that err independently is that of a
//! naive Bayes vote. Weights are scaled to a mean of 1. On the pair they were learnt on, what they give is fitted.

use crate::error::EvaluateError;
use crate::pair::Pair;
use crate::results::Row;
use crate::subsets::SubsetKind;
use std::collections::BTreeMap;

/// Learns weights from the rows of single members on this pair; `like` is a row of the similarity, method and length they
/// are for.
///
/// # Errors
/// When a member has not been evaluated alone on the pair, or none is better than chance.
pub fn learnt_weights(pair: &Pair, rows: &[Row], like: &Row) -> Result<BTreeMap<String, f64>, EvaluateError> {
    let matchable = pair.truth().with_match() as f64;
    let right_places: usize = (0..pair.queries()).map(|q| pair.truth().matches(q).len()).sum();
    let chance = right_places as f64 / matchable.max(1.0) / pair.references().max(1) as f64;
    // A map of right places only leaves nothing to learn, and no logarithm of 0 either.
    let log_odds = |p: f64| (p.clamp(1e-9, 1.0 - 1e-9) / (1.0 - p.clamp(1e-9, 1.0 - 1e-9))).ln();
    let mut weights = BTreeMap::new();
    for member in pair.members() {
        let alone = rows.iter().find(|r| {
            r.pair == pair.name()
                && r.kind == SubsetKind::Single
                && r.subset == *member
                && r.weights == "equal"
                && (&r.similarity, &r.method, r.length) == (&like.similarity, &like.method, like.length)
        });
        let alone = alone.ok_or_else(|| {
            EvaluateError::pair(
                pair.name(),
                format!("member {member} was not evaluated alone, so its weight cannot be learnt; evaluate the subsets single"),
            )
        })?;
        let p = (alone.measures.right as f64 + 1.0) / (matchable + 2.0);
        weights.insert(member.clone(), (log_odds(p) - log_odds(chance)).max(0.0));
    }
    let mean = weights.values().sum::<f64>() / weights.len().max(1) as f64;
    if mean <= 0.0 {
        return Err(EvaluateError::pair(
            pair.name(),
            "no member is better than chance, so there are no weights to learn; choose another pair",
        ));
    }
    weights.values_mut().for_each(|w| *w /= mean);
    Ok(weights)
}
