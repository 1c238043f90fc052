//! Bilinear resizing with a filter as wide as the scale: what torchvision's `resize(antialias=True)` does to a tensor.
//!
//! Each output value is the weighted mean of the input values around its centre, with weights that fall off linearly
//! (`aten/src/ATen/native/cpu/UpSampleKernel.cpp` of PyTorch defines it); first along rows, then along columns.

/// Weights along one axis.
#[derive(Debug)]
struct Axis {
    /// Per output value: the first input value, and where its weights begin and end in `weights`.
    cells: Vec<(usize, std::ops::Range<usize>)>,
    weights: Vec<f32>,
}

impl Axis {
    fn new(n_in: usize, n_out: usize) -> Self {
        let scale = n_in as f64 / n_out as f64;
        let width = scale.max(1.0);
        let mut cells = Vec::with_capacity(n_out);
        let mut weights = Vec::new();
        for cell in 0..n_out {
            let centre = scale * (cell as f64 + 0.5);
            let first = ((centre - width + 0.5).max(0.0) as usize).min(n_in - 1);
            let end = ((centre + width + 0.5) as usize).clamp(first + 1, n_in);
            let weight = |j: usize| (1.0 - ((j as f64 - centre + 0.5) / width).abs()).max(0.0);
            let sum: f64 = (first..end).map(weight).sum();
            let begin = weights.len();
            weights.extend((first..end).map(|j| (weight(j) / sum) as f32));
            cells.push((first, begin..weights.len()));
        }
        Self { cells, weights }
    }

    fn cells(&self) -> impl Iterator<Item = (usize, &[f32])> {
        self.cells
            .iter()
            .map(|(first, range)| (*first, &self.weights[range.clone()]))
    }
}

/// Resizes planes of one size to another.
#[derive(Debug)]
pub(crate) struct AntialiasedResize {
    width: usize,
    out_width: usize,
    rows: Axis,
    columns: Axis,
    /// The input's rows, each as wide as the output.
    narrowed: Vec<f32>,
}

impl AntialiasedResize {
    /// From one (height, width) to another, in pixels.
    pub(crate) fn new((height, width): (usize, usize), (out_height, out_width): (usize, usize)) -> Self {
        Self {
            width,
            out_width,
            rows: Axis::new(height, out_height),
            columns: Axis::new(width, out_width),
            narrowed: vec![0.0; height * out_width],
        }
    }

    /// Resizes a plane; both are row-major and of the sizes that were given.
    pub(crate) fn apply(&mut self, plane: &[f32], out: &mut [f32]) {
        let narrowed = self.narrowed.chunks_exact_mut(self.out_width);
        for (row, narrow) in plane.chunks_exact(self.width).zip(narrowed) {
            for (value, (first, weights)) in narrow.iter_mut().zip(self.columns.cells()) {
                *value = row[first..].iter().zip(weights).map(|(v, w)| v * w).sum();
            }
        }
        for (out, (first, weights)) in out.chunks_exact_mut(self.out_width).zip(self.rows.cells()) {
            out.fill(0.0);
            let rows = self.narrowed[first * self.out_width..].chunks_exact(self.out_width);
            for (row, weight) in rows.zip(weights) {
                for (sum, value) in out.iter_mut().zip(row) {
                    *sum += weight * value;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resized(plane: &[f32], from: (usize, usize), to: (usize, usize)) -> Vec<f32> {
        let mut out = vec![f32::NAN; to.0 * to.1];
        AntialiasedResize::new(from, to).apply(plane, &mut out);
        out
    }

    #[test]
    fn the_same_size_changes_nothing() {
        let plane: Vec<f32> = (0..12).map(|v| v as f32).collect();
        assert_eq!(resized(&plane, (3, 4), (3, 4)), plane);
    }

    /// `torch.nn.functional.interpolate(x, size=(1, 2), mode="bilinear", antialias=True)` of 0…7 in one row: weights
    /// 1, 3, 5, 7, 7, 5 over 28 at the left, mirrored at the right.
    #[test]
    fn shrinking_by_four_uses_a_triangle_of_eight() {
        let plane: Vec<f32> = (0..8).map(|v| v as f32).collect();
        let weights = [5.0, 7.0, 7.0, 5.0, 3.0, 1.0];
        let left: f32 = weights.iter().enumerate().map(|(i, w)| i as f32 * w).sum::<f32>() / 28.0;
        let out = resized(&plane, (1, 8), (1, 2));
        assert!((out[0] - left).abs() < 1e-6, "{out:?}");
        assert!((out[1] - (7.0 - left)).abs() < 1e-6, "{out:?}");
    }

    #[test]
    fn enlarging_interpolates() {
        assert_eq!(resized(&[0.0, 4.0], (1, 2), (1, 4)), [0.0, 1.0, 3.0, 4.0]);
        assert_eq!(resized(&[0.0, 4.0], (2, 1), (4, 1)), [0.0, 1.0, 3.0, 4.0]);
    }

    #[test]
    fn a_constant_stays_one() {
        let out = resized(&[7.0; 26 * 35], (26, 35), (14, 42));
        assert!(out.iter().all(|v| (v - 7.0).abs() < 1e-5));
    }
}
