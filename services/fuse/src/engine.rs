//! What happens to one tick, live or offline: similarity rows in, scores, fused scores and verdict out.

use crate::ensemble::{Best, Ensemble, Part};
use crate::history::Standing;
use crate::sequence::ForwardFilter;
use crate::similarity::similarity;
use crate::{FuseError, Map, SequenceMatcher};
use evpr_core::ledger::TickInfo;
use evpr_core::member::MAX_MEMBERS;
use evpr_core::message::{Candidate, FuseSettings, MatchHeader};
use evpr_core::plan::{Fuse, Rule, SequenceMethod, Similarity};
use evpr_core::{MemberSet, Plan, Reason};
use rayon::prelude::*;

/// One member under way.
#[derive(Debug)]
struct Lane {
    matcher: SequenceMatcher,
    /// S̃ of the newest tick; NaN where the member sat it out.
    scores: Vec<f64>,
    /// Ticks in a row with a row, the newest included.
    streak: u64,
}

/// One tick's input.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Input<'a> {
    /// Members switched on.
    pub(crate) enabled: &'a MemberSet,
    /// Per member of the plan, finite.
    pub(crate) weights: &'a [f64],
    /// Per member of the plan: its similarity row (R values); `None` where it has none or is switched off.
    pub(crate) rows: &'a [Option<&'a [f64]>],
    /// The tick was lost on the way.
    pub(crate) lost: bool,
}

/// What came of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Verdict {
    Match(Best),
    None(Reason),
}

/// Similarity, sequence matching and fusion over all members of a plan.
#[derive(Debug)]
pub(crate) struct Engine {
    map: Map,
    names: Vec<String>,
    kind: Similarity,
    lanes: Vec<Lane>,
    ensemble: Ensemble,
    min_confidence: f64,
    /// As the plan says.
    planned: Fuse,
    length: usize,
    /// Ticks taken since the first of the run; `None` where the first that was taken is a later one.
    since_start: Option<u64>,
}

impl Engine {
    pub(crate) fn new(plan: &Plan, map: Map) -> Result<Self, FuseError> {
        check(plan, &map)?;
        let fuse = &plan.fuse;
        let lane = |member: &crate::MapMember| Lane {
            matcher: SequenceMatcher::new(fuse.sequence, fuse.length, &member.valid),
            scores: vec![f64::NAN; map.references],
            streak: 0,
        };
        let ensemble = Ensemble::new(map.references, fuse.top, fuse.exclusion).with_rule(fuse.rule);
        Ok(Self {
            min_confidence: fuse.min_confidence,
            lanes: map.members.iter().map(lane).collect(),
            ensemble: match fuse.sequence {
                SequenceMethod::Filter(filter) => ensemble.with_filter(filter),
                _ => ensemble,
            },
            names: plan.members.iter().map(|m| m.name.clone()).collect(),
            kind: fuse.similarity,
            planned: fuse.clone(),
            length: fuse.length,
            since_start: None,
            map,
        })
    }

    /// The next tick is the first of the run: nothing came before it.
    pub(crate) fn starts_the_run(&mut self) {
        self.since_start = Some(0);
    }

    /// What is known beside the rows of the last ticks.
    pub(crate) fn standing(&self) -> Standing {
        let filter = self.ensemble.filter();
        Standing {
            since_start: self.since_start,
            streaks: self.lanes.iter().map(|l| l.streak).collect(),
            probabilities: filter.map_or_else(Vec::new, |f| f.probabilities().to_vec()),
            blind: filter.map_or(0, ForwardFilter::blind),
        }
    }

    /// Goes on from there. Rows in a row are counted again as they are taken in, but where the filter's probabilities stand
    /// for all of them.
    pub(crate) fn resume(&mut self, standing: &Standing) {
        self.since_start = standing.since_start;
        if self.ensemble.remembers() {
            for (lane, streak) in self.lanes.iter_mut().zip(&standing.streaks) {
                lane.streak = *streak;
            }
        }
        self.ensemble.resume(&standing.probabilities, standing.blind);
    }

    /// L as it is now, ticks.
    pub(crate) fn length(&self) -> usize {
        self.length
    }

