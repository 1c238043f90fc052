//! Steps 1 and 2 of the matching, as far as statistics go: mean and scale of each column, then of each row of what
//! comes out.
//!
//! A block of columns is read from the ring once and stays in the cache for three passes: means, variances, and the
//! sums of z and z² of each row. Blocks are independent; the rows' sums are added up in the order of the blocks.

use super::paper::RowScale;
use super::{EPSILON, Window};
use crate::simd::{Kernel, run_widest};
use rayon::prelude::*;
use std::ops::Range;

/// A column whose standard deviation (plus 1e-8) lies below this is not scaled.
const FLAT: f64 = 1e-4;
/// Columns per block: with L = 30 the block takes 30 KiB.
const BLOCK: usize = 128;
/// Columns whose sums are taken together.
const TILE: usize = 16;
/// Sums under way at a time: one alone would wait for each addition to end before the next.
const LANES: usize = 16;
/// Largest |mean|/σ of a row at which its variance may be taken from the sums of z and z²: 4 of 16 digits are lost
/// then, and the scores keep 1e-11.
const STEEPEST: f64 = 100.0;

/// z = op(x − mean, by), column by column.
#[derive(Debug, Clone, Copy)]
pub(super) struct Standardise<'a, F> {
    pub(super) mean: &'a [f64],
    pub(super) by: &'a [f64],
    pub(super) op: F,
}

/// Σz and Σz² of a row, or a part of it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Moments {
    sum: f64,
    squares: f64,
}

/// Statistics of the columns of a window.
#[derive(Debug)]
pub(super) struct Columns {
    mean: Vec<f64>,
    /// σ + 1e-8, or 1 where that is less than [`FLAT`].
    scale: Vec<f64>,
    /// 1 / scale.
    inverse: Vec<f64>,
    /// Block by block, one entry per tick of the window.
    moments: Vec<Moments>,
}

impl Columns {
    /// Memory for so many columns and a window of up to `length` ticks.
    pub(super) fn new(columns: usize, length: usize) -> Self {
        Self {
            mean: vec![0.0; columns],
            scale: vec![0.0; columns],
            inverse: vec![0.0; columns],
            moments: vec![Moments::default(); columns.div_ceil(BLOCK) * length],
        }
    }

    /// z as a quotient, as NumPy computes it.
    pub(super) fn by_quotient(&self) -> Standardise<'_, impl Fn(f64, f64) -> f64 + Copy + Sync> {
        Standardise {
            mean: &self.mean,
            by: &self.scale,
            op: |difference, scale| difference / scale,
        }
    }

    /// z as a product with the inverse scale: several times as fast as the quotient, and at most two roundings of
    /// the last digit away from it.
    pub(super) fn by_product(&self) -> Standardise<'_, impl Fn(f64, f64) -> f64 + Copy + Sync> {
        Standardise {
            mean: &self.mean,
            by: &self.inverse,
            op: |difference, inverse| difference * inverse,
        }
    }

    /// Takes the statistics of the window.
    pub(super) fn measure(&mut self, window: Window<'_>) {
        let n = window.len();
        let blocks = self
            .mean
            .par_chunks_mut(BLOCK)
            .zip(self.scale.par_chunks_mut(BLOCK))
            .zip(self.inverse.par_chunks_mut(BLOCK))
            .zip(self.moments.par_chunks_mut(n))
            .enumerate();
        let most = if window.is_large() { 4 } else { usize::MAX };
        blocks
            .with_min_len(most)
            .for_each(|(index, (((mean, scale), inverse), moments))| {
                let start = index * BLOCK;
                run_widest(Block {
                    window,
                    columns: start..start + mean.len(),
                    mean,
                    scale,
                    inverse,
                    moments,
                });
            });
    }

    /// Mean and scale of each row of the window that was measured last; false where the places of a row changed too
    /// much alike for its moments to tell.
    pub(super) fn row_scales(&self, window: Window<'_>, scales: &mut [RowScale]) -> bool {
        let (n, columns) = (window.len(), window.columns);
        let moments = &self.moments[..columns.div_ceil(BLOCK) * n];
        for (k, scale) in scales.iter_mut().enumerate() {
            let blocks = || moments.iter().skip(k).step_by(n);
            let mean = blocks().map(|b| b.sum).sum::<f64>() / columns as f64;
            // Σ(z − mean)² block by block, so that rounding errors do not grow with the map.
            let mut squares = 0.0;
            for (start, block) in (0..columns).step_by(BLOCK).zip(blocks()) {
                let width = BLOCK.min(columns - start) as f64;
                squares += block.squares - mean * (2.0 * block.sum - width * mean);
            }
            let variance = squares / columns as f64;
            if variance.is_nan() || mean * mean > STEEPEST * STEEPEST * variance {
                return false;
            }
            *scale = RowScale::new(mean, variance);
        }
        true
    }
}

