//! The footer: which columns there are, and where the pages of each row group stand.
//!
//! Format: `FileMetaData` in <https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift>.

use super::thrift::Thrift;
use crate::formats::unit::{self, NAMES};
use evpr_core::plan::TimeUnit;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

const MAGIC: &[u8] = b"PAR1";
/// The magic of a file whose footer is encrypted.
const ENCRYPTED: &[u8] = b"PARE";
/// Length of the footer and magic behind it.
const TAIL_BYTES: u64 = 8;
/// Largest footer that is read: enough for tens of thousands of row groups.
const MAX_FOOTER_BYTES: u64 = 16 << 20;
/// Most columns, with the groups that they stand in; most row groups.
const MAX_ELEMENTS: usize = 1 << 12;
const MAX_GROUPS: usize = 1 << 17;
const DAMAGED: &str = "has a damaged footer; copy or write the file again";

/// Physical types of values that are numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Physical {
    Boolean,
    Int32,
    Int64,
    Float,
    Double,
}

impl Physical {
    /// Bytes of a value that is stored plainly, at least.
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::Boolean => 0,
            Self::Int32 | Self::Float => 4,
            Self::Int64 | Self::Double => 8,
        }
    }
}

/// How a column's pages are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Codec {
    Plain,
    Snappy,
    Gzip,
    Zstd,
    Lz4,
}

/// How a column's values are stored.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kind {
    /// Which of the leaves of the schema it is.
    leaf: usize,
    pub(super) physical: Physical,
    pub(super) signed: bool,
    pub(super) optional: bool,
}

/// Where the pages of a column stand in a row group.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    pub(super) start: u64,
    pub(super) end: u64,
    pub(super) codec: Codec,
}

/// A row group that is not empty.
#[derive(Debug, Clone, Copy)]
pub(super) struct Group {
    /// Number of its first event.
    pub(super) first: u64,
    pub(super) rows: u64,
    /// t, x, y and p.
    pub(super) chunks: [Chunk; 4],
}

/// What a file holds.
#[derive(Debug)]
pub(super) struct Footer {
    /// t, x, y and p.
    pub(super) kinds: [Kind; 4],
    /// The unit that the type of t says; that its name says.
    pub(super) typed: Option<TimeUnit>,
    pub(super) named: Option<TimeUnit>,
    pub(super) groups: Vec<Group>,
    pub(super) events: u64,
}

/// An element of the schema.
#[derive(Default)]
struct Element<'a> {
    physical: Option<i64>,
    repetition: i64,
    name: &'a [u8],
    children: u64,
    converted: Option<i64>,
    logical: Logical,
}

/// A logical type, as far as it says what a number means.
#[derive(Default, Clone, Copy)]
enum Logical {
    #[default]
    None,
    Time(TimeUnit),
    Integer {
        signed: bool,
    },
    Other,
}

impl Footer {
    pub(super) fn read(file: &mut File, len: u64) -> Result<Self, String> {
        let failed = |e: std::io::Error| format!("cannot be read: {e}");
        let mut tail = [0; TAIL_BYTES as usize];
        let start = len
            .checked_sub(TAIL_BYTES)
            .filter(|start| *start >= MAGIC.len() as u64);
        let start = start.ok_or("is cut short: it has no footer; copy or write the file again")?;
        file.seek(SeekFrom::Start(start)).map_err(failed)?;
        file.read_exact(&mut tail).map_err(failed)?;
        if tail.ends_with(ENCRYPTED) {
            return Err("is encrypted Parquet, which is not read; write it without encryption".to_owned());
        }
        if !tail.ends_with(MAGIC) {
            return Err(
                "is cut short: it does not end with a footer; copy or write the file again".to_owned(),
            );
        }
        let footer = u64::from(u32::from_le_bytes([tail[0], tail[1], tail[2], tail[3]]));
        if footer > MAX_FOOTER_BYTES {
            return Err(format!(
                "has a footer of {footer} bytes; at most {MAX_FOOTER_BYTES} are read: write it with larger row groups"
            ));
        }
        let start = start.checked_sub(footer).ok_or(DAMAGED)?;
        file.seek(SeekFrom::Start(start)).map_err(failed)?;
        let mut bytes = vec![0; footer as usize];
        file.read_exact(&mut bytes).map_err(failed)?;
        Self::parse(&bytes, start)
    }

