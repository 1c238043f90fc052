//! `hog`: how edges of each direction are distributed over the image.
//!
//! A descriptor without learning, after histograms of oriented gradients (Dalal and Triggs, CVPR 2005) and divisive
//! normalisation (Jarrett et al., ICCV 2009). All in f64; indices are (row y, column x), from 0.
//!
//! 1. **Small image** g: grey, area-resized to H×W = 32×48. That is the anti-aliasing, and it matters.
//! 2. **Contrast of the whole**: `z = (g − mean g) / (std g + 1e-6)`, population std. Where g is one level all over,
//!    the row is 0.
//! 3. **Local contrast**: with M(a) the mean of a over the part of the 9×9 square around a pixel that is inside the
//!    image, `d = z − M(z)` and `n = d / (sqrt(M(d²)) + 0.3)`.
//! 4. **Orientation**: 8 filters k of 5×5 at θ = kπ/4, derivatives of a Gaussian of σ = 1 pixel:
//!    `w_k(v, u) = (u cos θ + v sin θ) · exp(−(u² + v²) / 2)` for u, v in −2…2, over the sum of its absolute values.
//!    `r_k(y, x) = max(0, Σ w_k(v, u) · n(y + v, x + u))`; beyond the border n is mirrored, the border pixel repeated.
//!    As `w_{k+4} = −w_k`, four sums do for eight filters.
//! 5. **Cells**: each r_k area-resized to 8×10 and to 2×3: 80 + 6 = 86 cells c of 8 numbers. Each cell to
//!    `c / (|c| + 0.01)`, Euclidean.
//! 6. **Row**: cells of 8×10, then of 2×3, each grid row-major, the 8 orientations of a cell together:
//!    86 · 8 = 688 numbers; less their mean; over their Euclidean length (0 where that is 1e-12 or less).

use crate::kind::{FrameView, Kind};
use crate::normalise::{standardise, write_unit};
use crate::resize::AreaResize;
use evpr_core::plan::Sensor;

const HEIGHT: usize = 32;
const WIDTH: usize = 48;
/// The square of the local contrast reaches so far to each side.
const LOCAL_RADIUS: usize = 4;
/// Beside the local standard deviation; in standard deviations of the whole image.
const LOCAL_FLOOR: f64 = 0.3;
/// A filter reaches so far to each side.
const FILTER_RADIUS: usize = 2;
const FILTER_SIDE: usize = 2 * FILTER_RADIUS + 1;
const PADDED_HEIGHT: usize = HEIGHT + 2 * FILTER_RADIUS;
const PADDED_WIDTH: usize = WIDTH + 2 * FILTER_RADIUS;
const ORIENTATIONS: usize = 8;
const GRIDS: [(usize, usize); 2] = [(8, 10), (2, 3)];
/// Beside the length of a cell.
const CELL_FLOOR: f64 = 0.01;
/// Numbers in a row.
pub(crate) const DIM: usize = (GRIDS[0].0 * GRIDS[0].1 + GRIDS[1].0 * GRIDS[1].1) * ORIENTATIONS;

type Filter = [[f64; FILTER_SIDE]; FILTER_SIDE];

/// The kind; the module says what it computes. Dimension 688.
#[derive(Debug)]
pub(crate) struct Hog {
    resize: AreaResize,
    grids: [AreaResize; GRIDS.len()],
    /// Orientations 0 to 3; the others are these, negated.
    filters: [Filter; ORIENTATIONS / 2],
    /// The small image, then with its whole contrast normalised, then its difference from the local mean.
    image: Vec<f64>,
    local: LocalMean,
    squares: Vec<f64>,
    /// The locally normalised image, mirrored beyond its borders.
    padded: Vec<f64>,
    positive: Vec<f64>,
    negative: Vec<f64>,
    /// One orientation in the cells of one grid.
    pooled: Vec<f64>,
    cells: Vec<f64>,
}

impl Hog {
    /// For this sensor.
    pub(crate) fn new(sensor: Sensor) -> Self {
        let plane = || vec![0.0; HEIGHT * WIDTH];
        Self {
            resize: AreaResize::new((sensor.height, sensor.width), (HEIGHT, WIDTH)),
            grids: GRIDS.map(|grid| AreaResize::new((HEIGHT, WIDTH), grid)),
            filters: std::array::from_fn(filter),
            image: plane(),
            local: LocalMean::new(),
            squares: plane(),
            padded: vec![0.0; PADDED_HEIGHT * PADDED_WIDTH],
            positive: plane(),
            negative: plane(),
            pooled: vec![0.0; GRIDS[0].0 * GRIDS[0].1],
            cells: vec![0.0; DIM],
        }
    }

