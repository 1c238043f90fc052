//! The formats of Prophesee's sensors: decoders that are pushed bytes, and recordings read through them.
//!
//! Facts from the vendor's pages "EVT 2.0", "EVT 2.1", "EVT 3.0", "RAW" and "DAT" under docs.prophesee.ai.

mod clock;
mod evt3;
mod words;

pub use evt3::Evt3Decoder;

use crate::RawEvent;

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
