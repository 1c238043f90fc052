//! The one place that knows how `evpr-fuse` turns similarities into answers.

use crate::outcome::Outcome;
use crate::pair::Pair;
use crate::spec::Configuration;
use evpr_core::plan::SequenceMethod;
use evpr_fuse::SequenceMatcher;
use evpr_fuse::ensemble::{Ensemble, Part};

/// Bytes that a sequence matcher keeps for each reference, at most: its ring, and room for statistics.
pub(crate) fn matcher_bytes(length: usize) -> u64 {
    8 * (length as u64 + 8)
}

/// Bytes that a configuration keeps for each reference, at most: fused scores, what is eligible, and the two rows of a
/// filter.
pub(crate) const FUSION_BYTES: u64 = 25;

/// Sequence matching of one member.
#[derive(Debug)]
pub(crate) struct Lane {
    matcher: SequenceMatcher,
}

impl Lane {
    pub(crate) fn new(method: SequenceMethod, length: usize, valid: &[bool]) -> Self {
        Self {
            matcher: SequenceMatcher::new(method, length, valid),
        }
    }

    /// Takes the next tick's similarities, or that there are none, and writes its scores. Gives what the tick has.
    pub(crate) fn advance(&mut self, row: Option<&[f64]>, scores: &mut [f64]) -> Matched {
        self.matcher.push(row);
        if row.is_none() || !self.matcher.score(scores) {
            return Matched::Nothing;
        }
        if self.matcher.has_history() {
            Matched::Scores
        } else {
            Matched::Alone
        }
    }
}

/// What a member has at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Matched {
    /// No row.
    Nothing,
    /// A row, but too few before it.
    Alone,
    /// Scores.
    Scores,
}

/// What a member brings to a tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scored<'a> {
    pub(crate) matched: Matched,
    pub(crate) scores: &'a [f64],
    pub(crate) valid: &'a [bool],
}

/// One configuration under way.
#[derive(Debug)]
pub(crate) struct Fusion {
    /// Members and their weights; those of weight 0 are left out.
    members: Vec<(usize, f64)>,
    ensemble: Ensemble,
    pub(crate) outcomes: Vec<Outcome>,
}

impl Fusion {
    /// `weight` gives the weight of each member.
    pub(crate) fn new(
        pair: &Pair,
        configuration: &Configuration,
        exclusion: usize,
        weight: impl Fn(usize) -> f64,
    ) -> Self {
        let members = configuration.subset.members.iter().map(|m| (m, weight(m)));
        let ensemble = Ensemble::new(pair.references(), 1, exclusion).with_rule(configuration.rule);
        Self {
            members: members.filter(|(_, weight)| *weight != 0.0).collect(),
            ensemble: match configuration.method {
                SequenceMethod::Filter(filter) => ensemble.with_filter(filter),
                _ => ensemble,
            },
            outcomes: Vec::with_capacity(pair.queries()),
        }
    }

    /// The fused scores of the last tick.
    pub(crate) fn fused(&self) -> &[f64] {
        self.ensemble.fused()
    }

    /// Answers the next tick. `scored` gives what a member has, `right` are the right places.
    pub(crate) fn advance<'a>(&mut self, scored: impl Fn(usize) -> Scored<'a>, right: &[u32]) {
        let there = |(member, weight): &(usize, f64)| {
            let scored = scored(*member);
            (scored.matched != Matched::Nothing).then_some((scored, *weight))
        };
        let alone = self
            .members
            .iter()
            .filter_map(there)
            .all(|(s, _)| s.matched == Matched::Alone);
        let parts = self
            .members
            .iter()
            .filter_map(there)
            .map(|(scored, weight)| Part {
                scores: scored.scores,
                valid: scored.valid,
                weight,
            });
        let best = self.ensemble.fuse(parts);
        let outcome = match best.filter(|_| !alone) {
            None => Outcome::NONE,
            Some(best) => Outcome::new(
                best.reference as u32,
                best.confidence,
                self.ensemble.fused(),
                self.ensemble.eligible(),
                right,
            ),
        };
        self.outcomes.push(outcome);
    }
}
