//! Sequence matching: from the last similarity rows of a member to one score per place.
//!
//! | method | S̃\[q, j\] | in |
//! |---|---|---|
//! | `paper` | both axes z-scored, summed along the diagonal | [`mod@paper`] |
//! | `rows` | z = (S − mean) / (σ + 1e-8) along each row, summed along the diagonal: Σ z\[t, j − (q − t)\] | here |
//! | `seqslam` | local contrast along each row, summed along the best of several lines | [`mod@seqslam`] |
//! | `filter` | z of this tick alone; the members' z are fused, then filtered | [`mod@filter`] |
//! | `none` | S of this tick alone | here |
//!
//! σ is the population standard deviation. With L = 1 `paper` and `rows` give S itself, as `none` does.
//!
//! What is missing is left out of the statistics and adds 0; nothing shifts and nothing is rescaled:
//! - A tick without a row adds no terms. The member sits it out, and it still takes its place in the window. To the
//!   filter, a tick on which no member has a row is one that says nothing: the camera moves on all the same.
//! - A reference without a map row scores 0, which speaks neither for nor against it; where S itself is the score, the
//!   mean of the others. For `seqslam`, the neighbours that a place is compared with are the nearest references with a
//!   row.
//!
//! Scores are computed anew from the ring at each tick, so nothing drifts. What needs one row only (its z-scores, its
//! local contrast) is computed as it comes. Large maps are shared out among the threads of the current rayon pool, in
//! pieces that do not depend on their number: neither do the scores.

mod columns;
mod diagonals;
pub mod filter;
mod numpy_order;
mod paper;
mod runs;
mod seqslam;

pub use filter::ForwardFilter;

use evpr_core::plan::SequenceMethod;
use ndarray::{Array2, ArrayView2};
use paper::Paper;
use runs::Runs;
use seqslam::Lines;
use std::ops::Range;

/// Added to standard deviations, as in the authors' code.
const EPSILON: f64 = 1e-8;
/// From so many values in the window on, work is shared out among threads.
const PARALLEL_VALUES: usize = 1 << 14;

/// The rows of a window, oldest first, over the columns that the map has a row for.
#[derive(Debug, Clone, Copy)]
struct Window<'a> {
    /// L rows of `columns` values.
    ring: &'a [f64],
    columns: usize,
    /// The ticks that have a row: slot in the ring, and lag behind the newest tick.
    ticks: &'a [(usize, usize)],
}

impl<'a> Window<'a> {
    /// N.
    #[inline(always)]
    fn len(&self) -> usize {
        self.ticks.len()
    }

    /// The rows, oldest first.
    #[inline(always)]
    fn rows(self) -> impl Iterator<Item = &'a [f64]> + Clone {
        let row = move |(slot, _): &(usize, usize)| &self.ring[slot * self.columns..][..self.columns];
        self.ticks.iter().map(row)
    }

    /// Whether sharing out the work gains more than it costs.
    fn is_large(&self) -> bool {
        self.columns * self.len() >= PARALLEL_VALUES
    }
}

/// What is done with the rows of the ring.
#[derive(Debug)]
enum Method {
    /// S itself.
    Alone,
    Paper(Paper),
    /// The ring holds row z-scores.
    Rows,
    /// The ring holds local contrasts of all references.
    SeqSlam(Lines),
}

/// Sequence matching of one member, tick by tick.
///
/// Keeps a ring of the last L rows (L × references with a map row, f64); nothing is allocated after
/// [`SequenceMatcher::new`].
#[derive(Debug)]
pub struct SequenceMatcher {
    method: Method,
    /// L, at least 1. Methods without a length have 1.
    length: usize,
    references: usize,
    runs: Runs,
    /// Values per row of the ring: one per column in `runs`, or per reference.
    width: usize,
    ring: Vec<f64>,
    /// Per slot of the ring: whether its tick had a row.
    present: Vec<bool>,
    /// Slot of the newest tick.
    newest: usize,
    /// Ticks taken, counted up to L.
    taken: usize,
    /// The window's ticks that have a row, oldest first: (slot, lag).
    ticks: Vec<(usize, usize)>,
}

