//! Matrices of scores as pictures: queries down, places across, with what is true, right and wrong.

use super::picture::{Anchor, Color, Picture, fitted};
use super::raster::Raster;
use crate::outcome::Outcome;
use crate::pair::Pair;

/// Longest side of a matrix, pixels.
const SIDE: usize = 260;
/// The same on the page.
const SHOWN: f64 = 260.0;
/// Levels of grey: fewer make smaller files, and more are not seen.
const LEVELS: f64 = 15.0;

/// Means of blocks of scores, taken as the scores come.
#[derive(Debug)]
pub(super) struct Grid {
    queries: usize,
    references: usize,
    height: usize,
    width: usize,
    sums: Vec<(f64, u32)>,
}

impl Grid {
    pub(super) fn new(queries: usize, references: usize) -> Self {
        let (height, width) = (queries.clamp(1, SIDE), references.clamp(1, SIDE));
        Self {
            queries: queries.max(1),
            references: references.max(1),
            height,
            width,
            sums: vec![(0.0, 0); height * width],
        }
    }

    /// Adds the scores of a query; what is not finite is left out.
    pub(super) fn add(&mut self, query: usize, scores: &[f64]) {
        let row = query * self.height / self.queries;
        for (reference, score) in scores.iter().enumerate().filter(|(_, s)| s.is_finite()) {
            let at = row * self.width + reference * self.width / self.references;
            if let Some(sum) = self.sums.get_mut(at) {
                *sum = (sum.0 + score, sum.1 + 1);
            }
        }
    }

    fn means(&self) -> Vec<Option<f64>> {
        let mean = |(sum, count): &(f64, u32)| (*count > 0).then(|| sum / f64::from(*count));
        self.sums.iter().map(mean).collect()
    }
}

/// A matrix with its title.
#[derive(Debug)]
pub(super) struct Panel {
    title: String,
    recall: f64,
    image: Raster,
    queries: usize,
    references: usize,
}

impl Panel {
    pub(super) fn new(title: String, grid: Grid, pair: &Pair, outcomes: &[Outcome]) -> Self {
        let means = grid.means();
        let mut known: Vec<f64> = means.iter().copied().flatten().collect();
        known.sort_by(f64::total_cmp);
        // A few outliers must not take all the greys.
        let at = |share: f64| known.get((share * known.len().saturating_sub(1) as f64) as usize);
        let (low, high) = (
            at(0.02).copied().unwrap_or(0.0),
            at(0.998).copied().unwrap_or(1.0),
        );
        // Small matrices are drawn larger, in whole pixels.
        let zoom = (SIDE / grid.width.max(grid.height)).max(1);
        let (width, height) = (grid.width * zoom, grid.height * zoom);
        let mut image = Raster::filled(width, height, [0xff; 3]);
        for (at, pixel) in image.pixels.iter_mut().enumerate() {
            let (y, x) = (at / width / zoom, at % width / zoom);
            if let Some(mean) = means.get(y * grid.width + x).copied().flatten() {
                let share = ((mean - low) / (high - low).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                let level = 250.0 - 190.0 * (share * LEVELS).round() / LEVELS;
                *pixel = [level as u8; 3];
            }
        }
        let place = |query: usize, reference: usize| {
            let x = (reference * width + width / 2) / grid.references;
            let y = (query * height + height / 2) / grid.queries;
            (x.min(width - 1), y.min(height - 1))
        };
        for query in 0..pair.queries() {
            for right in pair.truth.matches(query) {
                let (x, y) = place(query, *right as usize);
                image.mark(x, y, usize::from(zoom > 2), Color::Truth.rgb());
            }
        }
        let mut right = 0;
        for (query, outcome) in outcomes.iter().enumerate() {
            if let Some(answer) = outcome.answer {
                let (x, y) = place(query, answer as usize);
                let color = if outcome.is_right() {
                    Color::Right
                } else {
                    Color::Wrong
                };
                image.mark(x, y, 1, color.rgb());
            }
            right += usize::from(outcome.is_right());
        }
        Self {
            title,
            recall: right as f64 / outcomes.len().max(1) as f64,
            image,
            queries: grid.queries,
            references: grid.references,
        }
    }

    pub(super) fn picture(&self, name: &str, pair: &str) -> Picture {
        let (left, top) = (30.0, 24.0);
        // Each as large as the others.
        let larger = SHOWN / self.image.width.max(self.image.height).max(1) as f64;
        let (width, height) = (
            self.image.width as f64 * larger,
            self.image.height as f64 * larger,
        );
        let whole = left + SHOWN + 10.0;
        let caption = format!("{pair}: {}. Recall@1 {:.3}.", self.title, self.recall);
        let mut picture = Picture::new(name, &caption, whole, top + height + 40.0);
        let title = fitted(&self.title, super::picture::LETTERS, whole - 8.0);
        picture.text((4.0, 14.0), &title, Anchor::Start, Color::Ink);
        picture.image((left, top), (width, height), self.image.clone());
        picture.text((left - 4.0, top + 10.0), "0", Anchor::End, Color::Faint);
        picture.text(
            (left - 4.0, top + height),
            &self.queries.to_string(),
            Anchor::End,
            Color::Faint,
        );
        let places = format!("place 0 … {}", self.references);
        picture.text((left, top + height + 14.0), &places, Anchor::Start, Color::Faint);
        picture.height = picture.legend(top + height + 18.0, &legend());
        picture
    }
}

fn legend() -> Vec<(String, Color)> {
    let entries = [
        ("true", Color::Truth),
        ("right", Color::Right),
        ("wrong", Color::Wrong),
    ];
    entries.map(|(name, color)| (name.to_owned(), color)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_means_of_what_is_known() {
        let mut grid = Grid::new(2 * SIDE, 2);
        grid.add(0, &[1.0, f64::NEG_INFINITY]);
        grid.add(1, &[3.0, f64::NAN]);
        grid.add(2, &[5.0, 7.0]);
        let means = grid.means();
        assert_eq!(means[..4], [Some(2.0), None, Some(5.0), Some(7.0)]);
        assert_eq!(means.len(), 2 * SIDE);
    }
}
