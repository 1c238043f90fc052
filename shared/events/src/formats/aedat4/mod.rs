//! AEDAT4, the format of iniVation's DV software, in a file or over a network.
//!
//! A file begins with the line `#!AER-DAT4.0`; a network stream does not. Then: the header; packets, each
//! {i32 stream, i32 size, body}; in a file at last a table of the packets, which is not needed here. A body, once
//! decompressed, is a FlatBuffer. Times are µs of the Unix epoch. From docs.inivation.com, "AEDAT 4.0".

mod flatbuffer;
mod header;
mod packet;

use crate::{BATCH_EVENTS, Input, RawEvent, ReadOptions, Recording, Skipped, SourceError, SourceInfo};
use evpr_core::plan::Sensor;
use header::{Header, Stream};
use packet::{BadBody, EVENT_BYTES, MAX_PACKET_BYTES, Packet};
use std::ops::Range;

/// What a file begins with.
pub(super) const FIRST_LINE: &[u8] = b"#!AER-DAT4.0\r\n";
/// Largest header, bytes.
const MAX_HEADER_BYTES: usize = 1 << 20;
/// Waited for at once while a length is only a claim, bytes.
const STEP_BYTES: usize = 1 << 20;
/// {i32 stream, i32 size}.
const PACKET_HEADER_BYTES: usize = 8;

/// See the module.
pub(super) struct Aedat4 {
    input: Input,
    stream: i32,
    sensor: Option<Sensor>,
    others: Vec<Other>,
    /// Packets of streams that the header does not name.
    unnamed: u64,
    packet: Packet,
    /// What of the packet is not given yet, bytes.
    left: Range<usize>,
    /// Events given so far.
    index: u64,
    /// Place of the table at the end of the file: packets end there.
    table_at: Option<u64>,
    ended: bool,
}

/// A stream that is passed over.
struct Other {
    stream: Stream,
    /// Frames, samples or packets.
    count: u64,
    /// Packets whose samples could not be counted.
    damaged: u64,
}

impl Aedat4 {
    /// A file.
    pub(super) fn open(mut input: Input, options: &ReadOptions) -> Result<Self, SourceError> {
        if !wait_for(&mut input, FIRST_LINE.len())? || !input.buffered().starts_with(FIRST_LINE) {
            return Err(malformed(
                &input,
                "does not begin with the line #!AER-DAT4.0; it is damaged or of another format",
            ));
        }
        input.consume(FIRST_LINE.len());
        Self::after_first_line(input, options, true)
    }

    /// What DV software serves: a file without its first line, and without an end.
    pub(super) fn network(input: Input, options: &ReadOptions) -> Result<Self, SourceError> {
        Self::after_first_line(input, options, false)
    }

    fn after_first_line(mut input: Input, options: &ReadOptions, file: bool) -> Result<Self, SourceError> {
        let cut = "ends inside its header; it was cut off: record it again or get another copy";
        if !wait_for(&mut input, 4)? {
            return Err(malformed(&input, cut));
        }
        let len = u32_of(input.buffered()) as usize;
        if len > MAX_HEADER_BYTES {
            return Err(malformed(
                &input,
                format!(
                    "says that its header has {len} bytes, more than {} MiB; it is damaged, or not AEDAT4",
                    MAX_HEADER_BYTES >> 20
                ),
            ));
        }
        if !wait_for(&mut input, 4 + len)? {
            return Err(malformed(&input, cut));
        }
        let header = Header::read(input.buffered()).map_err(|what| malformed(&input, what))?;
        input.consume(4 + len);
        let stream = header
            .events(options.stream.as_deref())
            .map_err(|what| malformed(&input, what))?;
        let sensor = match (options.sensor, stream.sensor()) {
            (_, Ok(said)) => said,
            (Some(_), Err(_)) => None,
            (None, Err(what)) => return Err(malformed(&input, what)),
        };
        let id = stream.id;
        let others = header.streams.iter().filter(|s| s.id != id).cloned();
        let others = others.map(|stream| Other {
            stream,
            count: 0,
            damaged: 0,
        });
        // A recording that was interrupted has no table; nor has a network stream.
        let table_at = u64::try_from(header.table_at).ok();
        Ok(Self {
            stream: id,
            sensor,
            others: others.collect(),
            unnamed: 0,
            packet: Packet::new(header.compression),
            left: 0..0,
            index: 0,
            table_at: table_at.filter(|at| file && *at >= input.position()),
            ended: false,
            input,
        })
    }

