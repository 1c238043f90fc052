//! Which places are right answers to which queries: from pairs, from a matrix, or from positions.

use crate::error::StoreError;
use crate::npy::NpyHeader;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Most right pairs that are held: 64 MiB.
const MAX_PAIRS: usize = 16 << 20;
/// Most queries and references each.
const MAX_SIDE: usize = 8 << 20;
/// Longest header of a matrix, bytes.
const MAX_HEADER_BYTES: u64 = 4096;
/// Longest line of a file of pairs, bytes.
const MAX_LINE_BYTES: u64 = 1024;
/// First line of a file of pairs.
const PAIRS_HEADER: [&str; 2] = ["query_id", "reference_id"];

/// What the rows of a matrix stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Orientation {
    /// A row for each query, a column for each reference.
    QueryReference,
    /// A row for each reference, a column for each query.
    ReferenceQuery,
}

impl std::fmt::Display for Orientation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::QueryReference => "[query, reference]",
            Self::ReferenceQuery => "[reference, query]",
        })
    }
}

/// Right answers: for each query the references that count as the same place. Both are ticks, counted from 0.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GroundTruth {
    references: usize,
    /// Where each query's references begin in `right`, and their end.
    starts: Vec<usize>,
    /// References in growing order, query by query.
    right: Vec<u32>,
}

/// How many queries were answered rightly.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Recall {
    /// Queries whose answer is right.
    pub right: usize,
    /// All queries.
    pub queries: usize,
    /// Queries that have a right answer at all.
    pub with_match: usize,
}

impl Recall {
    /// Recall@1 over all queries: one without a right answer counts as wrong. 0 without queries.
    pub fn of_all(&self) -> f64 {
        self.right as f64 / self.queries.max(1) as f64
    }

    /// Recall@1 over the queries that have a right answer. 0 without any.
    pub fn of_matchable(&self) -> f64 {
        self.right as f64 / self.with_match.max(1) as f64
    }
}

impl GroundTruth {
    /// Counts every reference that lies at most `tolerance_m` metres from the query as right. A tick whose position is
    /// not known has no match and is nobody's.
    ///
    /// # Errors
    /// When the tolerance is not a finite number of 0 or more, or there are too many pairs to hold (16 Mi).
    pub fn from_positions(
        queries: &[Option<[f64; 2]>],
        references: &[Option<[f64; 2]>],
        tolerance_m: f64,
    ) -> Result<Self, StoreError> {
        if !(tolerance_m >= 0.0 && tolerance_m.is_finite()) {
            let what = format!("the tolerance {tolerance_m} m is not a distance; give 0 or more");
            return Err(StoreError::GroundTruth(what));
        }
        let near = |query: &Option<[f64; 2]>, reference: &Option<[f64; 2]>| match (query, reference) {
            (Some(q), Some(r)) => (q[0] - r[0]).hypot(q[1] - r[1]) <= tolerance_m,
            _ => false,
        };
        let mut right = Vec::new();
        let mut starts = vec![0];
        for query in queries {
            let matches = (0..)
                .zip(references)
                .filter(|(_, r)| near(query, r))
                .map(|(index, _)| index);
            right.extend(matches);
            if right.len() > MAX_PAIRS {
                return Err(StoreError::GroundTruth(too_many()));
            }
            starts.push(right.len());
        }
        Ok(Self {
            references: references.len(),
            starts,
            right,
        })
    }