/// A block of columns under way.
struct Block<'a> {
    window: Window<'a>,
    columns: Range<usize>,
    mean: &'a mut [f64],
    scale: &'a mut [f64],
    inverse: &'a mut [f64],
    moments: &'a mut [Moments],
}

impl Kernel for Block<'_> {
    #[inline(always)]
    fn run(self) {
        let rows = || self.window.rows().map(|row| &row[self.columns.clone()]);
        for start in (0..self.mean.len()).step_by(TILE) {
            let end = (start + TILE).min(self.mean.len());
            let sigma = &mut self.scale[start..end];
            statistics(
                rows().map(|row| &row[start..end]),
                &mut self.mean[start..end],
                sigma,
            );
        }
        for (scale, inverse) in self.scale.iter_mut().zip(&mut *self.inverse) {
            let sigma = *scale + EPSILON;
            *scale = if sigma < FLAT { 1.0 } else { sigma };
            *inverse = 1.0 / *scale;
        }
        for (moments, row) in self.moments.iter_mut().zip(rows()) {
            *moments = moments_of(row, self.mean, self.inverse);
        }
    }
}

/// Mean and population standard deviation of up to [`TILE`] columns. The sums of a whole tile stay in registers.
#[inline(always)]
fn statistics<'a>(rows: impl Iterator<Item = &'a [f64]> + Clone, mean: &mut [f64], sigma: &mut [f64]) {
    let n = rows.clone().count() as f64;
    if let (Ok(mean), Ok(sigma)) = (
        <&mut [f64; TILE]>::try_from(&mut *mean),
        <&mut [f64; TILE]>::try_from(&mut *sigma),
    ) {
        let rows = rows.filter_map(|row| <&[f64; TILE]>::try_from(row).ok());
        let mut sums = [0.0; TILE];
        for x in rows.clone() {
            for k in 0..TILE {
                sums[k] += x[k];
            }
        }
        *mean = sums.map(|sum| sum / n);
        let mut squares = [0.0; TILE];
        for x in rows {
            for k in 0..TILE {
                squares[k] += (x[k] - mean[k]) * (x[k] - mean[k]);
            }
        }
        *sigma = squares.map(|sum| (sum / n).sqrt());
        return;
    }
    for (k, (mean, sigma)) in mean.iter_mut().zip(sigma).enumerate() {
        *mean = rows.clone().fold(0.0, |sum, x| sum + x[k]) / n;
        let squares = rows
            .clone()
            .fold(0.0, |sum, x| sum + (x[k] - *mean) * (x[k] - *mean));
        *sigma = (squares / n).sqrt();
    }
}

/// Σz and Σz² with z = (x − mean)·inverse, over at most [`BLOCK`] values. Each sum has a loop of its own: together
/// they would not vectorise.
#[inline(always)]
fn moments_of(x: &[f64], mean: &[f64], inverse: &[f64]) -> Moments {
    let mut block = [0.0; BLOCK];
    let z = &mut block[..x.len()];
    for (((z, x), m), i) in z.iter_mut().zip(x).zip(mean).zip(inverse) {
        *z = (x - m) * i;
    }
    Moments {
        sum: sum(z, |z| z),
        squares: sum(z, |z| z * z),
    }
}

/// Σ f(z).
#[inline(always)]
fn sum(z: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    let (lanes, rest) = z.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for z in lanes {
        for k in 0..LANES {
            sums[k] += f(z[k]);
        }
    }
    for width in [8, 4, 2, 1] {
        for k in 0..width {
            sums[k] += sums[k + width];
        }
    }
    sums[0] + rest.iter().map(|z| f(*z)).sum::<f64>()
}
