//! The encodings of events in messages.
//!
//! Facts from the packages `dvs_msgs`, `event_camera_msgs` and `event_camera_codecs` (its decoders and types).

use super::fields::{Fields, Layout, Short};
use super::message::{ARRAY_EVENT_BYTES, Packet, time_ns};
use crate::formats::prophesee::{Decoder, Evt3Decoder};
use crate::{MAX_TIME_NS, RawEvent};
use std::ops::Range;

const NS_PER_US: u64 = 1_000;
/// The range of the counter of libcaer: 31 bits of µs.
const LIBCAER_RANGE: u32 = 1 << 31;
/// Most events in a word of 16 bits.
const EVENTS_PER_WORD: usize = 12;

/// Decodes what one topic holds.
#[derive(Debug)]
pub(super) enum Codec {
    /// Events each with its whole time.
    Array(Layout),
    /// EVT 3.0: times of the sensor. The time base may be anything.
    Evt3(Box<Evt3Decoder>),
    /// {u32 ns since the time base, u16 x, u15 y, u1 on}.
    Mono { base_ns: u64 },
    /// {u32: bits 31–17 x, 16–2 y, 1 on, 0 valid; u31 µs since the time base}.
    Libcaer { base_ns: u64, last_us: u32 },
    /// Words of 16 bits.
    LibcaerCmp(Cmp),
    /// Triggers of the camera, of 8 bytes each: no events.
    Trigger { count: u64 },
}

/// Words of 16 bits, of which bits 15–12 say the kind: 0 time, high (4096 µs); 1 time, low (µs); 2 column (bits 10–0);
/// 3 an event at row 10–0 with polarity 11; 4 base of vectors, row and polarity likewise; 5 vector of 8: an event at
/// base + i for each bit i, then the base moves on by 8. Times count from the time base of the packet.
#[derive(Debug, Default)]
pub(super) struct Cmp {
    base_ns: u64,
    high_us: u64,
    low_us: u64,
    x: Option<u16>,
    base: Option<u16>,
    moved: u16,
    before_start: u64,
}

impl Codec {
    /// By the name of the encoding.
    pub(super) fn new(encoding: &[u8]) -> Result<Self, String> {
        Ok(match encoding {
            b"evt3" => Self::Evt3(Box::default()),
            b"mono" => Self::Mono { base_ns: 0 },
            b"libcaer" => Self::Libcaer {
                base_ns: 0,
                last_us: 0,
            },
            b"libcaer_cmp" => Self::LibcaerCmp(Cmp::default()),
            b"trigger" => Self::Trigger { count: 0 },
            other => {
                return Err(format!(
                    "has the encoding \"{}\"; evt3, mono, libcaer, libcaer_cmp and trigger are read",
                    super::printable(other)
                ));
            }
        })
    }

    /// Its name in messages of type `EventPacket`.
    pub(super) fn encoding(&self) -> &'static [u8] {
        match self {
            Self::Array(_) => b"",
            Self::Evt3(_) => b"evt3",
            Self::Mono { .. } => b"mono",
            Self::Libcaer { .. } => b"libcaer",
            Self::LibcaerCmp(_) => b"libcaer_cmp",
            Self::Trigger { .. } => b"trigger",
        }
    }

    /// The unit of its times.
    pub(super) fn time_unit(&self) -> &'static str {
        match self {
            Self::Evt3(_) | Self::Libcaer { .. } | Self::LibcaerCmp(_) => "us",
            Self::Array(_) | Self::Mono { .. } | Self::Trigger { .. } => "ns",
        }
    }

    /// Bytes of the unit that a packet holds a whole number of.
    pub(super) fn unit_bytes(&self) -> usize {
        match self {
            Self::Array(_) => 1,
            Self::Evt3(_) | Self::LibcaerCmp(_) => 2,
            Self::Mono { .. } | Self::Libcaer { .. } | Self::Trigger { .. } => 8,
        }
    }

    /// Begins a packet. `lost`: packets are missing before it, the last of them that was there having come
    /// `since_ns` before.
    pub(super) fn begin(&mut self, packet: &Packet<'_>, lost: Option<u64>) -> Result<(), String> {
        let base = packet.time_base_ns;
        let counts = !matches!(self, Self::Evt3(_) | Self::Trigger { .. });
        // Room for all the wraps that a packet can have.
        if counts && base > MAX_TIME_NS / 2 {
            return Err(format!(
                "has the time base {base} ns, beyond the year 2116; the recording is damaged"
            ));
        }
        match self {
            Self::Evt3(decoder) => {
                if let (Some(since_ns), Some(now_ns)) = (lost, decoder.time_ns()) {
                    decoder.set_time_base(now_ns.saturating_add(since_ns));
                }
            }
            Self::Mono { base_ns } => *base_ns = base,
            Self::Libcaer { base_ns, last_us } => (*base_ns, *last_us) = (base, 0),
            Self::LibcaerCmp(cmp) => {
                (cmp.base_ns, cmp.high_us, cmp.low_us) = (base, 0, 0);
                if lost.is_some() {
                    (cmp.x, cmp.base) = (None, None);
                }
            }
            Self::Array(_) | Self::Trigger { .. } => {}
        }
        Ok(())
    }

    /// Appends events of `message[left]` to `out`, at most `room`, and takes from `left` what they were.
    pub(super) fn decode(
        &mut self,
        message: &[u8],
        left: &mut Range<usize>,
        room: usize,
        out: &mut Vec<RawEvent>,
    ) {
        let bytes = message.get(left.clone()).unwrap_or_default();
        let (taken, per_unit) = match self {
            Self::Array(Layout::Ros1) => (ARRAY_EVENT_BYTES, 1),
            Self::Array(Layout::Cdr) => {
                left.start = cdr_array(message, left, room, out);
                return;
            }
            Self::Evt3(_) | Self::LibcaerCmp(_) => (2, EVENTS_PER_WORD),
            Self::Mono { .. } | Self::Libcaer { .. } | Self::Trigger { .. } => (8, 1),
        };
        let len = bytes.len().min(room / per_unit * taken);
        let bytes = &bytes[..len];
        match self {
            Self::Array(_) => out.extend(bytes.as_chunks().0.iter().map(array_event)),
            Self::Evt3(decoder) => decoder.decode(bytes, out),
            Self::Mono { base_ns } => out.extend(bytes.as_chunks().0.iter().map(|e| mono_event(e, *base_ns))),
            Self::Libcaer { base_ns, last_us } => out.extend(
                bytes
                    .as_chunks()
                    .0
                    .iter()
                    .map(|e| libcaer_event(e, base_ns, last_us)),
            ),
            Self::LibcaerCmp(cmp) => cmp.decode(bytes, out),
            Self::Trigger { count } => *count += (len / 8) as u64,
        }
        left.start += len;
    }

    /// Triggers, and events whose time or place was not known.
    pub(super) fn passed_over(&self) -> (u64, u64) {
        match self {
            Self::Evt3(decoder) => {
                let passed = decoder.passed_over();
                (passed.triggers, passed.before_start)
            }
            Self::LibcaerCmp(cmp) => (0, cmp.before_start),
            Self::Trigger { count } => (*count, 0),
            _ => (0, 0),
        }
    }
}

