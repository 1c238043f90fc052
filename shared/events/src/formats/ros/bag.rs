//! The bag of ROS 1, version 2.0 (wiki.ros.org/Bags/Format/2.0): records {u32 length, header, u32 length, data}, whose
//! headers are fields {u32 length, name=value}. Chunks hold the records of connections (topics) and messages; behind
//! the last of them is an index, which is not needed here.

use super::chunk::{BAG, MAX_CHUNK_BYTES, decompress};
use super::container::{Chunked, Chunks, wait_for};
use super::fields::{Fields, Layout, Short};
use crate::{Input, SourceError};
use std::collections::HashMap;
use std::ops::Range;

/// What every bag begins with.
pub(in crate::formats) const MAGIC: &[u8] = b"#ROSBAG V";
const FIRST_LINE: &[u8] = b"#ROSBAG V2.0\n";
/// Largest header of a record, bytes.
const MAX_HEADER_BYTES: usize = 1 << 20;

/// Kinds of records.
const MESSAGE: u8 = 2;
const BAG_HEADER: u8 = 3;
const INDEX: u8 = 4;
const CHUNK: u8 = 5;
const CHUNK_INFO: u8 = 6;
const CONNECTION: u8 = 7;

/// See the module.
pub(super) struct Bag {
    file: Chunks,
    /// Where the index begins; `None` in a bag that was not closed.
    index_at: Option<u64>,
    /// Topic of each connection.
    connections: HashMap<u32, usize>,
}

/// The fields of a header that matter.
#[derive(Debug, Default)]
struct Header<'a> {
    op: Option<u8>,
    connection: Option<u32>,
    topic: Option<&'a [u8]>,
    kind: Option<&'a [u8]>,
    compression: Option<&'a [u8]>,
    size: Option<u32>,
    index_at: Option<u64>,
}

impl<'a> Header<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, Short> {
        let mut header = Self::default();
        let mut fields = Fields::packed(bytes);
        while fields.left() > 0 {
            let field = fields.block()?;
            let equals = field.iter().position(|b| *b == b'=').ok_or(Short)?;
            let (name, value) = (&field[..equals], &field[equals + 1..]);
            let mut number = Fields::packed(value);
            match name {
                b"op" => header.op = Some(number.u8()?),
                b"conn" => header.connection = Some(number.u32()?),
                b"topic" => header.topic = Some(value),
                b"type" => header.kind = Some(value),
                b"compression" => header.compression = Some(value),
                b"size" => header.size = Some(number.u32()?),
                b"index_pos" => header.index_at = Some(number.u64()?),
                _ => {}
            }
        }
        Ok(header)
    }
}

impl Bag {
    pub(super) fn open(mut input: Input) -> Result<Self, SourceError> {
        if !wait_for(&mut input, FIRST_LINE.len())? || !input.buffered().starts_with(FIRST_LINE) {
            let what = "is a rosbag of another version than 2.0; rewrite it with rosbag fix";
            return Err(SourceError::malformed(input.path(), what));
        }
        input.consume(FIRST_LINE.len());
        Ok(Self {
            file: Chunks::new(input),
            index_at: None,
            connections: HashMap::new(),
        })
    }

    fn read_chunk(&mut self, start: u64, before: usize, data_len: usize) -> Result<bool, SourceError> {
        if data_len > MAX_CHUNK_BYTES {
            let what = format!(
                "has {data_len} bytes, more than {} MiB; it is damaged, or write the bag with smaller chunks",
                MAX_CHUNK_BYTES >> 20
            );
            return Err(self.wrong(start, &what));
        }
        if !wait_for(&mut self.file.input, before + data_len)? {
            return Err(self.cut_off(start));
        }
        let bytes = self.file.input.buffered();
        let header = Header::read(&bytes[4..before - 4]).map_err(|Short| self.damaged(start))?;
        let (Some(compression), Some(size)) = (header.compression, header.size) else {
            return Err(self.damaged(start));
        };
        let body = &bytes[before..before + data_len];
        decompress(compression, BAG, body, u64::from(size), &mut self.file.chunk)
            .map_err(|what| self.wrong(start, &what))?;
        self.file.input.consume(before + data_len);
        self.file.left = 0..self.file.chunk.len();
        self.file.chunk_at = start;
        Ok(true)
    }

    /// The bytes have ended where a record would begin.
    fn end_of_input(&mut self) -> Result<bool, SourceError> {
        let (here, rest) = (self.file.input.position(), self.file.input.buffered().len());
        if rest > 0 {
            return Err(self.cut_off(here));
        }
        let what = match self.index_at {
            Some(at) => format!(
                "ends at byte {here}, but its chunks should reach to byte {at}: it was cut off; get the rest of it, \
                 or run rosbag reindex on it"
            ),
            None => {
                "was not closed when it was recorded, so its end may be missing; run rosbag reindex on it"
                    .to_owned()
            }
        };
        Err(SourceError::malformed(self.file.input.path(), what))
    }

