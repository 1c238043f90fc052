//! HDF5 in the layout of NSAVP: `/events/{timestamps u64 ns, x_coordinates u16, y_coordinates u16, polarities u8}`, in
//! chunks of 32768 with shuffle and deflate; attributes `height` and `width` of `/events` where the sensor is known.
//!
//! Chunks are written as they fill. What describes them (`hdf5_structure`) stands behind them, and last the superblock
//! at the start says where.

use super::hdf5_structure as structure;
use super::new_file::NewFile;
use super::{WriteError, Writer};
use crate::RawEvent;
use evpr_core::plan::Sensor;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use structure::{Chunk, Column};

/// Events per chunk, as in NSAVP's own files.
const CHUNK_EVENTS: usize = 1 << 15;

/// A column, and what is not written of it yet.
struct Pending {
    name: &'static str,
    bytes_each: usize,
    /// Values of the chunk that is being filled, little-endian.
    bytes: Vec<u8>,
    chunks: Vec<Chunk>,
}

impl Pending {
    fn new(name: &'static str, bytes_each: usize) -> Self {
        Self {
            name,
            bytes_each,
            bytes: Vec::with_capacity(CHUNK_EVENTS * bytes_each),
            chunks: Vec::new(),
        }
    }
}

/// See the module.
pub(super) struct Nsavp {
    file: NewFile,
    /// Where the next byte goes.
    end: u64,
    sensor: Option<Sensor>,
    columns: [Pending; 4],
    events: u64,
}

impl Nsavp {
    pub(super) fn create(path: &Path, sensor: Option<Sensor>) -> Result<Self, WriteError> {
        let mut this = Self {
            file: NewFile::create(path)?,
            end: 0,
            sensor,
            columns: [
                Pending::new("timestamps", 8),
                Pending::new("x_coordinates", 2),
                Pending::new("y_coordinates", 2),
                Pending::new("polarities", 1),
            ],
            events: 0,
        };
        this.append(&[0; structure::SUPERBLOCK_BYTES])?;
        Ok(this)
    }

    /// Writes at the end; where that was.
    fn append(&mut self, bytes: &[u8]) -> Result<u64, WriteError> {
        let at = self.end;
        self.file.write_all(bytes).map_err(|e| self.file.failed(e))?;
        self.end += bytes.len() as u64;
        Ok(at)
    }

    /// Writes the chunks that are being filled. A chunk is stored whole: what is missing is 0.
    fn write_chunks(&mut self) -> Result<(), WriteError> {
        for i in 0..self.columns.len() {
            let Some(column) = self.columns.get_mut(i) else {
                continue;
            };
            column.bytes.resize(CHUNK_EVENTS * column.bytes_each, 0);
            let shuffled = shuffle(&column.bytes, column.bytes_each);
            column.bytes.clear();
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(structure::DEFLATE_LEVEL));
            let packed = encoder.write_all(&shuffled).and_then(|()| encoder.finish());
            let packed = packed.map_err(|e| self.file.failed(e))?;
            let chunk = Chunk {
                at: self.append(&packed)?,
                bytes: packed.len() as u32,
            };
            if let Some(column) = self.columns.get_mut(i) {
                column.chunks.push(chunk);
            }
        }
        Ok(())
    }

    /// Writes what describes the chunks, and the superblock.
    fn describe(&mut self) -> Result<(), WriteError> {
        let mut datasets = Vec::new();
        for i in 0..self.columns.len() {
            let Some(column) = self.columns.get(i) else {
                continue;
            };
            let (index, root) = structure::chunk_index(&column.chunks, CHUNK_EVENTS as u64, self.end);
            let name = column.name;
            let column = Column {
                bytes_each: column.bytes_each as u32,
                len: self.events,
                chunk_len: CHUNK_EVENTS as u32,
                index: root,
            };
            self.append(&index)?;
            datasets.push((name, self.append(&structure::dataset(&column))?));
        }
        let sides = self.sensor.map(|s| [("height", s.height), ("width", s.width)]);
        let attributes: Vec<_> = sides.into_iter().flatten().map(|(n, v)| (n, v as i64)).collect();
        let events = self.append(&structure::group(&datasets, &attributes))?;
        let root = self.append(&structure::group(&[("events", events)], &[]))?;
        let superblock = structure::superblock(root, self.end);
        let written = self.file.seek(SeekFrom::Start(0));
        written
            .and_then(|_| self.file.write_all(&superblock))
            .map_err(|e| self.file.failed(e))
    }
}

impl Writer for Nsavp {
    fn write(&mut self, mut events: &[RawEvent]) -> Result<(), WriteError> {
        while !events.is_empty() {
            let filled = (self.events % CHUNK_EVENTS as u64) as usize;
            let (now, later) = events.split_at(events.len().min(CHUNK_EVENTS - filled));
            let [t, x, y, p] = &mut self.columns;
            t.bytes.extend(now.iter().flat_map(|e| e.t_ns.to_le_bytes()));
            x.bytes.extend(now.iter().flat_map(|e| e.x.to_le_bytes()));
            y.bytes.extend(now.iter().flat_map(|e| e.y.to_le_bytes()));
            p.bytes.extend(now.iter().map(|e| u8::from(e.on)));
            self.events += now.len() as u64;
            if filled + now.len() == CHUNK_EVENTS {
                self.write_chunks()?;
            }
            events = later;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), WriteError> {
        if !self.events.is_multiple_of(CHUNK_EVENTS as u64) {
            self.write_chunks()?;
        }
        self.describe()?;
        self.file.commit()
    }
}

/// The first bytes of all values, then the second ones, and so on.
fn shuffle(bytes: &[u8], bytes_each: usize) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    for plane in 0..bytes_each {
        out.extend(bytes.iter().skip(plane).step_by(bytes_each));
    }
    out
}
