//! `descriptors/<extractor>`: one row of one member at one tick, or the reason why there is none.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Life, Message, Refusal, Stamp, check, header};
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Header of a descriptor. The payload is the row (`dim` floats), empty when `reason` is not 0.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.DescriptorHeader.2")]
pub struct DescriptorHeader {
    /// Sender (the extractor) and sequence.
    pub stamp: Stamp,
    /// The tick.
    pub tick: u64,
    /// Times so far.
    pub life: Life,
    /// Epoch of the chunks it goes back to.
    pub epoch: u32,
    /// Index of the member in the plan.
    pub member: u32,
    /// 0 with a row, else the code of the [`crate::Reason`] why there is none.
    pub reason: u32,
    /// Length of the row.
    pub dim: u32,
    /// Index in the plan of the service that made the frame.
    pub reconstruct_service: u32,
    /// How often that service had been started.
    pub reconstruct_incarnation: u32,
    /// Rows that were computed at once with this one, itself included.
    pub together: u32,
    /// Unused.
    pub _pad: u32,
}

header!(DescriptorHeader, tick: tick, mark: |h, started, finished| {
    h.life.extract_started_ns = started;
    h.life.extracted_ns = finished;
}; closed_ns: |h| h.life.closed_ns, part: |h| h.member, together: |h| h.together);

/// Descriptors.
#[derive(Debug)]
pub struct Descriptors;

impl Message for Descriptors {
    type Header = DescriptorHeader;
    type Item = f32;

    fn check(plan: &Plan, header: &DescriptorHeader, payload: &[f32]) -> Result<(), Refusal> {
        check::descriptor(plan, header, payload)
    }
}