    /// Reads a file of lines `query_id,reference_id` below that header, for traverses of these numbers of ticks.
    ///
    /// # Errors
    /// One line: when it cannot be read, a line is no pair, or a tick is not one of the traverses'.
    pub fn from_pairs(path: &Path, queries: usize, references: usize) -> Result<Self, StoreError> {
        let wrong = |what: String| StoreError::GroundTruth(format!("{}: {what}", path.display()));
        let file = File::open(path).map_err(StoreError::io("open", path))?;
        let mut file = BufReader::new(file);
        let mut pairs = Vec::new();
        let mut text = Vec::new();
        for number in 1u64.. {
            text.clear();
            let read = file.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut text);
            if read.map_err(StoreError::io("read", path))? == 0 {
                break;
            }
            let line = std::str::from_utf8(&text).unwrap_or("\u{fffd}").trim();
            let line = line.trim_start_matches('\u{feff}');
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            if number == 1 && fields == PAIRS_HEADER || line.is_empty() {
                continue;
            }
            let pair = match fields.as_slice() {
                [query, reference] => query.parse::<usize>().ok().zip(reference.parse::<usize>().ok()),
                _ => None,
            };
            let Some((query, reference)) = pair else {
                return Err(wrong(format!(
                    "line {number} is no pair; write lines query_id,reference_id of whole numbers"
                )));
            };
            if query >= queries || reference >= references {
                return Err(wrong(format!(
                    "line {number}: query {query} and reference {reference} are not in the traverses, which have \
                     {queries} and {references} ticks; check that it belongs to them, and their slicing"
                )));
            }
            if pairs.len() >= MAX_PAIRS {
                return Err(wrong(too_many()));
            }
            pairs.push((query, reference as u32));
        }
        Self::from_list(pairs, queries, references).map_err(wrong)
    }

    /// Reads a matrix from a `.npy` file: `bool`, or 8-bit integers of which those above 0 are right. Its shape says
    /// which axis the queries are on; where both traverses have as many ticks it does not, and `orientation` must. Gives
    /// the orientation that was taken.
    ///
    /// # Errors
    /// One line: when it cannot be read, is no such matrix, or does not fit the traverses (in this orientation).
    pub fn from_npy(
        path: &Path,
        queries: usize,
        references: usize,
        orientation: Option<Orientation>,
    ) -> Result<(Self, Orientation), StoreError> {
        let wrong = |what: String| StoreError::GroundTruth(format!("{}: {what}", path.display()));
        let mut file = File::open(path).map_err(StoreError::io("open", path))?;
        let bytes = file.metadata().map_err(StoreError::io("look at", path))?.len();
        let mut head = Vec::new();
        let read = file.by_ref().take(MAX_HEADER_BYTES).read_to_end(&mut head);
        read.map_err(StoreError::io("read", path))?;
        let (header, start) = NpyHeader::decode(&head).map_err(wrong)?;
        if !["|b1", "|u1", "|i1"].contains(&header.descr.as_str()) {
            let found = &header.descr;
            return Err(wrong(format!(
                "its items are {found}; save booleans, as numpy.save(…, matrix.astype(bool)) does"
            )));
        }
        let &[rows, columns] = header.shape.as_slice() else {
            return Err(wrong(format!(
                "its shape is {:?}; a matrix has two axes",
                header.shape
            )));
        };
        let fits = |o| match o {
            Orientation::QueryReference => (rows, columns) == (queries as u64, references as u64),
            Orientation::ReferenceQuery => (rows, columns) == (references as u64, queries as u64),
        };
        let both = [Orientation::QueryReference, Orientation::ReferenceQuery];
        let orientation = match orientation {
            Some(given) if fits(given) => given,
            None if both.into_iter().all(fits) => {
                return Err(wrong(format!(
                    "is {rows}×{columns} and both traverses have {queries} ticks, so its shape does not say whether it \
                     is {} or {}; say which",
                    both[0], both[1]
                )));
            }
            given => match both.into_iter().find(|o| given.is_none() && fits(*o)) {
                Some(found) => found,
                None => {
                    let asked = given.map_or_else(String::new, |g| format!(" as {g}"));
                    return Err(wrong(format!(
                        "its shape ({rows}, {columns}) does not fit{asked}: the query has {queries} ticks, the reference \
                         {references}"
                    )));
                }
            },
        };
        if queries > MAX_SIDE || references > MAX_SIDE || bytes != start as u64 + rows * columns {
            return Err(wrong(format!(
                "has {bytes} bytes where {rows}×{columns} items and its header are {}; it is damaged",
                (start as u64).saturating_add(rows.saturating_mul(columns))
            )));
        }
        let rest = std::io::Cursor::new(head.split_off(start)).chain(file);
        let mut rest = BufReader::new(rest);
        // In memory the axis that varies fastest comes last.
        let by_query = (orientation == Orientation::QueryReference) != header.fortran_order;
        let (outer, inner) = if by_query {
            (queries, references)
        } else {
            (references, queries)
        };
        let mut line = vec![0; inner];
        let mut pairs = Vec::new();
        for one in 0..outer {
            rest.read_exact(&mut line).map_err(StoreError::io("read", path))?;
            for (other, _) in line.iter().enumerate().filter(|(_, item)| **item as i8 > 0) {
                let (query, reference) = if by_query { (one, other) } else { (other, one) };
                pairs.push((query, reference as u32));
            }
            if pairs.len() > MAX_PAIRS {
                return Err(wrong(too_many()));
            }
        }
        let truth = Self::from_list(pairs, queries, references).map_err(wrong)?;
        Ok((truth, orientation))
    }

    /// Of pairs that lie inside.
    fn from_list(mut pairs: Vec<(usize, u32)>, queries: usize, references: usize) -> Result<Self, String> {
        if queries > MAX_SIDE || references > MAX_SIDE {
            return Err(format!("the traverses have more than {MAX_SIDE} ticks"));
        }
        pairs.sort_unstable();
        pairs.dedup();
        let starts = (0..=queries).map(|query| pairs.partition_point(|(q, _)| *q < query));
        Ok(Self {
            references,
            starts: starts.collect(),
            right: pairs.iter().map(|(_, reference)| *reference).collect(),
        })
    }

    /// The same, with all references that lie at most `frames` ticks from a right one counted as right too.
    ///
    /// # Errors
    /// When there are too many pairs to hold (16 Mi).
    pub fn widened(&self, frames: usize) -> Result<Self, StoreError> {
        let mut starts = vec![0];
        let mut right = Vec::new();
        for query in 0..self.queries() {
            let mut next = 0;
            for reference in self.matches(query) {
                let reference = *reference as usize;
                let from = reference.saturating_sub(frames).max(next);
                next = reference
                    .saturating_add(frames)
                    .saturating_add(1)
                    .min(self.references);
                if right.len() + next.saturating_sub(from) > MAX_PAIRS {
                    return Err(StoreError::GroundTruth(too_many()));
                }
                right.extend((from..next).map(|r| r as u32));
            }
            starts.push(right.len());
        }
        Ok(Self {
            references: self.references,
            starts,
            right,
        })
    }

    /// Number of queries.
    pub fn queries(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of references.
    pub fn references(&self) -> usize {
        self.references
    }

    /// The references that are right answers to a query, in growing order; none for a query beyond the end.
    pub fn matches(&self, query: usize) -> &[u32] {
        let (start, end) = (self.starts.get(query), self.starts.get(query + 1));
        let range = start.zip(end).map(|(start, end)| *start..*end);
        range.and_then(|range| self.right.get(range)).unwrap_or_default()
    }

    /// Whether this reference is a right answer to this query.
    pub fn is_right(&self, query: usize, reference: usize) -> bool {
        let reference = u32::try_from(reference);
        reference.is_ok_and(|reference| self.matches(query).binary_search(&reference).is_ok())
    }

    /// Queries that have a right answer.
    pub fn with_match(&self) -> usize {
        self.starts.windows(2).filter(|w| w[0] < w[1]).count()
    }

    /// How many of these answers, one for each query from the first on, are right. No answer is a wrong one, and so are
    /// those that are missing at the end.
    pub fn recall(&self, answers: &[Option<usize>]) -> Recall {
        let right =
            |(query, answer): (usize, &Option<usize>)| answer.is_some_and(|r| self.is_right(query, r));
        Recall {
            right: answers.iter().enumerate().filter(|a| right(*a)).count(),
            queries: self.queries(),
            with_match: self.with_match(),
        }
    }
}

