//! The pages of a column in a row group, one after another: their headers are read and their bytes decompressed here,
//! within fixed bounds; what is in them is for the `parquet` crate.
//!
//! Formats: `PageHeader` in <https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift>, and
//! <https://github.com/apache/parquet-format/blob/master/Compression.md>.

use super::footer::{Chunk, Codec, Kind};
use super::thrift::Thrift;
use bytes::Bytes;
use flate2::read::MultiGzDecoder;
use parquet::basic::Encoding;
use parquet::column::page::{Page, PageMetadata, PageReader};
use parquet::errors::ParquetError;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

/// Largest page that is read, compressed or not. Writers aim at 1 MiB.
pub(super) const MAX_PAGE_BYTES: usize = 32 << 20;
/// A header is looked for in so many bytes first, and then in so many (it may hold the least and greatest value).
const HEADER_BYTES: [u64; 2] = [256, 64 << 10];

/// See the module.
pub(super) struct Pages {
    file: File,
    /// What of the file is not read yet.
    chunk: Chunk,
    kind: Kind,
    has_dictionary: bool,
}

/// What a page's header says.
#[derive(Default)]
struct Header {
    kind: i64,
    bytes: usize,
    packed: usize,
    sum: Option<u32>,
    values: u32,
    encoding: i64,
    levels: i64,
    nulls: u32,
    rows: u32,
    definition: u32,
    repetition: u32,
    plain: bool,
    has_body: bool,
}

fn bad(what: impl Into<String>) -> ParquetError {
    ParquetError::General(what.into())
}

fn encoding(number: i64) -> Result<Encoding, ParquetError> {
    match number {
        0 => Ok(Encoding::PLAIN),
        2 => Ok(Encoding::PLAIN_DICTIONARY),
        3 => Ok(Encoding::RLE),
        5 => Ok(Encoding::DELTA_BINARY_PACKED),
        8 => Ok(Encoding::RLE_DICTIONARY),
        9 => Ok(Encoding::BYTE_STREAM_SPLIT),
        other => Err(bad(format!("values in an unknown encoding ({other})"))),
    }
}

impl Header {
    /// `None` when it is damaged or cut short.
    fn parse(thrift: &mut Thrift<'_>) -> Option<Self> {
        let mut header = Self::default();
        let count = |t: &mut Thrift<'_>, kind| u32::try_from(t.whole(kind)?).ok();
        thrift.structure(|t, id, kind| {
            match id {
                1 => header.kind = t.whole(kind)?,
                2 => header.bytes = count(t, kind)? as usize,
                3 => header.packed = count(t, kind)? as usize,
                4 => header.sum = Some(t.whole(kind)? as u32),
                // A data page, a dictionary, a data page of version 2.
                5 | 7 | 8 => {
                    header.has_body |= matches!((header.kind, id), (0, 5) | (2, 7) | (3, 8));
                    t.inner(kind, |t, field, kind| {
                        match (id, field) {
                            (_, 1) => header.values = count(t, kind)?,
                            (5 | 7, 2) | (8, 4) => header.encoding = t.whole(kind)?,
                            (5, 3) => header.levels = t.whole(kind)?,
                            (8, 2) => header.nulls = count(t, kind)?,
                            (8, 3) => header.rows = count(t, kind)?,
                            (8, 5) => header.definition = count(t, kind)?,
                            (8, 6) => header.repetition = count(t, kind)?,
                            (8, 7) => header.plain = !Thrift::boolean(kind)?,
                            _ => t.skip(kind)?,
                        }
                        Some(())
                    })?;
                }
                _ => t.skip(kind)?,
            }
            Some(())
        })?;
        Some(header)
    }
}

impl Pages {
    /// `file` is read at any place.
    pub(super) fn new(file: File, chunk: Chunk, kind: Kind) -> Self {
        Self {
            file,
            chunk,
            kind,
            has_dictionary: false,
        }
    }

    fn left(&self) -> u64 {
        self.chunk.end.saturating_sub(self.chunk.start)
    }

    fn bytes(&mut self, len: u64) -> Result<Vec<u8>, ParquetError> {
        let mut bytes = vec![0; len as usize];
        let file = &mut self.file;
        let read = file
            .seek(SeekFrom::Start(self.chunk.start))
            .and_then(|_| file.read_exact(&mut bytes));
        read.map_err(|e| bad(format!("a page that cannot be read: {e}")))?;
        Ok(bytes)
    }

    fn header(&mut self) -> Result<Header, ParquetError> {
        for len in HEADER_BYTES {
            let bytes = self.bytes(len.min(self.left()))?;
            let mut thrift = Thrift::new(&bytes);
            if let Some(header) = Header::parse(&mut thrift) {
                self.chunk.start += (bytes.len() - thrift.left()) as u64;
                return Ok(header);
            }
        }
        Err(bad("a damaged page header"))
    }

