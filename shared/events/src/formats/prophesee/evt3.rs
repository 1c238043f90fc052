//! EVT 3.0: words of 16 bits, little endian, each of which changes one thing.
//!
//! | bits 15–12 | what | bits 11–0 |
//! |---|---|---|
//! | 0 | row of what follows | 11: which of two cameras; 10–0: y |
//! | 2 | one event | 11: polarity; 10–0: x |
//! | 3 | base of vectors | 11: polarity; 10–0: x |
//! | 4 | vector of 12 | an event at base + i for each bit i; then the base moves on by 12 |
//! | 5 | vector of 8 | the same with bits 7–0, and 8 |
//! | 6 | time, low | µs |
//! | 8 | time, high | 4096 µs |
//! | 10 | external trigger | id and edge |
//! | 7, 14, 15 | other data of the sensor and what continues them | passed over |
//! | others | reserved | passed over |

use super::clock::Clock;
use super::words::Words;
use super::{Decoder, PassedOver};
use crate::RawEvent;

const NS_PER_US: u64 = 1_000;

/// What must be known before an event can be given. A vector needs all of it, a single event all but the base.
const HIGH: u8 = 1;
const LOW: u8 = 2;
const Y: u8 = 4;
const BASE: u8 = 8;
const SINGLE: u8 = HIGH | LOW | Y;
const ALL: u8 = SINGLE | BASE;

/// Decodes EVT 3.0.
///
/// The time has 24 bits of µs and wraps each 16.777216 s. Whether a new high half has wrapped is decided by which
/// whole time is nearest to the one before: a step back by less than half the range (8.388608 s) is a step back, and
/// by as much or more a wrap; a step forward by more than half is one back over the edge. A new high half begins at
/// low half 0 until its low half comes; the same high half again changes nothing.
///
/// A stream may begin anywhere. Events are left out, and counted in [`PassedOver::before_start`], until a high half, a
/// low half after it, and a row have come; and for vectors a base. The state is kept from call to call: packets of one
/// stream (such as `event_camera_msgs/EventPacket` with encoding `evt3`) go through one decoder in their order. Where
/// packets may have been lost, call [`Self::set_time_base`].
#[derive(Debug, Clone)]
pub struct Evt3Decoder {
    words: Words<2>,
    high: Clock,
    /// The high part of the time, ns.
    high_ns: u64,
    /// The last word of each kind. Of the low halves of the time, the last since the high half changed, else 0.
    last: [u16; 16],
    /// How far vectors have moved on from the last base.
    moved: u16,
    known: u8,
    passed_over: PassedOver,
}

/// Kinds of words.
const ROW: u16 = 0x0;
const EVENT: u16 = 0x2;
const VECTOR_BASE: u16 = 0x3;
const VECTOR_12: u16 = 0x4;
const VECTOR_8: u16 = 0x5;
const TIME_LOW: u16 = 0x6;
const TIME_HIGH: u16 = 0x8;
const TRIGGER: u16 = 0xa;

/// Kinds at which something happens; of the others, the last word is kept.
const ACTING: u16 = 1 << EVENT | 1 << VECTOR_BASE | 1 << VECTOR_12 | 1 << VECTOR_8 | 1 << TRIGGER;

impl Default for Evt3Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Evt3Decoder {
    /// At the start of a stream: its first time is within the first 16.777216 s.
    pub fn new() -> Self {
        Self {
            words: Words::new(),
            high: Clock::new(12, 4096 * NS_PER_US),
            high_ns: 0,
            last: [0; 16],
            moved: 0,
            known: 0,
            passed_over: PassedOver::default(),
        }
    }

    /// At the start of a stream whose time is near `t_ns` (sensor time, ns): the first time is that one of all times
    /// with the same 24 bits of µs which is nearest to it.
    pub fn with_time_base(t_ns: u64) -> Self {
        let mut decoder = Self::new();
        decoder.set_time_base(t_ns);
        decoder
    }

