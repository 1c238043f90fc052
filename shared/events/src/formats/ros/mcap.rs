//! MCAP (mcap.dev/spec), as ROS 2 writes it: records {u8 kind, u64 length, content}. Chunks hold the records of
//! channels (topics) and messages; behind the last of them is a summary, which is not needed here.

use super::chunk::{MAX_CHUNK_BYTES, MCAP, decompress};
use super::container::{Chunked, Chunks, Topics, wait_for};
use super::fields::{Fields, Layout, Short};
use crate::{Input, SourceError};
use std::collections::HashMap;
use std::ops::Range;

/// What every file begins with.
pub(in crate::formats) const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// {u8 kind, u64 length}.
const HEAD_BYTES: usize = 9;
/// What a chunk may have besides its records: times, sizes and its compression.
const CHUNK_HEAD_BYTES: usize = 1 << 10;

/// Kinds of records.
const FOOTER: u8 = 0x02;
const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const CHUNK: u8 = 0x06;
const DATA_END: u8 = 0x0f;

const DAMAGED: &str = "holds a record that cannot be right; the recording is damaged";

/// See the module.
pub(super) struct Mcap {
    file: Chunks,
    /// Name of each schema that a channel may name: types of messages.
    schemas: HashMap<u16, Vec<u8>>,
    /// Topic of each channel.
    channels: HashMap<u16, usize>,
}

impl Mcap {
    pub(super) fn open(mut input: Input) -> Result<Self, SourceError> {
        if !wait_for(&mut input, MAGIC.len())? || !input.buffered().starts_with(MAGIC) {
            let what = "does not begin as MCAP does; it is damaged or of another format";
            return Err(SourceError::malformed(input.path(), what));
        }
        input.consume(MAGIC.len());
        Ok(Self {
            file: Chunks::new(input),
            schemas: HashMap::new(),
            channels: HashMap::new(),
        })
    }

    fn wrong(&self, start: u64, what: &str) -> SourceError {
        let path = self.file.input.path();
        SourceError::malformed(path, format!("the record at byte {start} {what}"))
    }
}

const CUT_OFF: &str = "is cut off; get the rest of the recording, or run mcap recover on it";
/// {u16 channel, u32 number, u64 time it was logged at, u64 time it was sent at}.
const MESSAGE_HEAD_BYTES: usize = 22;
/// More than the name of a type may have.
const MAX_SCHEMA_NAME_BYTES: usize = 1 << 10;

/// Number and topic of a channel: {u16 number, u16 schema, text topic, text encoding of messages, …}.
fn channel(
    content: &[u8],
    schemas: &HashMap<u16, Vec<u8>>,
    topics: &mut Topics,
) -> Result<(u16, usize), String> {
    let damaged = |Short| DAMAGED.to_owned();
    let mut fields = Fields::packed(content);
    let (id, schema) = (fields.u16().map_err(damaged)?, fields.u16().map_err(damaged)?);
    let topic = fields.block().map_err(damaged)?;
    let layout = match fields.block().map_err(damaged)? {
        b"cdr" => Some(Layout::Cdr),
        b"ros1" => Some(Layout::Ros1),
        _ => None,
    };
    let kind = schemas.get(&schema).map_or(&b""[..], Vec::as_slice);
    Ok((id, topics.find(topic, kind, layout)?))
}

/// Unpacks the content of a chunk: {u64 first time, u64 last time, u64 size, u32 CRC-32 or 0, text compression, u64
/// length, records}.
fn unpack(content: &[u8], out: &mut Vec<u8>) -> Result<(), String> {
    let read = || {
        let mut fields = Fields::packed(content);
        fields.take(16)?;
        let (size, crc) = (fields.u64()?, fields.u32()?);
        let compression = fields.block()?;
        let len = usize::try_from(fields.u64()?).map_err(|_| Short)?;
        Ok((size, crc, compression, fields.take(len)?))
    };
    let (size, crc, compression, records) = read().map_err(|Short| DAMAGED.to_owned())?;
    decompress(compression, MCAP, records, size, out)?;
    if crc != 0 && crc != crc32fast::hash(out) {
        return Err("does not have the checksum that it should have; the recording is damaged".to_owned());
    }
    Ok(())
}

