//! `matches`: the answer of one tick.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Message, Refusal, Stamp, check, header};
use crate::member::MAX_MEMBERS;
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// One place and its fused score.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.Candidate.1")]
pub struct Candidate {
    /// Fused score E, higher is more alike.
    pub score: f64,
    /// The map's tick.
    pub reference: u32,
    /// Unused.
    pub _pad: u32,
}

/// Header of an answer. The payload is the best candidates, best first; one zeroed item when there is none.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("evpr.MatchHeader.2")]
pub struct MatchHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// The tick.
    pub tick: u64,
    /// Sensor time of the tick's start, µs.
    pub start_us: u64,
    /// Sensor time of the tick's end, µs.
    pub end_us: u64,
    /// The best reference (the map's tick), or -1.
    pub reference: i64,
    /// Its fused score; 0 without a reference.
    pub score: f64,
    /// Margin against the best candidate elsewhere, 0 (none) to 1; 0 without a reference.
    pub confidence: f64,
    /// East or x of the reference in the map's frame, metres; NaN where the map has no positions.
    pub east_m: f64,
    /// North or y, metres.
    pub north_m: f64,
    /// Closing of the last window until the last frame was written, ns.
    pub reconstruct_ns: u64,
    /// From then until the last row was written, ns.
    pub extract_ns: u64,
    /// From then until the answer, ns.
    pub fuse_ns: u64,
    /// Closing of the last window until the answer, ns; 0 when not known.
    pub total_ns: u64,
    /// Why there is no reference: code of a [`crate::Reason`], 0 with one.
    pub reason: u32,
    /// Valid candidates in the payload.
    pub candidates: u32,
    /// Version of the control message in force.
    pub control_version: u64,
    /// 1 when every input of the answer was there: a row of each enabled member at this tick and at each before it that
    /// its sequence reaches back to. The answer is then that of a run in which nothing went wrong. Else 0.
    pub complete: u32,
    /// Unused.
    pub _pad: u32,
    /// How each member of the plan ended: 0 not enabled, 1 a row that was used, else the code of a [`crate::Reason`].
    pub ends: [u8; MAX_MEMBERS],
}

impl Default for MatchHeader {
    fn default() -> Self {
        Self {
            stamp: Stamp::default(),
            tick: 0,
            start_us: 0,
            end_us: 0,
            reference: -1,
            score: 0.0,
            confidence: 0.0,
            east_m: f64::NAN,
            north_m: f64::NAN,
            reconstruct_ns: 0,
            extract_ns: 0,
            fuse_ns: 0,
            total_ns: 0,
            reason: 0,
            candidates: 0,
            control_version: 0,
            complete: 0,
            _pad: 0,
            ends: [0; MAX_MEMBERS],
        }
    }
}

header!(MatchHeader, tick: tick);

/// Answers.
#[derive(Debug)]
pub struct Matches;

impl Message for Matches {
    type Header = MatchHeader;
    type Item = Candidate;

    fn check(plan: &Plan, header: &MatchHeader, payload: &[Candidate]) -> Result<(), Refusal> {
        check::matched(plan, header, payload)
    }
}
