//! Step 3 of the matching: the sum along the diagonals, the rows standardised on the way.

use super::columns::Standardise;
use super::runs::Runs;
use super::{RowScale, Window};
use crate::simd::{Kernel, run_widest};
use rayon::prelude::*;
use std::ops::Range;

/// References per block: what is read more than once stays in the fastest cache.
const BLOCK: usize = 512;

/// Writes S̃ of every reference: Σ over the window's ticks, oldest first, of (z − mean)·factor of the row, taken as
/// many references before as the tick lies back. 0 where the map has no row.
pub(super) fn add<F: Fn(f64, f64) -> f64 + Copy + Sync>(
    window: Window<'_>,
    runs: &Runs,
    z: Standardise<'_, F>,
    scales: &[RowScale],
    out: &mut [f64],
) {
    let least = if window.is_large() { 1 } else { usize::MAX };
    let blocks = out.par_chunks_mut(BLOCK).enumerate().with_min_len(least);
    blocks.for_each(|(index, out)| {
        run_widest(Block {
            window,
            runs,
            z,
            scales,
            start: index * BLOCK,
            out,
        });
    });
}

/// A block of references under way.
struct Block<'a, F> {
    window: Window<'a>,
    runs: &'a Runs,
    z: Standardise<'a, F>,
    scales: &'a [RowScale],
    /// First reference.
    start: usize,
    out: &'a mut [f64],
}

impl<F: Fn(f64, f64) -> f64 + Copy> Kernel for Block<'_, F> {
    #[inline(always)]
    fn run(self) {
        let (start, end) = (self.start, self.start + self.out.len());
        self.out.fill(0.0);
        let rows = self.window.rows().zip(self.window.ticks).zip(self.scales);
        for ((row, (_, lag)), scale) in rows {
            for run in self
                .runs
                .within(start.saturating_sub(*lag)..end.saturating_sub(*lag))
            {
                let to = run.references().start + lag - start..run.references().end + lag - start;
                add_row(&mut self.out[to], row, run.columns(), self.z, *scale);
            }
        }
        let mut hole = start;
        for run in self.runs.within(start..end) {
            self.out[hole - start..run.references().start - start].fill(0.0);
            hole = run.references().end;
        }
        self.out[hole - start..].fill(0.0);
    }
}

/// out += (z − mean)·factor over these columns of a row.
#[inline(always)]
fn add_row<F: Fn(f64, f64) -> f64>(
    out: &mut [f64],
    row: &[f64],
    columns: Range<usize>,
    z: Standardise<'_, F>,
    scale: RowScale,
) {
    let z_of = row[columns.clone()]
        .iter()
        .zip(&z.mean[columns.clone()])
        .zip(&z.by[columns]);
    for (out, ((x, mean), by)) in out.iter_mut().zip(z_of) {
        *out += ((z.op)(x - mean, *by) - scale.mean) * scale.factor;
    }
}
