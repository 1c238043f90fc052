//! Zip archives: the directory, and members as bytes in order.
//!
//! Format: PKWARE's APPNOTE.TXT 6.3 (<https://pkware.cachefly.net/webdocs/casestudies/APPNOTE.TXT>), of which stored
//! and deflated members are read, in archives of one part, with or without the 64-bit records.

use crate::{Input, SourceError};
use flate2::read::DeflateDecoder;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// What an archive begins with when it has a member.
pub(crate) const MAGIC: &[u8] = b"PK\x03\x04";
/// Largest directory that is read, bytes: some ten thousand members.
const MAX_DIRECTORY_BYTES: u64 = 4 << 20;
/// The record at the archive's end, its comment not counted; the 64-bit record and what points to it.
const END_BYTES: u64 = 22;
const END_64_BYTES: usize = 56;
const LOCATOR_BYTES: u64 = 20;
const ENTRY_BYTES: usize = 46;
const LOCAL_BYTES: usize = 30;

const STORED: u16 = 0;
const DEFLATED: u16 = 8;

/// A file inside an archive.
#[derive(Debug, Clone)]
pub(crate) struct Member {
    archive: PathBuf,
    pub(crate) name: String,
    encrypted: bool,
    method: u16,
    crc: u32,
    compressed: u64,
    size: u64,
    header_at: u64,
}

/// The little-endian number at this place.
fn number<const N: usize>(bytes: &[u8], at: usize) -> Option<u64> {
    let bytes = bytes.get(at..at.checked_add(N)?)?;
    Some(bytes.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)))
}

/// The members of an archive, directories left out.
pub(crate) fn members(path: &Path) -> Result<Vec<Member>, SourceError> {
    let failed = |e| SourceError::read(path, e);
    let damaged = || SourceError::malformed(path, "is a zip archive whose directory is damaged or cut short");
    let mut file = File::open(path).map_err(failed)?;
    let size = file.metadata().map_err(failed)?.len();
    let mut read = |at: u64, len: u64| -> Result<Vec<u8>, SourceError> {
        let end = at.checked_add(len).filter(|end| *end <= size);
        let len = usize::try_from(len)
            .ok()
            .filter(|_| end.is_some())
            .ok_or_else(damaged)?;
        let mut bytes = vec![0; len];
        file.seek(SeekFrom::Start(at)).map_err(failed)?;
        file.read_exact(&mut bytes).map_err(failed)?;
        Ok(bytes)
    };
    // The end record stands before a comment of at most 64 KiB.
    let tail_at = size.saturating_sub(END_BYTES + 0xffff);
    let tail = read(tail_at, size - tail_at)?;
    let at = tail
        .windows(4)
        .rposition(|w| w == b"PK\x05\x06")
        .ok_or_else(damaged)?;
    let end = tail
        .get(at..)
        .filter(|end| end.len() as u64 >= END_BYTES)
        .ok_or_else(damaged)?;
    let (mut bytes, mut from) = (
        number::<4>(end, 12).ok_or_else(damaged)?,
        number::<4>(end, 16).ok_or_else(damaged)?,
    );
    let end_at = tail_at + at as u64;
    if let Some(locator_at) = end_at.checked_sub(LOCATOR_BYTES)
        && let locator = read(locator_at, LOCATOR_BYTES)?
        && locator.starts_with(b"PK\x06\x07")
    {
        let at = number::<8>(&locator, 8).ok_or_else(damaged)?;
        let end = read(at, END_64_BYTES as u64)?;
        bytes = number::<8>(&end, 40).ok_or_else(damaged)?;
        from = number::<8>(&end, 48).ok_or_else(damaged)?;
    }
    if bytes > MAX_DIRECTORY_BYTES {
        return Err(SourceError::malformed(
            path,
            "is a zip archive with a directory of more than 4 MiB; unpack the recording that is wanted",
        ));
    }
    let directory = read(from, bytes)?;
    let mut rest = directory.as_slice();
    let mut members = Vec::new();
    while rest.starts_with(b"PK\x01\x02") {
        let (member, len) = entry(path, rest).ok_or_else(damaged)?;
        if !member.name.ends_with('/') {
            members.push(member);
        }
        rest = &rest[len..];
    }
    Ok(members)
}

