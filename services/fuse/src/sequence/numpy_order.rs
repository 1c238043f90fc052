//! Sums in NumPy's own order, for windows in which rounding errors decide.
//!
//! Over two ticks that changed all places alike, all z are 1 less about 1e-8, and step 2 divides their rounding
//! errors by that: only equal sums give equal scores. NumPy adds the rows of a matrix one after the other, as
//! [`columns`](super::columns) does, and the values of a row pairwise: halves of halves, down to leaves of at most
//! 128 values, which it adds in eight lanes.

use super::Window;
use super::columns::Standardise;
use super::paper::RowScale;
use std::ops::Range;

/// Values of a leaf at most.
const LEAF: usize = 128;

/// Mean and scale of each row of z, in two passes.
pub(super) fn row_scales<F: Fn(f64, f64) -> f64>(
    window: Window<'_>,
    z: Standardise<'_, F>,
    scales: &mut [RowScale],
) {
    let columns = window.columns as f64;
    for (scale, row) in scales.iter_mut().zip(window.rows()) {
        let all = 0..window.columns;
        let mean = pairwise(all.clone(), &|leaf| z_sum(row, &z, leaf, |z| z)) / columns;
        let square = |z: f64| (z - mean) * (z - mean);
        let variance = pairwise(all, &|leaf| z_sum(row, &z, leaf, square)) / columns;
        *scale = RowScale::new(mean, variance);
    }
}

/// Σ f(value).
pub(super) fn sum(values: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    pairwise(0..values.len(), &|leaf| {
        let (lanes, rest) = values[leaf].as_chunks::<8>();
        let mut sums = [0.0; 8];
        for lane in lanes {
            for k in 0..8 {
                sums[k] += f(lane[k]);
            }
        }
        add_lanes(sums, rest.iter().map(|v| f(*v)))
    })
}

/// Adds up the leaves of a range.
fn pairwise(range: Range<usize>, leaf: &impl Fn(Range<usize>) -> f64) -> f64 {
    let n = range.len();
    if n <= LEAF {
        return leaf(range);
    }
    let middle = range.start + n / 2 - n / 2 % 8;
    pairwise(range.start..middle, leaf) + pairwise(middle..range.end, leaf)
}

/// Σ f(z) over one leaf of a row.
#[inline(always)]
fn z_sum<F: Fn(f64, f64) -> f64>(
    row: &[f64],
    z: &Standardise<'_, F>,
    leaf: Range<usize>,
    f: impl Fn(f64) -> f64,
) -> f64 {
    let (x_lanes, x_rest) = row[leaf.clone()].as_chunks::<8>();
    let (m_lanes, m_rest) = z.mean[leaf.clone()].as_chunks::<8>();
    let (b_lanes, b_rest) = z.by[leaf].as_chunks::<8>();
    let mut sums = [0.0; 8];
    for ((x, m), b) in x_lanes.iter().zip(m_lanes).zip(b_lanes) {
        for k in 0..8 {
            sums[k] += f((z.op)(x[k] - m[k], b[k]));
        }
    }
    let rest = x_rest.iter().zip(m_rest).zip(b_rest);
    add_lanes(sums, rest.map(|((x, m), b)| f((z.op)(x - m, *b))))
}

fn add_lanes(r: [f64; 8], rest: impl Iterator<Item = f64>) -> f64 {
    let sum = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]));
    rest.fold(sum, |sum, v| sum + v)
}
