//! Sequence matching: from the last L similarity rows of a member to one score per place.
//!
//! Method `paper` (after SeqSLAM, with z-scores on both axes). At query tick q, C is the rows of S of the last
//! N = min(L, q+1) ticks that have one, over the columns that the map has a row for:
//! 1. columns: C ← (C − mean) / (σ + 1e-8), σ the population standard deviation down the column; where
//!    σ + 1e-8 < 1e-4 the column is divided by 1;
//! 2. rows: Z ← (C − mean) / (σ + 1e-8), along the row;
//! 3. S̃\[q, j\] = Σ over the window's ticks t with a row of Z\[t, j − (q − t)\], where that column exists.
//!
//! What is missing (a tick without a row, a column without one) is left out of the statistics and adds 0; nothing
//! shifts and nothing is rescaled. A column without a map row scores 0. L = 1 and method `none` give S itself,
//! columns without a map row the mean of the others.
//!
//! Everything is computed anew from the ring at each tick with two-pass statistics, so nothing drifts. Sums run in
//! the order of NumPy (down a column one after the other, along a row pairwise): over two ticks that changed all
//! places alike, step 2 divides rounding errors by about 1e-8, and only an equal order gives equal scores.

use evpr_core::plan::SequenceMethod;
use ndarray::{Array2, ArrayView2};
use std::ops::Range;

/// Added to standard deviations, as in the authors' code.
const EPSILON: f64 = 1e-8;
/// A column whose standard deviation (plus [`EPSILON`]) lies below this is not scaled.
const FLAT: f64 = 1e-4;
/// Columns treated together at most; also the leaf of the pairwise sum.
const BLOCK: usize = 128;

/// A run of consecutive references that the map has rows for.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// First reference.
    reference: usize,
    /// First column in the ring, which holds valid references only.
    column: usize,
    len: usize,
}

/// Sequence matching of one member, tick by tick.
///
/// Keeps a ring of the last L rows (L × valid references, f64); nothing is allocated after [`SequenceMatcher::new`].
#[derive(Debug)]
pub struct SequenceMatcher {
    /// L, at least 1. Method `none` is L = 1.
    length: usize,
    references: usize,
    columns: usize,
    runs: Vec<Run>,
    blocks: Vec<Range<usize>>,
    /// L rows of `columns` values.
    ring: Vec<f64>,
    /// Per slot of the ring: whether its tick had a row.
    present: Vec<bool>,
    /// Slot of the newest tick.
    newest: usize,
    /// The window's ticks that have a row, oldest first: (slot, lag).
    window: Vec<(usize, usize)>,
    column_mean: Vec<f64>,
    column_scale: Vec<f64>,
    /// Sums of the blocks, one block after the other, a row of the window each.
    block_sums: Vec<f64>,
    row_mean: Vec<f64>,
}

impl SequenceMatcher {
    /// A matcher over as many references as `valid` has entries; false where the map has no row. `length` is L in
    /// ticks; 0 counts as 1, and [`SequenceMethod::None`] has no use for more than 1.
    pub fn new(method: SequenceMethod, length: usize, valid: &[bool]) -> Self {
        let length = match method {
            SequenceMethod::Paper => length.max(1),
            SequenceMethod::None => 1,
        };
        let runs = runs_of(valid);
        let columns = runs.iter().map(|r| r.len).sum();
        let blocks = if length == 1 {
            Vec::new()
        } else {
            pairwise_blocks(columns)
        };
        let scratch = if length == 1 { 0 } else { columns };
        Self {
            length,
            references: valid.len(),
            columns,
            runs,
            ring: vec![0.0; length * columns],
            present: vec![false; length],
            newest: length - 1,
            window: Vec::with_capacity(length),
            column_mean: vec![0.0; scratch],
            column_scale: vec![0.0; scratch],
            block_sums: vec![0.0; length * blocks.len()],
            row_mean: vec![0.0; length],
            blocks,
        }
    }

    /// Takes the next tick: its similarity row (R values; those of references without a map row are not read), or
    /// `None` when the member has none, because it is switched off or for whatever reason.
    ///
    /// # Panics
    /// When the row does not have one value per reference.
    pub fn push(&mut self, row: Option<&[f64]>) {
        let slot = (self.newest + 1) % self.length;
        self.newest = slot;
        self.present[slot] = row.is_some();
        let Some(row) = row else { return };
        assert_eq!(
            row.len(),
            self.references,
            "a similarity row has one value per reference"
        );
        let kept = &mut self.ring[slot * self.columns..(slot + 1) * self.columns];
        for run in &self.runs {
            kept[run.column..run.column + run.len]
                .copy_from_slice(&row[run.reference..run.reference + run.len]);
        }
    }

