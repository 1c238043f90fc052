//! Which references the map has rows for, as runs of neighbours.

use std::ops::Range;

/// A run of consecutive references that the map has rows for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    /// First reference.
    reference: usize,
    /// First column. Columns count valid references only.
    column: usize,
    len: usize,
}

impl Run {
    pub(super) fn references(&self) -> Range<usize> {
        self.reference..self.reference + self.len
    }

    pub(super) fn columns(&self) -> Range<usize> {
        self.column..self.column + self.len
    }
}

/// All runs of a map, ascending.
#[derive(Debug)]
pub(super) struct Runs {
    runs: Vec<Run>,
    columns: usize,
}

impl Runs {
    /// The runs of true in `valid`, which has one entry per reference.
    pub(super) fn new(valid: &[bool]) -> Self {
        let mut runs: Vec<Run> = Vec::new();
        let references = valid.iter().enumerate().filter(|(_, v)| **v);
        for (column, (reference, _)) in references.enumerate() {
            match runs.last_mut() {
                Some(run) if run.reference + run.len == reference => run.len += 1,
                _ => runs.push(Run {
                    reference,
                    column,
                    len: 1,
                }),
            }
        }
        let columns = runs.iter().map(|r| r.len).sum();
        Self { runs, columns }
    }

    /// Columns there are: references that the map has a row for.
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter()
    }

    /// The runs, or parts of them, that lie within these references.
    #[inline(always)]
    pub(super) fn within(&self, references: Range<usize>) -> impl Iterator<Item = Run> + '_ {
        let Range { start, end } = references;
        let first = self.runs.partition_point(|r| r.reference + r.len <= start);
        let runs = self.runs[first..]
            .iter()
            .take_while(move |r| r.reference.max(start) < end);
        runs.map(move |run| {
            let skipped = start.saturating_sub(run.reference);
            Run {
                reference: run.reference + skipped,
                column: run.column + skipped,
                len: (run.reference + run.len).min(end) - run.reference - skipped,
            }
        })
    }

    /// The references among these that the map has no rows for, as ranges that are not empty.
    #[inline(always)]
    pub(super) fn holes_within(&self, references: Range<usize>) -> impl Iterator<Item = Range<usize>> + '_ {
        let Range { mut start, end } = references;
        let runs = self.within(start..end).map(|run| run.references());
        let holes = runs.chain(std::iter::once(end..end)).map(move |run| {
            let hole = start..run.start;
            start = run.end;
            hole
        });
        holes.filter(|hole| !hole.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(valid: &[bool], references: Range<usize>) -> Vec<(Range<usize>, Range<usize>)> {
        let runs = Runs::new(valid);
        runs.within(references)
            .map(|r| (r.references(), r.columns()))
            .collect()
    }

    #[test]
    fn columns_count_valid_references_only() {
        let valid = [false, true, true, false, false, true];
        assert_eq!(Runs::new(&valid).columns(), 3);
        assert_eq!(cut(&valid, 0..6), [(1..3, 0..2), (5..6, 2..3)]);
        assert_eq!(cut(&[false; 4], 0..4), []);
        assert_eq!(cut(&[], 0..0), []);
    }

    #[test]
    fn holes_are_what_lies_between_runs() {
        let runs = Runs::new(&[false, true, true, false, false, true]);
        let holes = |range| runs.holes_within(range).collect::<Vec<_>>();
        assert_eq!(holes(0..6), [0..1, 3..5]);
        assert_eq!(holes(1..4), vec![3..4; 1]);
        assert_eq!(holes(1..3), []);
        let none = Runs::new(&[false; 4]);
        assert_eq!(none.holes_within(1..3).collect::<Vec<_>>(), vec![1..3; 1]);
    }

    #[test]
    fn runs_are_cut_at_both_ends() {
        let valid = [true, true, true, true, false, true];
        assert_eq!(cut(&valid, 1..3), [(1..3, 1..3)]);
        assert_eq!(cut(&valid, 3..6), [(3..4, 3..4), (5..6, 4..5)]);
        assert_eq!(cut(&valid, 4..5), []);
        assert_eq!(cut(&valid, 2..2), []);
    }
}
