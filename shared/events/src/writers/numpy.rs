//! NumPy: a structured `.npy` array with the fields `t_ns` (i8), `x`, `y` (u2) and `p` (bool), or an `.npz` with four
//! arrays of these names and types, stored. `numpy.load` reads both; the name of the time says its unit.
//!
//! The columns of an `.npz` wait in nameless temporary files beside it until the archive is put together.
//! Formats: <https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>, and PKWARE's APPNOTE.TXT 6.3
//! for zip with 64-bit records.

use super::new_file::NewFile;
use super::{WriteError, Writer};
use crate::RawEvent;
use crc32fast::Hasher;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

const FIELDS: [(&str, &str); 4] = [("t_ns", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "|b1")];
/// Multiples of 64, as the format asks for, with room for any count.
const NPY_HEADER_BYTES: usize = 192;
const COLUMN_HEADER_BYTES: usize = 128;

/// A header of format version 1.0 of just this length.
fn header<const N: usize>(descr: &str, events: u64) -> [u8; N] {
    let text = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': ({events},), }}");
    let mut bytes = [b' '; N];
    bytes[..8].copy_from_slice(b"\x93NUMPY\x01\x00");
    bytes[8..10].copy_from_slice(&(N as u16 - 10).to_le_bytes());
    let len = text.len().min(N - 11);
    bytes[10..10 + len].copy_from_slice(&text.as_bytes()[..len]);
    bytes[N - 1] = b'\n';
    bytes
}

/// A `.npy` file.
pub(super) struct Npy {
    file: NewFile,
    events: u64,
}

impl Npy {
    pub(super) fn create(path: &Path) -> Result<Self, WriteError> {
        let mut npy = Self {
            file: NewFile::create(path)?,
            events: 0,
        };
        npy.put(&npy.header())?;
        Ok(npy)
    }

    fn header(&self) -> [u8; NPY_HEADER_BYTES] {
        let fields = FIELDS.map(|(name, kind)| format!("('{name}', '{kind}')"));
        header(&format!("[{}]", fields.join(", ")), self.events)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        self.file.write_all(bytes).map_err(|e| self.file.failed(e))
    }
}

impl Writer for Npy {
    fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        for event in events {
            let mut row = [0; 13];
            row[..8].copy_from_slice(&event.t_ns.to_le_bytes());
            row[8..10].copy_from_slice(&event.x.to_le_bytes());
            row[10..12].copy_from_slice(&event.y.to_le_bytes());
            row[12] = u8::from(event.on);
            self.put(&row)?;
        }
        self.events += events.len() as u64;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), WriteError> {
        self.file
            .seek(SeekFrom::Start(0))
            .map_err(|e| self.file.failed(e))?;
        self.put(&self.header())?;
        self.file.commit()
    }
}

/// A column that waits for its archive, with the sum of its bytes.
struct Column {
    file: BufWriter<File>,
    sum: Hasher,
    bytes: u64,
}

impl Column {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sum.update(bytes);
        self.bytes += bytes.len() as u64;
        self.file.write_all(bytes)
    }
}

/// An `.npz` archive.
pub(super) struct Npz {
    file: NewFile,
    columns: [Column; 4],
    events: u64,
}

impl Npz {
    pub(super) fn create(path: &Path) -> Result<Self, WriteError> {
        let file = NewFile::create(path)?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        let column = || {
            let file = tempfile::tempfile_in(folder.unwrap_or(Path::new(".")));
            file.map(|file| Column {
                file: BufWriter::new(file),
                sum: Hasher::new(),
                bytes: 0,
            })
            .map_err(|e| WriteError::write(path, e))
        };
        Ok(Self {
            columns: [column()?, column()?, column()?, column()?],
            file,
            events: 0,
        })
    }

    fn put(&mut self, events: &[RawEvent]) -> io::Result<()> {
        let [t, x, y, p] = &mut self.columns;
        for event in events {
            t.put(&event.t_ns.to_le_bytes())?;
            x.put(&event.x.to_le_bytes())?;
            y.put(&event.y.to_le_bytes())?;
            p.put(&[u8::from(event.on)])?;
        }
        self.events += events.len() as u64;
        Ok(())
    }

