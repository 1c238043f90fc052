//! What travels between processes: fixed-layout headers and plain payload items.
//!
//! Every header is `repr(C)`, has explicit padding, and carries a versioned type name: a layout change needs
//! a new number, because shared memory compares names and sizes, not fields. `layout` tests pin every offset.

mod check;
mod chunk;
mod descriptor;
mod event;
mod frame;
#[cfg(test)]
mod layout_tests;
mod lifecycle;
mod matched;
mod scores;
mod span;
mod stamp;
mod stats;
mod tick;

pub use check::{MAX_TICK, Refusal};
pub use chunk::{ChunkHeader, Chunks};
pub use descriptor::{DescriptorHeader, Descriptors};
pub use event::Event;
pub use frame::{ChannelOrder, FrameHeader, Frames};
pub use lifecycle::{Lifecycle, LifecycleHeader, ServiceHealth, ServiceState};
pub use matched::{Candidate, MatchHeader, Matches};
pub use scores::{Scores, ScoresHeader};
pub use span::{Span, SpanKind, Spans, SpansHeader};
pub use stamp::{Life, Stamp};
pub use stats::{Doing, Histogram, LiveStats, MemberCost, ServicePhase, Stats, StatsHeader};
pub use tick::{Control, ControlHeader, FuseSettings, MemberSetting, TickHeader, TickKind, Ticks};

use crate::plan::Plan;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// One kind of message: a header and a slice of items, both plain data.
pub trait Message: 'static {
    /// The header type.
    type Header: Header;
    /// The payload's item type.
    type Item: Copy + Default + std::fmt::Debug + ZeroCopySend + 'static;

    /// Whether a process of the plan can have sent this: its sender, sizes, indices and codes. Asked by every receiver
    /// before anything of the message is used; `payload` are the items that count.
    ///
    /// # Errors
    /// What is wrong with it.
    fn check(plan: &Plan, header: &Self::Header, payload: &[Self::Item]) -> Result<(), Refusal>;
}

/// What every header has in common.
pub trait Header: Copy + Default + std::fmt::Debug + ZeroCopySend + 'static {
    /// Who sent it, when, and as which message of theirs.
    fn stamp(&self) -> &Stamp;
    /// The same, to be filled in by the outlet that sends it.
    fn stamp_mut(&mut self) -> &mut Stamp;
    /// The tick that the message belongs to; 0 where ticks mean nothing.
    fn tick(&self) -> u64;
    /// When the window that the message belongs to was known to be over (host monotonic ns); 0 where it belongs to none,
    /// or none is over.
    fn closed_ns(&self) -> u64 {
        0
    }
    /// Which part of its tick it is: chunks: the windows that it closes, as bits; frames: reconstruction << 16 | window;
    /// rows: the member; ticks: all bits.
    fn part(&self) -> u32 {
        0
    }
    /// How many messages were computed at once with this one, itself included.
    fn together(&self) -> u32 {
        1
    }
    /// Notes when the sending stage started on its input and when it finished (host monotonic ns).
    fn mark(&mut self, _started_ns: u64, _finished_ns: u64) {}
}

/// Implements [`Header`] for a struct with a `stamp` field and, where given, a `tick` field, and what else it overrides.
macro_rules! header {
    ($name:ty $(, tick: $tick:ident)? $(, mark: $mark:expr)? $(; $($also:ident: $value:expr),+)?) => {
        impl $crate::message::Header for $name {
            fn stamp(&self) -> &$crate::message::Stamp {
                &self.stamp
            }
            fn stamp_mut(&mut self) -> &mut $crate::message::Stamp {
                &mut self.stamp
            }
            fn tick(&self) -> u64 {
                header!(@tick self $($tick)?)
            }
            $(fn mark(&mut self, started_ns: u64, finished_ns: u64) {
                let mark: fn(&mut $name, u64, u64) = $mark;
                mark(self, started_ns, finished_ns);
            })?
            $($(fn $also(&self) -> header!(@type $also) {
                let value: fn(&$name) -> header!(@type $also) = $value;
                value(self)
            })+)?
        }
    };
    (@tick $self:ident $tick:ident) => { $self.$tick };
    (@tick $self:ident) => { 0 };
    (@type closed_ns) => { u64 };
    (@type part) => { u32 };
    (@type together) => { u32 };
}
pub(crate) use header;
