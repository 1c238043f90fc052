//! Values one after another, as ROS 1 and as CDR write them: taken from bytes that may end anywhere.

/// How values are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// ROS 1: without gaps, little-endian.
    Ros1,
    /// CDR, what ROS 2 sends: a header of four bytes, then each value at a multiple of its size, counted from there.
    Cdr,
}

/// The bytes end before the value does.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Short;

/// Bytes of the header of CDR.
const CDR_HEADER: usize = 4;

/// Goes through the values of a message.
#[derive(Debug, Clone)]
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    aligned: bool,
    big_endian: bool,
}

impl<'a> Fields<'a> {
    /// Little-endian values without gaps.
    pub(super) fn packed(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            at: 0,
            aligned: false,
            big_endian: false,
        }
    }

    /// A whole message; what is wrong with its header of CDR otherwise.
    pub(super) fn message(bytes: &'a [u8], layout: Layout) -> Result<Self, String> {
        if layout == Layout::Ros1 {
            return Ok(Self::packed(bytes));
        }
        let big_endian = match bytes {
            [0, 0, _, _, ..] => true,
            [0, 1, _, _, ..] => false,
            [0x28, 0xb5, 0x2f, 0xfd, ..] => {
                return Err(
                    "is compressed with ZSTD by itself, which is not read; rewrite the bag with ros2 bag convert"
                        .to_owned(),
                );
            }
            [a, b, _, _, ..] => {
                return Err(format!(
                    "is in the representation {a:02x}{b:02x}; plain CDR (0000, 0001) is read"
                ));
            }
            _ => return Err("is shorter than its header of CDR; the recording is damaged".to_owned()),
        };
        Ok(Self {
            bytes,
            at: CDR_HEADER,
            aligned: true,
            big_endian,
        })
    }

    /// The place of the next value, bytes; before it may come a gap.
    pub(super) fn at(&self) -> usize {
        self.at
    }

    /// Goes on at this place.
    pub(super) fn go_to(&mut self, at: usize) {
        self.at = at;
    }

    /// Bytes that are left.
    pub(super) fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.at)
    }

    /// The next `len` bytes.
    pub(super) fn take(&mut self, len: usize) -> Result<&'a [u8], Short> {
        let rest = self.bytes.get(self.at..).ok_or(Short)?;
        let taken = rest.get(..len).ok_or(Short)?;
        self.at += len;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], Short> {
        if self.aligned {
            self.at = CDR_HEADER + (self.at - CDR_HEADER).next_multiple_of(N);
        }
        let mut number = [0; N];
        number.copy_from_slice(self.take(N)?);
        if self.big_endian {
            number.reverse();
        }
        Ok(number)
    }

    pub(super) fn u8(&mut self) -> Result<u8, Short> {
        Ok(self.number::<1>()?[0])
    }

    pub(super) fn u16(&mut self) -> Result<u16, Short> {
        Ok(u16::from_le_bytes(self.number()?))
    }

    pub(super) fn u32(&mut self) -> Result<u32, Short> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    pub(super) fn u64(&mut self) -> Result<u64, Short> {
        Ok(u64::from_le_bytes(self.number()?))
    }

    /// A length of 32 bits, and so many bytes.
    pub(super) fn block(&mut self) -> Result<&'a [u8], Short> {
        let len = self.u32()? as usize;
        self.take(len)
    }

    /// A text, without the zero that CDR ends it with.
    pub(super) fn text(&mut self) -> Result<&'a [u8], Short> {
        let text = self.block()?;
        Ok(text.strip_suffix(&[0]).unwrap_or(text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cdr_leaves_gaps_and_has_two_orders() {
        let little = [
            0, 1, 0, 0, 7, 0, 0, 0, 2, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 9, 0, 0, 0, 0, 1, 0, 0, 0,
        ];
        let mut f = Fields::message(&little, Layout::Cdr).unwrap();
        assert_eq!((f.u8(), f.u32(), f.text()), (Ok(7), Ok(258), Ok(&b"ab"[..])));
        assert_eq!((f.u8(), f.u64(), f.u8()), (Ok(9), Ok(1 << 32), Err(Short)));
        let big = [0, 0, 0, 0, 7, 0, 1, 2, 0, 0, 0, 5];
        let mut f = Fields::message(&big, Layout::Cdr).unwrap();
        assert_eq!((f.u8(), f.u16(), f.u32(), f.left()), (Ok(7), Ok(258), Ok(5), 0));
        assert!(Fields::message(&[0, 3, 0, 0], Layout::Cdr).is_err());
        assert!(Fields::message(&[0, 1, 0], Layout::Cdr).is_err());
    }
}