    /// Step 3: from `image` to `padded`.
    fn normalise_locally(&mut self) {
        let mean = self.local.of(&self.image);
        for (value, mean) in self.image.iter_mut().zip(mean) {
            *value -= mean;
        }
        for (square, value) in self.squares.iter_mut().zip(&self.image) {
            *square = value * value;
        }
        let variance = self.local.of(&self.squares);
        for (value, variance) in self.image.iter_mut().zip(variance) {
            *value /= variance.sqrt() + LOCAL_FLOOR;
        }
        for (y, row) in self.padded.chunks_exact_mut(PADDED_WIDTH).enumerate() {
            let from = &self.image[mirrored(y, HEIGHT) * WIDTH..][..WIDTH];
            for (x, out) in row.iter_mut().enumerate() {
                *out = from[mirrored(x, WIDTH)];
            }
        }
    }

    /// Step 4 for a filter and its negation: from `padded` to `positive` and `negative`.
    fn orient(&mut self, filter: &Filter) {
        let rows = self.positive.chunks_exact_mut(WIDTH);
        for (y, (out, negative)) in rows.zip(self.negative.chunks_exact_mut(WIDTH)).enumerate() {
            let mut sum = [0.0; WIDTH];
            for (v, weights) in filter.iter().enumerate() {
                let row = &self.padded[(y + v) * PADDED_WIDTH..][..PADDED_WIDTH];
                for (u, weight) in weights.iter().enumerate() {
                    for (sum, value) in sum.iter_mut().zip(&row[u..]) {
                        *sum += weight * value;
                    }
                }
            }
            for ((out, negative), sum) in out.iter_mut().zip(negative).zip(sum) {
                *out = sum.max(0.0);
                *negative = (-sum).max(0.0);
            }
        }
    }

    /// Step 5 for one orientation, as far as the area: from `positive` or `negative` into the cells.
    fn pool(&mut self, orientation: usize) {
        let plane = if orientation < self.filters.len() {
            &self.positive
        } else {
            &self.negative
        };
        let mut cells = self.cells.as_chunks_mut::<ORIENTATIONS>().0.iter_mut();
        for (grid, (rows, columns)) in self.grids.iter_mut().zip(GRIDS) {
            let pooled = &mut self.pooled[..rows * columns];
            grid.apply_plane(plane, pooled);
            for (value, cell) in pooled.iter().zip(&mut cells) {
                cell[orientation] = *value;
            }
        }
    }
}

impl Kind for Hog {
    fn extract(&mut self, frame: FrameView<'_>, row: &mut [f32]) {
        self.resize.apply(frame, &mut self.image);
        let all = 0..self.image.len();
        standardise(&mut self.image, all);
        self.normalise_locally();
        for k in 0..self.filters.len() {
            let filter = self.filters[k];
            self.orient(&filter);
            self.pool(k);
            self.pool(k + self.filters.len());
        }
        for cell in self.cells.as_chunks_mut::<ORIENTATIONS>().0 {
            let length = cell.iter().map(|v| v * v).sum::<f64>().sqrt();
            cell.iter_mut().for_each(|v| *v /= length + CELL_FLOOR);
        }
        let mean = self.cells.iter().sum::<f64>() / DIM as f64;
        self.cells.iter_mut().for_each(|v| *v -= mean);
        write_unit(&self.cells, row);
    }
}

/// Filter `k` of the module's step 4.
fn filter(k: usize) -> Filter {
    let (sin, cos) = (k as f64 * std::f64::consts::FRAC_PI_4).sin_cos();
    let offset = |i: usize| i as f64 - FILTER_RADIUS as f64;
    let mut filter: Filter = std::array::from_fn(|v| {
        std::array::from_fn(|u| {
            let (v, u) = (offset(v), offset(u));
            (u * cos + v * sin) * (-(u * u + v * v) / 2.0).exp()
        })
    });
    let sum: f64 = filter.iter().flatten().map(|w| w.abs()).sum();
    filter.iter_mut().flatten().for_each(|w| *w /= sum);
    filter
}

/// The pixel that stands at a place of the padded axis: beyond a border the image is mirrored, border pixel included.
fn mirrored(padded: usize, len: usize) -> usize {
    if padded < FILTER_RADIUS {
        FILTER_RADIUS - 1 - padded
    } else if padded < len + FILTER_RADIUS {
        padded - FILTER_RADIUS
    } else {
        2 * len + FILTER_RADIUS - 1 - padded
    }
}

/// The mean over the part of a square around each pixel that is inside the image.
#[derive(Debug)]
struct LocalMean {
    /// Mean along the rows.
    along: Vec<f64>,
    mean: Vec<f64>,
}

