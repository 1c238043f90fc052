//! Time per query of one member (similarity, sequence matching, fusing), as ratios to one plain read of the member's
//! map rows and ring on the same threads, and to the published per-column loop in NumPy:
//!
//! ```text
//! cargo bench -p evpr-fuse --bench per_query                     without the largest map
//! cargo bench -p evpr-fuse --bench per_query -- loop             only what is compared with the loop
//! EVPR_BENCH_LARGE=1 cargo bench -p evpr-fuse --bench per_query  with it (takes 4 GB of memory)
//! ```
//!
//! All that is compared is measured in turns in one run; a time is the best of the turns.

use evpr_core::plan::{SequenceMethod, Similarity};
use evpr_fuse::ensemble::{Ensemble, Part};
use evpr_fuse::{SequenceMatcher, similarity::similarity};
use rayon::prelude::*;
use std::hint::black_box;
use std::process::Command;
use std::time::Instant;

/// L.
const LENGTH: usize = 30;
const REFERENCES: [usize; 3] = [1_000, 10_000, 100_000];
const DIMS: [usize; 2] = [1024, 8448];
/// Map values above which a case is left out by default.
const LARGE: usize = 200_000_000;

/// What is measured, and the columns of the table.
const STEPS: [&str; 8] = [
    "read",
    "l2",
    "matching",
    "fusing",
    "l2_squared",
    "cosine",
    "sad",
    "alike",
];

fn main() {
    let large = std::env::var_os("EVPR_BENCH_LARGE").is_some();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    println!("L = {LENGTH}; ms, the best of all turns; in brackets the ratio to one read of rows and ring");
    println!("sum = l2 + matching + fusing; alike = matching when all places change alike");
    let mut matching_ms = Vec::new();
    let only_loop = std::env::args().any(|a| a == "loop");
    for dim in DIMS.into_iter().take(if only_loop { 1 } else { DIMS.len() }) {
        for references in REFERENCES {
            if references * dim > LARGE && !large {
                println!("R = {references}, D = {dim}: left out; set EVPR_BENCH_LARGE=1 to measure it");
                continue;
            }
            let mut case = Case::new(references, dim);
            for threads in [1, 2].into_iter().filter(|t| *t <= cores) {
                match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
                    Ok(pool) => {
                        let best = pool.install(|| case.measure());
                        print_row(references, dim, threads, &best);
                        if threads == 1 && dim == DIMS[0] {
                            matching_ms.push((references, best[2]));
                        }
                    }
                    Err(error) => eprintln!("no pool of {threads} threads: {error}"),
                }
            }
        }
    }
    compare_with_loop(&matching_ms);
}

/// Time per row, ms, where members are matched side by side, as `evpr evaluate` does, on so many threads.
fn side_by_side_ms(references: usize, threads: usize) -> Option<f64> {
    const ROWS: usize = 24;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .ok()?;
    let valid = vec![true; references];
    let row = |n: usize| {
        (0..references)
            .map(|j| f64::from(value(n * references + j)))
            .collect::<Vec<f64>>()
    };
    let rows: Vec<Vec<f64>> = (0..LENGTH).map(row).collect();
    let matcher = || {
        let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, LENGTH, &valid);
        rows.iter().for_each(|row| matcher.push(Some(row)));
        (matcher, vec![0.0; references])
    };
    let mut members: Vec<_> = (0..4 * threads).map(|_| matcher()).collect();
    let mut turn = || {
        ms(|| {
            members.par_iter_mut().for_each(|(matcher, scores)| {
                for n in 0..ROWS {
                    matcher.push(Some(black_box(&rows[n % LENGTH])));
                    matcher.score(black_box(scores));
                }
            });
        })
    };
    let best = pool.install(|| (0..20).map(|_| turn()).fold(f64::INFINITY, f64::min));
    Some(best / (4 * threads * ROWS) as f64)
}

fn print_row(references: usize, dim: usize, threads: usize, best: &[f64; STEPS.len()]) {
    let read = best[0];
    print!("R = {references:>6}, D = {dim}, {threads} threads:");
    for (name, ms) in STEPS.iter().zip(best) {
        print!("  {name} {ms:.3} ({:.2})", ms / read);
    }
    let sum: f64 = best[1..4].iter().sum();
    println!("  sum {sum:.3} ({:.2})", sum / read);
}

/// One member: its map, its history, and what works on them.
struct Case {
    dim: usize,
    rows: Vec<f32>,
    valid: Vec<bool>,
    query: Vec<f32>,
    /// L similarity rows, pushed in turn; as large as the ring, and read in its stead.
    history: Vec<f64>,
    matcher: SequenceMatcher,
    alike: SequenceMatcher,
    ensemble: Ensemble,
}

