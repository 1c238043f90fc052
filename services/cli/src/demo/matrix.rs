//! The fused scores of all members: every query against every place.

use super::recall::Recorded;
use crate::failure::Failure;
use evpr_core::MemberSet;
use evpr_fuse::offline::answers;

/// Fused scores E, queries × references, and the answers made of them.
#[derive(Debug)]
pub(crate) struct ScoreMatrix {
    /// Places of the map.
    pub(crate) references: usize,
    /// Per query one score per reference, NaN where no member has a row; an unanswered query has none at all.
    pub(crate) rows: Vec<Vec<f64>>,
    /// Per query the reference that is answered.
    pub(crate) answers: Vec<Option<usize>>,
}

impl ScoreMatrix {
    /// The value below which the share `q` (0 to 1) of all scores lies; `None` without scores.
    pub(crate) fn quantile(&self, q: f64) -> Option<f64> {
        let mut all: Vec<f64> = self
            .rows
            .iter()
            .flatten()
            .copied()
            .filter(|v| v.is_finite())
            .collect();
        all.sort_by(f64::total_cmp);
        let last = all.len().checked_sub(1)?;
        all.get((last as f64 * q).round() as usize).copied()
    }
}

/// Computes the matrix of all members with the plan's sequence length.
///
/// # Errors
/// When rows cannot be compared, which a recorder's never are.
pub(crate) fn fused(recorded: &Recorded) -> Result<ScoreMatrix, Failure> {
    let mut plan = recorded.plan.clone();
    // Every place is a candidate: the candidates are then the whole row.
    plan.fuse.top = recorded.map.references;
    let everybody: MemberSet = (0..plan.members.len()).collect();
    let references = recorded.map.references;
    let mut matrix = ScoreMatrix {
        references,
        rows: Vec::new(),
        answers: Vec::new(),
    };
    for (header, candidates) in answers(&plan, recorded.map.clone(), &recorded.query, |_| everybody)? {
        let mut row = vec![f64::NAN; if candidates.is_empty() { 0 } else { references }];
        for candidate in &candidates {
            if let Some(score) = row.get_mut(candidate.reference as usize) {
                *score = candidate.score;
            }
        }
        matrix.rows.push(row);
        matrix.answers.push(usize::try_from(header.reference).ok());
    }
    Ok(matrix)
}
