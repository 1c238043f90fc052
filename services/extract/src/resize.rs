//! Grey conversion and area resize in one pass.

use crate::kind::FrameView;
use evpr_core::message::ChannelOrder;

/// Weights along one axis: output cell i covers `[i, i+1) · n_in / n_out` of the input, and input pixel j counts with
/// the length of its overlap over the length of the cell.
#[derive(Debug)]
struct Axis {
    /// Per cell: its first input pixel, and where its weights begin and end in `weights`.
    cells: Vec<(usize, std::ops::Range<usize>)>,
    weights: Vec<f64>,
}

impl Axis {
    fn new(n_in: usize, n_out: usize) -> Self {
        let length = n_in as f64 / n_out as f64;
        let mut cells = Vec::with_capacity(n_out);
        let mut weights = Vec::new();
        for cell in 0..n_out {
            let (from, to) = (cell as f64 * length, (cell + 1) as f64 * length);
            let first = (from.floor() as usize).min(n_in - 1);
            let end = (to.ceil() as usize).clamp(first + 1, n_in);
            let begin = weights.len();
            for j in first..end {
                let overlap = to.min((j + 1) as f64) - from.max(j as f64);
                weights.push(overlap.max(0.0) / length);
            }
            cells.push((first, begin..weights.len()));
        }
        Self { cells, weights }
    }

    /// Cells in order: first input pixel, weights from there on.
    fn cells(&self) -> impl Iterator<Item = (usize, &[f64])> {
        self.cells
            .iter()
            .map(|(first, range)| (*first, &self.weights[range.clone()]))
    }
}

/// Shrinks (or enlarges) images of one size, in f64, by the mean over the area of each output pixel. Where it shrinks
/// this is its own anti-aliasing filter: every input pixel counts, with one and the same total weight.
#[derive(Debug)]
pub(crate) struct AreaResize {
    width: usize,
    rows: Axis,
    columns: Axis,
    /// The weighted sum of the input rows under one output row.
    sum: Vec<f64>,
}

impl AreaResize {
    /// Between two sizes (height, width), all above 0.
    pub(crate) fn new(from: (usize, usize), to: (usize, usize)) -> Self {
        Self {
            width: from.1,
            rows: Axis::new(from.0, to.0),
            columns: Axis::new(from.1, to.1),
            sum: vec![0.0; from.1],
        }
    }

    /// Writes the small grey image of a frame, row-major, not rounded.
    pub(crate) fn apply(&mut self, frame: FrameView<'_>, small: &mut [f64]) {
        let order = frame.channel_order;
        let rows = frame.pixels.chunks_exact(self.width * order.channels());
        self.reduce(rows, |sum, weight, row| add_grey(sum, weight, row, order), small);
    }

    /// The same for a plane of numbers.
    pub(crate) fn apply_plane(&mut self, plane: &[f64], small: &mut [f64]) {
        let add = |sum: &mut [f64], weight: f64, row: &[f64]| {
            for (sum, value) in sum.iter_mut().zip(row) {
                *sum += weight * value;
            }
        };
        self.reduce(plane.chunks_exact(self.width), add, small);
    }

    /// `add` adds a row, times a weight, to a sum.
    fn reduce<R>(
        &mut self,
        rows: impl Iterator<Item = R> + Clone,
        add: impl Fn(&mut [f64], f64, R),
        small: &mut [f64],
    ) {
        let mut small = small.iter_mut();
        for (first, weights) in self.rows.cells() {
            self.sum.fill(0.0);
            for (weight, row) in weights.iter().zip(rows.clone().skip(first)) {
                add(&mut self.sum, *weight, row);
            }
            for ((first, weights), pixel) in self.columns.cells().zip(&mut small) {
                let under = self.sum[first..].iter().zip(weights);
                *pixel = under.map(|(value, weight)| value * weight).sum();
            }
        }
    }
}

/// Adds a row of the frame, grey, times `weight`. One channel is grey as it is; of polarity frames, whose third channel
/// is unused, grey is the mean of the first two; of colour frames the luma of Rec. 601, 0.299 R + 0.587 G + 0.114 B.
fn add_grey(sum: &mut [f64], weight: f64, row: &[u8], order: ChannelOrder) {
    match order {
        ChannelOrder::Grey => {
            for (sum, value) in sum.iter_mut().zip(row) {
                *sum += weight * f64::from(*value);
            }
        }
        ChannelOrder::OffOnZero | ChannelOrder::OnOffZero => {
            for (sum, [first, second, _]) in sum.iter_mut().zip(row.as_chunks::<3>().0) {
                *sum += weight * (f64::from(u16::from(*first) + u16::from(*second)) / 2.0);
            }
        }
        ChannelOrder::BlueGreenRed => {
            for (sum, [blue, green, red]) in sum.iter_mut().zip(row.as_chunks::<3>().0) {
                let luma = 0.299 * f64::from(*red) + 0.587 * f64::from(*green) + 0.114 * f64::from(*blue);
                *sum += weight * luma;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn resize(order: ChannelOrder, from: (usize, usize), to: (usize, usize), pixels: &[u8]) -> Vec<f64> {
        let mut small = vec![f64::NAN; to.0 * to.1];
        let frame = FrameView {
            channel_order: order,
            pixels,
        };
        AreaResize::new(from, to).apply(frame, &mut small);
        small
    }

    #[test]
    fn cells_are_means_and_share_pixels() {
        let g = ChannelOrder::Grey;
        assert_eq!(resize(g, (2, 2), (1, 1), &[1, 2, 3, 4]), [2.5]);
        assert_eq!(resize(g, (1, 3), (1, 2), &[30, 60, 90]), [40.0, 80.0]);
        assert_eq!(resize(g, (1, 2), (1, 4), &[10, 20]), [10.0, 10.0, 20.0, 20.0]);
    }

    #[test]
    fn a_plane_is_as_a_grey_frame() {
        let pixels = [3, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 8];
        let plane: Vec<f64> = pixels.iter().copied().map(f64::from).collect();
        let mut small = [f64::NAN; 6];
        AreaResize::new((3, 4), (2, 3)).apply_plane(&plane, &mut small);
        assert_eq!(resize(ChannelOrder::Grey, (3, 4), (2, 3), &pixels), small);
    }

    #[test]
    fn grey_is_decided_by_the_channel_order() {
        let pixel = [100, 51, 7];
        for order in [ChannelOrder::OffOnZero, ChannelOrder::OnOffZero] {
            assert_eq!(resize(order, (1, 1), (1, 1), &pixel), [75.5]);
        }
        let luma = resize(ChannelOrder::BlueGreenRed, (1, 1), (1, 1), &pixel)[0];
        assert!((luma - (0.114 * 100.0 + 0.587 * 51.0 + 0.299 * 7.0)).abs() < 1e-12);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn weights_of_a_cell_sum_to_one_and_of_a_pixel_to_its_share(n_in in 1usize..300, n_out in 1usize..300) {
            let axis = Axis::new(n_in, n_out);
            let mut per_pixel = vec![0.0; n_in];
            for (first, weights) in axis.cells() {
                prop_assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
                for (i, weight) in weights.iter().enumerate() {
                    per_pixel[first + i] += weight;
                }
            }
            let share = n_out as f64 / n_in as f64;
            prop_assert!(per_pixel.iter().all(|w| (w - share).abs() < 1e-9));
        }
    }
}