    fn damaged(&self, start: u64) -> SourceError {
        self.wrong(start, "is of no known kind; the recording is damaged")
    }

    fn cut_off(&self, start: u64) -> SourceError {
        self.wrong(
            start,
            "is cut off; get the rest of the bag, or run rosbag reindex on it",
        )
    }

    fn wrong(&self, start: u64, what: &str) -> SourceError {
        let path = self.file.input.path();
        SourceError::malformed(path, format!("the record at byte {start} {what}"))
    }
}

/// Most connections of a bag: publishers of its topics.
const MAX_CONNECTIONS: usize = 1 << 16;

/// Whether these bytes hold the record that they begin with.
fn whole_record(bytes: &[u8]) -> bool {
    let mut fields = Fields::packed(bytes);
    fields.block().is_ok() && fields.block().is_ok()
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut fields = Fields::packed(bytes);
    fields.go_to(at);
    fields.u32().unwrap_or(0)
}

impl Chunked for Bag {
    fn chunks(&self) -> &Chunks {
        &self.file
    }

    fn chunks_mut(&mut self) -> &mut Chunks {
        &mut self.file
    }

    fn next_record(&mut self, may_wait: bool) -> Result<Option<bool>, SourceError> {
        let start = self.file.input.position();
        if self.index_at.is_some_and(|at| start >= at) {
            return Ok(Some(false));
        }
        if !may_wait && !whole_record(self.file.input.buffered()) {
            return Ok(None);
        }
        if !wait_for(&mut self.file.input, 4)? {
            return self.end_of_input().map(Some);
        }
        let header_len = u32_at(self.file.input.buffered(), 0) as usize;
        if header_len > MAX_HEADER_BYTES {
            return Err(self.wrong(start, "has a header of more than 1 MiB; the recording is damaged"));
        }
        let before = 4 + header_len + 4;
        if !wait_for(&mut self.file.input, before)? {
            return Err(self.cut_off(start));
        }
        let bytes = self.file.input.buffered();
        let data_len = u32_at(bytes, before - 4) as usize;
        let header = Header::read(&bytes[4..before - 4]).map_err(|Short| self.damaged(start))?;
        match header.op {
            Some(BAG_HEADER) => self.index_at = header.index_at.filter(|at| *at > start),
            Some(CHUNK) => return self.read_chunk(start, before, data_len).map(Some),
            Some(INDEX | CHUNK_INFO | CONNECTION) => {}
            Some(MESSAGE) => {
                let what =
                    "is a message outside of a chunk: the bag was not closed; run rosbag reindex on it";
                return Err(self.wrong(start, what));
            }
            _ => return Err(self.damaged(start)),
        }
        if !self.file.input.skip((before + data_len) as u64)? {
            return Err(self.cut_off(start));
        }
        Ok(Some(true))
    }

    fn next_in_chunk(&mut self) -> Result<Option<(usize, Range<usize>)>, String> {
        const DAMAGED: &str = "holds a record that cannot be right; the recording is damaged";
        let damaged = |Short| DAMAGED.to_owned();
        let mut fields = Fields::packed(&self.file.chunk[..self.file.left.end]);
        fields.go_to(self.file.left.start);
        let header = fields.block().map_err(damaged)?;
        let data = fields.block().map_err(damaged)?;
        let end = fields.at();
        let header = Header::read(header).map_err(damaged)?;
        self.file.left.start = end;
        match (header.op, header.connection) {
            (Some(MESSAGE), Some(connection)) => {
                let topic = self.connections.get(&connection).ok_or(DAMAGED)?;
                Ok(Some((*topic, end - data.len()..end)))
            }
            (Some(CONNECTION), Some(connection)) => {
                let about = Header::read(data).map_err(damaged)?;
                // The connection may know it under another name.
                let (Some(topic), Some(kind)) = (header.topic, about.kind) else {
                    return Err(DAMAGED.to_owned());
                };
                let topic = self.file.topics.find(topic, kind, Some(Layout::Ros1))?;
                if self.connections.len() >= MAX_CONNECTIONS && !self.connections.contains_key(&connection) {
                    return Err(format!(
                        "is of a bag with more than {MAX_CONNECTIONS} connections"
                    ));
                }
                self.connections.insert(connection, topic);
                Ok(None)
            }
            _ => Err(DAMAGED.to_owned()),
        }
    }
}
