//! A closer look at one configuration of each pair: its scores as a matrix beside those of some of its members, its worst
//! and best queries, and where it errs.

use super::MAX_PAIRS;
use super::matrix::{Grid, Panel};
use super::raster::Raster;
use super::view::{View, recall};
use crate::error::EvaluateError;
use crate::fusion::{Fusion, Lane, Matched, Scored};
use crate::measure::{distances_m, frames_off};
use crate::outcome::Outcome;
use crate::pair::Pair;
use crate::results::Row;
use crate::spec::{Configuration, Spec};
use crate::subsets::{MemberName, SubsetKind};
use evpr_core::MemberSet;
use evpr_fuse::similarity::similarity;
use rayon::prelude::*;

/// Most scores that are computed again for a look; of larger pairs a smaller ensemble is looked at.
const MAX_SCORES: usize = 64 << 20;
/// Most members with a matrix of their own.
const MAX_MEMBERS: usize = 4;
/// Queries of each sort that are shown.
const WORST: usize = 3;
const BEST: usize = 2;

/// A query with its answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// The query's tick.
    pub query: usize,
    /// The answered place: a tick of the map.
    pub answer: usize,
    /// The right place nearest to the answer.
    pub right: usize,
    /// Of the answer.
    pub confidence: f64,
    /// Whether the answer is right.
    pub is_right: bool,
    /// How far the answer is, metres, where that is known.
    pub(super) error_m: Option<f64>,
    /// How far the answer is from a right place, ticks of the map.
    pub(super) error_ticks: Option<usize>,
    /// Frames of the query, the answered place and the right place.
    pub frames: [Option<Raster>; 3],
}

/// A closer look at a pair.
#[derive(Debug)]
pub struct Look {
    pub(super) pair: String,
    pub(super) title: String,
    members: Vec<String>,
    pub(super) panels: Vec<Panel>,
    pub(super) outcomes: Vec<Outcome>,
    pub(super) errors_m: Vec<Option<f64>>,
    pub(super) errors_ticks: Vec<Option<usize>>,
    shown: Vec<Shown>,
    frames: Frames,
}

/// Whose frames are shown, or why none are.
#[derive(Debug)]
pub(super) enum Frames {
    NotAsked,
    Of(String),
    Failed(String),
}

impl Look {
    /// The pair's name.
    pub fn pair(&self) -> &str {
        &self.pair
    }

    /// Names of members of the ensemble that is looked at, or of the best ensemble of reconstructions.
    pub fn members(&self) -> &[String] {
        &self.members
    }

    /// The queries that are shown: wrong ones first, of falling confidence.
    pub fn shown(&self) -> &[Shown] {
        &self.shown
    }

    /// Gives the frames of every shown query, and what they are of, in a few words.
    pub fn set_frames(&mut self, what: String, frames: Vec<[Option<Raster>; 3]>) {
        for (shown, frames) in self.shown.iter_mut().zip(frames) {
            shown.frames = frames;
        }
        self.frames = Frames::Of(what);
    }

    /// Says why there are no frames.
    pub fn set_no_frames(&mut self, why: String) {
        self.frames = Frames::Failed(why);
    }

    pub(super) fn frames(&self) -> &Frames {
        &self.frames
    }
}

/// Looks at the first pairs: at the ensemble of all members, or where that is too large or was not evaluated at the best
/// of reconstructions, or else at the best one.
///
/// # Errors
/// As [`evaluate`](crate::evaluate).
pub fn looks(pairs: &[Pair], rows: &[Row], spec: &Spec) -> Result<Vec<Look>, EvaluateError> {
    let Some(view) = View::new(rows, pairs) else {
        return Ok(Vec::new());
    };
    let mut all = Vec::new();
    for pair in pairs.iter().take(MAX_PAIRS) {
        all.extend(look(pair, &view, spec)?);
    }
    Ok(all)
}

fn look(pair: &Pair, view: &View<'_>, spec: &Spec) -> Result<Option<Look>, EvaluateError> {
    let plain = Spec {
        weights: None,
        ..spec.clone()
    };
    let configurations = plain.configurations(&pair.members)?;
    let find = |row: &Row| configurations.iter().find(|c| c.key(&pair.name) == row.key);
    let rows = || {
        view.main_rows()
            .filter(|r| r.pair == pair.name && find(r).is_some())
    };
    let best_of = |kind: SubsetKind| {
        rows()
            .filter(|r| r.kind == kind && r.members > 1)
            .max_by(|a, b| recall(a).total_cmp(&recall(b)))
    };
    let scores = |r: &Row| r.members * pair.queries() * pair.references();
    let combined = best_of(SubsetKind::Combined).filter(|r| scores(r) <= MAX_SCORES);
    let parts = best_of(SubsetKind::Reconstruction);
    let any = || rows().max_by(|a, b| recall(a).total_cmp(&recall(b)));
    let Some(shown) = combined.or(parts).or_else(any) else {
        return Ok(None);
    };
    let Some(main) = find(shown) else { return Ok(None) };
    // Beside it, as in the paper: the best ensemble of reconstructions with its members.
    let beside = parts.and_then(find).unwrap_or(main);
    let of_main = |members: MemberSet, name: &str, kind: SubsetKind| Configuration {
        subset: crate::Subset {
            kind,
            name: name.to_owned(),
            members,
        },
        ..main.clone()
    };
    let mut wanted: Vec<Configuration> = beside
        .subset
        .members
        .iter()
        .take(MAX_MEMBERS)
        .map(|m| of_main(std::iter::once(m).collect(), &pair.members[m], SubsetKind::Single))
        .collect();
    if beside.subset != main.subset {
        wanted.push(of_main(
            beside.subset.members,
            &beside.subset.name,
            beside.subset.kind,
        ));
    }
    if main.subset.members.len() > 1 {
        wanted.push(main.clone());
    }
    let (panels, outcomes) = compute(pair, &plain, &wanted);
    let errors_m = distances_m(pair, &outcomes);
    let errors_ticks = frames_off(pair, &outcomes);
    let mut found = Look {
        pair: pair.name.clone(),
        title: format!(
            "{} {}, {} L={}, {}, {}",
            shown.kind.name(),
            shown.subset,
            shown.method,
            shown.length,
            shown.rule,
            shown.similarity
        ),
        members: beside
            .subset
            .members
            .iter()
            .map(|m| pair.members[m].clone())
            .collect(),
        panels,
        outcomes,
        errors_m,
        errors_ticks,
        shown: Vec::new(),
        frames: Frames::NotAsked,
    };
    found.shown = choose(pair, &found);
    Ok(Some(found))
}

