//! What Parquet needs of Thrift's compact protocol: fields of structures, out of bytes that are not trusted.
//!
//! `None` everywhere means: damaged or cut short.
//! Format: <https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md>.

const TRUE: u8 = 1;
const FALSE: u8 = 2;
const BYTE: u8 = 3;
const I16: u8 = 4;
const I64: u8 = 6;
const DOUBLE: u8 = 7;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const SET: u8 = 10;
const MAP: u8 = 11;
const STRUCT: u8 = 12;
/// Structures and lists that are passed over nest this deep at most.
const MAX_DEPTH: u32 = 16;

/// Bytes that are being read.
pub(super) struct Thrift<'a> {
    rest: &'a [u8],
}

impl<'a> Thrift<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// Bytes that were not read.
    pub(super) fn left(&self) -> usize {
        self.rest.len()
    }

    fn take(&mut self, len: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(len)?;
        self.rest = rest;
        Some(taken)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take(1).map(|b| b[0])
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn zigzag(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    /// A structure: `each` takes the value of every field, told its number and its kind.
    pub(super) fn structure(&mut self, mut each: impl FnMut(&mut Self, i16, u8) -> Option<()>) -> Option<()> {
        let mut id = 0i16;
        loop {
            let byte = self.byte()?;
            if byte == 0 {
                return Some(());
            }
            id = match byte >> 4 {
                0 => i16::try_from(self.zigzag()?).ok()?,
                step => id.checked_add(i16::from(step))?,
            };
            each(self, id, byte & 0xf)?;
        }
    }

    /// A field that is a structure itself.
    pub(super) fn inner(
        &mut self,
        kind: u8,
        each: impl FnMut(&mut Self, i16, u8) -> Option<()>,
    ) -> Option<()> {
        (kind == STRUCT).then_some(())?;
        self.structure(each)
    }

    /// A field that is a whole number of any size.
    pub(super) fn whole(&mut self, kind: u8) -> Option<i64> {
        match kind {
            BYTE => self.byte().map(|b| i64::from(b as i8)),
            I16..=I64 => self.zigzag(),
            _ => None,
        }
    }

    /// A field that is a boolean; its kind is its value.
    pub(super) fn boolean(kind: u8) -> Option<bool> {
        matches!(kind, TRUE | FALSE).then_some(kind == TRUE)
    }

    /// A field that is a text or bytes.
    pub(super) fn binary(&mut self, kind: u8) -> Option<&'a [u8]> {
        (kind == BINARY).then_some(())?;
        let len = usize::try_from(self.varint()?).ok()?;
        self.take(len)
    }

    /// A field that is a list of structures: `each` takes one of them.
    pub(super) fn structures(
        &mut self,
        kind: u8,
        mut each: impl FnMut(&mut Self) -> Option<()>,
    ) -> Option<()> {
        (kind == LIST).then_some(())?;
        let (of, count) = self.list()?;
        (count == 0 || of == STRUCT).then_some(())?;
        (0..count).try_for_each(|_| each(self))
    }

    /// The kind and number of a list's elements.
    fn list(&mut self) -> Option<(u8, u64)> {
        let byte = self.byte()?;
        let count = match byte >> 4 {
            15 => self.varint()?,
            count => u64::from(count),
        };
        // Each takes one byte at least.
        (count <= self.rest.len() as u64).then_some((byte & 0xf, count))
    }

    /// Passes over the value of a field.
    pub(super) fn skip(&mut self, kind: u8) -> Option<()> {
        self.skip_within(kind, MAX_DEPTH)
    }

    fn skip_within(&mut self, kind: u8, depth: u32) -> Option<()> {
        let depth = depth.checked_sub(1)?;
        // A boolean in a list is a byte, while that of a field is its kind.
        let element = |t: &mut Self, kind| match kind {
            TRUE | FALSE => t.byte().map(|_| ()),
            _ => t.skip_within(kind, depth),
        };
        match kind {
            TRUE | FALSE => Some(()),
            BYTE => self.byte().map(|_| ()),
            I16..=I64 => self.varint().map(|_| ()),
            DOUBLE => self.take(8).map(|_| ()),
            BINARY => self.binary(kind).map(|_| ()),
            LIST | SET => {
                let (of, count) = self.list()?;
                (0..count).try_for_each(|_| element(self, of))
            }
            MAP => match self.varint()? {
                0 => Some(()),
                count => {
                    let kinds = self.byte()?;
                    (0..count).try_for_each(|_| {
                        element(self, kinds >> 4)?;
                        element(self, kinds & 0xf)
                    })
                }
            },
            STRUCT => self.structure(|t, _, kind| t.skip_within(kind, depth)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_by_number_and_others_passed_over() {
        // 1: -3, 2: map {1: "a"}, 4: list of structures {1: 7}, {}, 40: true, 41: list of 2 booleans
        let bytes = [
            0x15, 5, 0x1b, 1, 0x58, 2, 1, b'a', 0x29, 0x2c, 0x15, 14, 0, 0, 0x01, 80, 0x19, 0x21, 1, 2, 0, 99,
        ];
        let (mut found, mut inner) = (Vec::new(), Vec::new());
        let mut thrift = Thrift::new(&bytes);
        let done = thrift.structure(|t, id, kind| {
            found.push(id);
            match id {
                1 => inner.push(t.whole(kind)?),
                4 => t.structures(kind, |t| {
                    t.structure(|t, _, kind| {
                        inner.push(t.whole(kind)?);
                        Some(())
                    })
                })?,
                40 => assert_eq!(Thrift::boolean(kind), Some(true)),
                _ => t.skip(kind)?,
            }
            Some(())
        });
        assert_eq!((done, thrift.left()), (Some(()), 1));
        assert_eq!((found, inner), (vec![1, 2, 4, 40, 41], vec![-3, 7]));
        for len in 0..bytes.len() - 1 {
            let cut = Thrift::new(&bytes[..len]).structure(|t, _, kind| t.skip(kind));
            assert_eq!(cut, None, "{len} bytes");
        }
    }

    #[test]
    fn what_nests_too_deep_or_counts_too_much_is_refused() {
        let deep = [0x1c; 1000];
        assert_eq!(Thrift::new(&deep).structure(|t, _, kind| t.skip(kind)), None);
        let many = [0x19, 0xf3, 0xff, 0xff, 0xff, 0x7f, 0, 0];
        assert_eq!(Thrift::new(&many).structure(|t, _, kind| t.skip(kind)), None);
    }
}