/// One entry of the directory, and its length.
fn entry(archive: &Path, bytes: &[u8]) -> Option<(Member, usize)> {
    let long = |at| number::<4>(bytes, at);
    let short = |at| number::<2>(bytes, at);
    let (name_len, extra_len) = (short(28)? as usize, short(30)? as usize);
    let name = bytes.get(ENTRY_BYTES..ENTRY_BYTES + name_len)?;
    let extra_at = ENTRY_BYTES + name_len;
    let mut extra = bytes.get(extra_at..extra_at + extra_len)?;
    let mut member = Member {
        archive: archive.to_owned(),
        name: String::from_utf8_lossy(name).into_owned(),
        encrypted: short(8)? & 1 != 0,
        method: short(10)? as u16,
        crc: long(16)? as u32,
        compressed: long(20)?,
        size: long(24)?,
        header_at: long(42)?,
    };
    while let (Some(id), Some(len)) = (number::<2>(extra, 0), number::<2>(extra, 2)) {
        let field = extra.get(4..4 + len as usize)?;
        if id == 1 {
            // The 64-bit numbers of just those that are full above, in this order.
            let mut at = 0;
            for value in [&mut member.size, &mut member.compressed, &mut member.header_at] {
                if *value == 0xffff_ffff {
                    *value = number::<8>(field, at)?;
                    at += 8;
                }
            }
        }
        extra = &extra[4 + len as usize..];
    }
    let len = extra_at + extra_len + short(32)? as usize;
    (len <= bytes.len()).then_some((member, len))
}

impl Member {
    /// The name after the last slash.
    pub(crate) fn file_name(&self) -> &str {
        self.name.rsplit(['/', '\\']).next().unwrap_or_default()
    }

    /// Its bytes, unpacked as they are asked for. They are called by the archive's path.
    pub(crate) fn open(&self) -> Result<Input, SourceError> {
        let wrong = |what: String| SourceError::malformed(&self.archive, format!("{} {what}", self.name));
        if self.encrypted {
            return Err(wrong("is encrypted; unpack the archive first".to_owned()));
        }
        if !matches!(self.method, STORED | DEFLATED) {
            return Err(wrong(format!(
                "is compressed by method {}; stored and deflated members are read: unpack the archive first",
                self.method
            )));
        }
        let mut input = Input::open(&self.archive)?;
        input.seek(self.header_at)?;
        let header = input.peek(LOCAL_BYTES)?;
        let lengths = number::<2>(header, 26).zip(number::<2>(header, 28));
        let Some((name, extra)) = lengths.filter(|_| header.starts_with(MAGIC)) else {
            return Err(wrong(
                "is not where the archive's directory says; it is damaged".to_owned(),
            ));
        };
        input.seek(self.header_at.saturating_add(LOCAL_BYTES as u64 + name + extra))?;
        let (size, crc, name) = (self.size, self.crc, self.name.clone());
        let (compressed, deflated) = (self.compressed, self.method == DEFLATED);
        Ok(input.map(move |archive| Checked {
            reader: if deflated {
                Box::new(DeflateDecoder::new(archive.take(compressed)))
            } else {
                Box::new(archive.take(compressed))
            },
            left: size,
            hasher: crc32fast::Hasher::new(),
            crc,
            name,
        }))
    }
}

/// Reads as much as the directory tells of, and checks the sum at the end.
struct Checked {
    reader: Box<dyn Read + Send>,
    left: u64,
    hasher: crc32fast::Hasher,
    crc: u32,
    name: String,
}

impl Read for Checked {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let wrong = |what: &str| io::Error::other(format!("{} {what}", self.name));
        let room = out.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
        if room == 0 {
            if self.left == 0 && self.hasher.clone().finalize() != self.crc {
                return Err(wrong("has a wrong checksum: the archive is damaged"));
            }
            return Ok(0);
        }
        let got = match self.reader.read(&mut out[..room]) {
            Ok(0) => return Err(wrong("ends too early: the archive is damaged or cut short")),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => return Err(e),
            Err(e) => return Err(wrong(&format!("is damaged: {e}"))),
            Ok(got) => got,
        };
        self.hasher.update(&out[..got]);
        self.left -= got as u64;
        Ok(got)
    }
}