    /// Makes these settings hold from the next tick on.
    pub(crate) fn set(&mut self, settings: &FuseSettings) {
        let planned = &self.planned;
        let rule = Rule::from_code(settings.rule, settings.trim).unwrap_or(planned.rule);
        self.ensemble.set_rule(rule);
        self.min_confidence = settings.min_confidence().unwrap_or(planned.min_confidence);
        let length = match settings.length {
            0 => planned.length,
            length => length as usize,
        };
        if length == self.length || !planned.sequence.has_length() {
            return;
        }
        self.length = length;
        for (lane, member) in self.lanes.iter_mut().zip(&self.map.members) {
            let nothing = SequenceMatcher::new(SequenceMethod::None, 1, &[]);
            let matcher = std::mem::replace(&mut lane.matcher, nothing);
            lane.matcher = matcher.with_length(planned.sequence, length, &member.valid);
        }
    }

    pub(crate) fn references(&self) -> usize {
        self.map.references
    }

    pub(crate) fn member_name(&self, member: usize) -> &str {
        self.names.get(member).map_or("unknown", String::as_str)
    }

    pub(crate) fn dim(&self, member: usize) -> usize {
        self.map.members.get(member).map_or(0, |m| m.dim)
    }

    /// S of one row: `row` must have the member's dimension, `out` one value per reference.
    pub(crate) fn similarity(&self, member: usize, row: &[f32], out: &mut [f64]) -> Result<(), FuseError> {
        let reference = &self.map.members[member];
        similarity(self.kind, row, reference.rows.values(), &reference.valid, out);
        match out
            .iter()
            .zip(&reference.valid)
            .position(|(s, valid)| *valid && !s.is_finite())
        {
            None => Ok(()),
            Some(reference) => Err(FuseError::NotFinite {
                member: self.member_name(member).to_owned(),
                reference,
            }),
        }
    }

    /// Takes the next tick into every member's history and, where `answer` is true, scores and fuses it.
    ///
    /// A member counts when it is enabled, its weight is not 0 and it has a row: one of weight 0 is matched, but
    /// answers as if it were switched off.
    pub(crate) fn advance(&mut self, input: Input<'_>, answer: bool) -> Option<Verdict> {
        let remembers = self.ensemble.remembers();
        self.lanes.par_iter_mut().zip(input.rows).for_each(|(lane, row)| {
            lane.matcher.push(*row);
            lane.streak = if row.is_some() { lane.streak + 1 } else { 0 };
            if answer || remembers {
                lane.matcher.score(&mut lane.scores);
            }
        });
        self.since_start = self.since_start.map(|ticks| ticks + 1);
        if !answer && !remembers {
            return None;
        }
        let (lanes, members) = (&self.lanes, &self.map.members);
        let weighs = |member: &usize| input.weights.get(*member).is_some_and(|w| *w != 0.0);
        let has_row = |member: &usize| input.rows.get(*member).is_some_and(Option::is_some);
        let counting = || input.enabled.iter().filter(weighs).filter(has_row);
        let best = self.ensemble.fuse(counting().map(|m| Part {
            scores: &lanes[m].scores,
            valid: &members[m].valid,
            weight: input.weights[m],
        }));
        answer.then(|| match best {
            _ if input.lost => Verdict::None(Reason::Lost),
            _ if !input.enabled.iter().any(|m| weighs(&m)) => Verdict::None(Reason::NoMembers),
            _ if counting().next().is_none() => Verdict::None(Reason::NoRows),
            _ if !counting().any(|m| lanes[m].matcher.has_history()) => Verdict::None(Reason::NoHistory),
            None => Verdict::None(Reason::NoRows),
            Some(best) if best.confidence < self.min_confidence => Verdict::None(Reason::LowConfidence),
            Some(best) => Verdict::Match(best),
        })
    }

