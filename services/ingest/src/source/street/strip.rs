//! Pictures of surfaces along the street, kept as running sums, so that the mean over any stretch of them costs the
//! same: nothing flickers because a far pixel would pick single texels.

/// Edge of a texel, metres.
pub(super) const TEXEL_M: f32 = 0.1;

/// Values are kept as whole parts of this.
const PARTS: f32 = 2048.0;
/// The largest value. A sum over [`MAX_STRETCH`] texels of it fits 31 bits.
const MAX_VALUE: f32 = 300.0;
/// The longest stretch that a mean is taken over, texels.
const MAX_STRETCH: usize = 3_000;

/// A surface: columns of texels along the street, each a row of cells across it (up a façade, or over the road).
#[derive(Debug, Clone)]
pub(super) struct Strip {
    cells: usize,
    columns: usize,
    /// For each column, and one after the last, the sum of all cells before it. Sums wrap; differences are right.
    sums: Vec<i32>,
}

impl Strip {
    /// `paint` writes the cells of a column, each from 0 to 300.
    pub(super) fn new(columns: usize, cells: usize, mut paint: impl FnMut(usize, &mut [f32])) -> Self {
        let mut sums = vec![0i32; (columns + 1) * cells];
        let mut values = vec![0f32; cells];
        for column in 0..columns {
            paint(column, &mut values);
            let (before, after) = sums.split_at_mut((column + 1) * cells);
            let before = &before[column * cells..];
            for ((sum, before), value) in after.iter_mut().zip(before).zip(&values) {
                *sum = before.wrapping_add((value.clamp(0.0, MAX_VALUE) * PARTS) as i32);
            }
        }
        Self { cells, columns, sums }
    }

    pub(super) fn cells(&self) -> usize {
        self.cells
    }

    /// Means over the stretch [from, to) of columns, in texels, summed up over the cells: `out[i]` is the sum of the
    /// means of the cells before `i`. `out` has one entry more than there are cells.
    pub(super) fn profile(&self, from: f64, to: f64, out: &mut [f32]) {
        let end = self.columns.saturating_sub(1) as f64;
        let from = from.clamp(0.0, end);
        let to = to
            .clamp(from, (from + MAX_STRETCH as f64).min(end))
            .max(from + 1e-3);
        let at = |x: f64| {
            let column = (x as usize).min(self.columns.saturating_sub(1));
            let pair = &self.sums[column * self.cells..(column + 2) * self.cells];
            let (here, next) = pair.split_at(self.cells);
            (here, next, (x - column as f64) as f32)
        };
        let ((a, a_next, a_part), (b, b_next, b_part)) = (at(from), at(to));
        let scale = (1.0 / (f64::from(PARTS) * (to - from))) as f32;
        let Some((first, means)) = out.split_first_mut() else {
            return;
        };
        *first = 0.0;
        let pairs = a.iter().zip(a_next).zip(b.iter().zip(b_next));
        for (mean, ((a, a_next), (b, b_next))) in means.iter_mut().zip(pairs) {
            let whole = b.wrapping_sub(*a) as f32;
            let last = b_next.wrapping_sub(*b) as f32 * b_part;
            let first = a_next.wrapping_sub(*a) as f32 * a_part;
            *mean = (whole + last - first) * scale;
        }
        let mut sum = 0.0;
        for mean in means {
            sum += *mean;
            *mean = sum;
        }
    }
}

/// The sum up to a place between cells, of what [`Strip::profile`] gave.
pub(super) fn sum_to(profile: &[f32], cells: f32) -> f32 {
    let last = profile.len().saturating_sub(2);
    let cell = (cells.max(0.0) as usize).min(last);
    let (here, next) = (profile[cell], profile[cell + 1]);
    here + (cells - cell as f32).clamp(0.0, 1.0) * (next - here)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value(column: usize, cell: usize) -> f32 {
        ((column * 7 + cell * 13) % 23) as f32 * 13.0
    }

    fn strip() -> Strip {
        Strip::new(5_000, 4, |column, cells| {
            for (cell, v) in cells.iter_mut().enumerate() {
                *v = value(column, cell);
            }
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn means_are_those_of_the_plain_computation(from in 0.0f64..4000.0, length in 0.01f64..900.0, z in 0.0f32..4.0) {
            let mut profile = [0f32; 5];
            strip().profile(from, from + length, &mut profile);
            let mean = |cell: usize| {
                let overlap = |column: usize| {
                    let c = column as f64;
                    ((from + length).min(c + 1.0) - from.max(c)).max(0.0)
                };
                let columns = from as usize..(from + length) as usize + 1;
                columns.map(|c| overlap(c) * f64::from(value(c, cell))).sum::<f64>() / length
            };
            let whole: f64 = (0..z as usize).map(mean).sum();
            let part = if (z as usize) < 4 { mean(z as usize) * f64::from(z.fract()) } else { 0.0 };
            let found = f64::from(sum_to(&profile, z));
            prop_assert!((found - whole - part).abs() < 0.02 + 1e-3 * whole, "{found} {}", whole + part);
        }
    }

    #[test]
    fn what_lies_outside_is_taken_from_the_edge() {
        let strip = strip();
        let mut profile = [0f32; 5];
        for (from, to) in [(-50.0, -10.0), (4_990.0, 9_000.0), (7_000.0, 6_000.0)] {
            strip.profile(from, to, &mut profile);
            assert!(profile.iter().all(|v| v.is_finite() && *v >= 0.0), "{profile:?}");
        }
        assert_eq!(sum_to(&[0.0, 2.0, 3.0], 9.0), 3.0);
        assert_eq!(sum_to(&[0.0, 2.0, 3.0], -1.0), 0.0);
    }
}
