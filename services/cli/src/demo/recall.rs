//! Recall@1 of every ensemble, from recorded rows: the answers are computed by the fuser's own functions, with all
//! members switched off but those of the ensemble.
//!
//! A query is right when the place that is answered lies within [`TOLERANCE_M`] of where the query was. All ticks of the
//! drive count: one that is not answered is not right.

use crate::failure::Failure;
use evpr_core::plan::StreetPass;
use evpr_core::{MemberSet, Plan};
use evpr_evaluate::{Subset, SubsetKind, subsets};
use evpr_fuse::offline::{Query, answers};
use evpr_fuse::{FuseError, Map};
use evpr_store::{GroundTruth, StoreError, Traverse};
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// How far from the query's position the answered place may lie, metres.
pub(crate) const TOLERANCE_M: f64 = 5.0;

/// A kind of ensembles, for people.
pub(crate) fn kind_title(kind: SubsetKind) -> &'static str {
    match kind {
        SubsetKind::Single => "single member",
        kind => kind.name(),
    }
}

/// All ensembles of a plan, the kinds in their order.
pub(crate) fn ensembles(plan: &Plan) -> Vec<Subset> {
    subsets(plan.members.iter().map(|m| m.name.as_str()), &SubsetKind::PAPER)
}

/// A recorded drive and the map it is compared with, with the positions of both.
#[derive(Debug)]
pub(crate) struct Recorded {
    pub(crate) pass: StreetPass,
    /// The plan with its map; members and what the fuser does are of interest here.
    pub(crate) plan: Plan,
    pub(crate) map: Map,
    pub(crate) query: Query,
    pub(crate) positions: Positions,
    /// Which places are right.
    pub(crate) truth: GroundTruth,
}

/// Where places and queries are: metres east and north at the start of each tick.
#[derive(Debug, Clone)]
pub(crate) struct Positions {
    pub(crate) references: Vec<[f64; 2]>,
    pub(crate) queries: Vec<[f64; 2]>,
}

impl Positions {
    /// Right is what lies within [`TOLERANCE_M`].
    ///
    /// # Errors
    /// When there are too many right answers to be held.
    fn truth(&self) -> Result<GroundTruth, StoreError> {
        let known = |places: &[[f64; 2]]| places.iter().copied().map(Some).collect::<Vec<_>>();
        GroundTruth::from_positions(&known(&self.queries), &known(&self.references), TOLERANCE_M)
    }

    /// The reference that is nearest to a query, and how far it is, metres.
    pub(crate) fn nearest(&self, query: usize) -> Option<(usize, f64)> {
        nearest(&self.references, *self.queries.get(query)?)
    }

    /// The query that is nearest to a place, and how far it is, metres.
    pub(crate) fn nearest_query(&self, place: [f64; 2]) -> Option<(usize, f64)> {
        nearest(&self.queries, place)
    }
}

fn nearest(places: &[[f64; 2]], to: [f64; 2]) -> Option<(usize, f64)> {
    let distance_m = |place: &[f64; 2]| (to[0] - place[0]).hypot(to[1] - place[1]);
    let distances = places.iter().map(distance_m).enumerate();
    distances.min_by(|a, b| a.1.total_cmp(&b.1))
}

impl Recorded {
    /// Opens the traverse `recorded` of this drive, to be compared with the plan's map.
    ///
    /// # Errors
    /// When a traverse cannot be opened, or has ticks without a position.
    pub(crate) fn open(plan: &Plan, pass: StreetPass, recorded: &Path) -> Result<Self, Failure> {
        let map = Map::open(plan)?;
        let positions = Positions {
            references: positions(plan.map.as_deref().ok_or(FuseError::NoMap)?)?,
            queries: positions(recorded)?,
        };
        Ok(Self {
            pass,
            query: Query::open(plan, recorded)?,
            truth: positions.truth()?,
            positions,
            plan: plan.clone(),
            map,
        })
    }

    /// Per tick the reference that these members answer with sequences of `length` ticks.
    ///
    /// # Errors
    /// When rows cannot be compared, which a recorder's never are.
    pub(crate) fn answers(
        &self,
        members: &MemberSet,
        length: usize,
    ) -> Result<Vec<Option<usize>>, FuseError> {
        let mut plan = self.plan.clone();
        plan.fuse.length = length;
        let answered = answers(&plan, self.map.clone(), &self.query, |_| *members)?;
        let reference = answered
            .iter()
            .map(|(header, _)| usize::try_from(header.reference).ok());
        Ok(reference.collect())
    }
}

