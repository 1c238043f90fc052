//! Rows in a file, mapped into memory. The only `unsafe` of the crate.
//!
//! A page that lies past the end of the file cannot be read: the process gets SIGBUS. So the file's size is checked
//! before it is mapped. Somebody who cuts a traverse's files while a process reads them still ends that process;
//! nothing in this crate does so.
#![allow(unsafe_code)]

use memmap2::Mmap;
use std::fs::File;
use std::io;

/// A run of `f32` in a mapped file.
#[derive(Debug)]
pub(crate) struct MappedRows {
    map: Mmap,
    /// First byte; a multiple of 4.
    offset: usize,
}

impl MappedRows {
    /// Maps the file; its numbers begin at byte `offset` and go to its end.
    ///
    /// # Errors
    /// What the system says; `InvalidData` when the numbers are not aligned or the last is cut.
    pub(crate) fn new(file: &File, offset: usize) -> io::Result<Self> {
        // SAFETY: the mapping is read-only, and the file belongs to a traverse with its final name, of which no file is
        // ever changed or shortened in place (the crate's documentation states this rule). Every bit pattern is an f32.
        let map = unsafe { Mmap::map(file) }?;
        let rows = Self { map, offset };
        match bytemuck::try_cast_slice::<u8, f32>(rows.bytes()) {
            Ok(_) => Ok(rows),
            Err(e) => Err(io::Error::new(io::ErrorKind::InvalidData, e.to_string())),
        }
    }

    fn bytes(&self) -> &[u8] {
        self.map.get(self.offset..).unwrap_or_default()
    }

    /// The numbers.
    pub(crate) fn as_slice(&self) -> &[f32] {
        // Whether the cast holds was found out in `new`; neither address nor length has changed since.
        bytemuck::try_cast_slice(self.bytes()).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn file(bytes: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytes).unwrap();
        file
    }

    #[test]
    fn numbers_are_seen_where_they_lie() {
        let mut bytes = vec![7; 8];
        bytes.extend([1.5f32, -2.0].iter().flat_map(|v| v.to_le_bytes()));
        let rows = MappedRows::new(&file(&bytes), 8).unwrap();
        assert_eq!(rows.as_slice(), [1.5, -2.0]);
        assert!(MappedRows::new(&file(&bytes), 16).unwrap().as_slice().is_empty());
    }

    #[test]
    fn cut_or_crooked_numbers_are_refused() {
        assert!(MappedRows::new(&file(&[0; 11]), 4).is_err());
        assert!(MappedRows::new(&file(&[0; 10]), 2).is_err());
    }
}
