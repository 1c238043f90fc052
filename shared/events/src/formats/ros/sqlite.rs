//! Tables of an SQLite file (sqlite.org/fileformat2.html), read row after row in the order of their numbers: just what
//! bags of ROS 2 need. Numbers are big-endian.

use super::chunk::MAX_CHUNK_BYTES;
use super::fields::Short;
use crate::SourceError;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// What every file begins with.
pub(in crate::formats) const MAGIC: &[u8] = b"SQLite format 3\0";
const HEADER_BYTES: usize = 100;
/// Kinds of pages of a table.
const INTERIOR: u8 = 5;
const LEAF: u8 = 13;
/// Deeper than any table.
const MAX_DEPTH: usize = 24;
const DAMAGED: &str = "holds a page that cannot be right; the recording is damaged";

/// An SQLite file.
#[derive(Debug)]
pub(super) struct Sqlite {
    path: PathBuf,
    file: File,
    page_bytes: usize,
    /// Of a page, without what is reserved.
    usable_bytes: usize,
    pages: u32,
}

/// Where a table is, and the names of its columns.
#[derive(Debug)]
pub(super) struct Table {
    root: u32,
    columns: Vec<String>,
}

/// A value of a row: where it is in the row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Value<'a> {
    /// None, or one of a kind that is not needed.
    Other,
    Number(i64),
    /// Text or bytes.
    Bytes(&'a [u8]),
}

/// Goes through the rows of a table.
#[derive(Debug)]
pub(super) struct Rows {
    /// Pages from the root down, each with the number of the next cell.
    stack: Vec<(Vec<u8>, usize, usize)>,
    /// Pages gone through: more than there are is a circle.
    seen: u32,
}