    /// Reads the next packet, whole; `left` is then its events. False at the end, and where it would wait although
    /// it must not.
    fn next_packet(&mut self, may_wait: bool) -> Result<bool, SourceError> {
        let start = self.input.position();
        if self.table_at.is_some_and(|at| start >= at) {
            self.ended = true;
            return Ok(false);
        }
        if !may_wait && self.input.buffered().len() < PACKET_HEADER_BYTES {
            return Ok(false);
        }
        if !wait_for(&mut self.input, PACKET_HEADER_BYTES)? {
            return self.end_of_input();
        }
        let (head, size) = self.input.buffered().split_at(4);
        let (stream, size) = (u32_of(head) as i32, u32_of(size) as i32);
        let size = usize::try_from(size)
            .map_err(|_| self.wrong(start, &format!("has the negative size {size}; it is damaged")))?;
        let end = start + PACKET_HEADER_BYTES as u64 + size as u64;
        if self.table_at.is_some_and(|at| end > at) {
            return Err(self.wrong(
                start,
                "reaches into the table at the end of the file; it is damaged",
            ));
        }
        if !may_wait && self.input.buffered().len() < PACKET_HEADER_BYTES + size {
            return Ok(false);
        }
        if stream == self.stream {
            self.read_events(start, size)
        } else {
            self.pass_over(stream, start, size)
        }
    }

    fn read_events(&mut self, start: u64, size: usize) -> Result<bool, SourceError> {
        if size > MAX_PACKET_BYTES {
            return Err(self.wrong(
                start,
                &format!(
                    "has {size} bytes, more than {} MiB; it is damaged, or write the recording with smaller packets",
                    MAX_PACKET_BYTES >> 20
                ),
            ));
        }
        if !wait_for(&mut self.input, PACKET_HEADER_BYTES + size)? {
            return Err(self.cut_off(start, size));
        }
        let body = &self.input.buffered()[PACKET_HEADER_BYTES..PACKET_HEADER_BYTES + size];
        let filled = if size == 0 {
            Ok(0..0)
        } else {
            self.packet.fill(body).and_then(|()| self.packet.events())
        };
        self.left = filled.map_err(|BadBody(what)| self.wrong(start, &what))?;
        self.input.consume(PACKET_HEADER_BYTES + size);
        Ok(true)
    }

    /// Counts a packet of another stream. What is wrong inside of it does no harm to the events.
    fn pass_over(&mut self, stream: i32, start: u64, size: usize) -> Result<bool, SourceError> {
        let other = self.others.iter_mut().find(|o| o.stream.id == stream);
        let samples = other.as_ref().is_some_and(|o| o.has_samples()) && size <= MAX_PACKET_BYTES;
        if samples && wait_for(&mut self.input, PACKET_HEADER_BYTES + size)? {
            let body = &self.input.buffered()[PACKET_HEADER_BYTES..PACKET_HEADER_BYTES + size];
            let counted = self.packet.fill(body).and_then(|()| self.packet.samples());
            if let Some(other) = other {
                match counted {
                    Ok(count) => other.count += count,
                    Err(_) => other.damaged += 1,
                }
            }
        } else if let Some(other) = other {
            other.count += u64::from(!other.has_samples());
            other.damaged += u64::from(other.has_samples());
        } else {
            self.unnamed += 1;
        }
        if self.input.skip((PACKET_HEADER_BYTES + size) as u64)? {
            Ok(true)
        } else {
            Err(self.cut_off(start, size))
        }
    }

    /// The bytes have ended where a packet would begin.
    fn end_of_input(&mut self) -> Result<bool, SourceError> {
        let (here, rest) = (self.input.position(), self.input.buffered().len());
        if rest > 0 {
            return Err(self.cut_off(here, 0));
        }
        if let Some(at) = self.table_at {
            return Err(malformed(
                &self.input,
                format!(
                    "ends at byte {here}, but its packets should reach to byte {at}; it was cut off: get the rest of it"
                ),
            ));
        }
        self.ended = true;
        Ok(false)
    }

