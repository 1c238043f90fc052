//! How alike members are: in what they see, and in what they get wrong.

use crate::error::EvaluateError;
use crate::outcome::Outcome;
use crate::pair::Pair;
use crate::spec::{Configuration, Spec, SubsetChoice};
use crate::subsets::SubsetKind;
use crate::sweep::sweep;
use evpr_core::config::method_label;
use evpr_core::plan::Similarity;
use evpr_fuse::similarity::similarity;
use rayon::prelude::*;
use serde::Serialize;

/// Queries over which similarities are correlated, evenly spaced.
const MAX_QUERIES: usize = 256;

/// How alike the members of a pair are. Matrices are in the order of `members`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Members {
    /// The pair.
    pub pair: String,
    /// Similarity that the following is of.
    pub similarity: String,
    /// Sequence method.
    pub method: String,
    /// Sequence length, ticks.
    pub length: usize,
    /// Names.
    pub members: Vec<String>,
    /// Recall@1 of each of all queries.
    pub recall: Vec<f64>,
    /// Queries over which similarities were correlated: those of them where both members have a row.
    pub queries: usize,
    /// Pearson's correlation of two members' similarities along a query's row, mean over the queries; `None` where they
    /// have no row in common.
    pub similarity_correlation: Vec<Vec<Option<f64>>>,
    /// Of the queries that at least one of two members gets wrong, the share that both do. 1 where neither errs.
    pub error_overlap: Vec<Vec<f64>>,
}

/// Compares all members of a pair, with the spec's first similarity, method and length.
///
/// # Errors
/// As [`evaluate`](crate::evaluate).
pub fn members(pair: &Pair, spec: &Spec) -> Result<Members, EvaluateError> {
    spec.check()?;
    let spec = Spec {
        subsets: vec![SubsetChoice::Kind(SubsetKind::Single)],
        similarities: spec.similarities[..1].to_vec(),
        methods: spec.methods[..1].to_vec(),
        lengths: spec.lengths[..1].to_vec(),
        rules: Vec::new(),
        weights: None,
        ..spec.clone()
    };
    let configurations = spec.configurations(&pair.members)?;
    let wanted: Vec<&Configuration> = configurations.iter().collect();
    let mut wrong: Vec<Vec<bool>> = vec![Vec::new(); pair.members.len()];
    sweep(pair, &spec, &wanted, &|_| (), &mut |c, outcomes| {
        if let Some(member) = c.subset.members.iter().next() {
            let matchable = |q: usize| !pair.truth.matches(q).is_empty();
            let judged = outcomes.iter().enumerate().filter(|(q, _)| matchable(*q));
            wrong[member] = judged.map(|(_, outcome)| !Outcome::is_right(outcome)).collect();
        }
        Ok(())
    })?;
    let step = pair.queries().div_ceil(MAX_QUERIES).max(1);
    let queries: Vec<usize> = (0..pair.queries()).step_by(step).collect();
    let first = configurations.first();
    let recall =
        |wrong: &Vec<bool>| wrong.iter().filter(|w| !**w).count() as f64 / pair.queries().max(1) as f64;
    Ok(Members {
        pair: pair.name.clone(),
        similarity: first.map_or_else(String::new, |c| c.similarity_word().to_owned()),
        method: first.map_or_else(String::new, |c| method_label(&c.method)),
        length: first.map_or(0, |c| c.length),
        members: pair.members.clone(),
        recall: wrong.iter().map(recall).collect(),
        queries: queries.len(),
        similarity_correlation: correlations(pair, spec.similarities[0], &queries),
        error_overlap: wrong
            .iter()
            .map(|a| wrong.iter().map(|b| overlap(a, b)).collect())
            .collect(),
    })
}

fn overlap(a: &[bool], b: &[bool]) -> f64 {
    let both = a.iter().zip(b).filter(|(a, b)| **a && **b).count();
    let either = a.iter().zip(b).filter(|(a, b)| **a || **b).count();
    if either == 0 {
        1.0
    } else {
        both as f64 / either as f64
    }
}

/// Means over the queries of the correlations along their rows.
fn correlations(pair: &Pair, kind: Similarity, queries: &[usize]) -> Vec<Vec<Option<f64>>> {
    let count = pair.members.len();
    let nothing = || vec![(0.0, 0usize); count * count];
    let sums = queries
        .par_iter()
        .fold(nothing, |mut sums, query| {
            let rows: Vec<Option<Vec<f64>>> = (0..count).map(|m| row(pair, kind, m, *query)).collect();
            for (a, row_a) in rows.iter().enumerate() {
                for (b, row_b) in rows.iter().enumerate().skip(a) {
                    let Some(r) = row_a
                        .as_ref()
                        .zip(row_b.as_ref())
                        .and_then(|(a, b)| correlation(a, b))
                    else {
                        continue;
                    };
                    let sum = &mut sums[a * count + b];
                    *sum = (sum.0 + r, sum.1 + 1);
                }
            }
            sums
        })
        .reduce(nothing, |a, b| {
            a.iter().zip(b).map(|(a, b)| (a.0 + b.0, a.1 + b.1)).collect()
        });
    let of = |a: usize, b: usize| {
        let (sum, n) = sums[a.min(b) * count + a.max(b)];
        (n > 0).then(|| sum / n as f64)
    };
    (0..count)
        .map(|a| (0..count).map(|b| of(a, b)).collect())
        .collect()
}

/// A member's similarities at a query; NaN where the map has no row.
fn row(pair: &Pair, kind: Similarity, member: usize, query: usize) -> Option<Vec<f64>> {
    let rows = &pair.rows[member];
    if !rows.query.present()[query] {
        return None;
    }
    let mut out = vec![0.0; pair.references()];
    let (map, valid) = (rows.reference.rows(), rows.reference.present());
    similarity(kind, rows.query.row(query), map, valid, &mut out);
    Some(out)
}

/// Pearson's correlation over the places that both have; `None` where one of them is the same everywhere.
fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let both = || a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite());
    let n = both().count() as f64;
    let (mean_a, mean_b) = (
        both().map(|p| p.0).sum::<f64>() / n,
        both().map(|p| p.1).sum::<f64>() / n,
    );
    let sum = |of: &dyn Fn(f64, f64) -> f64| both().map(|(a, b)| of(a - mean_a, b - mean_b)).sum::<f64>();
    let r = sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    r.is_finite().then_some(r)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlations_leave_out_what_is_not_there() {
        let a = [1.0, 2.0, f64::NAN, 3.0, 100.0];
        let b = [2.0, 4.0, 7.0, 6.0, f64::NAN];
        assert!((correlation(&a, &b).unwrap() - 1.0).abs() < 1e-12);
        let down: Vec<f64> = b.iter().map(|b| -b).collect();
        assert!((correlation(&a, &down).unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(correlation(&a, &[1.0; 5]), None);
        assert_eq!(correlation(&[f64::NAN], &[1.0]), None);
    }

    #[test]
    fn errors_overlap() {
        let (a, b) = ([true, true, false, false], [true, false, true, false]);
        assert_eq!(
            (overlap(&a, &b), overlap(&a, &a), overlap(&[false], &[false])),
            (1.0 / 3.0, 1.0, 1.0)
        );
    }
}