    /// Pages stand before `end`.
    fn parse(bytes: &[u8], end: u64) -> Result<Self, String> {
        let mut schema = Vec::new();
        Thrift::new(bytes)
            .structure(|t, id, kind| match id {
                2 => t.structures(kind, |t| {
                    (schema.len() < MAX_ELEMENTS).then_some(())?;
                    schema.push(element(t)?);
                    Some(())
                }),
                _ => t.skip(kind),
            })
            .ok_or(DAMAGED)?;
        let (kinds, typed, named) = columns(&schema)?;
        let mut footer = Self {
            kinds,
            typed,
            named,
            groups: Vec::new(),
            events: 0,
        };
        let mut wrong = None;
        let read = Thrift::new(bytes).structure(|t, id, kind| match id {
            4 => t.structures(kind, |t| {
                let (rows, chunks) = row_group(t, &kinds)?;
                match chunks.map(|chunk| chunk.ok_or(DAMAGED.to_owned())?.checked(end)) {
                    _ if rows == 0 => {}
                    [Ok(t), Ok(x), Ok(y), Ok(p)] => {
                        (footer.groups.len() < MAX_GROUPS).then_some(())?;
                        let (first, chunks) = (footer.events, [t, x, y, p]);
                        footer.events = first.checked_add(rows)?;
                        footer.groups.push(Group { first, rows, chunks });
                    }
                    bad => wrong = wrong.take().or(bad.into_iter().find_map(Result::err)),
                }
                Some(())
            }),
            _ => t.skip(kind),
        });
        match (wrong, read) {
            (Some(what), _) => Err(what),
            (None, Some(())) => Ok(footer),
            (None, None) => Err(DAMAGED.to_owned()),
        }
    }
}

fn element<'a>(thrift: &mut Thrift<'a>) -> Option<Element<'a>> {
    let mut element = Element::default();
    thrift.structure(|t, id, kind| {
        match id {
            1 => element.physical = Some(t.whole(kind)?),
            3 => element.repetition = t.whole(kind)?,
            4 => element.name = t.binary(kind)?,
            5 => element.children = u64::try_from(t.whole(kind)?).ok()?,
            6 => element.converted = Some(t.whole(kind)?),
            10 => t.inner(kind, |t, id, kind| {
                element.logical = logical(t, id, kind)?;
                Some(())
            })?,
            _ => t.skip(kind)?,
        }
        Some(())
    })?;
    Some(element)
}

/// A field of the union `LogicalType`.
fn logical(thrift: &mut Thrift<'_>, id: i16, kind: u8) -> Option<Logical> {
    let mut found = Logical::Other;
    match id {
        // TIME and TIMESTAMP
        7 | 8 => thrift.inner(kind, |t, id, kind| match id {
            2 => t.inner(kind, |t, id, kind| {
                found = match id {
                    1 => Logical::Time(TimeUnit::Ms),
                    2 => Logical::Time(TimeUnit::Us),
                    3 => Logical::Time(TimeUnit::Ns),
                    _ => return None,
                };
                t.skip(kind)
            }),
            _ => t.skip(kind),
        })?,
        // INTEGER
        10 => thrift.inner(kind, |t, id, kind| {
            if id == 2 {
                found = Logical::Integer {
                    signed: Thrift::boolean(kind)?,
                };
            }
            t.skip(kind)
        })?,
        // UNKNOWN: a column of nulls is refused when it is read.
        _ => thrift.skip(kind)?,
    }
    Some(found)
}

impl Element<'_> {
    /// What the logical type says, or else the older converted type.
    fn meaning(&self) -> Logical {
        match (self.logical, self.converted) {
            (Logical::None, Some(7 | 9)) => Logical::Time(TimeUnit::Ms),
            (Logical::None, Some(8 | 10)) => Logical::Time(TimeUnit::Us),
            (Logical::None, Some(11..=14)) => Logical::Integer { signed: false },
            (Logical::None, Some(15..=18)) => Logical::Integer { signed: true },
            (Logical::None, Some(_)) => Logical::Other,
            (logical, _) => logical,
        }
    }

    fn name(&self) -> String {
        let name: String = String::from_utf8_lossy(self.name).chars().take(40).collect();
        name.escape_debug().to_string()
    }

    fn kind(&self, leaf: usize) -> Result<Kind, String> {
        let physical = match self.physical {
            Some(0) => Some(Physical::Boolean),
            Some(1) => Some(Physical::Int32),
            Some(2) => Some(Physical::Int64),
            Some(4) => Some(Physical::Float),
            Some(5) => Some(Physical::Double),
            _ => None,
        };
        match (physical, self.repetition, self.meaning()) {
            (Some(physical), 0 | 1, Logical::None | Logical::Time(_) | Logical::Integer { .. }) => Ok(Kind {
                leaf,
                physical,
                signed: !matches!(self.meaning(), Logical::Integer { signed: false }),
                optional: self.repetition == 1,
            }),
            _ => Err(format!(
                "has a column {} that is not one integer, floating-point number or boolean per event; write it as one",
                self.name()
            )),
        }
    }
}

/// What the columns t, x, y and p are, and the unit that the type and the name of t say.
type Columns = ([Kind; 4], Option<TimeUnit>, Option<TimeUnit>);

