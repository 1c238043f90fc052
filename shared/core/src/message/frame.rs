//! `frames/<reconstruction>`: one image of one window, or the reason why there is none.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Life, Message, Refusal, Stamp, check, header};
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// What the channels of a frame mean, in memory order. Stored as its number.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ChannelOrder {
    /// One channel.
    #[default]
    Grey = 0,
    /// OFF, ON, 0: read as blue, green, red.
    OffOnZero = 1,
    /// ON, OFF, 0: read as blue, green, red.
    OnOffZero = 2,
    /// Blue, green, red of an ordinary image.
    BlueGreenRed = 3,
}

impl ChannelOrder {
    /// The order with this number.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Grey, Self::OffOnZero, Self::OnOffZero, Self::BlueGreenRed]
            .into_iter()
            .find(|o| *o as u32 == code)
    }

    /// Channels per pixel: 1 or 3.
    pub fn channels(self) -> usize {
        if self == Self::Grey { 1 } else { 3 }
    }
}

/// Header of a frame. The payload is `height × width × channels` bytes, row-major, channels interleaved; it
/// is empty when `reason` is not 0.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.FrameHeader.1")]
pub struct FrameHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// The tick.
    pub tick: u64,
    /// Events in the window.
    pub events: u64,
    /// Times so far.
    pub life: Life,
    /// Epoch of the chunks it was made of.
    pub epoch: u32,
    /// Index of the reconstruction in the plan.
    pub reconstruction: u32,
    /// Index of the window in the plan.
    pub window: u32,
    /// Pixels.
    pub height: u32,
    /// Pixels.
    pub width: u32,
    /// Number of a [`ChannelOrder`].
    pub channel_order: u32,
    /// 0 with an image, else the code of the [`crate::Reason`] why there is none.
    pub reason: u32,
    /// Bit i is set when extractor i of the plan is wanted for this frame.
    pub extractors: u32,
}

header!(FrameHeader, tick: tick, mark: |h, started, finished| {
    h.life.reconstruct_started_ns = started;
    h.life.reconstructed_ns = finished;
}; closed_ns: |h| h.life.closed_ns, part: |h| h.reconstruction << 16 | h.window);

/// Frames.
#[derive(Debug)]
pub struct Frames;

impl Message for Frames {
    type Header = FrameHeader;
    type Item = u8;

    fn check(plan: &Plan, header: &FrameHeader, payload: &[u8]) -> Result<(), Refusal> {
        check::frame(plan, header, payload)
    }
}
