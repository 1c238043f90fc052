//! Similarity of one query row and the rows of a map; higher is more alike.
//!
//! | kind | S |
//! |---|---|
//! | `l2` | −‖q − r‖₂, the paper's equation |
//! | `l2_squared` | −‖q − r‖₂², the authors' code |
//! | `cosine` | q·r / (max(‖q‖, 1e-12) · max(‖r‖, 1e-12)) |
//! | `sad` | −Σ\|q − r\| |
//!
//! Each map row is read once, two rows at a time in short turns: one row alone leaves the memory idle whenever the
//! processor comes to the end of a page. Differences are summed directly, so that nearly identical rows keep their
//! order; f32 lanes add at most 64 terms each before they go into an f64, and the products of the cosine, which may
//! cancel, are f64. The result is within 1e-5 of the exact one, relatively; where f32 would overflow or lose a tiny
//! sum, the row is computed again in f64.

mod block;

pub use block::{PASS, similarities};

use crate::simd::tiles::LANES;
use crate::simd::{Kernel, run_widest};
use evpr_core::plan::Similarity;
use rayon::prelude::*;

/// Steps of all lanes on one row before the other row has its turn: 256 bytes.
const SPAN: usize = 4;
/// Values summed in f32 lanes before they go into f64: 64 per lane.
const CHUNK: usize = 64 * LANES;
/// Rows that take turns.
const PAIR: usize = 2;
/// From so many map values on, the rows are shared out among threads.
const PARALLEL_VALUES: usize = 1 << 18;
/// Map values per piece of work: 256 KiB.
const BLOCK_VALUES: usize = 1 << 16;
/// Sums of squares outside this range are computed again in f64.
const TRUSTED: std::ops::Range<f64> = 1e-25..1e35;

/// −‖q − r‖₂ for each map row. See [`similarity`].
pub fn l2(query: &[f32], rows: &[f32], valid: &[bool], out: &mut [f64]) {
    each_pair(
        query.len(),
        rows,
        valid,
        out,
        #[inline(always)]
        |pair| distances_squared(query, pair).map(|d| -d.sqrt()),
    );
}

/// −‖q − r‖₂² for each map row. See [`similarity`].
pub fn l2_squared(query: &[f32], rows: &[f32], valid: &[bool], out: &mut [f64]) {
    each_pair(
        query.len(),
        rows,
        valid,
        out,
        #[inline(always)]
        |pair| distances_squared(query, pair).map(|d| -d),
    );
}

/// q·r / (‖q‖ ‖r‖) for each map row; a norm below 1e-12 counts as 1e-12. See [`similarity`].
pub fn cosine(query: &[f32], rows: &[f32], valid: &[bool], out: &mut [f64]) {
    let wide: Vec<f64> = query.iter().map(|q| f64::from(*q)).collect();
    let query_norm = sum_f64(query, query, |q, _| q * q).sqrt().max(1e-12);
    each_pair(
        query.len(),
        rows,
        valid,
        out,
        #[inline(always)]
        |pair| {
            dots_and_squares(&wide, pair).map(|(dot, square)| dot / (query_norm * square.sqrt().max(1e-12)))
        },
    );
}

/// −Σ|q − r| for each map row. See [`similarity`].
pub fn sad(query: &[f32], rows: &[f32], valid: &[bool], out: &mut [f64]) {
    each_pair(
        query.len(),
        rows,
        valid,
        out,
        #[inline(always)]
        |pair| {
            let mut sums = sums_f32(query, pair, |a, b| (a - b).abs());
            for (sum, row) in sums.iter_mut().zip(pair) {
                if !sum.is_finite() {
                    *sum = sum_f64(query, row, |a, b| (a - b).abs());
                }
            }
            sums.map(|sum| -sum)
        },
    );
}

/// One row of S: the query row (D values) against the map's `rows` (R×D, row-major).
///
/// `valid` and `out` have R entries. Where `valid` is false the map has no row: nothing is read there and `out`
/// becomes NaN, which stands for "no similarity" and is left out of everything that follows. With finite rows every
/// other entry is finite.
///
/// Large maps are shared out among the threads of the current rayon pool; the result does not depend on that.
///
/// # Panics
/// When `rows`, `valid` and `out` do not have R·D, R and R entries.
pub fn similarity(kind: Similarity, query: &[f32], rows: &[f32], valid: &[bool], out: &mut [f64]) {
    match kind {
        Similarity::L2 => l2(query, rows, valid, out),
        Similarity::L2Squared => l2_squared(query, rows, valid, out),
        Similarity::Cosine => cosine(query, rows, valid, out),
        Similarity::Sad => sad(query, rows, valid, out),
    }
}