    fn archive(&mut self) -> io::Result<()> {
        let mut directory = Vec::new();
        let mut at = 0;
        for ((name, kind), column) in FIELDS.iter().zip(&mut self.columns) {
            let start: [u8; COLUMN_HEADER_BYTES] = header(&format!("'{kind}'"), self.events);
            let mut sum = Hasher::new();
            sum.update(&start);
            sum.combine(&column.sum);
            let entry = Entry {
                name: format!("{name}.npy"),
                sum: sum.finalize(),
                bytes: start.len() as u64 + column.bytes,
                at,
            };
            let local = entry.local();
            self.file.write_all(&local)?;
            self.file.write_all(&start)?;
            column.file.flush()?;
            let file = column.file.get_mut();
            file.seek(SeekFrom::Start(0))?;
            let copied = io::copy(&mut file.take(column.bytes), &mut self.file)?;
            if copied != column.bytes {
                return Err(io::Error::other("a temporary file is shorter than was written"));
            }
            at += local.len() as u64 + entry.bytes;
            directory.extend(entry.central());
        }
        self.file.write_all(&directory)?;
        self.file
            .write_all(&ends(FIELDS.len() as u64, directory.len() as u64, at))
    }
}

impl Writer for Npz {
    fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        self.put(events).map_err(|e| self.file.failed(e))
    }

    fn finish(mut self: Box<Self>) -> Result<(), WriteError> {
        self.archive().map_err(|e| self.file.failed(e))?;
        self.file.commit()
    }
}

/// A stored member of a zip archive.
struct Entry {
    name: String,
    sum: u32,
    bytes: u64,
    at: u64,
}

/// The version of the format that has 64-bit records.
const ZIP_64: u16 = 45;
/// 1 January 1980: no other date is known.
const DATE: u16 = 1 << 5 | 1;

impl Entry {
    /// Version, flags, method, time and date, sum, and sizes that refer to the 64-bit ones.
    fn common(&self, out: &mut Vec<u8>) {
        for short in [ZIP_64, 0, 0, 0, DATE] {
            out.extend(short.to_le_bytes());
        }
        out.extend(self.sum.to_le_bytes());
        out.extend([0xff; 8]);
        out.extend((self.name.len() as u16).to_le_bytes());
    }

    fn local(&self) -> Vec<u8> {
        let mut out = b"PK\x03\x04".to_vec();
        self.common(&mut out);
        out.extend(20u16.to_le_bytes());
        out.extend(self.name.as_bytes());
        out.extend([1, 0, 16, 0]);
        out.extend(self.bytes.to_le_bytes());
        out.extend(self.bytes.to_le_bytes());
        out
    }

    fn central(&self) -> Vec<u8> {
        let mut out = b"PK\x01\x02".to_vec();
        out.extend(ZIP_64.to_le_bytes());
        self.common(&mut out);
        out.extend(28u16.to_le_bytes());
        // Comment, part and attributes: none.
        out.extend([0; 10]);
        out.extend([0xff; 4]);
        out.extend(self.name.as_bytes());
        out.extend([1, 0, 24, 0]);
        for long in [self.bytes, self.bytes, self.at] {
            out.extend(long.to_le_bytes());
        }
        out
    }
}

/// What stands behind the directory of so many entries and bytes that begins at `at`.
fn ends(entries: u64, bytes: u64, at: u64) -> Vec<u8> {
    let mut out = b"PK\x06\x06".to_vec();
    out.extend(44u64.to_le_bytes());
    out.extend(ZIP_64.to_le_bytes());
    out.extend(ZIP_64.to_le_bytes());
    out.extend([0; 8]);
    for long in [entries, entries, bytes, at] {
        out.extend(long.to_le_bytes());
    }
    out.extend(b"PK\x06\x07\x00\x00\x00\x00");
    out.extend((at + bytes).to_le_bytes());
    out.extend(1u32.to_le_bytes());
    out.extend(b"PK\x05\x06\x00\x00\x00\x00");
    out.extend([0xff; 12]);
    out.extend([0, 0]);
    out
}