/// Kind and length of the record that these bytes begin with.
fn head(bytes: &[u8]) -> (u8, u64) {
    let mut fields = Fields::packed(bytes);
    (fields.u8().unwrap_or(0), fields.u64().unwrap_or(0))
}

/// Whether these bytes hold the record that they begin with.
fn whole_record(bytes: &[u8]) -> bool {
    let (_, len) = head(bytes);
    bytes.len() as u64 >= (HEAD_BYTES as u64).saturating_add(len)
}

impl Chunked for Mcap {
    fn chunks(&self) -> &Chunks {
        &self.file
    }

    fn chunks_mut(&mut self) -> &mut Chunks {
        &mut self.file
    }

    fn next_record(&mut self, may_wait: bool) -> Result<Option<bool>, SourceError> {
        let start = self.file.input.position();
        if !may_wait && !whole_record(self.file.input.buffered()) {
            return Ok(None);
        }
        if !wait_for(&mut self.file.input, HEAD_BYTES)? {
            let what = if self.file.input.buffered().is_empty() {
                "ends without the record that should end it: it was cut off; get the rest of it, or run mcap recover \
                 on it"
                    .to_owned()
            } else {
                format!("the record at byte {start} {CUT_OFF}")
            };
            return Err(SourceError::malformed(self.file.input.path(), what));
        }
        let (kind, len) = head(self.file.input.buffered());
        if matches!(kind, DATA_END | FOOTER) {
            return Ok(Some(false));
        }
        if !matches!(kind, SCHEMA | CHANNEL | MESSAGE | CHUNK) {
            let whole = self.file.input.skip((HEAD_BYTES as u64).saturating_add(len))?;
            return if whole {
                Ok(Some(true))
            } else {
                Err(self.wrong(start, CUT_OFF))
            };
        }
        let fits = |len: &usize| *len <= MAX_CHUNK_BYTES + CHUNK_HEAD_BYTES;
        let Some(len) = usize::try_from(len).ok().filter(fits) else {
            let what = format!(
                "has {len} bytes, more than {} MiB; it is damaged, or write the recording with smaller chunks",
                MAX_CHUNK_BYTES >> 20
            );
            return Err(self.wrong(start, &what));
        };
        if !wait_for(&mut self.file.input, HEAD_BYTES + len)? {
            return Err(self.wrong(start, CUT_OFF));
        }
        let record = &self.file.input.buffered()[..HEAD_BYTES + len];
        if kind == CHUNK {
            unpack(&record[HEAD_BYTES..], &mut self.file.chunk).map_err(|what| self.wrong(start, &what))?;
        } else {
            self.file.chunk.clear();
            self.file.chunk.extend_from_slice(record);
        }
        self.file.input.consume(HEAD_BYTES + len);
        (self.file.left, self.file.chunk_at) = (0..self.file.chunk.len(), start);
        Ok(Some(true))
    }

    fn next_in_chunk(&mut self) -> Result<Option<(usize, Range<usize>)>, String> {
        let damaged = |Short| DAMAGED.to_owned();
        let mut fields = Fields::packed(&self.file.chunk[..self.file.left.end]);
        fields.go_to(self.file.left.start);
        let (kind, len) = head(fields.take(HEAD_BYTES).map_err(damaged)?);
        let len = usize::try_from(len).map_err(|_| DAMAGED)?;
        let start = fields.at();
        let content = fields.take(len).map_err(damaged)?;
        let end = fields.at();
        self.file.left.start = end;
        let mut fields = Fields::packed(content);
        match kind {
            SCHEMA => {
                let id = fields.u16().map_err(damaged)?;
                let name = fields.block().map_err(damaged)?;
                let name = &name[..name.len().min(MAX_SCHEMA_NAME_BYTES)];
                self.schemas.insert(id, name.to_owned());
                Ok(None)
            }
            CHANNEL => {
                let (id, topic) = channel(content, &self.schemas, &mut self.file.topics)?;
                self.channels.insert(id, topic);
                Ok(None)
            }
            MESSAGE => {
                let id = fields.u16().map_err(damaged)?;
                fields.take(MESSAGE_HEAD_BYTES - 2).map_err(damaged)?;
                let topic = self.channels.get(&id).ok_or(DAMAGED)?;
                Ok(Some((*topic, start + MESSAGE_HEAD_BYTES..end)))
            }
            _ => Ok(None),
        }
    }
}
