//! All pairs, side by side as far as the memory allows.

use crate::error::EvaluateError;
use crate::measure::measure;
use crate::pair::Pair;
use crate::results::{Results, Row};
use crate::spec::{Configuration, Spec};
use crate::sweep::sweep;
use evpr_core::plan::Similarity;
use rayon::prelude::*;
use std::sync::Mutex;

/// Who wants to know how far it is. Work is counted in queries × configurations.
pub trait Progress: Sync {
    /// So much more is to be done.
    fn found(&self, work: u64);
    /// So much more is done.
    fn advanced(&self, work: u64);
}

impl Progress for () {
    fn found(&self, _: u64) {}
    fn advanced(&self, _: u64) {}
}

/// Evaluates all configurations of all pairs that `results` does not have yet, and writes them there. Pairs are computed
/// side by side, as many as fit into the spec's memory together.
///
/// # Errors
/// See [`EvaluateError`]. What was ready before stays on disk.
pub fn evaluate(
    pairs: &[Pair],
    spec: &Spec,
    results: &mut Results,
    progress: &dyn Progress,
) -> Result<(), EvaluateError> {
    spec.check()?;
    results.settle("exclusion", &spec.exclusion.to_string())?;
    let mut open: Vec<(&Pair, Vec<Configuration>)> = Vec::new();
    for pair in pairs {
        let mut configurations = spec.configurations(&pair.members)?;
        for c in &configurations {
            pair.check_length(c.method, c.length)?;
        }
        configurations.retain(|c| !results.has(&c.key(&pair.name)));
        open.push((pair, configurations));
    }
    progress.found(open.iter().map(|(p, c)| (p.queries() * c.len()) as u64).sum());
    let side_by_side = rayon::current_num_threads().clamp(1, open.len().max(1));
    // Each pair gets its share, so that together they stay below the limit.
    let each = Spec {
        memory_bytes: spec.memory_bytes / side_by_side as u64,
        ..spec.clone()
    };
    let shared = Mutex::new(&mut *results);
    let (small, large): (Vec<_>, Vec<_>) = open.into_iter().partition(|(pair, configurations)| {
        let longest = configurations.iter().map(|c| c.length).max().unwrap_or(1);
        crate::bytes_needed(pair, &[(longest, configurations.len())]) <= each.memory_bytes
    });
    for group in small.chunks(side_by_side) {
        group
            .par_iter()
            .try_for_each(|(pair, configurations)| one(pair, configurations, &each, &shared, progress))?;
    }
    for (pair, configurations) in &large {
        one(pair, configurations, spec, &shared, progress)?;
    }
    results.write()
}

fn one(
    pair: &Pair,
    configurations: &[Configuration],
    spec: &Spec,
    results: &Mutex<&mut Results>,
    progress: &dyn Progress,
) -> Result<(), EvaluateError> {
    let mut similarities: Vec<Similarity> = Vec::new();
    for c in configurations {
        if !similarities.contains(&c.similarity) {
            similarities.push(c.similarity);
        }
    }
    for similarity in similarities {
        let these: Vec<&Configuration> = configurations
            .iter()
            .filter(|c| c.similarity == similarity)
            .collect();
        sweep(
            pair,
            spec,
            &these,
            &|work| progress.advanced(work),
            &mut |c, outcomes| {
                let row = Row::new(pair, c, measure(pair, &outcomes, c.length));
                let mut results = results.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                results.add(row)
            },
        )?;
    }
    Ok(())
}