    fn cut_off(&self, start: u64, size: usize) -> SourceError {
        let whole = PACKET_HEADER_BYTES as u64 + size as u64;
        let what =
            format!("is cut off: it should have {whole} bytes or more; record again or get another copy");
        self.wrong(start, &what)
    }

    fn wrong(&self, start: u64, what: &str) -> SourceError {
        malformed(&self.input, format!("the packet at byte {start} {what}"))
    }

    fn give(&mut self, out: &mut Vec<RawEvent>) -> Result<(), SourceError> {
        let room = (BATCH_EVENTS - out.len()) * EVENT_BYTES;
        let now = self.left.start..self.left.end.min(self.left.start + room);
        self.left.start = now.end;
        let before = out.len();
        let outcome = self.packet.decode(now, out);
        self.index += (out.len() - before) as u64;
        outcome.map_err(|(_, t_us)| {
            let why = if t_us < 0 {
                "is negative"
            } else {
                "lies beyond the year 2262"
            };
            let what = format!(
                "event {} (from 0) has the time {t_us} µs, which {why}",
                self.index
            );
            malformed(&self.input, what)
        })
    }
}

impl Other {
    /// Its packets hold a vector of samples, each a table.
    fn has_samples(&self) -> bool {
        matches!(self.stream.kind.as_str(), "IMUS" | "TRIG")
    }

    fn skipped(&self) -> impl Iterator<Item = Skipped> {
        let stream = self.stream.id;
        let what = match self.stream.kind.as_str() {
            "FRME" => "frames".to_owned(),
            "IMUS" => "IMU samples".to_owned(),
            "TRIG" => "triggers".to_owned(),
            "EVTS" => "packets of events".to_owned(),
            other => {
                let letters = other.chars().take(4).flat_map(char::escape_debug);
                format!("packets of type {}", letters.collect::<String>())
            }
        };
        let kinds = [(what, self.count), ("damaged packets".to_owned(), self.damaged)];
        let kinds = kinds.into_iter().filter(|(_, count)| *count > 0);
        kinds.map(move |(what, count)| Skipped {
            what: format!("{what} (stream {stream})"),
            count,
        })
    }
}

impl Recording for Aedat4 {
    fn sensor(&self) -> Option<Sensor> {
        self.sensor
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        while !self.ended && out.len() < BATCH_EVENTS {
            let outcome = if self.left.is_empty() {
                self.next_packet(out.is_empty())
            } else {
                self.give(out).map(|()| true)
            };
            match outcome {
                Ok(true) => {}
                Ok(false) => break,
                Err(e) => {
                    self.ended = true;
                    return Err(e);
                }
            }
        }
        Ok(!out.is_empty() || !self.ended)
    }

    fn progress_permille(&self) -> u64 {
        // What may stand behind the last packet is not read.
        if self.ended {
            1000
        } else {
            self.input.progress_permille()
        }
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: "AEDAT4",
            path: self.input.path().to_owned(),
            time_unit: "us",
            time_unit_from: "format",
            events: None,
        }
    }

    fn skipped(&self) -> Vec<Skipped> {
        let unnamed = (self.unnamed > 0).then(|| Skipped {
            what: "packets of streams that the header does not name".to_owned(),
            count: self.unnamed,
        });
        self.others
            .iter()
            .flat_map(Other::skipped)
            .chain(unnamed)
            .collect()
    }
}

/// Waits until `len` bytes are there; false when the input ends before. Memory grows with what has come, not with
/// what is claimed.
fn wait_for(input: &mut Input, len: usize) -> Result<bool, SourceError> {
    while input.buffered().len() < len {
        let now = len.min((2 * input.buffered().len()).max(STEP_BYTES));
        if input.peek(now)?.len() < now {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The number in the first four bytes.
fn u32_of(bytes: &[u8]) -> u32 {
    let mut number = [0; 4];
    number.iter_mut().zip(bytes).for_each(|(n, b)| *n = *b);
    u32::from_le_bytes(number)
}

fn malformed(input: &Input, what: impl Into<String>) -> SourceError {
    SourceError::malformed(input.path(), what)
}