fn positions(traverse: &Path) -> Result<Vec<[f64; 2]>, Failure> {
    let traverse = Traverse::open(traverse)?;
    let known: Option<Vec<[f64; 2]>> = traverse.ticks().iter().map(|t| t.position).collect();
    known.ok_or_else(|| {
        Failure::new(format!(
            "{}: it has ticks without a position, so nobody can say which answers are right",
            traverse.path().display()
        ))
    })
}

/// How well one ensemble did.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct EnsembleRecall {
    pub(crate) name: String,
    /// Ticks with a right answer.
    pub(crate) right: usize,
    /// The same as a share of all ticks.
    pub(crate) recall_at_1: f64,
}

/// How well the ensembles of one kind did on one drive.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct KindRecall {
    pub(crate) kind: SubsetKind,
    pub(crate) pass: StreetPass,
    /// Sequence length L, ticks.
    pub(crate) length: usize,
    /// Ticks of the drive.
    pub(crate) ticks: usize,
    /// Mean of Recall@1 over the ensembles of this kind.
    pub(crate) mean: f64,
    /// All ensembles of this kind, best first; equals in the plan's order.
    pub(crate) ensembles: Vec<EnsembleRecall>,
}

impl KindRecall {
    /// The best ensemble of this kind.
    pub(crate) fn best(&self) -> Option<&EnsembleRecall> {
        self.ensembles.first()
    }
}

/// Recall@1 of all ensembles on a drive, one entry per kind.
///
/// # Errors
/// As [`Recorded::answers`].
pub(crate) fn measure(recorded: &Recorded, length: usize) -> Result<Vec<KindRecall>, Failure> {
    let all = ensembles(&recorded.plan);
    let ticks = recorded.query.ticks.len();
    let measured: Result<Vec<EnsembleRecall>, FuseError> = all
        .par_iter()
        .map(|ensemble| {
            let answers = recorded.answers(&ensemble.members, length)?;
            let right = recorded.truth.recall(&answers).right;
            Ok(EnsembleRecall {
                name: ensemble.name.clone(),
                right,
                recall_at_1: right as f64 / ticks.max(1) as f64,
            })
        })
        .collect();
    let measured = measured?;
    let of_kind = |kind: SubsetKind| {
        let mut ensembles: Vec<EnsembleRecall> = std::iter::zip(&all, &measured)
            .filter(|(e, _)| e.kind == kind)
            .map(|(_, recall)| recall.clone())
            .collect();
        let mean = ensembles.iter().map(|e| e.recall_at_1).sum::<f64>() / ensembles.len().max(1) as f64;
        ensembles.sort_by_key(|e| std::cmp::Reverse(e.right));
        KindRecall {
            kind,
            pass: recorded.pass,
            length,
            ticks,
            mean,
            ensembles,
        }
    };
    Ok(SubsetKind::PAPER.map(of_kind).into())
}

#[cfg(test)]
mod tests {
    use super::super::setup::Setup;
    use super::*;

    #[test]
    fn every_member_is_once_in_each_kind() {
        let setup = Setup {
            seed: 1,
            quick: false,
        };
        let plan = setup.mapping(Path::new("record")).unwrap();
        let all = ensembles(&plan);
        let expected = [(36, 1), (9, 4), (12, 3), (12, 3), (1, 36)];
        for (kind, (count, size)) in SubsetKind::PAPER.into_iter().zip(expected) {
            let of_kind: Vec<&Subset> = all.iter().filter(|e| e.kind == kind).collect();
            assert_eq!(of_kind.len(), count, "{kind:?}");
            assert!(of_kind.iter().all(|e| e.members.len() == size), "{kind:?}");
            let covered: MemberSet = of_kind
                .iter()
                .flat_map(|e| e.members.iter().collect::<Vec<_>>())
                .collect();
            assert_eq!(covered.len(), plan.members.len());
        }
        assert_eq!(all[36].name, "event_count@*/patch_norm");
        assert_eq!(all.last().unwrap().name, "*@*/*");
    }

    #[test]
    fn right_is_within_five_metres_and_beyond_the_ends_is_wrong() {
        let positions = Positions {
            references: vec![[0.0, 0.0], [6.0, 0.0], [12.0, 0.0]],
            queries: vec![[4.0, 3.0], [10.0, 0.0]],
        };
        let truth = positions.truth().unwrap();
        assert_eq!(truth.matches(0), [0, 1], "the first is exactly 5 m away");
        assert!(!truth.is_right(0, 3) && !truth.is_right(2, 0));
        assert_eq!(positions.nearest(1), Some((2, 2.0)));
        assert_eq!(positions.nearest(2), None);
    }
}