/// The matrices of all configurations, which are of one similarity, method and length, and the outcomes of the last.
fn compute(pair: &Pair, spec: &Spec, wanted: &[Configuration]) -> (Vec<Panel>, Vec<Outcome>) {
    let Some(last) = wanted.last() else {
        return (Vec::new(), Vec::new());
    };
    let mut members = MemberSet::default();
    for c in wanted {
        c.subset.members.iter().for_each(|m| members.set(m, true));
    }
    struct Member {
        at: usize,
        lane: Lane,
        similarities: Vec<f64>,
        scores: Vec<f64>,
        matched: Matched,
    }
    let references = pair.references();
    let mut states: Vec<Member> = members
        .iter()
        .map(|at| Member {
            at,
            lane: Lane::new(last.method, last.length, pair.rows[at].reference.present()),
            similarities: vec![0.0; references],
            scores: vec![0.0; references],
            matched: Matched::Nothing,
        })
        .collect();
    let mut place = vec![0; pair.members.len()];
    states.iter().enumerate().for_each(|(i, m)| place[m.at] = i);
    let mut fusions: Vec<(Fusion, Grid)> = wanted
        .iter()
        .map(|c| {
            let grid = Grid::new(pair.queries(), references);
            (Fusion::new(pair, c, spec.exclusion, |_| 1.0), grid)
        })
        .collect();
    for query in 0..pair.queries() {
        states.par_iter_mut().for_each(|m| {
            let rows = &pair.rows[m.at];
            let present = rows.query.present()[query];
            if present {
                let (map, valid) = (rows.reference.rows(), rows.reference.present());
                similarity(
                    last.similarity,
                    rows.query.row(query),
                    map,
                    valid,
                    &mut m.similarities,
                );
            }
            m.matched = m.lane.advance(present.then_some(&m.similarities), &mut m.scores);
        });
        let states = &states;
        fusions.par_iter_mut().for_each(|(fusion, grid)| {
            let scored = |m: usize| Scored {
                matched: states[place[m]].matched,
                scores: &states[place[m]].scores,
                valid: pair.rows[m].reference.present(),
            };
            fusion.advance(scored, pair.truth.matches(query));
            if fusion.outcomes.last().is_some_and(|o| o.answer.is_some()) {
                grid.add(query, fusion.fused());
            }
        });
    }
    let mut outcomes = Vec::new();
    let mut panels = Vec::new();
    for (c, (fusion, grid)) in wanted.iter().zip(fusions) {
        panels.push(Panel::new(title(c), grid, pair, &fusion.outcomes));
        outcomes = fusion.outcomes;
    }
    (panels, outcomes)
}

/// A member is told from its neighbours by its reconstruction.
fn title(c: &Configuration) -> String {
    match (c.subset.kind, MemberName::parse(&c.subset.name)) {
        (SubsetKind::Combined, _) => "all members together".to_owned(),
        (SubsetKind::Single, Some(parts)) => {
            format!("{} ({}, {})", parts.reconstruction, parts.window, parts.extractor)
        }
        (SubsetKind::Reconstruction, Some(parts)) => {
            format!("reconstructions together ({}, {})", parts.window, parts.extractor)
        }
        _ => c.subset.name.clone(),
    }
}

/// The most confident wrong answers and the most confident right ones, not next to one another.
fn choose(pair: &Pair, look: &Look) -> Vec<Shown> {
    let apart = (look.outcomes.len() / 50).max(3);
    let mut order: Vec<usize> = (0..look.outcomes.len())
        .filter(|q| look.outcomes[*q].answer.is_some() && !pair.truth.matches(*q).is_empty())
        .collect();
    order.sort_by(|a, b| {
        look.outcomes[*b]
            .confidence
            .total_cmp(&look.outcomes[*a].confidence)
    });
    let mut all = Vec::new();
    for (is_right, most) in [(false, WORST), (true, BEST)] {
        let mut taken: Vec<usize> = Vec::new();
        for query in order
            .iter()
            .copied()
            .filter(|q| look.outcomes[*q].is_right() == is_right)
        {
            if taken.len() < most && taken.iter().all(|t| t.abs_diff(query) >= apart) {
                taken.push(query);
            }
        }
        all.extend(taken.into_iter().filter_map(|query| {
            let outcome = &look.outcomes[query];
            let answer = outcome.answer?;
            let nearest = pair
                .truth
                .matches(query)
                .iter()
                .min_by_key(|r| r.abs_diff(answer))?;
            Some(Shown {
                query,
                answer: answer as usize,
                right: *nearest as usize,
                confidence: outcome.confidence,
                is_right,
                error_m: look.errors_m[query],
                error_ticks: look.errors_ticks[query],
                frames: [None, None, None],
            })
        }));
    }
    all
}