    /// Whether every input of the newest tick was there: a row of each of these members, at it and at every tick before it
    /// that the sequence reaches back to, as far as the run does.
    pub(crate) fn is_complete(&self, enabled: &MemberSet) -> bool {
        let reach = match self.planned.sequence {
            SequenceMethod::Filter(_) => u64::MAX,
            method if method.has_length() => self.length.max(1) as u64,
            _ => 1,
        };
        let wanted = self.since_start.map_or(reach, |ticks| ticks.min(reach));
        enabled
            .iter()
            .all(|m| self.lanes.get(m).is_none_or(|l| l.streak >= wanted))
    }

    /// The candidates that belong to a verdict.
    pub(crate) fn candidates(&self, verdict: Verdict) -> &[Candidate] {
        match verdict {
            Verdict::Match(_) => self.ensemble.candidates(),
            Verdict::None(_) => &[],
        }
    }

    /// E of the last answered tick.
    pub(crate) fn fused(&self) -> &[f64] {
        self.ensemble.fused()
    }

    /// Which places E means something of.
    pub(crate) fn eligible(&self) -> &[bool] {
        self.ensemble.eligible()
    }

    /// S̃ of a member at the last answered tick.
    pub(crate) fn scores(&self, member: usize) -> &[f64] {
        &self.lanes[member].scores
    }

    /// The answer, without latencies. `ends` has a code per member.
    pub(crate) fn header(&self, info: &TickInfo, verdict: Verdict, ends: [u8; MAX_MEMBERS]) -> MatchHeader {
        let header = MatchHeader {
            tick: info.tick,
            start_us: info.start_us,
            end_us: info.end_us,
            control_version: info.control_version,
            complete: u32::from(self.is_complete(&info.members)),
            ends,
            ..MatchHeader::default()
        };
        match verdict {
            Verdict::None(reason) => MatchHeader {
                reason: reason.code(),
                ..header
            },
            Verdict::Match(best) => {
                let [east_m, north_m] = self.map.position(best.reference).unwrap_or([f64::NAN; 2]);
                MatchHeader {
                    reference: best.reference as i64,
                    score: best.score,
                    confidence: best.confidence,
                    east_m,
                    north_m,
                    candidates: self.ensemble.candidates().len() as u32,
                    ..header
                }
            }
        }
    }
}

/// Checks that map and plan fit, so that everything after this may index freely, and reads the map through.
fn check(plan: &Plan, map: &Map) -> Result<(), FuseError> {
    if plan.members.len() > MAX_MEMBERS {
        return Err(FuseError::TooManyMembers {
            members: plan.members.len(),
            most: MAX_MEMBERS,
        });
    }
    if map.members.len() != plan.members.len() {
        return Err(FuseError::Members {
            map: map.members.len(),
            plan: plan.members.len(),
        });
    }
    if map.references == 0 {
        return Err(FuseError::EmptyMap);
    }
    if u32::try_from(map.references).is_err() {
        return Err(FuseError::TooLong {
            references: map.references,
        });
    }
    if let (SequenceMethod::SeqSlam(_), true) = (plan.fuse.sequence, map.references < plan.fuse.length) {
        return Err(FuseError::TooShort {
            references: map.references,
            length: plan.fuse.length,
        });
    }
    check_members(plan, &map.members, map.references)?;
    for (named, member) in plan.members.iter().zip(&map.members) {
        if !member.valid.contains(&true) {
            return Err(FuseError::NoRows {
                member: named.name.clone(),
            });
        }
        if let Some(reference) = member.first_not_finite() {
            return Err(FuseError::NotFinite {
                member: named.name.clone(),
                reference,
            });
        }
    }
    Ok(())
}

/// Checks the shapes of a traverse's members against the plan.
pub(crate) fn check_members(
    plan: &Plan,
    members: &[crate::MapMember],
    ticks: usize,
) -> Result<(), FuseError> {
    if members.len() != plan.members.len() {
        return Err(FuseError::Members {
            map: members.len(),
            plan: plan.members.len(),
        });
    }
    for (named, member) in plan.members.iter().zip(members) {
        member.check(&named.name, ticks)?;
        let dim = plan.extractors.get(named.extractor).map_or(0, |e| e.dim);
        if dim != member.dim {
            return Err(FuseError::Dimension {
                member: named.name.clone(),
                map: member.dim,
                plan: dim,
            });
        }
    }
    Ok(())
}
