//! Weights of members: given in a file, or learnt from a labelled pair.
//!
//! Learnt, a member's weight is how much more often it is right than chance, as log odds: ln(p / (1 − p)) −
//! ln(c / (1 − c)), and 0 where that is below 0. p = (right + 1) / (n + 2), over the n queries of the pair that have a
//! right place; c is the mean share of the map's places that is right for them. So weighed, the sum over members that
//! err independently is that of a naive Bayes vote. Weights are scaled to a mean of 1. On the pair they were learnt on,
//! what they give is fitted.

use crate::error::EvaluateError;
use crate::pair::{Digest, Pair};
use crate::results::Row;
use crate::subsets::SubsetKind;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// Largest file of weights, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Reads weights: a TOML file of `"member" = weight`, as `ensemble.weights` of a configuration. They are named after the
/// file, with a digest of what it says, so that other weights are other results.
///
/// # Errors
/// When it cannot be read, is not such a file, or names something that is a member of none of the pairs.
pub fn read_weights(path: &Path, pairs: &[Pair]) -> Result<(String, BTreeMap<String, f64>), EvaluateError> {
    let file = std::fs::File::open(path).map_err(EvaluateError::io("open", path))?;
    let mut text = String::new();
    file.take(MAX_FILE_BYTES)
        .read_to_string(&mut text)
        .map_err(EvaluateError::io("read", path))?;
    let bad = |reason: String| EvaluateError::bad(path, reason);
    let numbers: BTreeMap<String, toml::Value> =
        toml::from_str(&text).map_err(|e| bad(e.to_string().trim().replace('\n', " ")))?;
    let mut weights = BTreeMap::new();
    let mut digest = Digest::default();
    for (member, value) in numbers {
        let number = value.as_float().or_else(|| value.as_integer().map(|n| n as f64));
        let weight = number.filter(|w| w.is_finite() && *w >= 0.0).ok_or_else(|| {
            bad(format!(
                "the weight {value} of {member} makes no sense; give a number of 0 or more"
            ))
        })?;
        if !pairs.iter().any(|p| p.members.contains(&member)) {
            let known: Vec<&str> = pairs
                .iter()
                .flat_map(|p| &p.members)
                .map(String::as_str)
                .collect();
            return Err(bad(format!(
                "no pair has a member {member}; there are {}",
                known.join(", ")
            )));
        }
        member.bytes().for_each(|byte| digest.add(u64::from(byte)));
        digest.add(weight.to_bits());
        weights.insert(member, weight);
    }
    let name = path.file_stem().map_or_else(String::new, |n| {
        n.to_string_lossy().replace(['|', '\n', '\r', '"'], "_")
    });
    Ok((format!("{name}#{:08x}", digest.0 as u32), weights))
}

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