/// Scores the valid rows two by two, in the order they lie in.
fn each_pair<F: Fn([&[f32]; PAIR]) -> [f64; PAIR] + Sync>(
    dim: usize,
    rows: &[f32],
    valid: &[bool],
    out: &mut [f64],
    scores: F,
) {
    assert_eq!(rows.len(), out.len() * dim, "rows must be R×D");
    assert_eq!(valid.len(), out.len(), "valid must have R entries");
    let dim = dim.max(1);
    let score = |((out, valid), rows)| {
        run_widest(Pairs {
            dim,
            rows,
            valid,
            out,
            scores: &scores,
        });
    };
    if rows.len() < PARALLEL_VALUES {
        return score(((out, valid), rows));
    }
    let block = (BLOCK_VALUES / dim).next_multiple_of(PAIR).max(PAIR);
    out.par_chunks_mut(block)
        .zip(valid.par_chunks(block))
        .zip(rows.par_chunks(block * dim))
        .for_each(score);
}

/// Rows under way.
struct Pairs<'a, F> {
    dim: usize,
    rows: &'a [f32],
    valid: &'a [bool],
    out: &'a mut [f64],
    scores: &'a F,
}

impl<F: Fn([&[f32]; PAIR]) -> [f64; PAIR]> Kernel for Pairs<'_, F> {
    #[inline(always)]
    fn run(self) {
        let mut waiting: Option<(&mut f64, &[f32])> = None;
        let rows = self.rows.chunks_exact(self.dim);
        for ((out, valid), row) in self.out.iter_mut().zip(self.valid).zip(rows) {
            if !valid {
                *out = f64::NAN;
            } else if let Some((first_out, first)) = waiting.take() {
                [*first_out, *out] = (self.scores)([first, row]);
            } else {
                waiting = Some((out, row));
            }
        }
        if let Some((out, row)) = waiting {
            [*out, _] = (self.scores)([row, row]);
        }
    }
}

/// Σ(q − r)² of each row.
#[inline(always)]
fn distances_squared(query: &[f32], pair: [&[f32]; PAIR]) -> [f64; PAIR] {
    let mut sums = sums_f32(query, pair, |a, b| (a - b) * (a - b));
    for (sum, row) in sums.iter_mut().zip(pair) {
        if !TRUSTED.contains(sum) {
            *sum = sum_f64(query, row, |a, b| (a - b) * (a - b));
        }
    }
    sums
}

/// Σ f(q, r) of each row, in f32 lanes; the lanes of each chunk are added up in f64. A row's sum does not depend on
/// the other row.
#[inline(always)]
fn sums_f32(query: &[f32], pair: [&[f32]; PAIR], f: impl Fn(f32, f32) -> f32) -> [f64; PAIR] {
    let mut totals = [0.0; PAIR];
    for (start, chunk) in (0..).step_by(CHUNK).zip(query.chunks(CHUNK)) {
        let (q_lanes, q_rest) = chunk.as_chunks::<LANES>();
        let rows = pair.map(|row| row[start..start + chunk.len()].as_chunks::<LANES>());
        let mut lanes = [[0.0f32; LANES]; PAIR];
        for (at, q_span) in (0..).step_by(SPAN).zip(q_lanes.chunks(SPAN)) {
            for (lanes, (r_lanes, _)) in lanes.iter_mut().zip(rows) {
                let mut sums = *lanes;
                for (q, r) in q_span.iter().zip(&r_lanes[at..at + q_span.len()]) {
                    for k in 0..LANES {
                        sums[k] += f(q[k], r[k]);
                    }
                }
                *lanes = sums;
            }
        }
        for ((total, lanes), (_, r_rest)) in totals.iter_mut().zip(lanes).zip(rows) {
            *total += lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
            let rest = q_rest.iter().zip(r_rest);
            *total += rest.map(|(q, r)| f64::from(f(*q, *r))).sum::<f64>();
        }
    }
    totals
}

/// Σ f(q, r) in f64: the slow and safe way.
#[cold]
fn sum_f64(query: &[f32], row: &[f32], f: impl Fn(f64, f64) -> f64) -> f64 {
    query
        .iter()
        .zip(row)
        .map(|(q, r)| f(f64::from(*q), f64::from(*r)))
        .sum()
}