fn array_event(e: &[u8; ARRAY_EVENT_BYTES]) -> RawEvent {
    let u16_at = |i: usize| u16::from_le_bytes([e[i], e[i + 1]]);
    let u32_at = |i: usize| u32::from_le_bytes([e[i], e[i + 1], e[i + 2], e[i + 3]]);
    RawEvent {
        t_ns: u64::from(u32_at(4)) * 1_000_000_000 + u64::from(u32_at(8)),
        x: u16_at(0),
        y: u16_at(2),
        on: e[12] != 0,
    }
}

/// Gives the place behind what it took.
fn cdr_array(message: &[u8], left: &Range<usize>, room: usize, out: &mut Vec<RawEvent>) -> usize {
    let Ok(mut fields) = Fields::message(message, Layout::Cdr) else {
        return left.end;
    };
    fields.go_to(left.start);
    let mut event = || -> Result<RawEvent, Short> {
        let (x, y) = (fields.u16()?, fields.u16()?);
        let t_ns = time_ns(&mut fields)?;
        let on = fields.u8()? != 0;
        Ok(RawEvent { t_ns, x, y, on })
    };
    for _ in 0..room {
        match event() {
            Ok(event) => out.push(event),
            Err(Short) => return left.end,
        }
    }
    fields.at()
}

fn mono_event(e: &[u8; 8], base_ns: u64) -> RawEvent {
    let e = u64::from_le_bytes(*e);
    RawEvent {
        t_ns: base_ns + (e & 0xffff_ffff),
        x: (e >> 32) as u16,
        y: (e >> 48) as u16 & 0x7fff,
        on: e >> 63 != 0,
    }
}

/// The counter has wrapped where it falls by half its range or more.
fn libcaer_event(e: &[u8; 8], base_ns: &mut u64, last_us: &mut u32) -> RawEvent {
    let data = u32::from_le_bytes([e[0], e[1], e[2], e[3]]);
    let us = u32::from_le_bytes([e[4], e[5], e[6], e[7]]) % LIBCAER_RANGE;
    if last_us.saturating_sub(us) >= LIBCAER_RANGE / 2 {
        *base_ns = base_ns.saturating_add(u64::from(LIBCAER_RANGE) * NS_PER_US);
    }
    *last_us = us;
    RawEvent {
        t_ns: base_ns.saturating_add(u64::from(us) * NS_PER_US).min(MAX_TIME_NS),
        x: (data >> 17) as u16,
        y: (data >> 2) as u16 & 0x7fff,
        on: data & 2 != 0,
    }
}

impl Cmp {
    fn decode(&mut self, bytes: &[u8], out: &mut Vec<RawEvent>) {
        for word in bytes.as_chunks().0 {
            let word = u16::from_le_bytes(*word);
            let low = u64::from(word & 0xfff);
            match word >> 12 {
                0 => self.high_us = low << 12,
                1 => self.low_us = low,
                2 => self.x = Some(word & 0x7ff),
                3 => self.event(Some(word), 0, out),
                4 => (self.base, self.moved) = (Some(word), 0),
                5 => {
                    for bit in (0..8).filter(|bit| word >> bit & 1 != 0) {
                        self.event(self.base, self.moved.saturating_add(bit), out);
                    }
                    self.moved = self.moved.saturating_add(8);
                }
                // Not written.
                _ => {}
            }
        }
    }

    fn event(&mut self, row: Option<u16>, moved: u16, out: &mut Vec<RawEvent>) {
        let (Some(x), Some(row)) = (self.x, row) else {
            self.before_start += 1;
            return;
        };
        out.push(RawEvent {
            t_ns: self.base_ns + (self.high_us | self.low_us) * NS_PER_US,
            x,
            y: (row & 0x7ff).saturating_add(moved),
            on: row & 0x800 != 0,
        });
    }
}