    fn next_page(&mut self) -> Result<Option<Page>, ParquetError> {
        while self.left() > 0 {
            let header = self.header()?;
            let largest = header.bytes.max(header.packed);
            if largest > MAX_PAGE_BYTES {
                return Err(bad(format!(
                    "a page of {largest} bytes (at most {MAX_PAGE_BYTES} are read); write it with smaller pages or row groups"
                )));
            }
            if header.packed as u64 > self.left() {
                return Err(bad("a page that reaches beyond its column"));
            }
            let packed = self.bytes(header.packed as u64)?;
            self.chunk.start += header.packed as u64;
            match header.kind {
                // An index, which nobody writes.
                1 => {}
                _ if !header.has_body => return Err(bad("a page without its header")),
                _ => return self.page(&header, packed).map(Some),
            }
        }
        Ok(None)
    }

    fn page(&mut self, header: &Header, packed: Vec<u8>) -> Result<Page, ParquetError> {
        if header.sum.is_some_and(|sum| sum != crc32fast::hash(&packed)) {
            return Err(bad("a page with a wrong check sum"));
        }
        // Levels stand before the values of a page of version 2, and are not compressed.
        let levels = match header.kind {
            3 => u64::from(header.definition) + u64::from(header.repetition),
            _ => 0,
        };
        let levels = usize::try_from(levels).unwrap_or(usize::MAX);
        let (Some(values), Some(len)) = (packed.get(levels..), header.bytes.checked_sub(levels)) else {
            return Err(bad("a page that is smaller than its levels"));
        };
        let buf = if self.chunk.codec == Codec::Plain || (header.kind == 3 && header.plain) {
            packed
        } else {
            let mut buf = vec![0; header.bytes];
            buf[..levels].copy_from_slice(&packed[..levels]);
            if len > 0 && !unpack(self.chunk.codec, values, &mut buf[levels..]) {
                return Err(bad(format!(
                    "a page that cannot be unpacked ({:?})",
                    self.chunk.codec
                )));
            }
            buf
        };
        let buf = Bytes::from(buf);
        let width = self.kind.physical.bytes() as u64;
        let needs = u64::from(header.values) * width;
        match encoding(header.encoding)? {
            Encoding::PLAIN | Encoding::BYTE_STREAM_SPLIT
                if !self.kind.optional && needs > buf.len() as u64 =>
            {
                return Err(bad("a page that is shorter than its header says"));
            }
            Encoding::PLAIN_DICTIONARY | Encoding::RLE_DICTIONARY
                if header.kind != 2 && !self.has_dictionary =>
            {
                return Err(bad("a page that needs a dictionary which is not there"));
            }
            _ => {}
        }
        Ok(match header.kind {
            0 => Page::DataPage {
                buf,
                num_values: header.values,
                encoding: encoding(header.encoding)?,
                def_level_encoding: match (self.kind.optional, header.levels) {
                    (false, _) | (true, 3) => Encoding::RLE,
                    _ => return Err(bad("levels in an unknown encoding")),
                },
                rep_level_encoding: Encoding::RLE,
                statistics: None,
            },
            2 => {
                // Room for all of them is made before they are read.
                if width == 0 || needs > buf.len() as u64 {
                    return Err(bad("a dictionary that is shorter than its header says"));
                }
                self.has_dictionary = true;
                Page::DictionaryPage {
                    buf,
                    num_values: header.values,
                    encoding: encoding(header.encoding)?,
                    is_sorted: false,
                }
            }
            3 => Page::DataPageV2 {
                buf,
                num_values: header.values,
                encoding: encoding(header.encoding)?,
                num_nulls: header.nulls,
                num_rows: header.rows,
                def_levels_byte_len: header.definition,
                rep_levels_byte_len: header.repetition,
                is_compressed: false,
                statistics: None,
            },
            other => return Err(bad(format!("a page of an unknown kind ({other})"))),
        })
    }
}

/// Fills `out`; false when `packed` does not hold just as many bytes.
fn unpack(codec: Codec, packed: &[u8], out: &mut [u8]) -> bool {
    let filled = match codec {
        Codec::Plain => None,
        Codec::Snappy => match snap::raw::decompress_len(packed) {
            Ok(len) if len == out.len() => snap::raw::Decoder::new().decompress(packed, out).ok(),
            _ => None,
        },
        Codec::Gzip => {
            let mut reader = MultiGzDecoder::new(packed);
            reader.read_exact(out).ok().map(|()| out.len())
        }
        Codec::Zstd => zstd_safe::decompress(out, packed).ok(),
        Codec::Lz4 => lz4_flex::block::decompress_into(packed, out).ok(),
    };
    filled == Some(out.len())
}

impl Iterator for Pages {
    type Item = Result<Page, ParquetError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_page().transpose()
    }
}

impl PageReader for Pages {
    fn get_next_page(&mut self) -> Result<Option<Page>, ParquetError> {
        self.next_page()
    }

    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>, ParquetError> {
        Err(bad("pages that are not looked at beforehand"))
    }

    fn skip_next_page(&mut self) -> Result<(), ParquetError> {
        Err(bad("pages that are not passed over"))
    }

    fn at_record_boundary(&mut self) -> Result<bool, ParquetError> {
        Ok(true)
    }
}
