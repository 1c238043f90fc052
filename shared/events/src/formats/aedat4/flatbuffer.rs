//! Reading of FlatBuffers, with every offset checked: flatbuffers.dev, "FlatBuffers internals".
//!
//! A buffer begins with the offset of its root table and four letters that say what it is. A table begins with the
//! offset (backwards) of its list of fields, which says where in the table each field stands. Numbers are
//! little-endian.

/// An offset or a length that points outside the buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Damaged;

type Read<T> = Result<T, Damaged>;

/// Four bytes before a list of fields gives the first one: its own length and the table's.
const FIELDS_START: usize = 4;

/// A table in a buffer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Table<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Where each field stands in the table, two bytes per field.
    fields: &'a [u8],
}

/// The buffer behind its length, which stands in the first four bytes.
pub(super) fn sized(bytes: &[u8]) -> Read<&[u8]> {
    let len = u32_at(bytes, 0)? as usize;
    slice(bytes, 4, len)
}

/// The four letters that say what a buffer is.
pub(super) fn identifier(buffer: &[u8]) -> Read<[u8; 4]> {
    array(buffer, 4)
}

impl<'a> Table<'a> {
    /// The table that a buffer begins with.
    pub(super) fn root(buffer: &'a [u8]) -> Read<Self> {
        let at = u32_at(buffer, 0)? as usize;
        let back = i64::from(i32::from_le_bytes(array(buffer, at)?));
        let list = usize::try_from(i64::try_from(at).map_err(|_| Damaged)? - back).map_err(|_| Damaged)?;
        let list_len = usize::from(u16::from_le_bytes(array(buffer, list)?));
        let fields_len = list_len.checked_sub(FIELDS_START).ok_or(Damaged)?;
        Ok(Self {
            bytes: buffer,
            at,
            fields: slice(buffer, list + FIELDS_START, fields_len)?,
        })
    }

    /// Where a field stands; `None` when it is left out and has its default.
    fn field(&self, index: usize) -> Option<usize> {
        let entry = self.fields.get(2 * index..2 * index + 2)?;
        let offset = usize::from(u16::from_le_bytes([entry[0], entry[1]]));
        (offset != 0).then_some(self.at + offset)
    }

    pub(super) fn i32(&self, index: usize, default: i32) -> Read<i32> {
        self.field(index)
            .map_or(Ok(default), |at| Ok(i32::from_le_bytes(array(self.bytes, at)?)))
    }

    pub(super) fn i64(&self, index: usize, default: i64) -> Read<i64> {
        self.field(index)
            .map_or(Ok(default), |at| Ok(i64::from_le_bytes(array(self.bytes, at)?)))
    }

    /// A vector of items of `item_bytes` each, as bytes; empty when it is left out. A string is one of single bytes.
    pub(super) fn vector(&self, index: usize, item_bytes: usize) -> Read<&'a [u8]> {
        let Some(at) = self.field(index) else {
            return Ok(&[]);
        };
        let start = at.checked_add(u32_at(self.bytes, at)? as usize).ok_or(Damaged)?;
        let len = (u32_at(self.bytes, start)? as usize)
            .checked_mul(item_bytes)
            .ok_or(Damaged)?;
        slice(self.bytes, start + 4, len)
    }
}

fn slice(bytes: &[u8], start: usize, len: usize) -> Read<&[u8]> {
    let end = start.checked_add(len).ok_or(Damaged)?;
    bytes.get(start..end).ok_or(Damaged)
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Read<[u8; N]> {
    slice(bytes, at, N)?.try_into().map_err(|_| Damaged)
}

fn u32_at(bytes: &[u8], at: usize) -> Read<u32> {
    Ok(u32::from_le_bytes(array(bytes, at)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A table with the fields {i32 7, i64 -1 left out, "ab"}.
    const SAMPLE: &[u8] = &[
        20, 0, 0, 0, b'T', b'E', b'S', b'T', // root at 20
        0, 0, 10, 0, 12, 0, 4, 0, 0, 0, 8, 0, // list at 10: its length, the table's, the fields
        10, 0, 0, 0, 7, 0, 0, 0, 4, 0, 0, 0, // table: list 10 back; 7; the string is 4 on
        2, 0, 0, 0, b'a', b'b',
    ];

    #[test]
    fn fields_defaults_and_strings() {
        let table = Table::root(SAMPLE).unwrap();
        assert_eq!(identifier(SAMPLE), Ok(*b"TEST"));
        assert_eq!(
            (table.i32(0, 1), table.i64(1, -1), table.i32(9, 5)),
            (Ok(7), Ok(-1), Ok(5))
        );
        assert_eq!(
            (table.vector(2, 1), table.vector(1, 1)),
            (Ok(&b"ab"[..]), Ok(&[][..]))
        );
        assert_eq!(table.vector(2, 2), Err(Damaged));
    }

    #[test]
    fn a_cut_buffer_is_damaged() {
        for len in 0..SAMPLE.len() {
            let whole = Table::root(&SAMPLE[..len])
                .and_then(|t| t.vector(2, 1))
                .map(<[u8]>::len);
            assert_eq!(whole, Err(Damaged), "{len}");
        }
        assert_eq!(sized(&[3, 0, 0, 0, 1, 2]), Err(Damaged));
        assert_eq!(sized(&[2, 0, 0, 0, 1, 2, 3]), Ok(&[1, 2][..]));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(512))]
        #[test]
        fn nothing_is_read_outside(bytes: Vec<u8>, at in 0..SAMPLE.len(), to: u8, index in 0_usize..8) {
            let mut mutated = SAMPLE.to_vec();
            mutated[at] = to;
            for buffer in [&bytes, &mutated] {
                if let Ok(table) = Table::root(buffer) {
                    let _ = (table.i32(index, 0), table.i64(index, 0), table.vector(index, 16));
                }
            }
        }
    }
}