impl Sqlite {
    pub(super) fn open(path: &Path) -> Result<Self, SourceError> {
        let wrong = |what: &str| SourceError::malformed(path, what);
        for ending in ["-wal", "-journal"] {
            let mut beside = path.as_os_str().to_owned();
            beside.push(ending);
            if std::fs::metadata(&beside).is_ok_and(|m| m.len() > 0) {
                return Err(wrong(&format!(
                    "was not closed: rows are in the file beside it whose name ends in {ending}; run sqlite3 FILE \
                     VACUUM on it"
                )));
            }
        }
        let file = File::open(path).map_err(|e| SourceError::read(path, e))?;
        let len = file.metadata().map_err(|e| SourceError::read(path, e))?.len();
        let mut header = [0; HEADER_BYTES];
        if len < HEADER_BYTES as u64 {
            return Err(wrong("ends inside its header; it was cut off"));
        }
        file.read_exact_at(&mut header, 0)
            .map_err(|e| SourceError::read(path, e))?;
        let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 1 << 16,
            n => usize::from(n),
        };
        let usable_bytes = page_bytes.saturating_sub(usize::from(header[20]));
        if !header.starts_with(MAGIC)
            || !page_bytes.is_power_of_two()
            || page_bytes < 512
            || usable_bytes < 480
        {
            return Err(wrong(
                "has a header that cannot be right; the recording is damaged",
            ));
        }
        if u32::from_be_bytes([header[56], header[57], header[58], header[59]]) > 1 {
            return Err(wrong("has texts in UTF-16; bags of ROS 2 are in UTF-8"));
        }
        let said = u32::from_be_bytes([header[28], header[29], header[30], header[31]]);
        let pages = u32::try_from(len / page_bytes as u64).unwrap_or(u32::MAX);
        if said > pages {
            return Err(wrong(
                "is shorter than it says: it was cut off; get the rest of it, or run sqlite3 FILE .recover on it",
            ));
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            page_bytes,
            usable_bytes,
            pages,
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn wrong(&self, what: &str) -> SourceError {
        SourceError::malformed(&self.path, what)
    }

    /// The table of this name, which has these columns; and their places in a row.
    pub(super) fn table<const N: usize>(
        &self,
        name: &str,
        columns: [&str; N],
    ) -> Result<(Table, [usize; N]), SourceError> {
        let mut rows = self.rows(1)?;
        let mut row = Vec::new();
        while rows.next(self, &mut row)?.is_some() {
            let mut values = [Value::Other; 5];
            values_of(&row, &mut values).map_err(|Short| self.wrong(DAMAGED))?;
            let [kind, called, _, root, sql] = values;
            if kind != Value::Bytes(b"table") || called != Value::Bytes(name.as_bytes()) {
                continue;
            }
            let (Value::Number(root), Value::Bytes(sql)) = (root, sql) else {
                return Err(self.wrong(DAMAGED));
            };
            let root = u32::try_from(root).map_err(|_| self.wrong(DAMAGED))?;
            let table = Table {
                root,
                columns: columns_of(&String::from_utf8_lossy(sql)),
            };
            let mut places = [0; N];
            for (place, column) in places.iter_mut().zip(columns) {
                *place =
                    table.columns.iter().position(|c| c == column).ok_or_else(|| {
                        self.wrong(&format!("has a table {name} without {column}; {NO_BAG}"))
                    })?;
            }
            return Ok((table, places));
        }
        Err(self.wrong(&format!("has no table {name}; {NO_BAG}")))
    }

    /// The rows of a table from its first.
    pub(super) fn all(&self, table: &Table) -> Result<Rows, SourceError> {
        self.rows(table.root)
    }

    fn rows(&self, root: u32) -> Result<Rows, SourceError> {
        let mut rows = Rows {
            stack: Vec::new(),
            seen: 0,
        };
        rows.enter(self, root)?;
        Ok(rows)
    }

    fn page(&self, number: u32) -> Result<Vec<u8>, SourceError> {
        if number == 0 || number > self.pages {
            return Err(self.wrong(DAMAGED));
        }
        let mut page = vec![0; self.page_bytes];
        let at = u64::from(number - 1) * self.page_bytes as u64;
        self.file
            .read_exact_at(&mut page, at)
            .map_err(|e| SourceError::read(&self.path, e))?;
        page.truncate(self.usable_bytes);
        Ok(page)
    }

    /// Puts the row that this cell begins into `row`, and gives its number.
    fn cell(&self, cell: &[u8], row: &mut Vec<u8>) -> Result<i64, SourceError> {
        let damaged = |Short| self.wrong(DAMAGED);
        let (len, rest) = varint(cell).map_err(damaged)?;
        let (number, rest) = varint(rest).map_err(damaged)?;
        let fits = |len: &usize| *len <= MAX_CHUNK_BYTES;
        let Some(len) = usize::try_from(len).ok().filter(fits) else {
            return Err(self.wrong(&format!(
                "has a row of {len} bytes, more than {} MiB; it is damaged, or its messages are too large",
                MAX_CHUNK_BYTES >> 20
            )));
        };
        let most = self.usable_bytes - 35;
        let least = (self.usable_bytes - 12) * 32 / 255 - 23;
        let here = if len <= most {
            len
        } else {
            let fitting = least + (len - least) % (self.usable_bytes - 4);
            if fitting <= most { fitting } else { least }
        };
        row.clear();
        row.extend_from_slice(rest.get(..here).ok_or(Short).map_err(damaged)?);
        let mut next = rest.get(here..).unwrap_or_default().first_chunk().copied();
        while row.len() < len {
            let page = self.page(u32::from_be_bytes(next.ok_or(Short).map_err(damaged)?))?;
            let (head, body) = page.split_at(4);
            row.extend_from_slice(&body[..body.len().min(len - row.len())]);
            next = head.first_chunk().copied();
        }
        Ok(number as i64)
    }
}

const NO_BAG: &str = "it is not a bag of ROS 2";

impl Rows {
    /// Goes down to a page.
    fn enter(&mut self, of: &Sqlite, number: u32) -> Result<(), SourceError> {
        self.seen += 1;
        if self.seen > of.pages || self.stack.len() == MAX_DEPTH {
            return Err(of.wrong(DAMAGED));
        }
        let start = if number == 1 { HEADER_BYTES } else { 0 };
        self.stack.push((of.page(number)?, start, 0));
        Ok(())
    }

    /// Puts the next row into `row`, and gives its number; `None` behind the last.
    pub(super) fn next(&mut self, of: &Sqlite, row: &mut Vec<u8>) -> Result<Option<i64>, SourceError> {
        let damaged = || of.wrong(DAMAGED);
        loop {
            let Some((page, start, next)) = self.stack.last_mut() else {
                return Ok(None);
            };
            let u16_at = |at: usize| {
                let bytes = page.get(at..)?.first_chunk()?;
                Some(usize::from(u16::from_be_bytes(*bytes)))
            };
            let u32_at = |at: usize| Some(u32::from_be_bytes(*page.get(at..)?.first_chunk()?));
            let kind = page.get(*start).copied();
            let count = u16_at(*start + 3).ok_or_else(damaged)?;
            let pointers = *start + if kind == Some(INTERIOR) { 12 } else { 8 };
            let index = *next;
            *next += 1;
            let cell = u16_at(pointers + 2 * index);
            match kind {
                Some(INTERIOR) if index < count => {
                    let child = cell.and_then(u32_at).ok_or_else(damaged)?;
                    self.enter(of, child)?;
                }
                // The last child has a place of its own.
                Some(INTERIOR) if index == count => {
                    let child = u32_at(*start + 8).ok_or_else(damaged)?;
                    self.enter(of, child)?;
                }
                Some(LEAF) if index < count => {
                    let cell = cell.and_then(|at| page.get(at..)).ok_or_else(damaged)?;
                    return of.cell(cell, row).map(Some);
                }
                Some(INTERIOR | LEAF) => {
                    self.stack.pop();
                }
                _ => return Err(damaged()),
            }
        }
    }