/// The pixels of the square along one axis.
fn around(i: usize, len: usize) -> std::ops::Range<usize> {
    i.saturating_sub(LOCAL_RADIUS)..(i + LOCAL_RADIUS + 1).min(len)
}

impl LocalMean {
    fn new() -> Self {
        Self {
            along: vec![0.0; HEIGHT * WIDTH],
            mean: vec![0.0; HEIGHT * WIDTH],
        }
    }

    /// The square is a rectangle wherever it is cut, so the mean is that of means along rows.
    fn of(&mut self, plane: &[f64]) -> &[f64] {
        for (out, row) in self.along.chunks_exact_mut(WIDTH).zip(plane.chunks_exact(WIDTH)) {
            for (x, out) in out.iter_mut().enumerate() {
                let under = &row[around(x, WIDTH)];
                *out = under.iter().sum::<f64>() / under.len() as f64;
            }
        }
        for (y, out) in self.mean.chunks_exact_mut(WIDTH).enumerate() {
            let under = around(y, HEIGHT);
            let share = 1.0 / under.len() as f64;
            out.fill(0.0);
            for row in self.along[under.start * WIDTH..under.end * WIDTH].chunks_exact(WIDTH) {
                for (out, value) in out.iter_mut().zip(row) {
                    *out += share * value;
                }
            }
        }
        &self.mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::message::ChannelOrder;

    const SENSOR: Sensor = Sensor {
        height: HEIGHT,
        width: WIDTH,
    };

    /// The row of an image given by its levels.
    fn row(level: impl Fn(usize, usize) -> u8) -> Vec<f32> {
        let at = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (y, x)));
        let pixels: Vec<u8> = at.map(|(y, x)| level(y, x)).collect();
        let frame = FrameView {
            channel_order: ChannelOrder::Grey,
            pixels: &pixels,
        };
        let mut row = vec![f32::NAN; DIM];
        Hog::new(SENSOR).extract(frame, &mut row);
        row
    }

    /// The strongest orientation of the cell in row 4, column 5 of the finer grid: pixels 16…19, 24…28.8.
    fn strongest(row: &[f32]) -> usize {
        let cell = &row[(4 * 10 + 5) * ORIENTATIONS..][..ORIENTATIONS];
        (0..ORIENTATIONS)
            .max_by(|a, b| cell[*a].total_cmp(&cell[*b]))
            .unwrap()
    }

    #[test]
    fn an_edge_answers_in_its_direction() {
        let steps: [fn(isize, isize) -> isize; 8] = [
            |_, x| x,
            |y, x| x + y,
            |y, _| y,
            |y, x| y - x,
            |_, x| -x,
            |y, x| -x - y,
            |y, _| -y,
            |y, x| x - y,
        ];
        for (k, step) in steps.iter().enumerate() {
            // Through the middle of the cell.
            let level = |y: usize, x: usize| {
                if step(2 * y as isize - 35, 2 * x as isize - 53) > 0 {
                    200
                } else {
                    50
                }
            };
            assert_eq!(strongest(&row(level)), k, "orientation {k}");
        }
    }

    #[test]
    fn filters_have_no_response_to_one_level_and_come_in_opposite_pairs() {
        for k in 0..ORIENTATIONS {
            let (here, opposite) = (filter(k), filter((k + 4) % ORIENTATIONS));
            let (mut sum, mut absolute) = (0.0, 0.0);
            for (a, b) in here.iter().flatten().zip(opposite.iter().flatten()) {
                assert!((a + b).abs() < 1e-12);
                sum += a;
                absolute += a.abs();
            }
            assert!(sum.abs() < 1e-12 && (absolute - 1.0).abs() < 1e-12, "filter {k}");
        }
    }

    #[test]
    fn beyond_the_border_the_image_is_mirrored() {
        let places: Vec<usize> = (0..9).map(|padded| mirrored(padded, 5)).collect();
        assert_eq!(places, [1, 0, 0, 1, 2, 3, 4, 4, 3]);
    }

    #[test]
    fn the_local_mean_is_over_what_is_inside() {
        let plane: Vec<f64> = (0..HEIGHT * WIDTH).map(|i| (i * i % 97) as f64).collect();
        let mut local = LocalMean::new();
        let mean = local.of(&plane);
        for (y, x) in [(0, 0), (3, 47), (16, 20), (31, 2), (31, 47)] {
            let (rows, columns) = (around(y, HEIGHT), around(x, WIDTH));
            let count = (rows.len() * columns.len()) as f64;
            let sum: f64 = rows
                .flat_map(|y| columns.clone().map(move |x| y * WIDTH + x))
                .map(|i| plane[i])
                .sum();
            assert!((mean[y * WIDTH + x] - sum / count).abs() < 1e-9, "({y}, {x})");
        }
    }
}