impl Case {
    fn new(references: usize, dim: usize) -> Self {
        let valid = vec![true; references];
        let history: Vec<f64> = (0..LENGTH * references).map(|i| f64::from(value(i))).collect();
        let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, LENGTH, &valid);
        let mut alike = SequenceMatcher::new(SequenceMethod::Paper, LENGTH, &valid);
        for (t, row) in history.chunks_exact(references).enumerate() {
            matcher.push(Some(row));
            alike.push(Some(&vec![t as f64; references]));
        }
        Self {
            dim,
            rows: (0..references * dim).map(value).collect(),
            valid,
            query: (0..dim).map(|i| value(i * 31 + 5)).collect(),
            history,
            matcher,
            alike,
            ensemble: Ensemble::new(references, 10, 5),
        }
    }

    /// The best time of each step, ms.
    fn measure(&mut self) -> [f64; STEPS.len()] {
        let references = self.valid.len();
        let (mut out, mut scores) = (vec![0.0; references], vec![0.0; references]);
        let mut best = [f64::INFINITY; STEPS.len()];
        let turns = (1_000_000_000 / self.rows.len()).clamp(9, 301);
        for turn in 0..turns {
            let times = [
                ms(|| {
                    black_box(plain_read(black_box(&self.rows), black_box(&self.history)));
                }),
                self.similarity_ms(Similarity::L2, &mut out),
                ms(|| {
                    let at = turn % LENGTH * references;
                    self.matcher.push(Some(&self.history[at..at + references]));
                    self.matcher.score(black_box(&mut scores));
                }),
                ms(|| {
                    black_box(self.ensemble.fuse(std::iter::once(Part {
                        scores: &scores,
                        valid: &self.valid,
                        weight: 1.0,
                    })));
                }),
                self.similarity_ms(Similarity::L2Squared, &mut out),
                self.similarity_ms(Similarity::Cosine, &mut out),
                self.similarity_ms(Similarity::Sad, &mut out),
                ms(|| {
                    self.alike.score(black_box(&mut scores));
                }),
            ];
            for (best, time) in best.iter_mut().zip(times) {
                *best = best.min(time);
            }
        }
        best
    }

    fn similarity_ms(&self, kind: Similarity, out: &mut [f64]) -> f64 {
        debug_assert_eq!(self.rows.len(), out.len() * self.dim);
        ms(|| similarity(kind, black_box(&self.query), &self.rows, &self.valid, out))
    }
}

/// Reads every value once.
fn plain_read(rows: &[f32], ring: &[f64]) -> u64 {
    let rows = rows.par_chunks(1 << 16).map(|block| {
        let mut lanes = [0u32; 32];
        for chunk in block.as_chunks::<32>().0 {
            for (lane, v) in lanes.iter_mut().zip(chunk) {
                *lane = lane.wrapping_add(v.to_bits());
            }
        }
        lanes.iter().fold(0u64, |sum, v| sum.wrapping_add(u64::from(*v)))
    });
    let ring = ring.par_chunks(1 << 15).map(|block| {
        let mut lanes = [0u64; 16];
        for chunk in block.as_chunks::<16>().0 {
            for (lane, v) in lanes.iter_mut().zip(chunk) {
                *lane = lane.wrapping_add(v.to_bits());
            }
        }
        lanes.iter().fold(0u64, |sum, v| sum.wrapping_add(*v))
    });
    rows.chain(ring).reduce(|| 0, u64::wrapping_add)
}

/// Runs the published loop in NumPy, where it can be run, and prints the ratios to the matching on one thread.
fn compare_with_loop(matching_ms: &[(usize, f64)]) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scripts/bench_np_trace.py");
    let (small, length) = (&matching_ms[..matching_ms.len().min(2)], LENGTH.to_string());
    let references: Vec<String> = small.iter().map(|(r, _)| r.to_string()).collect();
    let output = Command::new("python3")
        .args([script, "--length", &length])
        .args(&references)
        .output();
    let text = match output {
        Ok(output) if output.status.success() => String::from_utf8_lossy(&output.stdout).into_owned(),
        Ok(output) => return println!("no loop: {}", String::from_utf8_lossy(&output.stderr).trim()),
        Err(error) => return println!("no loop: python3 cannot be run: {error}"),
    };
    for ((references, ours), line) in small.iter().zip(text.lines()) {
        match line
            .split_whitespace()
            .nth(1)
            .and_then(|ms| ms.parse::<f64>().ok())
        {
            Some(theirs) => {
                println!(
                    "R = {references:>6}: a np.trace per column takes {theirs:.1} ms, matching {ours:.3} ms on one thread: {:.0} times as fast",
                    theirs / ours
                );
                for threads in [1, 2] {
                    if let Some(ours) = side_by_side_ms(*references, threads) {
                        println!(
                            "R = {references:>6}: members side by side, {threads} threads: {ours:.4} ms per row: {:.0} times as fast",
                            theirs / ours
                        );
                    }
                }
            }
            None => println!("no loop: cannot read its line: {line}"),
        }
    }
}

fn ms(run: impl FnOnce()) -> f64 {
    let start = Instant::now();
    run();
    start.elapsed().as_secs_f64() * 1e3
}

/// Noise that is the same every time.
fn value(i: usize) -> f32 {
    let h = (i as u32).wrapping_mul(2_654_435_761);
    let h = (h ^ (h >> 15)).wrapping_mul(2_246_822_519);
    (h >> 8) as f32 / (1 << 23) as f32 - 1.0
}