    /// Says that the sensor's time is now near `t_ns`, as after a gap in the stream. Events are left out until the
    /// next full time and row; an unfinished word is forgotten.
    pub fn set_time_base(&mut self, t_ns: u64) {
        self.high.set_ns(t_ns);
        self.known = 0;
        self.words = Words::new();
    }

    /// Sensor time that the stream has come to, ns; `None` while none is known.
    pub fn time_ns(&self) -> Option<u64> {
        (self.known & (HIGH | LOW) == HIGH | LOW).then(|| self.now_ns())
    }

    #[inline]
    fn now_ns(&self) -> u64 {
        self.high_ns + u64::from(self.last[usize::from(TIME_LOW)] & 0xfff) * NS_PER_US
    }

    #[inline]
    fn row(&self) -> u16 {
        self.last[usize::from(ROW)] & 0x7ff
    }

    /// A vector of `len` pixels.
    #[inline]
    fn vector(&mut self, mut valid: u32, len: u16, out: &mut Vec<RawEvent>) {
        let base = self.last[usize::from(VECTOR_BASE)];
        let (x, on) = ((base & 0x7ff).saturating_add(self.moved), base & 0x800 != 0);
        self.moved = self.moved.saturating_add(len);
        let count = valid.count_ones() as usize;
        if self.known != ALL {
            self.passed_over.before_start += count as u64;
            return;
        }
        let (t_ns, y) = (self.now_ns(), self.row());
        let end = out.len() + count;
        // By fours, which branches foresee better; what is too much goes again.
        out.extend((0..count.next_multiple_of(4)).map(|_| {
            let x = x.saturating_add(valid.trailing_zeros() as u16);
            valid &= valid.wrapping_sub(1);
            RawEvent { t_ns, x, y, on }
        }));
        out.truncate(end);
    }

    fn time_high(&mut self, word: u16) {
        let high_ns = self.high.read(u32::from(word));
        if high_ns != self.high_ns || self.known & HIGH == 0 {
            self.high_ns = high_ns;
            self.last[usize::from(TIME_LOW)] = 0;
        }
        self.last[usize::from(TIME_HIGH)] = word;
    }

    /// Words while time or row are not known yet; what is left of them then.
    fn first_words<'a>(&mut self, mut words: &'a [[u8; 2]], out: &mut Vec<RawEvent>) -> &'a [[u8; 2]] {
        while let [first, rest @ ..] = words
            && self.known & SINGLE != SINGLE
        {
            let word = u16::from_le_bytes(*first);
            match word >> 12 {
                ROW => self.known |= Y,
                TIME_LOW if self.known & HIGH != 0 => self.known |= LOW,
                TIME_HIGH if self.known & HIGH == 0 => {
                    self.time_high(word);
                    self.known |= HIGH;
                }
                _ => {}
            }
            match word >> 12 {
                EVENT => self.passed_over.before_start += 1,
                _ => self.words(std::slice::from_ref(first), out),
            }
            words = rest;
        }
        words
    }

    /// Words when time and row are known if an event is among them.
    fn words(&mut self, mut words: &[[u8; 2]], out: &mut Vec<RawEvent>) {
        while let [first, rest @ ..] = words {
            words = rest;
            let word = u16::from_le_bytes(*first);
            let kind = word >> 12;
            let last = std::mem::replace(&mut self.last[usize::from(kind)], word);
            // Without branches up to here, as kinds follow each other without a rule.
            if (ACTING >> kind & 1 == 0) & ((kind != TIME_HIGH) | (word == last)) {
                continue;
            }
            match kind {
                EVENT => out.push(RawEvent {
                    t_ns: self.now_ns(),
                    x: word & 0x7ff,
                    y: self.row(),
                    on: word & 0x800 != 0,
                }),
                VECTOR_BASE => {
                    self.moved = 0;
                    self.known |= BASE;
                }
                VECTOR_12 => match words {
                    // A sensor sends its vectors as 12, 12 and 8: taken as one of 32.
                    [a, b, rest @ ..] if a[1] >> 4 == VECTOR_12 as u8 && b[1] >> 4 == VECTOR_8 as u8 => {
                        let bits = |word: &[u8; 2]| u32::from(u16::from_le_bytes(*word) & 0xfff);
                        self.vector(bits(first) | bits(a) << 12 | bits(b) << 24, 32, out);
                        words = rest;
                    }
                    _ => self.vector(u32::from(word & 0xfff), 12, out),
                },
                VECTOR_8 => self.vector(u32::from(word & 0xff), 8, out),
                TIME_HIGH => self.time_high(word),
                _ => self.passed_over.triggers += 1,
            }
        }
    }
}

