//! The formats of Prophesee's sensors: decoders that are pushed bytes, and recordings read through them.
//!
//! Facts from the vendor's pages "EVT 2.0", "EVT 2.1", "EVT 3.0", "RAW" and "DAT" under docs.prophesee.ai.

mod clock;
mod dat;
mod evt2;
mod evt21;
mod evt3;
mod header;
mod recording;
mod words;

pub use dat::DatDecoder;
pub use evt2::Evt2Decoder;
pub use evt3::Evt3Decoder;
pub use evt21::{Evt21Decoder, Evt21Order};

pub(super) use header::begins;
pub(super) use recording::Prophesee;

use crate::RawEvent;

/// How the events of a stream are encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// EVT 2.0.
    Evt2,
    /// EVT 2.1, in one of two orders of bytes.
    Evt21(Evt21Order),
    /// EVT 3.0.
    Evt3,
    /// DAT, version 2, from its two bytes of type and size on.
    Dat,
}

impl Encoding {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Evt2,
        Self::Evt21(Evt21Order::Little),
        Self::Evt21(Evt21Order::HalvesSwapped),
        Self::Evt3,
        Self::Dat,
    ];

    /// Its name in configurations and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Evt2 => "evt2",
            Self::Evt21(Evt21Order::Little) => "evt21",
            Self::Evt21(Evt21Order::HalvesSwapped) => "evt21_legacy",
            Self::Evt3 => "evt3",
            Self::Dat => "dat",
        }
    }

    /// The one of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|encoding| encoding.name() == name)
    }
}

/// A state machine that is pushed the bytes of a stream, in order and cut anywhere, and gives its events. It waits for
/// nothing, and nothing that it can be pushed is an error: words of unknown kinds are passed over.
///
/// Events are given in the order of the stream with the times of the sensor, whatever these are: duplicate and
/// backward times, and pixels outside the sensor, are for the receiver to judge.
pub trait Decoder: Send {
    /// Bytes of a word, the unit of the stream.
    fn word_bytes(&self) -> usize;

    /// Most events that one word can give.
    fn most_events_per_word(&self) -> usize;

    /// Appends the events of these bytes to `out`. What is cut off at the end of `bytes` is kept for the next call.
    fn decode(&mut self, bytes: &[u8], out: &mut Vec<RawEvent>);

    /// Bytes of an unfinished word, 0 to `word_bytes() - 1`: other than 0 at the end, the stream is cut off.
    fn pending_bytes(&self) -> usize;

    /// What was passed over so far.
    fn passed_over(&self) -> PassedOver;
}

/// What a decoder passed over.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PassedOver {
    /// External triggers.
    pub triggers: u64,
    /// Events at the beginning of a stream that was joined in its middle: before their time or place was known.
    pub before_start: u64,
}
