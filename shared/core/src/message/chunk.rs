//! `events/<camera>`: a run of events inside one segment of one tick.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Event, Message, Refusal, Stamp, check, header};
use crate::member::{MemberSet, Reason};
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Header of a chunk. A chunk never crosses a window edge; it may be empty, when it only closes something.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.ChunkHeader.1")]
pub struct ChunkHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// The tick these events belong to.
    pub tick: u64,
    /// Sensor time in µs that the events' times count from.
    pub base_us: u64,
    /// Host monotonic time (ns) at which ingest knew that the closed windows were over; 0 if none closes.
    pub closed_ns: u64,
    /// How often ingest had been started: half-built windows of an older epoch are thrown away.
    pub epoch: u32,
    /// Index of the segment within the tick's plan.
    pub segment: u32,
    /// [`ChunkHeader::OPENS_SEGMENT`] and [`ChunkHeader::CLOSES_SEGMENT`], and [`ChunkHeader::loss`].
    pub flags: u32,
    /// Bit i is set when this chunk closes window i of the plan.
    pub closes: u32,
    /// The members enabled at this tick.
    pub members: MemberSet,
}

impl ChunkHeader {
    /// Flag: the first chunk of its segment.
    pub const OPENS_SEGMENT: u32 = 1;
    /// Flag: the last chunk of its segment.
    pub const CLOSES_SEGMENT: u32 = 2;
    /// Where the flags hold the code of a reason.
    const LOSS_SHIFT: u32 = 8;

    /// Why events of this segment are missing, if ingest knows that some are: no window that covers the segment is
    /// whole.
    pub fn loss(&self) -> Option<Reason> {
        Reason::from_code(self.flags >> Self::LOSS_SHIFT)
    }

    /// The flags with this loss.
    pub fn with_loss(flags: u32, loss: Option<Reason>) -> u32 {
        flags | loss.map_or(0, Reason::code) << Self::LOSS_SHIFT
    }

    /// True for the first chunk of its segment.
    pub fn opens_segment(&self) -> bool {
        self.flags & Self::OPENS_SEGMENT != 0
    }

    /// True for the last chunk of its segment.
    pub fn closes_segment(&self) -> bool {
        self.flags & Self::CLOSES_SEGMENT != 0
    }
}

header!(ChunkHeader, tick: tick; closed_ns: |h| h.closed_ns, part: |h| h.closes);

/// Chunks of events.
#[derive(Debug)]
pub struct Chunks;

impl Message for Chunks {
    type Header = ChunkHeader;
    type Item = Event;

    fn check(plan: &Plan, header: &ChunkHeader, payload: &[Event]) -> Result<(), Refusal> {
        check::chunk(plan, header, payload)
    }
}
