//! `scores`: what the fuser made of a tick, for whoever watches. Nobody waits for it, and it is only sent while somebody
//! listens.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Message, Refusal, Stamp, check, header};
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Header of the scores of a tick.
///
/// The payload is two runs of floats. First `columns` of them: the places of the map in `columns` shares as even as can
/// be, in order, and of each share the highest fused score E; NaN where no place of the share has one. Then one per
/// member of the plan: the place of its own highest score S̃ (exact up to 2²⁴ places), −1 without a row.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.ScoresHeader.1")]
pub struct ScoresHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// The tick.
    pub tick: u64,
    /// Places of the map.
    pub references: u64,
    /// Shares that they are in: at most [`crate::plan::SCORE_COLUMNS`], and at most `references`.
    pub columns: u32,
    /// Unused.
    pub _pad: u32,
}

header!(ScoresHeader, tick: tick);

/// Scores.
#[derive(Debug)]
pub struct Scores;

impl Message for Scores {
    type Header = ScoresHeader;
    type Item = f32;

    fn check(plan: &Plan, header: &ScoresHeader, payload: &[f32]) -> Result<(), Refusal> {
        check::scores(plan, header, payload)
    }
}
