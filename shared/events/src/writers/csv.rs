//! CSV with the header `t,x,y,p`: times in seconds with all nine decimals (`1.000000250`), polarity 1 or 0.
//!
//! The decimal point makes the unit plain to every reader, and nine decimals keep each nanosecond. The size of the
//! sensor is not said.

use super::new_file::NewFile;
use super::{WriteError, Writer};
use crate::RawEvent;
use std::io::Write;
use std::path::Path;

/// Longest line: 10 + 1 + 9 digits of time, two coordinates of 5, polarity, three commas, line end; with room.
const LINE_BYTES: usize = 48;

/// See the module.
pub(super) struct Csv {
    file: NewFile,
}

impl Csv {
    pub(super) fn create(path: &Path) -> Result<Self, WriteError> {
        let mut file = NewFile::create(path)?;
        file.write_all(b"t,x,y,p\n").map_err(|e| file.failed(e))?;
        Ok(Self { file })
    }
}

impl Writer for Csv {
    fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        for event in events {
            let mut buffer = [0; LINE_BYTES];
            let start = line(event, &mut buffer);
            self.file
                .write_all(&buffer[start..])
                .map_err(|e| self.file.failed(e))?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), WriteError> {
        self.file.commit()
    }
}

/// The event's line, from its end backwards; where in the buffer it begins.
fn line(event: &RawEvent, buffer: &mut [u8; LINE_BYTES]) -> usize {
    let mut at = LINE_BYTES - 3;
    buffer[at..].copy_from_slice(if event.on { b",1\n" } else { b",0\n" });
    at = number(u64::from(event.y), 1, buffer, at);
    at -= 1;
    buffer[at] = b',';
    at = number(u64::from(event.x), 1, buffer, at);
    at -= 1;
    buffer[at] = b',';
    at = number(event.t_ns % 1_000_000_000, 9, buffer, at);
    at -= 1;
    buffer[at] = b'.';
    number(event.t_ns / 1_000_000_000, 1, buffer, at)
}

/// A number that ends before `end`, with at least `digits` digits; where it begins.
fn number(mut value: u64, digits: usize, buffer: &mut [u8; LINE_BYTES], end: usize) -> usize {
    let mut at = end;
    while value > 0 || end - at < digits {
        at -= 1;
        buffer[at] = b'0' + (value % 10) as u8;
        value /= 10;
    }
    at
}