fn too_many() -> String {
    format!(
        "more than {MAX_PAIRS} pairs are right; that is more than can be held, so make the tolerance smaller"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().unwrap()
    }

    fn npy(path: &Path, descr: &str, fortran: bool, shape: &str, items: &[u8]) {
        let order = if fortran { "True" } else { "False" };
        let text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(items);
        std::fs::write(path, bytes).unwrap();
    }

    /// Query 0 has references 1 and 2, query 1 none.
    fn two_by_three() -> GroundTruth {
        GroundTruth::from_list(vec![(0, 2), (0, 1), (0, 2)], 2, 3).unwrap()
    }

    #[test]
    fn positions_within_the_tolerance_are_right() {
        let queries = [Some([4.0, 3.0]), Some([10.0, 0.0]), None, Some([99.0, 0.0])];
        let references = [Some([0.0, 0.0]), Some([6.0, 0.0]), None, Some([12.0, 0.0])];
        let truth = GroundTruth::from_positions(&queries, &references, 5.0).unwrap();
        assert_eq!(truth.matches(0), [0, 1], "exactly 5 m counts");
        assert_eq!(truth.matches(1), [1, 3]);
        assert!(truth.matches(2).is_empty() && truth.matches(3).is_empty() && truth.matches(4).is_empty());
        assert!(truth.is_right(1, 3) && !truth.is_right(1, 2) && !truth.is_right(9, 0));
        assert!(!truth.is_right(0, usize::MAX));
        assert_eq!(
            (truth.queries(), truth.references(), truth.with_match()),
            (4, 4, 2)
        );
        let recall = truth.recall(&[Some(1), Some(0), Some(2), None]);
        assert_eq!(
            (recall.right, recall.of_all(), recall.of_matchable()),
            (1, 0.25, 0.5)
        );
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(GroundTruth::from_positions(&queries, &references, bad).is_err());
        }
    }

    #[test]
    fn widened_by_frames_without_going_past_the_ends() {
        let truth = GroundTruth::from_list(vec![(0, 0), (0, 2), (0, 7), (2, 9)], 3, 10).unwrap();
        assert_eq!(truth.widened(0).unwrap(), truth);
        let wide = truth.widened(1).unwrap();
        assert_eq!(wide.matches(0), [0, 1, 2, 3, 6, 7, 8]);
        assert_eq!((wide.matches(1), wide.matches(2)), (&[][..], &[8, 9][..]));
        assert_eq!(truth.widened(99).unwrap().matches(2).len(), 10);
    }

    #[test]
    fn pairs_are_read_and_checked() {
        let folder = folder();
        let path = folder.path().join("pairs.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            GroundTruth::from_pairs(&path, 2, 3)
        };
        assert_eq!(
            read("query_id,reference_id\r\n0,2\n0,1\n\n0, 2").unwrap(),
            two_by_three()
        );
        for (text, words) in [
            ("0,1\nquery_id,reference_id\n", "line 2 is no pair"),
            ("query_id,reference_id\n0,1.5\n", "line 2 is no pair"),
            ("query_id,reference_id\n0\n", "line 2 is no pair"),
            (
                "0,3\n",
                "line 1: query 0 and reference 3 are not in the traverses",
            ),
            ("2,0\n", "have 2 and 3 ticks"),
            ("\u{1}\u{2}", "line 1 is no pair"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(
                error.contains(words) && error.lines().count() == 1,
                "{text:?}: {error}"
            );
        }
        std::fs::write(&path, [b'7'; 5000]).unwrap();
        assert!(GroundTruth::from_pairs(&path, 2, 3).is_err());
        assert!(GroundTruth::from_pairs(&folder.path().join("none"), 2, 3).is_err());
    }

    #[test]
    fn matrices_are_read_in_either_orientation_and_order() {
        let folder = folder();
        let path = folder.path().join("truth.npy");
        let by_query = [0, 1, 1, 0, 0, 0];
        let by_reference = [0, 0, 1, 0, 1, 0];
        for (fortran, shape, items, expected) in [
            (false, "(2, 3)", by_query, Orientation::QueryReference),
            (true, "(2, 3)", by_reference, Orientation::QueryReference),
            (false, "(3, 2)", by_reference, Orientation::ReferenceQuery),
            (true, "(3, 2)", by_query, Orientation::ReferenceQuery),
        ] {
            npy(&path, "|b1", fortran, shape, &items);
            for given in [None, Some(expected)] {
                let found = GroundTruth::from_npy(&path, 2, 3, given).unwrap();
                assert_eq!(found, (two_by_three(), expected), "{shape} {fortran}");
            }
        }
        npy(&path, "|i1", false, "(2, 3)", &[0, 1, 1, 255, 0, 0]);
        assert_eq!(
            GroundTruth::from_npy(&path, 2, 3, None).unwrap().0,
            two_by_three(),
            "-1 is not right"
        );
    }

    #[test]
    fn a_square_matrix_needs_to_be_told() {
        let folder = folder();
        let path = folder.path().join("square.npy");
        npy(&path, "|b1", false, "(2, 2)", &[0, 1, 0, 0]);
        let error = GroundTruth::from_npy(&path, 2, 2, None).unwrap_err().to_string();
        assert!(error.contains("say which"), "{error}");
        let matches = |o| GroundTruth::from_npy(&path, 2, 2, Some(o)).unwrap().0;
        assert_eq!(matches(Orientation::QueryReference).matches(0), [1]);
        assert_eq!(matches(Orientation::ReferenceQuery).matches(1), [0]);
    }

    #[test]
    fn matrices_that_do_not_fit_are_refused() {
        let folder = folder();
        let path = folder.path().join("bad.npy");
        let refused = |given, words: &str| {
            let error = GroundTruth::from_npy(&path, 2, 3, given).unwrap_err().to_string();
            assert!(
                error.contains(words) && error.lines().count() == 1,
                "{words}: {error}"
            );
        };
        npy(&path, "|b1", false, "(2, 4)", &[0; 8]);
        refused(
            None,
            "its shape (2, 4) does not fit: the query has 2 ticks, the reference 3",
        );
        npy(&path, "|b1", false, "(2, 3)", &[0; 6]);
        refused(
            Some(Orientation::ReferenceQuery),
            "does not fit as [reference, query]",
        );
        npy(&path, "|b1", false, "(2, 3)", &[0; 5]);
        refused(None, "it is damaged");
        npy(&path, "<f4", false, "(2, 3)", &[0; 24]);
        refused(None, "its items are <f4");
        npy(&path, "|b1", false, "(6,)", &[0; 6]);
        refused(None, "two axes");
        std::fs::write(&path, b"\x93NUM").unwrap();
        refused(None, ".npy");
    }
}
