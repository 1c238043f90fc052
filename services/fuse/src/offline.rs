//! Answers of a stored query traverse, computed by the same engine as the running fuser's.

use crate::engine::{Engine, Input, check_members};
use crate::map::open_members;
use crate::{FuseError, Map, MapMember};
use evpr_core::ledger::TickInfo;
use evpr_core::member::MAX_MEMBERS;
use evpr_core::message::FuseSettings;
use evpr_core::plan::Filter;
use evpr_core::stage::Answer;
use evpr_core::{MemberSet, Plan, Reason};
use std::path::Path;

/// A tick of a stored traverse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueryTick {
    /// The tick.
    pub tick: u64,
    /// Sensor time of its start, µs.
    pub start_us: u64,
    /// Sensor time of its end, µs.
    pub end_us: u64,
}

/// A stored query traverse.
#[derive(Debug, Clone)]
pub struct Query {
    /// Its ticks, ascending. Numbers that are missing stand for ticks without any row.
    pub ticks: Vec<QueryTick>,
    /// Per member of the plan, one row per entry of `ticks`.
    pub members: Vec<MapMember>,
}

impl Query {
    /// Opens a recorded traverse that the plan's members made.
    ///
    /// # Errors
    /// [`FuseError::Store`] when the traverse cannot be opened, or was made by other parameters than the plan's.
    pub fn open(plan: &Plan, path: &Path) -> Result<Self, FuseError> {
        let (traverse, members) = open_members(plan, path)?;
        let tick = |t: &evpr_store::TickRecord| QueryTick {
            tick: t.tick,
            start_us: t.start_us,
            end_us: t.end_us,
        };
        Ok(Self {
            ticks: traverse.ticks().iter().map(tick).collect(),
            members,
        })
    }
}

/// The answers of a stored traverse, one per entry of its ticks, with the plan's weights.
///
/// `enabled` says who is switched on at each tick; a member that is off counts as one without a row. The headers are
/// as the running fuser's except for latencies, control version and stamp, which are 0, and the reason of a missing
/// row, which traverses do not keep: it is given as [`Reason::Lost`].
///
/// # Errors
/// Map, query and plan do not fit, or a row is not finite: see [`FuseError`].
pub fn answers(
    plan: &Plan,
    map: Map,
    query: &Query,
    enabled: impl Fn(u64) -> MemberSet,
) -> Result<Vec<Answer>, FuseError> {
    answers_with(plan, map, query, enabled, |_| FuseSettings::default())
}

/// As [`answers`]; `settings` are those of each tick.
///
/// # Errors
/// As [`answers`].
pub fn answers_with(
    plan: &Plan,
    map: Map,
    query: &Query,
    enabled: impl Fn(u64) -> MemberSet,
    settings: impl Fn(u64) -> FuseSettings,
) -> Result<Vec<Answer>, FuseError> {
    check_members(plan, &query.members, query.ticks.len())?;
    let mut engine = Engine::new(plan, map)?;
    let weights: Vec<f64> = plan.members.iter().map(|m| m.weight).collect();
    let mut buffers = vec![vec![0.0; engine.references()]; plan.members.len()];
    let absent = vec![None; plan.members.len()];
    let mut answers = Vec::with_capacity(query.ticks.len());
    let mut next = query.ticks.first().map_or(0, |t| t.tick);
    if next == 0 {
        engine.starts_the_run();
    }
    for (index, at) in query.ticks.iter().enumerate() {
        // More missing ticks than this leave the same empty window, or a filter that starts over.
        let most = plan
            .fuse
            .history_ticks()
            .map_or(Filter::FORGETS_AFTER, |history| history + 1);
        for _ in 0..at.tick.saturating_sub(next).min(most) {
            let input = Input {
                enabled: &MemberSet::default(),
                weights: &weights,
                rows: &absent,
                lost: true,
            };
            engine.advance(input, false);
        }
        next = at.tick.saturating_add(1);
        engine.set(&settings(at.tick));
        let members: MemberSet = enabled(at.tick)
            .iter()
            .filter(|m| *m < plan.members.len())
            .collect();
        let mut ends = [0; MAX_MEMBERS];
        for member in members.iter() {
            ends[member] = Reason::Lost as u8;
            let Some(row) = query.members[member].row(index) else {
                continue;
            };
            if !row.iter().all(|v| v.is_finite()) {
                let member = engine.member_name(member).to_owned();
                return Err(FuseError::QueryNotFinite {
                    member,
                    tick: at.tick,
                });
            }
            engine.similarity(member, row, &mut buffers[member])?;
            ends[member] = 1;
        }
        let rows: Vec<Option<&[f64]>> = buffers
            .iter()
            .zip(ends)
            .map(|(row, end)| (end == 1).then_some(row.as_slice()))
            .collect();
        let input = Input {
            enabled: &members,
            weights: &weights,
            rows: &rows,
            lost: false,
        };
        let Some(verdict) = engine.advance(input, true) else {
            continue;
        };
        let info = TickInfo {
            tick: at.tick,
            start_us: at.start_us,
            end_us: at.end_us,
            position: None,
            control_version: 0,
            members,
            weights: Vec::new(),
            fuse: FuseSettings::default(),
        };
        answers.push((
            engine.header(&info, verdict, ends),
            engine.candidates(verdict).to_vec(),
        ));
    }
    Ok(answers)
}