impl Decoder for Evt3Decoder {
    fn word_bytes(&self) -> usize {
        2
    }

    fn most_events_per_word(&self) -> usize {
        12
    }

    fn decode(&mut self, bytes: &[u8], out: &mut Vec<RawEvent>) {
        let (first, whole) = self.words.split(bytes);
        for words in [first.as_slice(), whole] {
            let words = self.first_words(words, out);
            self.words(words, out);
        }
    }

    fn pending_bytes(&self) -> usize {
        self.words.pending()
    }

    fn passed_over(&self) -> PassedOver {
        self.passed_over
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(decoder: &mut Evt3Decoder, words: &[u16]) -> Vec<(u64, u16, u16, bool)> {
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        let mut out = Vec::new();
        decoder.decode(&bytes, &mut out);
        out.iter().map(|e| (e.t_ns / 1000, e.x, e.y, e.on)).collect()
    }

    const fn high(high: u16) -> u16 {
        0x8000 | high
    }

    const fn low(low: u16) -> u16 {
        0x6000 | low
    }

    #[test]
    fn words_change_one_thing_each() {
        let mut decoder = Evt3Decoder::new();
        let words = [
            high(1),
            low(5),
            0x0003, // y 3
            0x2807, // x 7, ON
            0x2008, // x 8, OFF
            0x0804, // y 4 of the other camera
            0x3864, // base 100, ON
            0x4801, // 100 and 111
            0x4002, // 113
            0x5f81, // 124 and 131: bits 8 to 11 do not count
            0x5001, // 132
            0xa101, // trigger
            0xe014,
            0x7fff,
            0xffff,
            0x1fff,
            0x9fff,
            0xbfff,
            0xcfff,
            0xdfff,
            low(6),
            0x2800,
        ];
        let want = [
            (4101, 7, 3, true),
            (4101, 8, 3, false),
            (4101, 100, 4, true),
            (4101, 111, 4, true),
            (4101, 113, 4, true),
            (4101, 124, 4, true),
            (4101, 131, 4, true),
            (4101, 132, 4, true),
            (4102, 0, 4, true),
        ];
        assert_eq!(decode(&mut decoder, &words), want);
        let passed = PassedOver {
            triggers: 1,
            before_start: 0,
        };
        assert_eq!(decoder.passed_over(), passed);
        assert_eq!(decoder.time_ns(), Some(4_102_000));
    }

    #[test]
    fn packets_share_the_state_and_go_on_from_a_base() {
        let mut decoder = Evt3Decoder::with_time_base(100 * 16_777_216_000);
        // The state comes with the first packet, the event with the second.
        assert_eq!(decode(&mut decoder, &[high(4095), low(9), 0x0001]), []);
        let before = 100 * 16_777_216 - 4096 + 9;
        assert_eq!(decode(&mut decoder, &[0x2002]), [(before, 2, 1, false)]);
        assert_eq!(
            decode(&mut decoder, &[high(0), low(1), 0x2003]),
            [(100 * 16_777_216 + 1, 3, 1, false)]
        );
        // Packets are lost: what is stale is not used.
        decoder.set_time_base(200 * 16_777_216_000);
        assert_eq!(decoder.time_ns(), None);
        assert_eq!(
            decode(&mut decoder, &[0x2003, high(2), low(0), 0x2003, 0x0001, 0x2004]),
            [(200 * 16_777_216 + 8192, 4, 1, false)]
        );
        assert_eq!(decoder.passed_over().before_start, 2);
    }
}
