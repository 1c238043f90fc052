//! Lines of text, out of the input's buffer.

use crate::{Input, SourceError};
use std::ops::Range;

/// Longest line that is taken, bytes.
pub(crate) const MAX_LINE_BYTES: usize = 64 << 10;

/// An input as lines. A line is handed out as a range, to be looked up with [`Lines::bytes`] before the next one.
pub(crate) struct Lines {
    input: Input,
    /// Length with its end of the line that was handed out last: it is taken when the next one is asked for.
    handed_out: usize,
    number: u64,
}

impl Lines {
    pub(crate) fn new(input: Input) -> Self {
        Self {
            input,
            handed_out: 0,
            number: 0,
        }
    }

    pub(crate) fn input(&self) -> &Input {
        &self.input
    }

    /// The next line without its end (`\n` or `\r\n`); `None` after the last.
    pub(crate) fn next(&mut self) -> Result<Option<Range<usize>>, SourceError> {
        self.input.consume(self.handed_out);
        self.handed_out = 0;
        let mut searched = 0;
        loop {
            let here = self.input.buffered();
            if let Some(at) = here[searched..].iter().position(|b| *b == b'\n') {
                return self.hand_out(searched + at, searched + at + 1).map(Some);
            }
            searched = here.len();
            if searched > MAX_LINE_BYTES {
                return self.hand_out(searched, searched).map(Some);
            }
            if self.input.peek(searched + 1)?.len() == searched {
                return if searched == 0 {
                    Ok(None)
                } else {
                    self.hand_out(searched, searched).map(Some)
                };
            }
        }
    }

    /// True when a whole line can be had without waiting.
    pub(crate) fn is_ready(&self) -> bool {
        let rest = self.input.buffered().get(self.handed_out..);
        rest.is_some_and(|rest| rest.contains(&b'\n'))
    }

    fn hand_out(&mut self, len: usize, with_end: usize) -> Result<Range<usize>, SourceError> {
        self.number += 1;
        if len > MAX_LINE_BYTES {
            let what = format!(
                "is longer than {} KiB; these are no lines of text",
                MAX_LINE_BYTES >> 10
            );
            return Err(SourceError::Line {
                path: self.input.path().to_owned(),
                line: self.number,
                what,
            });
        }
        self.handed_out = with_end;
        let carriage_return = self.input.buffered()[..len].last() == Some(&b'\r');
        Ok(0..len - usize::from(carriage_return))
    }

    /// The line of this range.
    pub(crate) fn bytes(&self, line: Range<usize>) -> &[u8] {
        self.input.buffered().get(line).unwrap_or_default()
    }

    /// Gives back the line that was handed out last: the next one is the same again.
    pub(crate) fn unread(&mut self) {
        self.handed_out = 0;
        self.number -= 1;
    }

    /// Number of the line handed out last, from 1.
    pub(crate) fn number(&self) -> u64 {
        self.number
    }

    pub(crate) fn progress_permille(&self) -> u64 {
        self.input.progress_permille()
    }
}