impl SequenceMatcher {
    /// A matcher over as many references as `valid` has entries; false where the map has no row. `length` is L in
    /// ticks; 0 counts as 1, and [`SequenceMethod::None`] and [`SequenceMethod::Filter`] have no use for more than 1.
    pub fn new(method: SequenceMethod, length: usize, valid: &[bool]) -> Self {
        let length = if method.has_length() { length.max(1) } else { 1 };
        let runs = Runs::new(valid);
        let columns = runs.columns();
        let (method, width) = match method {
            SequenceMethod::Paper if length > 1 => (Method::Paper(Paper::new(columns, length)), columns),
            SequenceMethod::Rows if length > 1 => (Method::Rows, columns),
            SequenceMethod::Filter(_) => (Method::Rows, columns),
            SequenceMethod::SeqSlam(parameters) => {
                let lines = Lines::new(parameters, length, valid.len(), columns);
                (Method::SeqSlam(lines), valid.len())
            }
            SequenceMethod::Paper | SequenceMethod::Rows | SequenceMethod::None => (Method::Alone, columns),
        };
        Self {
            method,
            length,
            references: valid.len(),
            ring: vec![0.0; length * width],
            width,
            present: vec![false; length],
            newest: length - 1,
            taken: 0,
            ticks: Vec::with_capacity(length),
            runs,
        }
    }

    /// Takes the next tick: its similarity row (R values; those of references without a map row are not read), or
    /// `None` when the member has none, because it is switched off or for whatever reason.
    ///
    /// # Panics
    /// When the row does not have one value per reference.
    pub fn push(&mut self, row: Option<&[f64]>) {
        let slot = (self.newest + 1) % self.length;
        self.newest = slot;
        self.taken = (self.taken + 1).min(self.length);
        self.present[slot] = row.is_some();
        let Some(row) = row else { return };
        assert_eq!(
            row.len(),
            self.references,
            "a similarity row has one value per reference"
        );
        let kept = &mut self.ring[slot * self.width..(slot + 1) * self.width];
        if let Method::SeqSlam(lines) = &mut self.method {
            return lines.contrast(row, &self.runs, kept);
        }
        for run in self.runs.iter() {
            kept[run.columns()].copy_from_slice(&row[run.references()]);
        }
        if let Method::Rows = self.method {
            standardise(kept);
        }
    }

    /// Changes L, after so many ticks and before the next is taken. What is in the window stays, as far as it fits: a longer
    /// one grows from there tick by tick, as it does at the start.
    #[must_use]
    pub fn with_length(self, method: SequenceMethod, length: usize, valid: &[bool]) -> Self {
        let mut longer = Self::new(method, length, valid);
        if longer.width != self.width {
            return longer;
        }
        let kept = self.taken.min(longer.length);
        for lag in (0..kept).rev() {
            let from = (self.newest + self.length - lag) % self.length;
            let to = (longer.newest + 1) % longer.length;
            let row = &self.ring[from * self.width..(from + 1) * self.width];
            let copy = &mut longer.ring[to * self.width..(to + 1) * self.width];
            copy.copy_from_slice(row);
            // With L = 1 rows are kept as they are.
            if let (Method::Rows, Method::Alone, true) = (&longer.method, &self.method, self.present[from]) {
                standardise(copy);
            }
            longer.present[to] = self.present[from];
            longer.newest = to;
        }
        longer.taken = kept;
        longer
    }

    /// How many of the last L ticks have a row, the newest included.
    pub fn history(&self) -> usize {
        self.present.iter().filter(|p| **p).count()
    }

    /// L in ticks; 1 where the method has no length.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Whether there is history enough for scores that tell places apart: `paper` wants a second row in its window,
    /// `seqslam` L ticks, with or without rows. The others always have it.
    pub fn has_history(&self) -> bool {
        match self.method {
            Method::Alone | Method::Rows => true,
            Method::Paper(_) => self.history() > 1,
            Method::SeqSlam(_) => self.taken == self.length,
        }
    }

