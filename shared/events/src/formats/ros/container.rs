//! What bags and MCAP have in common: topics, and their messages one after another.

use crate::{Input, SourceError};
use std::ops::Range;
use std::path::Path;

/// Most topics of a recording.
const MAX_TOPICS: usize = 1 << 12;
/// Longest name of a topic or type, bytes.
const MAX_NAME_BYTES: usize = 512;
/// Waited for at once while a length is only a claim, bytes.
const STEP_BYTES: usize = 1 << 20;

/// A topic, with what fills it.
#[derive(Debug)]
pub(super) struct Topic {
    pub(super) name: String,
    /// Type of its messages.
    pub(super) kind: String,
    pub(super) layout: Option<super::fields::Layout>,
    /// Messages that were passed over.
    pub(super) count: u64,
}

/// What comes next.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// A message of this topic, in [`Container::chunk`].
    Message(usize, Range<usize>),
    /// More is to come, but is not there yet.
    Later,
    End,
}

/// A file of messages.
pub(super) trait Container: Send {
    /// The next message. With `may_wait` false, only what is there already is read.
    fn next(&mut self, may_wait: bool) -> Result<Next, SourceError>;

    /// The bytes that the last message is in.
    fn chunk(&self) -> &[u8];

    /// What it is called in messages.
    fn path(&self) -> &Path;

    /// How much of it has been read, permille.
    fn progress_permille(&self) -> u64;

    /// The topics known so far.
    fn topics(&self) -> &Topics;

    /// The same, to be counted for.
    fn topics_mut(&mut self) -> &mut Topics;
}

/// The topics known so far.
#[derive(Debug, Default)]
pub(super) struct Topics(pub(super) Vec<Topic>);

impl Topics {
    /// The number of this topic with messages of this type; new where it is not known yet.
    pub(super) fn find(
        &mut self,
        name: &[u8],
        kind: &[u8],
        layout: Option<super::fields::Layout>,
    ) -> Result<usize, String> {
        if name.len().max(kind.len()) > MAX_NAME_BYTES {
            return Err(format!(
                "names a topic or type with more than {MAX_NAME_BYTES} bytes; it is damaged"
            ));
        }
        let (name, kind) = (super::printable(name), super::printable(kind));
        let same = |t: &Topic| t.name == name && t.kind == kind && t.layout == layout;
        if let Some(at) = self.0.iter().position(same) {
            return Ok(at);
        }
        if self.0.len() == MAX_TOPICS {
            return Err(format!(
                "has more than {MAX_TOPICS} topics; write those that are wanted into another"
            ));
        }
        self.0.push(Topic {
            name,
            kind,
            layout,
            count: 0,
        });
        Ok(self.0.len() - 1)
    }

    /// Some of them, for a person.
    pub(super) fn listed(&self) -> String {
        const MOST: usize = 8;
        let one = |t: &Topic| format!("{} ({})", t.name, t.kind);
        let mut listed: Vec<String> = self.0.iter().take(MOST).map(one).collect();
        if listed.is_empty() {
            return "no topics at all".to_owned();
        }
        if self.0.len() > MOST {
            listed.push("…".to_owned());
        }
        listed.join(", ")
    }
}

/// Waits until `len` bytes are there; false when the input ends before. Memory grows with what has come, not with
/// what is claimed.
pub(super) fn wait_for(input: &mut Input, len: usize) -> Result<bool, SourceError> {
    while input.buffered().len() < len {
        let now = len.min((2 * input.buffered().len()).max(STEP_BYTES));
        if input.peek(now)?.len() < now {
            return Ok(false);
        }
    }
    Ok(true)
}
