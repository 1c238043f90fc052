//! `spans`: what a process did when, for a trace. Sent only while somebody listens.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Message, Refusal, Stamp, check, header};
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// What a span is of. Stored as its number.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum SpanKind {
    /// Work on one input: from taking it up to being done with it. Stages: what comes of it included.
    #[default]
    Input = 0,
    /// One output: from beginning with it to having handed it over.
    Output = 1,
}

impl SpanKind {
    /// The kind with this number.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Input, Self::Output]
            .into_iter()
            .find(|k| *k as u32 == code)
    }
}

/// A stretch of time of one process. Host monotonic times, ns.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.Span.1")]
pub struct Span {
    /// Input: when it was sent. Output: when it began to be handed over, the work being done.
    pub sent_ns: u64,
    /// The beginning.
    pub start_ns: u64,
    /// The end.
    pub end_ns: u64,
    /// The tick.
    pub tick: u64,
    /// When the window that it belongs to was known to be over; 0 where it belongs to none, or none is over.
    pub closed_ns: u64,
    /// Number of a [`SpanKind`].
    pub kind: u32,
    /// [`super::Header::part`] of the message.
    pub part: u32,
}

/// Header of some spans.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.SpansHeader.1")]
pub struct SpansHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
}

header!(SpansHeader);

/// Spans; the payload is some of them, in the order of their ends.
#[derive(Debug)]
pub struct Spans;

impl Message for Spans {
    type Header = SpansHeader;
    type Item = Span;

    fn check(plan: &Plan, header: &SpansHeader, payload: &[Span]) -> Result<(), Refusal> {
        check::spans(plan, header, payload)
    }
}
