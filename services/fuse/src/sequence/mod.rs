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
//! Everything is computed anew from the ring at each tick, so nothing drifts. The ring is read twice: once for the
//! statistics of columns and rows (`columns`), once for the sum (`diagonals`). Large maps are shared out among the
//! threads of the current rayon pool, in pieces that do not depend on their number: neither do the scores. Where the
//! places of a tick all changed nearly alike, step 2 magnifies rounding errors, and only sums in NumPy's own order
//! give NumPy's scores: then the rows are computed again in that order (`numpy_order`).

mod columns;
mod diagonals;
mod numpy_order;
mod runs;

use columns::Columns;
use evpr_core::plan::SequenceMethod;
use ndarray::{Array2, ArrayView2};
use runs::Runs;

/// Added to standard deviations, as in the authors' code.
const EPSILON: f64 = 1e-8;
/// From so many values in the window on, work is shared out among threads.
const PARALLEL_VALUES: usize = 1 << 14;

/// The rows of a window, oldest first, over the columns that the map has a row for.
#[derive(Debug, Clone, Copy)]
struct Window<'a> {
    /// L rows of `columns` values.
    ring: &'a [f64],
    columns: usize,
    /// The ticks that have a row: slot in the ring, and lag behind the newest tick.
    ticks: &'a [(usize, usize)],
}

impl<'a> Window<'a> {
    /// N.
    #[inline(always)]
    fn len(&self) -> usize {
        self.ticks.len()
    }

    /// The rows, oldest first.
    #[inline(always)]
    fn rows(self) -> impl Iterator<Item = &'a [f64]> {
        let row = move |(slot, _): &(usize, usize)| &self.ring[slot * self.columns..][..self.columns];
        self.ticks.iter().map(row)
    }

    /// Whether sharing out the work gains more than it costs.
    fn is_large(&self) -> bool {
        self.columns * self.len() >= PARALLEL_VALUES
    }
}

/// What step 2 does to a row: z ↦ (z − mean) · factor.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct RowScale {
    mean: f64,
    /// 1 / (σ + 1e-8).
    factor: f64,
}

impl RowScale {
    fn new(mean: f64, variance: f64) -> Self {
        let factor = 1.0 / (variance.sqrt() + EPSILON);
        Self { mean, factor }
    }
}

/// Sequence matching of one member, tick by tick.
///
/// Keeps a ring of the last L rows (L × valid references, f64); nothing is allocated after [`SequenceMatcher::new`].
#[derive(Debug)]
pub struct SequenceMatcher {
    /// L, at least 1. Method `none` is L = 1.
    length: usize,
    references: usize,
    runs: Runs,
    /// L rows of the columns in `runs`.
    ring: Vec<f64>,
    /// Per slot of the ring: whether its tick had a row.
    present: Vec<bool>,
    /// Slot of the newest tick.
    newest: usize,
    /// The window's ticks that have a row, oldest first: (slot, lag).
    ticks: Vec<(usize, usize)>,
    columns: Columns,
    row_scales: Vec<RowScale>,
}

