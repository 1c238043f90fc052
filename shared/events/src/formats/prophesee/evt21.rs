//! EVT 2.1: words of 64 bits, as EVT 2.0 with a vector of 32 pixels.
//!
//! | bits 63–60 | what | bits 59–0 |
//! |---|---|---|
//! | 0, 1 | events, OFF or ON | 59–54: time, low, µs; 53–43: x; 42–32: y; an event at x + i for each bit i of 31–0 |
//! | 8 | time, high | 59–32: 64 µs |
//! | 10 | external trigger | time, id and edge |
//! | 14, 15 | other data of the sensor and what continues them | passed over |
//! | others | reserved | passed over |

use super::evt2::HighTime;
use super::words::Words;
use super::{Decoder, PassedOver};
use crate::RawEvent;

/// The order of a word's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evt21Order {
    /// Little endian: bits 7–0 first. GenX320 and later.
    Little,
    /// The upper half first, each half little endian: `legacy`, as IMX636 sends it.
    HalvesSwapped,
}

/// Decodes EVT 2.1. Times, wraps and the start of a stream are as in [`super::Evt2Decoder`].
#[derive(Debug, Clone)]
pub struct Evt21Decoder {
    order: Evt21Order,
    words: Words<8>,
    high: HighTime,
    passed_over: PassedOver,
}

impl Evt21Decoder {
    /// At the start of a stream.
    pub fn new(order: Evt21Order) -> Self {
        Self {
            order,
            words: Words::new(),
            high: HighTime::new(),
            passed_over: PassedOver::default(),
        }
    }

    #[inline]
    fn word(&mut self, word: u64, out: &mut Vec<RawEvent>) {
        let (upper, mut valid) = ((word >> 32) as u32, word as u32);
        match upper >> 28 {
            kind @ (0x0 | 0x1) => match self.high.with_low(upper >> 22) {
                Some(t_ns) => {
                    let (x, y) = ((upper >> 11 & 0x7ff) as u16, (upper & 0x7ff) as u16);
                    while valid != 0 {
                        out.push(RawEvent {
                            t_ns,
                            x: x + valid.trailing_zeros() as u16,
                            y,
                            on: kind == 1,
                        });
                        valid &= valid - 1;
                    }
                }
                None => self.passed_over.before_start += u64::from(valid.count_ones()),
            },
            0x8 => self.high.read(upper),
            0xa => self.passed_over.triggers += 1,
            _ => {}
        }
    }
}

impl Decoder for Evt21Decoder {
    fn word_bytes(&self) -> usize {
        8
    }

    fn most_events_per_word(&self) -> usize {
        32
    }

    fn decode(&mut self, bytes: &[u8], out: &mut Vec<RawEvent>) {
        let (first, whole) = self.words.split(bytes);
        let words = first.iter().chain(whole).map(|word| u64::from_le_bytes(*word));
        match self.order {
            Evt21Order::Little => words.for_each(|word| self.word(word, out)),
            Evt21Order::HalvesSwapped => words.for_each(|word| self.word(word.rotate_left(32), out)),
        }
    }

    fn pending_bytes(&self) -> usize {
        self.words.pending()
    }

    fn passed_over(&self) -> PassedOver {
        self.passed_over
    }
}