    /// Writes S̃ of the newest tick (R values) and returns true; false, and `out` all NaN, when that tick has no row
    /// or the map has none at all: the member sits it out. A place that the method cannot score is −∞: with `seqslam`
    /// the first L − 1 references, and all of them until there are L ticks.
    ///
    /// # Panics
    /// When `out` does not have one value per reference.
    pub fn score(&mut self, out: &mut [f64]) -> bool {
        assert_eq!(out.len(), self.references, "one score per reference");
        if !self.present[self.newest] || self.runs.columns() == 0 {
            out.fill(f64::NAN);
            return false;
        }
        self.find_ticks();
        let window = Window {
            ring: &self.ring,
            columns: self.width,
            ticks: &self.ticks,
        };
        match &mut self.method {
            Method::Alone => score_alone(&self.ring, &self.runs, out),
            Method::Paper(paper) => paper.score(window, &self.runs, out),
            Method::Rows => diagonals::add(window, &self.runs, AsTheyAre, out),
            Method::SeqSlam(_) if self.taken < self.length => out.fill(f64::NEG_INFINITY),
            Method::SeqSlam(lines) => lines.score(window, &self.runs, out),
        }
        true
    }

    fn find_ticks(&mut self) {
        self.ticks.clear();
        for lag in (0..self.length).rev() {
            let slot = (self.newest + self.length - lag) % self.length;
            if self.present[slot] {
                self.ticks.push((slot, lag));
            }
        }
    }

    /// For tests: what `paper` works on.
    #[cfg(test)]
    fn paper_parts(&self) -> Option<(&Paper, Window<'_>)> {
        let window = Window {
            ring: &self.ring,
            columns: self.width,
            ticks: &self.ticks,
        };
        match &self.method {
            Method::Paper(paper) => Some((paper, window)),
            _ => None,
        }
    }
}

/// S itself, what the map does not have as the mean of the rest.
fn score_alone(row: &[f64], runs: &Runs, out: &mut [f64]) {
    if row.len() < out.len() {
        out.fill(numpy_order::sum(row, |s| s) / row.len() as f64);
    }
    for run in runs.iter() {
        out[run.references()].copy_from_slice(&row[run.columns()]);
    }
}

/// Row z-scores, in NumPy's own order: where all places are alike, only rounding errors are left, scaled by 1e8.
fn standardise(row: &mut [f64]) {
    let n = row.len() as f64;
    let mean = numpy_order::sum(row, |s| s) / n;
    row.iter_mut().for_each(|s| *s -= mean);
    let scale = (numpy_order::sum(row, |d| d * d) / n).sqrt() + EPSILON;
    row.iter_mut().for_each(|d| *d /= scale);
}

/// Terms of the diagonal sum that need nothing done to them.
#[derive(Debug, Clone, Copy)]
struct AsTheyAre;

impl diagonals::Terms for AsTheyAre {
    #[inline(always)]
    fn add(&self, out: &mut [f64], _tick: usize, row: &[f64], columns: Range<usize>) {
        for (out, z) in out.iter_mut().zip(&row[columns]) {
            *out += z;
        }
    }
}

/// Sequence matching of a whole matrix: S (Q×R, similarity of query tick q and reference j) to S̃ (Q×R), everything
/// present. The same code as the running fuser's, fed row by row. For `filter` these are the probabilities that one
/// member's rows give.
///
/// While N = 1 < L (the first tick) all scores of `paper` are 0, and the first L − 1 rows and columns of `seqslam` are
/// −∞. A `length` of 0 counts as 1. Values should be finite; NaN spreads through the statistics of its window.
pub fn sequence_match(similarity: ArrayView2<'_, f64>, length: usize, method: SequenceMethod) -> Array2<f64> {
    let mut matcher = SequenceMatcher::new(method, length, &vec![true; similarity.ncols()]);
    let mut filter = match method {
        SequenceMethod::Filter(parameters) => Some(ForwardFilter::new(parameters, similarity.ncols())),
        _ => None,
    };
    let mut scores = Array2::zeros(similarity.dim());
    let (mut row, mut out) = (vec![0.0; similarity.ncols()], vec![0.0; similarity.ncols()]);
    if row.is_empty() {
        return scores;
    }
    for (from, mut to) in similarity.rows().into_iter().zip(scores.rows_mut()) {
        row.iter_mut().zip(from).for_each(|(r, s)| *r = *s);
        matcher.push(Some(&row));
        matcher.score(&mut out);
        if let Some(filter) = &mut filter {
            filter.advance(Some(&out));
            out.copy_from_slice(filter.probabilities());
        }
        to.iter_mut().zip(&out).for_each(|(t, s)| *t = *s);
    }
    scores
}
