//! Lines of a file through one buffer of fixed size.

use crate::SourceError;
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Longest line that is taken, bytes.
pub(super) const MAX_LINE_BYTES: usize = 64 << 10;
const BUFFER_BYTES: usize = 512 << 10;

/// A file as lines. A line is handed out as a range, to be looked up with [`Lines::bytes`] before the next one.
pub(super) struct Lines {
    path: PathBuf,
    file: File,
    buffer: Vec<u8>,
    /// What of the buffer is not handed out yet.
    left: Range<usize>,
    /// Where the line handed out last began.
    last: usize,
    ended: bool,
    number: u64,
    taken_bytes: u64,
    size_bytes: u64,
}

impl Lines {
    pub(super) fn open(path: &Path) -> Result<Self, SourceError> {
        let failed = |e| SourceError::read(path, e);
        let file = File::open(path).map_err(failed)?;
        let size_bytes = file.metadata().map_err(failed)?.len();
        Ok(Self {
            path: path.to_owned(),
            file,
            buffer: vec![0; BUFFER_BYTES],
            left: 0..0,
            last: 0,
            ended: false,
            number: 0,
            taken_bytes: 0,
            size_bytes,
        })
    }

    /// The next line without its end (`\n` or `\r\n`); `None` after the last.
    pub(super) fn next(&mut self) -> Result<Option<Range<usize>>, SourceError> {
        let mut searched = 0;
        loop {
            let unsearched = &self.buffer[self.left.start + searched..self.left.end];
            if let Some(at) = unsearched.iter().position(|b| *b == b'\n') {
                return self.hand_out(searched + at, searched + at + 1).map(Some);
            }
            searched = self.left.len();
            if searched > MAX_LINE_BYTES {
                return self.hand_out(searched, searched).map(Some);
            }
            if self.ended {
                return if searched == 0 {
                    Ok(None)
                } else {
                    self.hand_out(searched, searched).map(Some)
                };
            }
            self.fill()?;
        }
    }

    fn hand_out(&mut self, len: usize, with_end: usize) -> Result<Range<usize>, SourceError> {
        self.number += 1;
        if len > MAX_LINE_BYTES {
            let what = format!(
                "is longer than {} KiB; this is not an event per line",
                MAX_LINE_BYTES >> 10
            );
            return Err(SourceError::Line {
                path: self.path.clone(),
                line: self.number,
                what,
            });
        }
        self.last = self.left.start;
        self.left.start += with_end;
        self.taken_bytes += with_end as u64;
        let line = self.last..self.last + len;
        let carriage_return = self.buffer[line.clone()].last() == Some(&b'\r');
        Ok(line.start..line.end - usize::from(carriage_return))
    }

    fn fill(&mut self) -> Result<(), SourceError> {
        self.buffer.copy_within(self.left.clone(), 0);
        self.left = 0..self.left.len();
        let got = loop {
            match self.file.read(&mut self.buffer[self.left.end..]) {
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                other => break other.map_err(|e| SourceError::read(&self.path, e))?,
            }
        };
        self.left.end += got;
        self.ended = got == 0;
        Ok(())
    }

    /// The line of this range.
    pub(super) fn bytes(&self, line: Range<usize>) -> &[u8] {
        self.buffer.get(line).unwrap_or_default()
    }

    /// Gives back the line that was handed out last: the next one is the same again.
    pub(super) fn unread(&mut self) {
        self.taken_bytes -= (self.left.start - self.last) as u64;
        self.left.start = self.last;
        self.number -= 1;
    }

    /// Number of the line handed out last, from 1.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    pub(super) fn progress_permille(&self) -> u64 {
        (u128::from(self.taken_bytes) * 1000 / u128::from(self.size_bytes.max(1))).min(1000) as u64
    }
}
