//! Method `paper`: both axes standardised, then the sum along the diagonals.
//!
//! At query tick q, C is the rows of S of the last N = min(L, q+1) ticks that have one, over the columns that the map
//! has a row for:
//! 1. columns: C ← (C − mean) / (σ + 1e-8), σ the population standard deviation down the column; where
//!    σ + 1e-8 < 1e-4 the column is divided by 1;
//! 2. rows: Z ← (C − mean) / (σ + 1e-8), along the row;
//! 3. S̃\[q, j\] = Σ over the window's ticks t with a row of Z\[t, j − (q − t)\], where that column exists.
//!
//! The ring is read twice: once for the statistics of columns and rows (`columns`), once for the sum (`diagonals`).
//! Where the places of a tick all changed nearly alike, step 2 magnifies rounding errors, and only sums in NumPy's own
//! order give NumPy's scores: then the rows are computed again in that order (`numpy_order`).

use super::columns::{Columns, Standardise};
use super::runs::Runs;
use super::{EPSILON, Window, diagonals, numpy_order};
use std::ops::Range;

/// What step 2 does to a row: z ↦ (z − mean) · factor.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct RowScale {
    mean: f64,
    /// 1 / (σ + 1e-8).
    factor: f64,
}

impl RowScale {
    pub(super) fn new(mean: f64, variance: f64) -> Self {
        let factor = 1.0 / (variance.sqrt() + EPSILON);
        Self { mean, factor }
    }
}

/// Steps 1 to 3, with their memory.
#[derive(Debug)]
pub(super) struct Paper {
    columns: Columns,
    row_scales: Vec<RowScale>,
}

impl Paper {
    /// Memory for so many columns and a window of up to `length` ticks.
    pub(super) fn new(columns: usize, length: usize) -> Self {
        Self {
            columns: Columns::new(columns, length),
            row_scales: vec![RowScale::default(); length],
        }
    }

    /// Writes S̃ of the window's newest tick.
    pub(super) fn score(&mut self, window: Window<'_>, runs: &Runs, out: &mut [f64]) {
        let scales = &mut self.row_scales[..window.len()];
        self.columns.measure(window);
        if self.columns.row_scales(window, scales) {
            let z = self.columns.by_product();
            diagonals::add(window, runs, Scaled { z, scales }, out);
        } else {
            let z = self.columns.by_quotient();
            numpy_order::row_scales(window, z, scales);
            diagonals::add(window, runs, Scaled { z, scales }, out);
        }
    }
}

/// The terms of step 3: the rows standardised on the way.
#[derive(Debug, Clone, Copy)]
struct Scaled<'a, F> {
    z: Standardise<'a, F>,
    /// Per tick of the window.
    scales: &'a [RowScale],
}

impl<F: Fn(f64, f64) -> f64 + Copy + Sync> diagonals::Terms for Scaled<'_, F> {
    #[inline(always)]
    fn add(&self, out: &mut [f64], tick: usize, row: &[f64], columns: Range<usize>) {
        let scale = self.scales[tick];
        let z_of = row[columns.clone()]
            .iter()
            .zip(&self.z.mean[columns.clone()])
            .zip(&self.z.by[columns]);
        for (out, ((x, mean), by)) in out.iter_mut().zip(z_of) {
            *out += ((self.z.op)(x - mean, *by) - scale.mean) * scale.factor;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{PARALLEL_VALUES, SequenceMatcher};
    use super::*;
    use crate::simd::tests::with_baseline;
    use evpr_core::plan::SequenceMethod;
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

    /// The paper's part of a matcher and its window.
    fn parts(matcher: &SequenceMatcher) -> (&Paper, Window<'_>) {
        match matcher.paper_parts() {
            Some(parts) => parts,
            None => panic!("its method is paper"),
        }
    }

    /// The same with NumPy's sums, whatever the moments say.
    fn scores_in_numpy_order(matcher: &mut SequenceMatcher) -> Vec<f64> {
        scores(matcher);
        let (paper, window) = parts(matcher);
        let mut scales = vec![RowScale::default(); window.len()];
        let mut out = vec![0.0; matcher.references];
        let z = paper.columns.by_quotient();
        numpy_order::row_scales(window, z, &mut scales);
        let terms = Scaled { z, scales: &scales };
        diagonals::add(window, &matcher.runs, terms, &mut out);
        out
    }

    fn moments_can_tell(matcher: &mut SequenceMatcher) -> bool {
        scores(matcher);
        let (paper, window) = parts(matcher);
        let mut scales = vec![RowScale::default(); window.len()];
        paper.columns.row_scales(window, &mut scales)
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