fn columns(schema: &[Element<'_>]) -> Result<Columns, String> {
    let (root, elements) = schema.split_first().ok_or(DAMAGED)?;
    let mut found: [Option<Kind>; 4] = [None; 4];
    let (mut typed, mut named) = (None, None);
    // Elements of the top level that are still to come; of what is below one of them.
    let (mut top, mut below) = (root.children, 0u64);
    let mut leaf = 0;
    for element in elements {
        if below > 0 {
            below -= 1;
        } else {
            top = top.checked_sub(1).ok_or(DAMAGED)?;
            let column = std::str::from_utf8(element.name).ok().and_then(unit::column);
            if let (0, Some((column, unit))) = (element.children, column) {
                if found[column].is_some() {
                    return Err(format!("has two columns for {}; drop one", NAMES[column].0));
                }
                found[column] = Some(element.kind(leaf)?);
                if let (0, Logical::Time(unit)) = (column, element.meaning()) {
                    typed = Some(unit);
                }
                named = named.or(unit);
            }
        }
        below = below.checked_add(element.children).ok_or(DAMAGED)?;
        leaf += usize::from(element.children == 0);
    }
    if top + below > 0 {
        return Err(DAMAGED.to_owned());
    }
    if let Some(missing) = found.iter().position(Option::is_none) {
        let have: Vec<String> = elements.iter().take(8).map(Element::name).collect();
        return Err(format!(
            "has no column {} among {}; name one {}",
            NAMES[missing].0,
            have.join(", "),
            NAMES[missing].1.join(" or ")
        ));
    }
    match found {
        [Some(t), Some(x), Some(y), Some(p)] => Ok(([t, x, y, p], typed, named)),
        _ => Err(DAMAGED.to_owned()),
    }
}

/// A column chunk as the footer has it.
#[derive(Default, Clone, Copy)]
struct Raw {
    elsewhere: bool,
    physical: i64,
    codec: i64,
    bytes: i64,
    data_page: i64,
    dictionary: i64,
}

impl Raw {
    /// It, if its pages stand within the file.
    fn checked(self, end: u64) -> Result<Chunk, String> {
        if self.elsewhere {
            return Err("has columns in other files; write it as one file".to_owned());
        }
        let codec = match self.codec {
            0 => Codec::Plain,
            1 => Codec::Snappy,
            2 => Codec::Gzip,
            6 => Codec::Zstd,
            7 => Codec::Lz4,
            other => {
                let name = match other {
                    3 => "LZO",
                    4 => "Brotli",
                    5 => "the old LZ4 of Hadoop",
                    _ => "an unknown codec",
                };
                return Err(format!(
                    "is compressed with {name}, which is not read; write it with snappy, zstd, gzip, lz4 or none"
                ));
            }
        };
        // Some writers say 0 for none.
        let start = match self.dictionary {
            1.. if self.dictionary < self.data_page => self.dictionary,
            _ => self.data_page,
        };
        let start = u64::try_from(start).map_err(|_| DAMAGED)?;
        let bytes = u64::try_from(self.bytes).map_err(|_| DAMAGED)?;
        let stop = start
            .checked_add(bytes)
            .filter(|stop| *stop <= end)
            .ok_or(DAMAGED)?;
        Ok(Chunk {
            start,
            end: stop,
            codec,
        })
    }
}

/// The number of rows of a row group, and its chunks of the four columns.
fn row_group(thrift: &mut Thrift<'_>, kinds: &[Kind; 4]) -> Option<(u64, [Option<Raw>; 4])> {
    let mut rows = 0;
    let mut chunks = [None; 4];
    thrift.structure(|t, id, kind| match id {
        1 => {
            let mut leaf = 0;
            t.structures(kind, |t| {
                let raw = column_chunk(t)?;
                if let Some(column) = kinds.iter().position(|kind| kind.leaf == leaf) {
                    let wants = match kinds[column].physical {
                        Physical::Boolean => 0,
                        Physical::Int32 => 1,
                        Physical::Int64 => 2,
                        Physical::Float => 4,
                        Physical::Double => 5,
                    };
                    (raw.physical == wants).then_some(())?;
                    chunks[column] = Some(raw);
                }
                leaf += 1;
                Some(())
            })
        }
        3 => {
            rows = u64::try_from(t.whole(kind)?).ok()?;
            Some(())
        }
        _ => t.skip(kind),
    })?;
    Some((rows, chunks))
}

fn column_chunk(thrift: &mut Thrift<'_>) -> Option<Raw> {
    let mut raw = Raw::default();
    thrift.structure(|t, id, kind| match id {
        1 => {
            raw.elsewhere = !t.binary(kind)?.is_empty();
            Some(())
        }
        3 => t.inner(kind, |t, id, kind| {
            match id {
                1 => raw.physical = t.whole(kind)?,
                4 => raw.codec = t.whole(kind)?,
                7 => raw.bytes = t.whole(kind)?,
                9 => raw.data_page = t.whole(kind)?,
                11 => raw.dictionary = t.whole(kind)?,
                _ => t.skip(kind)?,
            }
            Some(())
        }),
        _ => t.skip(kind),
    })?;
    Some(raw)
}
