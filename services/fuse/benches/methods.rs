//! Time per query of every sequence method (one member) and of every fusion rule (many members):
//!
//! ```text
//! cargo bench -p evpr-fuse --bench methods
//! ```
//!
//! All that is compared is measured in turns in one run; a time is the best of the turns, on one thread and on two.

use evpr_core::config::{RULES, SEQUENCE_METHODS};
use evpr_core::plan::SequenceMethod;
use evpr_fuse::SequenceMatcher;
use evpr_fuse::ensemble::{Ensemble, Part};
use std::hint::black_box;
use std::time::Instant;

const TURNS: usize = 41;
/// References of the maps; the second is the longest published one.
const REFERENCES: [usize; 3] = [849, 8_300, 100_000];
const LENGTH: usize = 10;
const MEMBERS: usize = 64;

fn main() {
    for threads in [1, 2] {
        match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
            Ok(pool) => pool.install(|| {
                REFERENCES.iter().for_each(|r| methods(*r, threads));
                REFERENCES.iter().for_each(|r| rules(*r, threads));
            }),
            Err(error) => eprintln!("no pool of {threads} threads: {error}"),
        }
    }
}

fn methods(references: usize, threads: usize) {
    let rows = rows(LENGTH, references);
    let valid = vec![true; references];
    let mut cases: Vec<_> = SEQUENCE_METHODS
        .all()
        .into_iter()
        .filter_map(|word| SEQUENCE_METHODS.parse(word).ok())
        .map(|method| {
            let mut matcher = SequenceMatcher::new(method, LENGTH, &valid);
            rows.iter().for_each(|row| matcher.push(Some(row)));
            let mut ensemble = Ensemble::new(references, 5, 5);
            if let SequenceMethod::Filter(filter) = method {
                ensemble = ensemble.with_filter(filter);
            }
            (method.name(), matcher, ensemble, f64::INFINITY)
        })
        .collect();
    let mut scores = vec![0.0; references];
    for turn in 0..TURNS {
        for (_, matcher, ensemble, best) in &mut cases {
            *best = best.min(ms(|| {
                matcher.push(Some(black_box(&rows[turn % LENGTH])));
                matcher.score(&mut scores);
                let part = Part {
                    scores: &scores,
                    valid: &valid,
                    weight: 1.0,
                };
                black_box(ensemble.fuse(std::iter::once(part)));
            }));
        }
    }
    print!("R = {references:>6}, L = {LENGTH}, one member, {threads} threads, ms:");
    cases
        .iter()
        .for_each(|(name, .., best)| print!("  {name} {best:.3}"));
    println!();
}

fn rules(references: usize, threads: usize) {
    let rows = rows(MEMBERS, references);
    let valid = vec![true; references];
    let mut cases: Vec<_> = RULES
        .all()
        .into_iter()
        .filter_map(|word| RULES.parse(word).ok())
        .map(|rule| {
            let ensemble = Ensemble::new(references, 5, 5).with_rule(rule);
            (rule.name(), ensemble, f64::INFINITY)
        })
        .collect();
    for _ in 0..TURNS / 4 {
        for (_, ensemble, best) in &mut cases {
            let parts = rows.iter().map(|scores| Part {
                scores,
                valid: &valid,
                weight: 1.0,
            });
            *best = best.min(ms(|| {
                black_box(ensemble.fuse(parts));
            }));
        }
    }
    print!("R = {references:>6}, {MEMBERS} members, {threads} threads, ms:");
    cases
        .iter()
        .for_each(|(name, _, best)| print!("  {name} {best:.3}"));
    println!();
}

fn ms(run: impl FnOnce()) -> f64 {
    let start = Instant::now();
    run();
    start.elapsed().as_secs_f64() * 1e3
}

/// Noise that is the same every time.
fn rows(ticks: usize, references: usize) -> Vec<Vec<f64>> {
    let value = |i: usize| {
        let h = (i as u32).wrapping_mul(2_654_435_761);
        let h = (h ^ (h >> 15)).wrapping_mul(2_246_822_519);
        f64::from(h >> 8) / f64::from(1 << 23) - 1.0
    };
    (0..ticks)
        .map(|t| (0..references).map(|j| value(t * references + j)).collect())
        .collect()
}