    /// How many of the last L ticks have a row, the newest included.
    pub fn history(&self) -> usize {
        self.present.iter().filter(|p| **p).count()
    }

    /// L in ticks.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Writes S̃ of the newest tick (R values) and returns true; false, and `out` all NaN, when that tick has no row
    /// or the map has none at all: the member sits it out.
    ///
    /// # Panics
    /// When `out` does not have one value per reference.
    pub fn score(&mut self, out: &mut [f64]) -> bool {
        assert_eq!(out.len(), self.references, "one score per reference");
        if !self.present[self.newest] || self.columns == 0 {
            out.fill(f64::NAN);
            return false;
        }
        if self.length == 1 {
            self.score_alone(out);
        } else {
            self.find_window();
            self.standardise_columns();
            self.score_diagonals(out);
        }
        true
    }

    /// L = 1: S itself, what the map does not have as the mean of the rest.
    fn score_alone(&self, out: &mut [f64]) {
        if self.columns < self.references {
            let sum = pairwise_sum(&self.ring[..self.columns]);
            out.fill(sum / self.columns as f64);
        }
        for run in &self.runs {
            out[run.reference..run.reference + run.len]
                .copy_from_slice(&self.ring[run.column..run.column + run.len]);
        }
    }

    fn find_window(&mut self) {
        self.window.clear();
        for lag in (0..self.length).rev() {
            let slot = (self.newest + self.length - lag) % self.length;
            if self.present[slot] {
                self.window.push((slot, lag));
            }
        }
    }

    /// Step 1: mean and scale of each column, block by block while the block is in the cache, and the means of the
    /// rows of the result.
    fn standardise_columns(&mut self) {
        let (ring, columns, n) = (&self.ring, self.columns, self.window.len());
        let row_of = |slot: usize, block: &Range<usize>| &ring[slot * columns..][block.clone()];
        for (index, block) in self.blocks.iter().enumerate() {
            let mean = &mut self.column_mean[block.clone()];
            let scale = &mut self.column_scale[block.clone()];
            mean.fill(0.0);
            scale.fill(0.0);
            for (slot, _) in &self.window {
                for (m, s) in mean.iter_mut().zip(row_of(*slot, block)) {
                    *m += s;
                }
            }
            mean.iter_mut().for_each(|m| *m /= n as f64);
            for (slot, _) in &self.window {
                for ((v, m), s) in scale.iter_mut().zip(&*mean).zip(row_of(*slot, block)) {
                    *v += (s - m) * (s - m);
                }
            }
            for v in &mut *scale {
                let sigma = (*v / n as f64).sqrt() + EPSILON;
                *v = if sigma < FLAT { 1.0 } else { sigma };
            }
            for (k, (slot, _)) in self.window.iter().enumerate() {
                self.block_sums[index * n + k] = block_sum(row_of(*slot, block), mean, scale, |z| z);
            }
        }
        for (k, mean) in self.row_mean.iter_mut().enumerate().take(n) {
            let sums = &mut self.block_sums.iter().skip(k).step_by(n).copied();
            *mean = pairwise_combine(columns, sums) / columns as f64;
        }
    }

    /// Steps 2 and 3: the standard deviation of each row, and the row added where its lag puts it.
    fn score_diagonals(&mut self, out: &mut [f64]) {
        out.fill(0.0);
        for (k, (slot, lag)) in self.window.iter().enumerate() {
            let row = &self.ring[slot * self.columns..(slot + 1) * self.columns];
            let mean = self.row_mean[k];
            let mut sums = self.blocks.iter().map(|b| {
                let (m, s) = (&self.column_mean[b.clone()], &self.column_scale[b.clone()]);
                block_sum(&row[b.clone()], m, s, |z| (z - mean) * (z - mean))
            });
            let variance = pairwise_combine(self.columns, &mut sums) / self.columns as f64;
            let factor = 1.0 / (variance.sqrt() + EPSILON);
            for run in &self.runs {
                let start = run.reference + lag;
                let end = (start + run.len).min(self.references);
                if start >= end {
                    break;
                }
                let columns = run.column..run.column + (end - start);
                let z = row[columns.clone()]
                    .iter()
                    .zip(&self.column_mean[columns.clone()])
                    .zip(&self.column_scale[columns]);
                for (out, ((x, m), s)) in out[start..end].iter_mut().zip(z) {
                    *out += ((x - m) / s - mean) * factor;
                }
            }
        }
        let mut hole = 0;
        for run in &self.runs {
            out[hole..run.reference].fill(0.0);
            hole = run.reference + run.len;
        }
        out[hole..].fill(0.0);
    }
}

