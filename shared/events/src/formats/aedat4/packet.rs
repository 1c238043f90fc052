//! Bodies of packets: decompression, and where the events are.

use super::flatbuffer::{Damaged, Table, identifier, sized};
use crate::{MAX_TIME_NS, RawEvent};
use lz4_flex::frame::FrameDecoder;
use std::io::BufRead;
use std::ops::Range;
use zstd_safe::DCtx;

/// Most bytes of a packet that is read, as it is in the file and decompressed: 4 million events.
pub(super) const MAX_PACKET_BYTES: usize = 64 << 20;
/// What a decompressed packet without a known size is first given room for.
const FIRST_ROOM_BYTES: usize = 256 << 10;
/// What ZSTD answers when the room is too small: the negative of its error 70.
const TOO_LITTLE_ROOM: usize = 0_usize.wrapping_sub(70);
/// An event: {i64 t in µs, i16 x, i16 y, u8 on, 3 bytes of padding}, little-endian.
pub(super) const EVENT_BYTES: usize = 16;
/// Latest time that has a place in [`RawEvent`], µs.
const MAX_TIME_US: u64 = MAX_TIME_NS / 1000;

/// How the bodies of packets are compressed. Every body is a frame of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Lz4,
    Zstd,
}

impl Compression {
    /// By its number in the header: LZ4 and ZSTD each have two, of different effort.
    pub(super) fn new(number: i32) -> Result<Self, String> {
        match number {
            0 => Ok(Self::None),
            1 | 2 => Ok(Self::Lz4),
            3 | 4 => Ok(Self::Zstd),
            other => Err(format!(
                "has packets of the unknown compression {other}; this build knows none, LZ4 and ZSTD"
            )),
        }
    }
}

/// Why a body cannot be read.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct BadBody(pub(super) String);

impl From<Damaged> for BadBody {
    fn from(_: Damaged) -> Self {
        Self("holds offsets that point outside of it; it is damaged".to_owned())
    }
}

/// A decompressed body, in a buffer that serves one packet after the other.
pub(super) struct Packet {
    compression: Compression,
    zstd: Option<DCtx<'static>>,
    bytes: Vec<u8>,
}

impl Packet {
    pub(super) fn new(compression: Compression) -> Self {
        Self {
            compression,
            zstd: None,
            bytes: Vec::new(),
        }
    }

    /// Decompresses a body.
    pub(super) fn fill(&mut self, body: &[u8]) -> Result<(), BadBody> {
        self.bytes.clear();
        match self.compression {
            Compression::None => self.bytes.extend_from_slice(body),
            Compression::Lz4 => self.fill_lz4(body)?,
            Compression::Zstd => self.fill_zstd(body)?,
        }
        Ok(())
    }

    fn fill_lz4(&mut self, body: &[u8]) -> Result<(), BadBody> {
        let mut decoder = FrameDecoder::new(body);
        loop {
            let block = decoder
                .fill_buf()
                .map_err(|e| BadBody(format!("is no LZ4 frame: {}", one_line(&e.to_string()))))?;
            if block.is_empty() {
                return Ok(());
            }
            if self.bytes.len() + block.len() > MAX_PACKET_BYTES {
                return Err(too_large());
            }
            self.bytes.extend_from_slice(block);
            let taken = block.len();
            decoder.consume(taken);
        }
    }

    fn fill_zstd(&mut self, body: &[u8]) -> Result<(), BadBody> {
        let bad = |e: &str| BadBody(format!("is no ZSTD frame: {}", one_line(e)));
        let said = zstd_safe::get_frame_content_size(body).map_err(|_| bad("its header is damaged"))?;
        let mut room = match said {
            Some(len) if len > MAX_PACKET_BYTES as u64 => return Err(too_large()),
            Some(len) => len as usize,
            None => FIRST_ROOM_BYTES,
        };
        let context = match &mut self.zstd {
            Some(context) => context,
            none => none.insert(DCtx::try_create().ok_or_else(|| bad("there is no memory for it"))?),
        };
        // Decompressed in one step, a frame needs no window; where it does not say its size, the room is found out.
        loop {
            self.bytes.reserve(room);
            match context.decompress(&mut self.bytes, body) {
                Ok(_) => return Ok(()),
                Err(TOO_LITTLE_ROOM) if said.is_none() && room < MAX_PACKET_BYTES => {
                    self.bytes.clear();
                    room = (2 * room).min(MAX_PACKET_BYTES);
                }
                Err(code) => return Err(bad(zstd_safe::get_error_name(code))),
            }
        }
    }

    /// Where in the packet the events are: a whole number of them.
    pub(super) fn events(&self) -> Result<Range<usize>, BadBody> {
        if self.bytes.is_empty() {
            return Ok(0..0);
        }
        let buffer = sized(&self.bytes)?;
        if identifier(buffer)? != *b"EVTS" {
            return Err(BadBody("of a stream of events holds something else".to_owned()));
        }
        let events = Table::root(buffer)?.vector(0, EVENT_BYTES)?;
        // No events need not stand anywhere in it.
        if events.is_empty() {
            return Ok(0..0);
        }
        let start = events.as_ptr() as usize - self.bytes.as_ptr() as usize;
        Ok(start..start + events.len())
    }

    /// How many samples there are in a packet of tables, such as IMU samples or triggers.
    pub(super) fn samples(&self) -> Result<u64, BadBody> {
        let buffer = sized(&self.bytes)?;
        let offsets = Table::root(buffer)?.vector(0, size_of::<u32>())?;
        Ok((offsets.len() / size_of::<u32>()) as u64)
    }

    /// Appends these events to `out`. A time that cannot be ends them; then it is given, with how many came before.
    pub(super) fn decode(&self, events: Range<usize>, out: &mut Vec<RawEvent>) -> Result<(), (usize, i64)> {
        let bytes = self.bytes.get(events).unwrap_or_default();
        let times = || bytes.chunks_exact(EVENT_BYTES).map(time_us);
        let bad = times().position(|t| u64::try_from(t).is_ok_and(|t| t > MAX_TIME_US) || t < 0);
        let good = bad.map_or(bytes, |at| &bytes[..at * EVENT_BYTES]);
        out.extend(good.chunks_exact(EVENT_BYTES).map(event));
        match bad {
            None => Ok(()),
            Some(at) => Err((at, times().nth(at).unwrap_or(0))),
        }
    }
}

fn time_us(e: &[u8]) -> i64 {
    i64::from_le_bytes([e[0], e[1], e[2], e[3], e[4], e[5], e[6], e[7]])
}

/// A pixel left of or above the sensor is one that no sensor has.
fn event(e: &[u8]) -> RawEvent {
    let coordinate = |low, high| u16::try_from(i16::from_le_bytes([low, high])).unwrap_or(u16::MAX);
    RawEvent {
        t_ns: (time_us(e) as u64).wrapping_mul(1000),
        x: coordinate(e[8], e[9]),
        y: coordinate(e[10], e[11]),
        on: e[12] != 0,
    }
}

fn too_large() -> BadBody {
    BadBody(format!(
        "holds more than {} MiB; write the recording with smaller packets",
        MAX_PACKET_BYTES >> 20
    ))
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
