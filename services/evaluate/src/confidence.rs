//! Confidence: how far it can be trusted, and where to put a threshold.

use crate::outcome::Outcome;
use crate::results::Row;
use serde::{Deserialize, Serialize};

/// Bins of confidence from 0 to 1: thresholds are multiples of 1/1000.
const BINS: usize = 1000;
/// Rows of a calibration table.
const DECILES: usize = 10;

/// The answers of one bin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bin {
    /// Confidence from this many thousandths on, below the next.
    pub from: u32,
    /// Answers in it.
    pub answers: u32,
    /// Of them, those that are right.
    pub right: u32,
}

/// The bins that have answers, ascending.
pub(crate) fn bins(outcomes: &[Outcome]) -> Vec<Bin> {
    let mut all = [(0u32, 0u32); BINS + 1];
    for outcome in outcomes.iter().filter(|o| o.answer.is_some()) {
        let bin = &mut all[((outcome.confidence * BINS as f64) as usize).min(BINS)];
        bin.0 += 1;
        bin.1 += u32::from(outcome.is_right());
    }
    let there = (0u32..).zip(all).filter(|(_, (answers, _))| *answers > 0);
    there
        .map(|(from, (answers, right))| Bin { from, answers, right })
        .collect()
}

/// What answers of at least some confidence are worth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Trust {
    /// The least confidence.
    pub confidence: f64,
    /// Answers of at least this confidence.
    pub answers: u32,
    /// The share of them that is right; 1 without any.
    pub precision: f64,
    /// The right ones of them as a share of the queries that have a right place.
    pub recall: f64,
}

impl Row {
    /// What answers of at least this confidence are worth. Confidences are known to a thousandth, rounded down.
    pub fn trust(&self, confidence: f64) -> Trust {
        let least = (confidence * BINS as f64 - 1e-9).ceil();
        let bins = self
            .measures
            .confidence
            .iter()
            .filter(|b| f64::from(b.from) >= least);
        let (answers, right) = bins.fold((0, 0), |(a, r), b| (a + b.answers, r + b.right));
        Trust {
            confidence,
            answers,
            precision: if answers == 0 {
                1.0
            } else {
                f64::from(right) / f64::from(answers)
            },
            recall: f64::from(right) / self.measures.matchable.max(1) as f64,
        }
    }

    /// The lowest threshold, in thousandths, at and above which at least this share of the answers is right, and hence the
    /// one that keeps most of them; `None` where there is none with an answer.
    pub fn threshold(&self, wanted_precision: f64) -> Option<Trust> {
        let candidates = self.measures.confidence.iter();
        candidates
            .map(|bin| self.trust(f64::from(bin.from) / BINS as f64))
            .find(|trust| trust.precision >= wanted_precision)
    }

    /// Per tenth of confidence the answers, and how many of them are right.
    pub fn calibration(&self) -> [Bin; 10] {
        let mut table = [Bin {
            from: 0,
            answers: 0,
            right: 0,
        }; DECILES];
        for (at, row) in (0u32..).zip(&mut table) {
            row.from = at * (BINS / DECILES) as u32;
        }
        for bin in &self.measures.confidence {
            let row = &mut table[(bin.from as usize / (BINS / DECILES)).min(DECILES - 1)];
            row.answers += bin.answers;
            row.right += bin.right;
        }
        table
    }
}