impl SequenceMatcher {
    /// A matcher over as many references as `valid` has entries; false where the map has no row. `length` is L in
    /// ticks; 0 counts as 1, and [`SequenceMethod::None`] has no use for more than 1.
    pub fn new(method: SequenceMethod, length: usize, valid: &[bool]) -> Self {
        let length = match method {
            SequenceMethod::Paper => length.max(1),
            SequenceMethod::None => 1,
        };
        let runs = Runs::new(valid);
        let columns = runs.columns();
        let scratch = if length == 1 { 0 } else { columns };
        Self {
            length,
            references: valid.len(),
            ring: vec![0.0; length * columns],
            present: vec![false; length],
            newest: length - 1,
            ticks: Vec::with_capacity(length),
            columns: Columns::new(scratch, length),
            row_scales: vec![RowScale::default(); length],
            runs,
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
        let columns = self.runs.columns();
        let kept = &mut self.ring[slot * columns..(slot + 1) * columns];
        for run in self.runs.iter() {
            kept[run.columns()].copy_from_slice(&row[run.references()]);
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
        if !self.present[self.newest] || self.runs.columns() == 0 {
            out.fill(f64::NAN);
            return false;
        }
        if self.length == 1 {
            self.score_alone(out);
        } else {
            self.find_ticks();
            self.score_window(out);
        }
        true
    }

    /// L = 1: S itself, what the map does not have as the mean of the rest.
    fn score_alone(&self, out: &mut [f64]) {
        if self.runs.columns() < self.references {
            out.fill(numpy_order::sum(&self.ring) / self.runs.columns() as f64);
        }
        for run in self.runs.iter() {
            out[run.references()].copy_from_slice(&self.ring[run.columns()]);
        }
    }

    fn find_ticks(&mut self) {
        self.ticks.clear();
        for lag in (0..self.length).rev() {
            let slot = (self.newest + self.length - lag) % self.length;
            if self.present[slot] {
                self.ticks.push((slot, lag));
            }
        }
    }

    fn score_window(&mut self, out: &mut [f64]) {
        let window = Window {
            ring: &self.ring,
            columns: self.runs.columns(),
            ticks: &self.ticks,
        };
        let scales = &mut self.row_scales[..window.len()];
        self.columns.measure(window);
        if self.columns.row_scales(window, scales) {
            diagonals::add(window, &self.runs, self.columns.by_product(), scales, out);
        } else {
            let z = self.columns.by_quotient();
            numpy_order::row_scales(window, z, scales);
            diagonals::add(window, &self.runs, z, scales, out);
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::tests::with_baseline;
    use proptest::prelude::*;

    /// A matcher that was shown `ticks` rows: noise, and per tick a step that all places take.
    fn matcher(references: usize, ticks: usize, step: f64) -> SequenceMatcher {
        let valid: Vec<bool> = (0..references).map(|j| j % 7 != 5).collect();
        let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, ticks, &valid);
        let noise = |i: usize| ((i * 7919 + 17) as f64).sin() * 43_758.545_3 % 1.0;
        for t in 0..ticks {
            let row: Vec<f64> = (0..references)
                .map(|j| noise(t * references + j) + step * (t * t % 5) as f64)
                .collect();
            matcher.push(Some(&row));
        }
        matcher
    }

    fn scores(matcher: &mut SequenceMatcher) -> Vec<f64> {
        let mut out = vec![0.0; matcher.references];
        assert!(matcher.score(&mut out));
        out
    }

    /// The same with NumPy's sums, whatever the moments say.
    fn scores_in_numpy_order(matcher: &mut SequenceMatcher) -> Vec<f64> {
        scores(matcher);
        let window = Window {
            ring: &matcher.ring,
            columns: matcher.runs.columns(),
            ticks: &matcher.ticks,
        };
        let mut scales = vec![RowScale::default(); window.len()];
        let mut out = vec![0.0; matcher.references];
        numpy_order::row_scales(window, matcher.columns.by_quotient(), &mut scales);
        diagonals::add(
            window,
            &matcher.runs,
            matcher.columns.by_quotient(),
            &scales,
            &mut out,
        );
        out
    }

    fn moments_can_tell(matcher: &mut SequenceMatcher) -> bool {
        scores(matcher);
        let window = Window {
            ring: &matcher.ring,
            columns: matcher.runs.columns(),
            ticks: &matcher.ticks,
        };
        let mut scales = vec![RowScale::default(); window.len()];
        matcher.columns.row_scales(window, &mut scales)
    }

    #[test]
    fn numpy_order_is_for_places_that_change_alike() {
        for (step, can_tell) in [(0.0, true), (1.0, true), (5.0, true), (1e4, false), (1e9, false)] {
            let mut matcher = matcher(3000, 10, step);
            assert_eq!(moments_can_tell(&mut matcher), can_tell, "step {step}");
            if !can_tell {
                assert_eq!(scores(&mut matcher), scores_in_numpy_order(&mut matcher));
            }
        }
    }

    #[test]
    fn a_single_tick_needs_no_numpy_order() {
        let mut first = SequenceMatcher::new(SequenceMethod::Paper, 4, &[true; 300]);
        first.push(Some(&vec![0.7; 300]));
        assert!(moments_can_tell(&mut first));
        assert!(scores(&mut first).iter().all(|s| *s == 0.0));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn both_orders_agree_where_moments_can_tell(
            references in 2usize..2000, ticks in 2usize..12, step in 0.0f64..30.0,
        ) {
            let mut matcher = matcher(references, ticks, step);
            prop_assume!(moments_can_tell(&mut matcher));
            let (got, want) = (scores(&mut matcher), scores_in_numpy_order(&mut matcher));
            for (g, w) in got.iter().zip(&want) {
                prop_assert!((g - w).abs() <= 1e-10 * w.abs().max(1.0), "{} {}", g, w);
            }
        }

        #[test]
        fn the_width_of_the_vectors_changes_nothing(references in 1usize..1000, ticks in 1usize..12) {
            prop_assume!(references * ticks < PARALLEL_VALUES);
            let mut matcher = matcher(references, ticks, 0.3);
            let wide = scores(&mut matcher);
            prop_assert_eq!(wide, with_baseline(|| scores(&mut matcher)));
        }
    }
}
