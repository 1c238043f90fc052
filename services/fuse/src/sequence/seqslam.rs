//! Method `seqslam`: local contrast along each row, then the best of several straight lines through the window.
//!
//! After Milford and Wyeth, "SeqSLAM: Visual Route-Based Navigation for Sunny Summer Days and Stormy Winter Nights",
//! ICRA 2012, as the authors of the ensemble method compute it for their baseline:
//! 1. contrast: E = (S − µ) / (√ν + 1e-8) along the row, where µ is the mean of S, then ν that of (S − µ)², over the
//!    k references around each (⌊k/2⌋ before it, the row reflected at its ends: d c b a | a b c d | d c b a);
//!    k = min(window, ⌊R/4⌋). With fewer than 8 references there is no contrast: E = 0;
//! 2. S̃\[q, j\] is the greatest, over the velocities v, of Σ E\[q − lag, ⌊j − lag·v⌋\] over lag = L − 1 … 0, rounded
//!    towards zero. Lines that begin before the map do not count.
//!
//! Places before the L-th have no score, nor does any before the L-th tick: −∞.

use super::diagonals::BLOCK;
use super::runs::Runs;
use super::{EPSILON, Window};
use crate::simd::{Kernel, run_widest};
use evpr_core::plan::SeqSlam;
use rayon::prelude::*;
use std::ops::Range;

/// Consecutive places whose line passes as many references before them.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Stretch {
    places: Range<usize>,
    /// Places less references.
    shift: usize,
}

/// The lines of one velocity.
#[derive(Debug)]
struct Velocity {
    /// The first place with a line that lies wholly on the map.
    first: usize,
    /// Per lag: where the lines pass.
    lags: Vec<Vec<Stretch>>,
}

impl Velocity {
    fn new(velocity: f64, length: usize, references: usize) -> Self {
        let reach = (length - 1) as f64 * velocity;
        // Rounding towards zero, -0.9 still lies on the map.
        let on_map = |place: &usize| *place as f64 - reach > -1.0;
        let first = (length - 1..references).find(on_map).unwrap_or(references);
        let lags = (0..length).map(|lag| stretches(lag as f64 * velocity, first..references));
        Self {
            first,
            lags: lags.collect(),
        }
    }
}

/// Where lines pass that have come `distance` references since. Each place is computed in f64 as NumPy does, as far as
/// that makes a difference: near a whole number it depends on the place which way its reference is rounded.
fn stretches(distance: f64, places: Range<usize>) -> Vec<Stretch> {
    let shift = |place: usize| place - (place as f64 - distance) as usize;
    let mut stretches = Vec::new();
    let Range { mut start, end } = places;
    while start < end {
        let here = shift(start);
        // Above 0 the shift can only become smaller, once.
        let until = match (start as f64) < distance {
            true => start + 1,
            false => start + partition_point(end - start, |k| shift(start + k) == here),
        };
        stretches.push(Stretch {
            places: start..until,
            shift: here,
        });
        start = until;
    }
    stretches
}

/// The first of 0…n for which `holds` no longer does; it holds up to there.
fn partition_point(n: usize, holds: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, n);
    while low < high {
        let middle = low + (high - low) / 2;
        match holds(middle) {
            true => low = middle + 1,
            false => high = middle,
        }
    }
    low
}

/// The lines through a window, with memory for contrasts.
#[derive(Debug)]
pub(super) struct Lines {
    velocities: Vec<Velocity>,
    /// k.
    window: usize,
    /// A row reflected at both ends.
    reflected: Vec<f64>,
    /// Local means of one value per column.
    means: Vec<f64>,
}

impl Lines {
    /// Lines over `length` ticks of a map of so many references, `columns` of them with a row.
    pub(super) fn new(parameters: SeqSlam, length: usize, references: usize, columns: usize) -> Self {
        let [least, greatest] = parameters.velocities;
        // As np.linspace has them.
        let steps = parameters.velocity_steps.max(1);
        let step = (greatest - least) / (steps.max(2) - 1) as f64;
        let velocity = |k: usize| match k {
            0 => least,
            k if k == steps - 1 => greatest,
            k => k as f64 * step + least,
        };
        let window = parameters.window.min(columns / 4).max(1);
        Self {
            velocities: (0..steps)
                .map(|k| Velocity::new(velocity(k), length, references))
                .collect(),
            window,
            reflected: vec![0.0; columns + window],
            means: vec![0.0; columns],
        }
    }

    /// Writes E of a similarity row, over all references; 0 where the map has no row.
    pub(super) fn contrast(&mut self, row: &[f64], runs: &Runs, out: &mut [f64]) {
        out.fill(0.0);
        if self.window < 2 || self.means.is_empty() {
            // A place next to nothing has no contrast.
            return;
        }
        let (k, before) = (self.window, self.window / 2);
        let columns = before..before + self.means.len();
        let values = &mut self.reflected[columns.clone()];
        for run in runs.iter() {
            values[run.columns()].copy_from_slice(&row[run.references()]);
        }
        reflect(&mut self.reflected, columns.clone());
        local_means(&self.reflected, k, &mut self.means);
        for (value, mean) in self.reflected[columns.clone()].iter_mut().zip(&self.means) {
            *value -= mean;
        }
        for run in runs.iter() {
            let differences = &self.reflected[columns.clone()][run.columns()];
            out[run.references()].copy_from_slice(differences);
        }
        self.reflected[columns.clone()].iter_mut().for_each(|d| *d *= *d);
        reflect(&mut self.reflected, columns);
        local_means(&self.reflected, k, &mut self.means);
        for run in runs.iter() {
            let variances = &self.means[run.columns()];
            for (difference, variance) in out[run.references()].iter_mut().zip(variances) {
                *difference /= variance.max(0.0).sqrt() + EPSILON;
            }
        }
    }

