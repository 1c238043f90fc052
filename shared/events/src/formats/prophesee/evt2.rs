//! EVT 2.0: words of 32 bits, little endian.
//!
//! | bits 31–28 | what | bits 27–0 |
//! |---|---|---|
//! | 0, 1 | an event, OFF or ON | 27–22: time, low, µs; 21–11: x; 10–0: y |
//! | 8 | time, high | 64 µs |
//! | 10 | external trigger | time, id and edge |
//! | 14, 15 | other data of the sensor and what continues them | passed over |
//! | others | reserved | passed over |

use super::clock::Clock;
use super::words::Words;
use super::{Decoder, PassedOver};
use crate::RawEvent;

/// Decodes EVT 2.0.
///
/// The time has 34 bits of µs and wraps each 4 h 46 min 19.869184 s. Whether a new high part has wrapped is decided as
/// in EVT 3.0: the whole time nearest to the one before is taken, so half the range (2 h 23 min) is the threshold.
/// Events before the first high part are left out, and counted in [`PassedOver::before_start`].
#[derive(Debug, Clone)]
pub struct Evt2Decoder {
    words: Words<4>,
    high: HighTime,
    passed_over: PassedOver,
}

/// The high part of the time in EVT 2.0 and 2.1: 28 bits of 64 µs.
#[derive(Debug, Clone)]
pub(super) struct HighTime {
    clock: Clock,
    ns: Option<u64>,
}

impl HighTime {
    pub(super) fn new() -> Self {
        Self {
            clock: Clock::new(28, 64_000),
            ns: None,
        }
    }

    pub(super) fn read(&mut self, high: u32) {
        self.ns = Some(self.clock.read(high));
    }

    /// The time with these low 6 bits of µs, ns; `None` before the first high part.
    #[inline]
    pub(super) fn with_low(&self, low: u32) -> Option<u64> {
        self.ns.map(|ns| ns + u64::from(low & 0x3f) * 1_000)
    }
}

impl Default for Evt2Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Evt2Decoder {
    /// At the start of a stream.
    pub fn new() -> Self {
        Self {
            words: Words::new(),
            high: HighTime::new(),
            passed_over: PassedOver::default(),
        }
    }

    #[inline]
    fn word(&mut self, word: u32, out: &mut Vec<RawEvent>) {
        match word >> 28 {
            kind @ (0x0 | 0x1) => match self.high.with_low(word >> 22) {
                Some(t_ns) => out.push(RawEvent {
                    t_ns,
                    x: (word >> 11 & 0x7ff) as u16,
                    y: (word & 0x7ff) as u16,
                    on: kind == 1,
                }),
                None => self.passed_over.before_start += 1,
            },
            0x8 => self.high.read(word),
            0xa => self.passed_over.triggers += 1,
            _ => {}
        }
    }
}

impl Decoder for Evt2Decoder {
    fn word_bytes(&self) -> usize {
        4
    }

    fn most_events_per_word(&self) -> usize {
        1
    }

    fn decode(&mut self, bytes: &[u8], out: &mut Vec<RawEvent>) {
        let (first, whole) = self.words.split(bytes);
        for word in first.iter().chain(whole) {
            self.word(u32::from_le_bytes(*word), out);
        }
    }

    fn pending_bytes(&self) -> usize {
        self.words.pending()
    }

    fn passed_over(&self) -> PassedOver {
        self.passed_over
    }
}
