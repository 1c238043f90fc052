//! `ticks`: ingest tells everybody downstream that a tick exists and who is enabled in it; and `control`,
//! by which the supervisor tells ingest who shall be.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Message, Refusal, Stamp, check, header};
use crate::member::MemberSet;
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use serde::{Deserialize, Serialize};

/// What a tick message says. Stored as its number.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum TickKind {
    /// The tick has begun: its members and weights are settled. Payload: a weight per member of the plan.
    #[default]
    Open = 0,
    /// The tick is to be answered. Lossless: it lies wholly inside the recording. Latest: its last window closed.
    Close = 1,
    /// There is no tick `tick` nor any after it.
    End = 2,
}

impl TickKind {
    /// The kind with this number.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Open, Self::Close, Self::End]
            .into_iter()
            .find(|k| *k as u32 == code)
    }
}

/// What of the fuser's settings changes while it runs. 0 stands for what the plan says, but of the least confidence.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend, Serialize, Deserialize)]
#[type_name("evpr.FuseSettings.2")]
pub struct FuseSettings {
    /// Sequence length, ticks.
    pub length: u32,
    /// [`crate::plan::Rule::code`].
    pub rule: u32,
    /// The share that the rule `trimmed_mean` leaves out at either end.
    pub trim: f64,
    /// Latest delivery: the answer is due this long after the tick's last window closed, ns.
    pub deadline_ns: u64,
    /// The least confidence of an answer, 0 to 1, where `sets_min_confidence` is 1.
    pub min_confidence: f64,
    /// 1 where `min_confidence` counts, 0 where the plan's does.
    pub sets_min_confidence: u32,
    /// Unused.
    pub _pad: u32,
}

impl FuseSettings {
    /// The least confidence, if it has been changed.
    pub fn min_confidence(&self) -> Option<f64> {
        (self.sets_min_confidence == 1 && (0.0..=1.0).contains(&self.min_confidence))
            .then_some(self.min_confidence)
    }
}

/// Header of a tick message.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("evpr.TickHeader.4")]
pub struct TickHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// The tick.
    pub tick: u64,
    /// Sensor time of the tick's start, µs.
    pub start_us: u64,
    /// Sensor time of the tick's end, µs.
    pub end_us: u64,
    /// Host monotonic time (ns) at which the tick's last window closed; 0 before.
    pub closed_ns: u64,
    /// Where the camera was at the tick's start, metres east (or x) in the recording's frame; NaN where the recording
    /// does not know, and but for [`TickKind::Open`].
    pub east_m: f64,
    /// The same, metres north (or y).
    pub north_m: f64,
    /// Version of the control message in force: the tick named here is the one a change takes effect at.
    pub control_version: u64,
    /// The members enabled at this tick.
    pub members: MemberSet,
    /// The fuser's settings at this tick.
    pub fuse: FuseSettings,
    /// How often ingest had been started.
    pub epoch: u32,
    /// Number of a [`TickKind`].
    pub kind: u32,
}

impl TickHeader {
    /// Where the camera was at the tick's start: metres east and north; `None` where not known.
    pub fn position(&self) -> Option<[f64; 2]> {
        (self.east_m.is_finite() && self.north_m.is_finite()).then_some([self.east_m, self.north_m])
    }
}

impl Default for TickHeader {
    /// Zeroes, and no position.
    fn default() -> Self {
        Self {
            stamp: Stamp::default(),
            tick: 0,
            start_us: 0,
            end_us: 0,
            closed_ns: 0,
            east_m: f64::NAN,
            north_m: f64::NAN,
            control_version: 0,
            members: MemberSet::default(),
            fuse: FuseSettings::default(),
            epoch: 0,
            kind: 0,
        }
    }
}

header!(TickHeader, tick: tick; closed_ns: |h| h.closed_ns, part: |_| u32::MAX);

/// Tick messages; the payload is a weight per member (f64) with [`TickKind::Open`] and is empty otherwise.
#[derive(Debug)]
pub struct Ticks;

impl Message for Ticks {
    type Header = TickHeader;
    type Item = f64;

    fn check(plan: &Plan, header: &TickHeader, payload: &[f64]) -> Result<(), Refusal> {
        check::tick(plan, header, payload)
    }
}

/// What a member shall be from the next tick on.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.MemberSetting.2")]
pub struct MemberSetting {
    /// Its weight in the sum.
    pub weight: f64,
    /// 1 when enabled, else 0.
    pub enabled: u32,
    /// 1 where a network that works for no enabled member shall not be kept in memory, else 0.
    pub unload: u32,
}

/// Header of a control message: the whole wanted state, newest version wins.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.ControlHeader.3")]
pub struct ControlHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// Grows by one with each change.
    pub version: u64,
    /// The fuser's settings.
    pub fuse: FuseSettings,
}

header!(ControlHeader);

/// Control messages; the payload is one setting per member of the plan.
#[derive(Debug)]
pub struct Control;

impl Message for Control {
    type Header = ControlHeader;
    type Item = MemberSetting;

    fn check(plan: &Plan, header: &ControlHeader, payload: &[MemberSetting]) -> Result<(), Refusal> {
        check::control(plan, header, payload)
    }
}