    /// Writes S̃ of the window's newest tick. The rows of the window are contrasts of all references.
    pub(super) fn score(&self, window: Window<'_>, runs: &Runs, out: &mut [f64]) {
        let least = if window.is_large() { 1 } else { usize::MAX };
        let blocks = out.par_chunks_mut(BLOCK).enumerate().with_min_len(least);
        blocks.for_each(|(index, out)| {
            run_widest(Block {
                window,
                runs,
                velocities: &self.velocities,
                start: index * BLOCK,
                out,
            });
        });
    }
}

/// Mirrors what stands in `middle` to both sides of it.
fn reflect(values: &mut [f64], middle: Range<usize>) {
    for k in 0..middle.start {
        values[middle.start - 1 - k] = values[middle.start + k];
    }
    for k in 0..values.len() - middle.end {
        values[middle.end + k] = values[middle.end - 1 - k];
    }
}

/// The mean of k values from each on, as one running sum.
fn local_means(values: &[f64], k: usize, means: &mut [f64]) {
    let mut sum: f64 = values[..k].iter().sum();
    means[0] = sum / k as f64;
    let entering = values[k..].iter().zip(values);
    for (mean, (new, old)) in means[1..].iter_mut().zip(entering) {
        sum += new - old;
        *mean = sum / k as f64;
    }
}

/// A block of places under way.
struct Block<'a> {
    window: Window<'a>,
    runs: &'a Runs,
    velocities: &'a [Velocity],
    /// First place.
    start: usize,
    out: &'a mut [f64],
}

impl Kernel for Block<'_> {
    #[inline(always)]
    fn run(self) {
        let (start, end) = (self.start, self.start + self.out.len());
        let mut memory = [0.0; BLOCK];
        let sums = &mut memory[..self.out.len()];
        self.out.fill(f64::NEG_INFINITY);
        for velocity in self.velocities.iter().filter(|v| v.first < end) {
            sums.fill(0.0);
            for (row, (_, lag)) in self.window.rows().zip(self.window.ticks) {
                for stretch in &velocity.lags[*lag] {
                    let places = stretch.places.start.max(start)..stretch.places.end.min(end);
                    if places.is_empty() {
                        continue;
                    }
                    let references = places.start - stretch.shift..places.end - stretch.shift;
                    add(
                        &mut sums[places.start - start..places.end - start],
                        &row[references],
                    );
                }
            }
            let first = velocity.first.saturating_sub(start);
            take_greater(&mut self.out[first..], &sums[first..]);
        }
        for hole in self.runs.holes_within(start..end) {
            for score in &mut self.out[hole.start - start..hole.end - start] {
                *score = if *score > f64::NEG_INFINITY { 0.0 } else { *score };
            }
        }
    }
}

/// sums += row. (A function of its own because the compiler knows of arguments that they do not overlap.)
#[inline(always)]
fn add(sums: &mut [f64], row: &[f64]) {
    for (sum, e) in sums.iter_mut().zip(row) {
        *sum += e;
    }
}

#[inline(always)]
fn take_greater(out: &mut [f64], sums: &[f64]) {
    for (out, sum) in out.iter_mut().zip(sums) {
        *out = if *sum > *out { *sum } else { *out };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn every_place_has_the_reference_of_the_formula(
            ninths in 0usize..30, nudge in -3i32..4, length in 1usize..40, references in 1usize..3000,
        ) {
            // Multiples of 1/9 and their neighbours: sums of them come close to whole numbers.
            let velocity = (ninths as f64 / 9.0 * (1.0 + f64::from(nudge) * f64::EPSILON)).max(0.0);
            let lines = Velocity::new(velocity, length, references);
            for place in 0..references {
                let at = |lag: usize| (place as f64 - lag as f64 * velocity).trunc();
                let counts = place + 1 >= length && at(length - 1) >= 0.0;
                prop_assert_eq!(counts, place >= lines.first);
                for (lag, stretches) in lines.lags.iter().enumerate().filter(|_| counts) {
                    let mut here = stretches.iter().filter(|s| s.places.contains(&place));
                    let found = here.next().map(|s| (place - s.shift) as f64);
                    prop_assert_eq!((found, here.next()), (Some(at(lag)), None), "lag {}", lag);
                }
            }
        }
    }

    #[test]
    fn rows_are_reflected_with_their_ends() {
        let mut values = [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 0.0];
        reflect(&mut values, 2..6);
        assert_eq!(values, [2.0, 1.0, 1.0, 2.0, 3.0, 4.0, 4.0]);
        let mut means = [0.0; 4];
        local_means(&values, 4, &mut means);
        assert_eq!(means, [1.5, 1.75, 2.5, 3.25]);
    }
}
