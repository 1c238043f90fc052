//! The part that every header shares, and the times of a tick's life.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Who sent a message and as which one of theirs. 40 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.Stamp.1")]
pub struct Stamp {
    /// The run: receivers refuse messages of another one.
    pub run_id: u64,
    /// Counts the sender's messages on this channel from 0: a gap is a loss.
    pub seq: u64,
    /// Host monotonic time of sending, ns.
    pub sent_ns: u64,
    /// Index of the sending service in the plan.
    pub service: u32,
    /// How often that service had been started when this was sent, from 1.
    pub incarnation: u32,
    /// Payload items that count: a slice in shared memory has at least one.
    pub items: u32,
    /// Unused.
    pub _pad: u32,
}

impl Stamp {
    /// The supervisor's number among services.
    pub const SUPERVISOR: u32 = u32::MAX;
}

/// Host monotonic times (ns) of the stations between the closing of a window and its row; 0 where not reached.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.Life.1")]
pub struct Life {
    /// Ingest knew that the window was over.
    pub closed_ns: u64,
    /// The reconstruction took up the closing chunk, or was done with the frame before this one of the same chunk.
    pub reconstruct_started_ns: u64,
    /// The frame was written.
    pub reconstructed_ns: u64,
    /// The extractor took up the frame; where several are computed at once, began to compute.
    pub extract_started_ns: u64,
    /// The row was written.
    pub extracted_ns: u64,
}