/// (Σ q·r, Σ r²) of each row, the query widened beforehand. The products of the first sum are f64: f32 would lose a
/// small cosine. The second has no terms to cancel and is summed as in [`sums_f32`].
#[inline(always)]
fn dots_and_squares(query: &[f64], pair: [&[f32]; PAIR]) -> [(f64, f64); PAIR] {
    let mut totals = [(0.0, 0.0); PAIR];
    for (start, chunk) in (0..).step_by(CHUNK).zip(query.chunks(CHUNK)) {
        let (q_lanes, q_rest) = chunk.as_chunks::<LANES>();
        let rows = pair.map(|row| row[start..start + chunk.len()].as_chunks::<LANES>());
        let mut dots = [[0.0f64; LANES / 2]; PAIR];
        let mut squares = [[0.0f32; LANES]; PAIR];
        for (at, q_span) in (0..).step_by(SPAN).zip(q_lanes.chunks(SPAN)) {
            for ((dots, squares), (r_lanes, _)) in dots.iter_mut().zip(&mut squares).zip(rows) {
                let r_span = &r_lanes[at..at + q_span.len()];
                add_dots(dots, q_span, r_span);
                add_squares(squares, r_span);
            }
        }
        let lanes = dots.iter().zip(&squares).zip(rows);
        for ((dot, square), ((dots, squares), (_, r_rest))) in
            totals.iter_mut().map(|(d, s)| (d, s)).zip(lanes)
        {
            *dot += dots.iter().sum::<f64>();
            *square += squares.iter().map(|v| f64::from(*v)).sum::<f64>();
            for (q, r) in q_rest.iter().zip(r_rest) {
                *dot += q * f64::from(*r);
                *square += f64::from(r * r);
            }
        }
    }
    for ((_, square), row) in totals.iter_mut().zip(pair) {
        if !TRUSTED.contains(square) {
            *square = sum_f64(row, row, |r, _| r * r);
        }
    }
    totals
}

#[inline(always)]
fn add_dots(lanes: &mut [f64; LANES / 2], query: &[[f64; LANES]], row: &[[f32; LANES]]) {
    let mut sums = *lanes;
    for (q, r) in query
        .as_flattened()
        .as_chunks()
        .0
        .iter()
        .zip(row.as_flattened().as_chunks().0)
    {
        let (q, r): (&[f64; LANES / 2], &[f32; LANES / 2]) = (q, r);
        for k in 0..LANES / 2 {
            sums[k] += q[k] * f64::from(r[k]);
        }
    }
    *lanes = sums;
}