    /// How much of the file has been gone through, permille; not quite right, as pages may hold other things.
    pub(super) fn progress_permille(&self, of: &Sqlite) -> u64 {
        if self.stack.is_empty() {
            return 1000;
        }
        (u64::from(self.seen) * 1000 / u64::from(of.pages.max(1))).min(999)
    }
}

/// A number of up to 64 bits, seven in a byte, of the last byte eight.
fn varint(bytes: &[u8]) -> Result<(u64, &[u8]), Short> {
    let mut number = 0_u64;
    for (i, byte) in bytes.iter().enumerate().take(9) {
        if i == 8 {
            return Ok((number << 8 | u64::from(*byte), &bytes[9..]));
        }
        number = number << 7 | u64::from(byte & 0x7f);
        if byte & 0x80 == 0 {
            return Ok((number, &bytes[i + 1..]));
        }
    }
    Err(Short)
}

/// The values of a row: as many of its columns as there is room for.
pub(super) fn values_of<'a>(row: &'a [u8], values: &mut [Value<'a>]) -> Result<(), Short> {
    let (len, mut kinds) = varint(row)?;
    let len = usize::try_from(len).map_err(|_| Short)?;
    let mut body = row.get(len..).ok_or(Short)?;
    kinds = kinds
        .get(..len.checked_sub(row.len() - kinds.len()).ok_or(Short)?)
        .ok_or(Short)?;
    for value in values {
        if kinds.is_empty() {
            break;
        }
        let (kind, rest) = varint(kinds)?;
        kinds = rest;
        let len = match kind {
            1..=4 => kind,
            5 => 6,
            6 | 7 => 8,
            0 | 8..=11 => 0,
            _ => (kind - 12) / 2,
        };
        let len = usize::try_from(len).map_err(|_| Short)?;
        let (bytes, rest) = body.split_at_checked(len).ok_or(Short)?;
        body = rest;
        *value = match kind {
            1..=6 => {
                let negative = bytes[0] & 0x80 != 0;
                let start = if negative { -1_i64 } else { 0 };
                Value::Number(bytes.iter().fold(start, |n, b| n << 8 | i64::from(*b)))
            }
            8 | 9 => Value::Number(kind as i64 - 8),
            12.. => Value::Bytes(bytes),
            _ => Value::Other,
        };
    }
    Ok(())
}

/// Names of the columns that a statement `CREATE TABLE` lists.
fn columns_of(sql: &str) -> Vec<String> {
    let list = sql.split_once('(').map_or("", |(_, list)| list);
    let name = |column: &str| {
        let name = column.split_whitespace().next().unwrap_or_default();
        name.trim_matches(['"', '`', '[', ']', '(', ')', ';'])
            .to_lowercase()
    };
    list.split(',').map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_as_many_bytes_as_they_need() {
        assert_eq!(varint(&[0x7f, 1]), Ok((127, &[1][..])));
        assert_eq!(varint(&[0x81, 0x00]), Ok((128, &[][..])));
        assert_eq!(varint(&[0xff; 9]), Ok((u64::MAX, &[][..])));
        assert_eq!(varint(&[0xff; 8]), Err(Short));
        let row = [7, 1, 2, 9, 0, 15, 14, 0xff, 1, 2, b'a', 7];
        let mut values = [Value::Other; 7];
        values_of(&row, &mut values).unwrap();
        let want = [
            Value::Number(-1),
            Value::Number(258),
            Value::Number(1),
            Value::Other,
            Value::Bytes(b"a"),
            Value::Bytes(&[7]),
            Value::Other,
        ];
        assert_eq!(values, want);
        assert_eq!(values_of(&row[..11], &mut values), Err(Short));
        assert_eq!(values_of(&[0], &mut values), Err(Short));
    }

    #[test]
    fn columns_are_named_in_order() {
        let sql =
            "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL, \"data\" BLOB NOT NULL)";
        assert_eq!(columns_of(sql), ["id", "topic_id", "data"]);
    }
}
