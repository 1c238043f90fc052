//! Headers of `.npy` files, as NumPy's format version 1.0 has them
//! (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>).

use evpr_core::plan::RowType;

/// Length of the headers written here, bytes: room for any shape, and a multiple of 64 as the format asks for.
pub(crate) const HEADER_BYTES: usize = 128;
/// Longest piece of a header that an error shows, characters.
const MAX_SHOWN: usize = 120;
const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// Type and shape of an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NpyHeader {
    /// NumPy's name of the item type: `<f4`, `|b1`.
    pub descr: String,
    /// Whether the first axis varies fastest.
    pub fortran_order: bool,
    /// Length of each axis.
    pub shape: Vec<u64>,
}

impl NpyHeader {
    /// R×D numbers of this type, row by row.
    pub(crate) fn rows(ticks: u64, dim: usize, rows: RowType) -> Self {
        let descr = match rows {
            RowType::F32 => "<f4",
            RowType::F16 => "<f2",
        };
        Self {
            descr: descr.to_owned(),
            fortran_order: false,
            shape: vec![ticks, dim as u64],
        }
    }

    /// R `bool`.
    pub(crate) fn present(ticks: u64) -> Self {
        Self {
            descr: "|b1".to_owned(),
            fortran_order: false,
            shape: vec![ticks],
        }
    }

    /// The header as bytes. At most two axes, so that it always fits.
    pub(crate) fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [b' '; HEADER_BYTES];
        bytes[..6].copy_from_slice(MAGIC);
        bytes[6..8].copy_from_slice(&[1, 0]);
        bytes[8..10].copy_from_slice(&(HEADER_BYTES as u16 - 10).to_le_bytes());
        let text = self.to_string();
        let len = text.len().min(HEADER_BYTES - 11);
        bytes[10..10 + len].copy_from_slice(&text.as_bytes()[..len]);
        bytes[HEADER_BYTES - 1] = b'\n';
        bytes
    }

    /// Reads the header at the start of a file: what it says, and at which byte the data begin.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn decode(bytes: &[u8]) -> Result<(Self, usize), String> {
        let short = || "the .npy header is cut short".to_owned();
        if bytes.get(..6) != Some(MAGIC.as_slice()) {
            return Err("it does not begin as a .npy file".to_owned());
        }
        let (start, len) = match bytes.get(6..12).ok_or_else(short)? {
            [1, _, a, b, _, _] => (10, usize::from(u16::from_le_bytes([*a, *b]))),
            [2 | 3, _, a, b, c, d] => (12, u32::from_le_bytes([*a, *b, *c, *d]) as usize),
            other => return Err(format!("its .npy format version {} is not known", other[0])),
        };
        let text = bytes.get(start..start + len).ok_or_else(short)?;
        let text = std::str::from_utf8(text).map_err(|_| "the .npy header is not text".to_owned())?;
        let header = Self::parse(text).ok_or_else(|| {
            let shown: String = text.trim_end().chars().take(MAX_SHOWN).collect();
            format!("the .npy header {shown:?} is not understood")
        })?;
        Ok((header, start + len))
    }

    fn parse(text: &str) -> Option<Self> {
        let value = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}':"))?;
            Some(rest.trim_start())
        };
        let (descr, _) = value("descr")?.strip_prefix('\'')?.split_once('\'')?;
        // No type has control characters in its name, and messages show it.
        if descr.contains(char::is_control) {
            return None;
        }
        let order = value("fortran_order")?;
        let fortran_order = order.starts_with("True");
        if !fortran_order && !order.starts_with("False") {
            return None;
        }
        let (shape, _) = value("shape")?.strip_prefix('(')?.split_once(')')?;
        let shape = shape
            .split(',')
            .map(str::trim)
            .filter(|axis| !axis.is_empty())
            .map(|axis| axis.parse().ok())
            .collect::<Option<_>>()?;
        Some(Self {
            descr: descr.to_owned(),
            fortran_order,
            shape,
        })
    }
}

impl std::fmt::Display for NpyHeader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let order = if self.fortran_order { "True" } else { "False" };
        let mut axes = String::new();
        for axis in &self.shape {
            axes.push_str(&format!("{axis}, "));
        }
        let axes = match self.shape.len() {
            1 => axes.trim_end(),
            _ => axes.trim_end_matches(", "),
        };
        write!(
            f,
            "{{'descr': '{}', 'fortran_order': {order}, 'shape': ({axes}), }}",
            self.descr
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_numpys_own() {
        // np.lib.format.write_array_header_1_0 of a (7, 3) '<f4' array.
        let expected = b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, 'shape': (7, 3), }";
        let bytes = NpyHeader::rows(7, 3, RowType::F32).encode();
        assert_eq!(&bytes[..expected.len()], expected);
        assert_eq!(bytes[127], b'\n');
        let text = NpyHeader::present(5).to_string();
        assert_eq!(text, "{'descr': '|b1', 'fortran_order': False, 'shape': (5,), }");
    }

    #[test]
    fn what_is_written_is_read_back() {
        for header in [
            NpyHeader::rows(0, 1, RowType::F32),
            NpyHeader::rows(u64::MAX, usize::MAX, RowType::F16),
            NpyHeader::present(12),
        ] {
            assert_eq!(NpyHeader::decode(&header.encode()), Ok((header, HEADER_BYTES)));
        }
    }

    #[test]
    fn other_versions_and_spacing_are_read() {
        let text = b"{'shape':(2,3),'fortran_order':True,'descr':'<f8'}\n";
        let mut bytes = b"\x93NUMPY\x02\x00".to_vec();
        bytes.extend((text.len() as u32).to_le_bytes());
        bytes.extend(text);
        let (header, offset) = NpyHeader::decode(&bytes).unwrap();
        assert_eq!((header.descr.as_str(), header.fortran_order), ("<f8", true));
        assert_eq!((header.shape, offset), (vec![2, 3], bytes.len()));
    }

    #[test]
    fn damage_is_named() {
        let good = NpyHeader::rows(2, 3, RowType::F32).encode();
        for len in 0..HEADER_BYTES {
            assert!(NpyHeader::decode(&good[..len]).is_err(), "{len}");
        }
        assert!(NpyHeader::decode(&[0; HEADER_BYTES]).is_err());
        let mut bad = good;
        bad[6] = 9;
        assert!(NpyHeader::decode(&bad).unwrap_err().contains("version 9"));
        let mut bad = good;
        bad[20] = b'?';
        assert!(NpyHeader::decode(&bad).is_err() || NpyHeader::decode(&bad) != NpyHeader::decode(&good));
    }
}
