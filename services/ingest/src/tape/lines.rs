//! Reading the file of ticks, up to the last line that is whole.

use super::{Entry, Head, TapeError, TapeHead, VERSION, sha256_hex, ticks_path};
use evpr_core::Plan;
use evpr_events::writers::Committed;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Longest line of a plan, and of anything else, bytes.
const MAX_PLAN_BYTES: u64 = 64 << 20;
const MAX_LINE_BYTES: u64 = 1 << 20;

/// Bytes, line by line.
struct Text {
    file: BufReader<File>,
    /// The line read last.
    line: Vec<u8>,
    /// Its number, from 1, and where in the file it ends.
    number: u64,
    end: u64,
}

impl Text {
    /// Reads a line of at most so many bytes; false at the end, or where a line is cut off or too long.
    fn next(&mut self, most: u64) -> io::Result<bool> {
        self.line.clear();
        self.file.by_ref().take(most).read_until(b'\n', &mut self.line)?;
        self.end += self.line.len() as u64;
        self.number += 1;
        Ok(self.line.ends_with(b"\n"))
    }
}

/// A tape's entries, as far as they are whole.
pub(super) struct Lines {
    path: PathBuf,
    head: TapeHead,
    text: Text,
    whole_end: u64,
    whole: Committed,
}

impl Lines {
    /// Opens the file that belongs to this file of events.
    ///
    /// # Errors
    /// When it is no tape, of another version, or changed by somebody.
    pub(super) fn open(events: &Path) -> Result<Self, TapeError> {
        let path = ticks_path(events);
        if !path.exists() {
            let what = format!(
                "is no tape, as there is no {}; `evpr run --record-events` makes one",
                path.display()
            );
            return Err(TapeError::about(events, what));
        }
        let unreadable = |e: io::Error| TapeError::about(&path, format!("cannot be read: {e}"));
        let file = File::open(&path).map_err(unreadable)?;
        let mut text = Text {
            file: BufReader::new(file),
            line: Vec::new(),
            number: 0,
            end: 0,
        };
        let head = read_head(&path, &mut text).map_err(|e| e.unwrap_or_else(unreadable))?;
        let (begin, begin_number) = (text.end, text.number);
        let (mut whole_end, mut whole) = (begin, Committed::default());
        while text.next(MAX_LINE_BYTES).map_err(unreadable)? {
            if text.line.starts_with(b"{\"whole\"")
                && let Ok(Entry::Whole(committed)) = serde_json::from_slice(&text.line)
            {
                (whole_end, whole) = (text.end, committed);
            }
        }
        text.file.seek(SeekFrom::Start(begin)).map_err(unreadable)?;
        (text.end, text.number) = (begin, begin_number);
        Ok(Self {
            path,
            head,
            text,
            whole_end,
            whole,
        })
    }

    pub(super) fn head(&self) -> &TapeHead {
        &self.head
    }

    /// Where the part that counts ends, and what of the events belongs to it.
    pub(super) fn whole(&self) -> (u64, Committed) {
        (self.whole_end, self.whole)
    }

    /// How much of it has been read, permille.
    pub(super) fn permille(&self) -> u64 {
        self.text.end.saturating_mul(1000) / self.whole_end.max(1)
    }

    /// The next entry; `None` at the end.
    ///
    /// # Errors
    /// When a line cannot be read or understood.
    pub(super) fn next(&mut self) -> Result<Option<Entry>, TapeError> {
        if self.text.end >= self.whole_end {
            return Ok(None);
        }
        let read = self.text.next(MAX_LINE_BYTES);
        let number = self.text.number;
        match read {
            Ok(true) => serde_json::from_slice(&self.text.line)
                .map(Some)
                .map_err(|e| self.damaged(&format!("is not understood ({e})"))),
            Ok(false) => Err(self.damaged("is cut off")),
            Err(e) => {
                let what = format!("line {number} cannot be read: {e}");
                Err(TapeError::about(&self.path, what))
            }
        }
    }

    /// That the line read last is wrong.
    pub(super) fn damaged(&self, what: &str) -> TapeError {
        let what = format!(
            "line {} {what}; the tape is damaged, and ends before it",
            self.text.number
        );
        TapeError::about(&self.path, what)
    }
}

/// Reads the first two lines; without a word where the system failed to.
fn read_head(path: &Path, text: &mut Text) -> Result<TapeHead, HeadError> {
    let wrong = |what: &str| HeadError::Wrong(TapeError::about(path, what));
    let no_tape = "does not begin as a tape of events does; it is damaged, or something else";
    let head: Option<Head> = match text.next(MAX_LINE_BYTES)? {
        true => serde_json::from_slice(&text.line).ok(),
        false => None,
    };
    let head = head.ok_or_else(|| wrong(no_tape))?;
    let other = |what: &str| wrong(&format!("{what}, by evpr {}; replay it with that one", head.evpr));
    if head.tape != VERSION {
        return Err(other(&format!(
            "is a tape of version {}, this evpr reads version {VERSION}: it was made",
            head.tape
        )));
    }
    if !text.next(MAX_PLAN_BYTES)? {
        return Err(wrong(no_tape));
    }
    let plan = text.line.trim_ascii_end();
    if sha256_hex(plan) != head.plan_sha256 {
        return Err(wrong(
            "the plan in its second line is not the one that was written; it is damaged, or somebody edited it",
        ));
    }
    let plan: Plan = serde_json::from_slice(plan).map_err(|e| {
        other(&format!(
            "this evpr does not understand its plan ({e}), which was made"
        ))
    })?;
    Ok(TapeHead {
        evpr: head.evpr,
        plan,
    })
}

/// Why the head of a tape cannot be read.
enum HeadError {
    Wrong(TapeError),
    System(io::Error),
}

impl From<io::Error> for HeadError {
    fn from(error: io::Error) -> Self {
        Self::System(error)
    }
}

impl HeadError {
    fn unwrap_or_else(self, system: impl Fn(io::Error) -> TapeError) -> TapeError {
        match self {
            Self::Wrong(error) => error,
            Self::System(error) => system(error),
        }
    }
}