#[inline(always)]
fn add_squares(lanes: &mut [f32; LANES], row: &[[f32; LANES]]) {
    let mut sums = *lanes;
    for r in row {
        for k in 0..LANES {
            sums[k] += r[k] * r[k];
        }
    }
    *lanes = sums;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KINDS: [Similarity; 4] = [
        Similarity::L2,
        Similarity::L2Squared,
        Similarity::Cosine,
        Similarity::Sad,
    ];

    fn exact(kind: Similarity, q: &[f32], r: &[f32]) -> f64 {
        let (q, r): (Vec<f64>, Vec<f64>) = (
            q.iter().map(|v| f64::from(*v)).collect(),
            r.iter().map(|v| f64::from(*v)).collect(),
        );
        let sum = |f: fn(f64, f64) -> f64| q.iter().zip(&r).map(|(a, b)| f(*a, *b)).sum::<f64>();
        let norm = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
        match kind {
            Similarity::L2 => -sum(|a, b| (a - b) * (a - b)).sqrt(),
            Similarity::L2Squared => -sum(|a, b| (a - b) * (a - b)),
            Similarity::Cosine => sum(|a, b| a * b) / (norm(&q) * norm(&r)),
            Similarity::Sad => -sum(|a, b| (a - b).abs()),
        }
    }

    fn one(kind: Similarity, q: &[f32], r: &[f32]) -> f64 {
        let mut out = [0.0];
        similarity(kind, q, r, &[true], &mut out);
        out[0]
    }

    #[test]
    fn worked_by_hand() {
        let (q, r) = ([3.0, 0.0], [0.0, 4.0]);
        assert_eq!(KINDS.map(|k| one(k, &q, &r)), [-5.0, -25.0, 0.0, -7.0]);
        assert_eq!(KINDS.map(|k| one(k, &q, &q)), [0.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn rows_of_zeros_have_a_cosine_of_zero() {
        assert_eq!(one(Similarity::Cosine, &[0.0, 0.0], &[1.0, 2.0]), 0.0);
        assert_eq!(one(Similarity::Cosine, &[0.0, 0.0], &[0.0, 0.0]), 0.0);
    }

    #[test]
    fn invalid_references_become_nan_and_are_not_read() {
        let rows = [0.0, 0.0, f32::NAN, f32::NAN, 3.0, 4.0];
        for kind in KINDS {
            let mut out = [7.0; 3];
            similarity(kind, &[0.0, 1.0], &rows, &[true, false, true], &mut out);
            assert!(
                out[0].is_finite() && out[1].is_nan() && out[2].is_finite(),
                "{kind:?}: {out:?}"
            );
        }
    }

    #[test]
    fn huge_and_tiny_values_keep_their_precision() {
        for scale in [1e-30f32, 1e-15, 1e15, 1e30] {
            let q: Vec<f32> = (0..100).map(|i| (i as f32 * 0.37).sin() * scale).collect();
            let r: Vec<f32> = (0..100).map(|i| (i as f32 * 0.11).cos() * scale).collect();
            for kind in [Similarity::L2, Similarity::L2Squared, Similarity::Sad] {
                let (got, want) = (one(kind, &q, &r), exact(kind, &q, &r));
                assert!(
                    (got - want).abs() <= 1e-5 * want.abs(),
                    "{kind:?} at {scale}: {got} {want}"
                );
            }
        }
    }

    #[test]
    fn threads_change_nothing() {
        let dim = 64;
        let references = PARALLEL_VALUES / dim + 37;
        let value = |i: usize| ((i as f32) * 0.618).fract();
        let rows: Vec<f32> = (0..references * dim).map(value).collect();
        let query: Vec<f32> = (0..dim).map(|i| value(i * 7 + 3)).collect();
        let valid: Vec<bool> = (0..references).map(|j| j % 5 != 3).collect();
        for kind in KINDS {
            let mut out = vec![0.0; references];
            similarity(kind, &query, &rows, &valid, &mut out);
            for (j, row) in rows.chunks_exact(dim).enumerate() {
                if valid[j] {
                    assert_eq!(out[j], one(kind, &query, row), "{kind:?} {j}");
                } else {
                    assert!(out[j].is_nan());
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn the_width_of_the_vectors_changes_nothing(
            dim in 1usize..1500, references in 1usize..8, holes in any::<u8>(), seed in 0usize..1000,
        ) {
            let value = |i: usize| ((i + seed) as f32 * 0.618).fract() - 0.4;
            let rows: Vec<f32> = (0..references * dim).map(value).collect();
            let query: Vec<f32> = (0..dim).map(|i| value(i * 7 + 3)).collect();
            let valid: Vec<bool> = (0..references).map(|j| holes >> j & 1 == 0).collect();
            for kind in KINDS {
                let score = || {
                    let mut out = vec![0.0; references];
                    similarity(kind, &query, &rows, &valid, &mut out);
                    out.iter().map(|s| s.to_bits()).collect::<Vec<_>>()
                };
                prop_assert_eq!(score(), crate::simd::tests::with_baseline(score), "{:?}", kind);
            }
        }

        #[test]
        fn within_1e_5_of_exact_also_for_nearly_identical_rows(
            dim in 1usize..3000, seed in any::<u32>(), step in prop::sample::select(vec![1.0f32, 1e-3, 1e-6]),
        ) {
            let noise = |i: usize, k: u32| {
                let h = (i as u32).wrapping_add(k).wrapping_mul(2654435761).wrapping_add(seed).wrapping_mul(2246822519);
                (h >> 8) as f32 / (1 << 23) as f32 - 1.0
            };
            let q: Vec<f32> = (0..dim).map(|i| noise(i, 1)).collect();
            let r: Vec<f32> = q.iter().enumerate().map(|(i, v)| v + step * noise(i, 77)).collect();
            for kind in KINDS {
                let (got, want) = (one(kind, &q, &r), exact(kind, &q, &r));
                prop_assert!((got - want).abs() <= 1e-5 * want.abs(), "{:?}: {} {}", kind, got, want);
            }
        }
    }
}
