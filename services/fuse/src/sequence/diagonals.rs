//! The sum along the diagonals of a window.

use super::Window;
use super::runs::Runs;
use crate::simd::{Kernel, run_widest};
use rayon::prelude::*;
use std::ops::Range;

/// References per block: what is read more than once stays in the fastest cache.
pub(super) const BLOCK: usize = 512;

/// What is summed up: the rows of the window, with something done to them on the way.
pub(super) trait Terms: Copy + Sync {
    /// `out` += the terms of these columns of `row`, the row of the window's `tick`-th tick. To be inlined.
    fn add(&self, out: &mut [f64], tick: usize, row: &[f64], columns: Range<usize>);
}

/// Writes S̃ of every reference: Σ over the window's ticks, oldest first, of the terms of the row, taken as many
/// references before as the tick lies back. 0 where the map has no row.
pub(super) fn add(window: Window<'_>, runs: &Runs, terms: impl Terms, out: &mut [f64]) {
    let least = if window.is_large() { 1 } else { usize::MAX };
    let blocks = out.par_chunks_mut(BLOCK).enumerate().with_min_len(least);
    blocks.for_each(|(index, out)| {
        run_widest(Block {
            window,
            runs,
            terms,
            start: index * BLOCK,
            out,
        });
    });
}

/// A block of references under way.
struct Block<'a, T> {
    window: Window<'a>,
    runs: &'a Runs,
    terms: T,
    /// First reference.
    start: usize,
    out: &'a mut [f64],
}

impl<T: Terms> Kernel for Block<'_, T> {
    #[inline(always)]
    fn run(self) {
        let (start, end) = (self.start, self.start + self.out.len());
        self.out.fill(0.0);
        let rows = self.window.rows().zip(self.window.ticks).enumerate();
        for (tick, (row, (_, lag))) in rows {
            for run in self
                .runs
                .within(start.saturating_sub(*lag)..end.saturating_sub(*lag))
            {
                let to = run.references().start + lag - start..run.references().end + lag - start;
                self.terms.add(&mut self.out[to], tick, row, run.columns());
            }
        }
        for hole in self.runs.holes_within(start..end) {
            self.out[hole.start - start..hole.end - start].fill(0.0);
        }
    }
}
