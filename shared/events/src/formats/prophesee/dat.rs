//! DAT, version 2: decoded events, 8 bytes each, little endian: the time in µs (32 bits), then x (bits 13–0), y
//! (bits 27–14) and polarity (bits 31–28; 0 is OFF) of the second 32 bits.

use super::clock::Clock;
use super::words::Words;
use super::{Decoder, PassedOver};
use crate::RawEvent;

/// Decodes the events of a DAT recording, which stand behind its header and two bytes of type and size.
///
/// The time wraps each 71 min 34.967296 s. Of all whole times with an event's 32 bits, the one nearest to the event
/// before is taken: half the range (35 min 47 s) is the threshold between a step back and a wrap.
#[derive(Debug, Clone)]
pub struct DatDecoder {
    words: Words<8>,
    clock: Clock,
}

impl Default for DatDecoder {
    fn default() -> Self {
        Self::new()
    }
}

impl DatDecoder {
    /// At the first event.
    pub fn new() -> Self {
        Self {
            words: Words::new(),
            clock: Clock::new(32, 1_000),
        }
    }

    #[inline]
    fn word(&mut self, word: u64, out: &mut Vec<RawEvent>) {
        let place = (word >> 32) as u32;
        out.push(RawEvent {
            t_ns: self.clock.read(word as u32),
            x: (place & 0x3fff) as u16,
            y: (place >> 14 & 0x3fff) as u16,
            on: place >> 28 != 0,
        });
    }
}

impl Decoder for DatDecoder {
    fn word_bytes(&self) -> usize {
        8
    }

    fn most_events_per_word(&self) -> usize {
        1
    }

    fn decode(&mut self, bytes: &[u8], out: &mut Vec<RawEvent>) {
        let (first, whole) = self.words.split(bytes);
        for word in first.iter().chain(whole) {
            self.word(u64::from_le_bytes(*word), out);
        }
    }

    fn pending_bytes(&self) -> usize {
        self.words.pending()
    }

    fn passed_over(&self) -> PassedOver {
        PassedOver::default()
    }
}