/// Sequence matching of a whole matrix: S (Q×R, similarity of query tick q and reference j) to S̃ (Q×R), everything
/// present. The same code as the running fuser's, fed row by row.
///
/// While N = 1 < L (the first tick) all scores are 0. A `length` of 0 counts as 1. Values should be finite; NaN
/// spreads through the statistics of its window.
pub fn sequence_match(similarity: ArrayView2<'_, f64>, length: usize, method: SequenceMethod) -> Array2<f64> {
    let mut matcher = SequenceMatcher::new(method, length, &vec![true; similarity.ncols()]);
    let mut scores = Array2::zeros(similarity.dim());
    let (mut row, mut out) = (vec![0.0; similarity.ncols()], vec![0.0; similarity.ncols()]);
    if row.is_empty() {
        return scores;
    }
    for (from, mut to) in similarity.rows().into_iter().zip(scores.rows_mut()) {
        row.iter_mut().zip(from).for_each(|(r, s)| *r = *s);
        matcher.push(Some(&row));
        matcher.score(&mut out);
        to.iter_mut().zip(&out).for_each(|(t, s)| *t = *s);
    }
    scores
}

fn runs_of(valid: &[bool]) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    let references = valid.iter().enumerate().filter(|(_, v)| **v);
    for (column, (reference, _)) in references.enumerate() {
        match runs.last_mut() {
            Some(run) if run.reference + run.len == reference => run.len += 1,
            _ => runs.push(Run {
                reference,
                column,
                len: 1,
            }),
        }
    }
    runs
}

/// The leaves of NumPy's pairwise sum of n values.
fn pairwise_blocks(n: usize) -> Vec<Range<usize>> {
    fn split(start: usize, n: usize, blocks: &mut Vec<Range<usize>>) {
        if n <= BLOCK {
            blocks.push(start..start + n);
        } else {
            let half = pairwise_half(n);
            split(start, half, blocks);
            split(start + half, n - half, blocks);
        }
    }
    let mut blocks = Vec::new();
    split(0, n, &mut blocks);
    blocks
}

fn pairwise_half(n: usize) -> usize {
    n / 2 - n / 2 % 8
}

/// Adds up the sums of the leaves of n values, in the order of the tree.
fn pairwise_combine(n: usize, sums: &mut impl Iterator<Item = f64>) -> f64 {
    fn combine(n: usize, sums: &mut dyn Iterator<Item = f64>) -> f64 {
        if n <= BLOCK {
            return sums.next().unwrap_or(0.0);
        }
        let half = pairwise_half(n);
        let left = combine(half, sums);
        left + combine(n - half, sums)
    }
    combine(n, sums)
}

/// NumPy's sum of a contiguous array.
fn pairwise_sum(values: &[f64]) -> f64 {
    if values.len() <= BLOCK {
        let (lanes, rest) = values.as_chunks::<8>();
        let mut sums = [0.0; 8];
        for lane in lanes {
            for k in 0..8 {
                sums[k] += lane[k];
            }
        }
        return add_lanes(sums, rest.iter().copied());
    }
    let (left, right) = values.split_at(pairwise_half(values.len()));
    pairwise_sum(left) + pairwise_sum(right)
}

/// Σ f(z), z = (x − mean)/scale, over one leaf: eight lanes, then the rest one after the other.
#[inline(always)]
fn block_sum(x: &[f64], mean: &[f64], scale: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    let (x_lanes, x_rest) = x.as_chunks::<8>();
    let (m_lanes, m_rest) = mean.as_chunks::<8>();
    let (s_lanes, s_rest) = scale.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for ((x, m), s) in x_lanes.iter().zip(m_lanes).zip(s_lanes) {
        for k in 0..8 {
            sums[k] += f((x[k] - m[k]) / s[k]);
        }
    }
    let rest = x_rest.iter().zip(m_rest).zip(s_rest);
    add_lanes(sums, rest.map(|((x, m), s)| f((x - m) / s)))
}

fn add_lanes(r: [f64; 8], rest: impl Iterator<Item = f64>) -> f64 {
    let sum = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]));
    rest.fold(sum, |sum, v| sum + v)
}
