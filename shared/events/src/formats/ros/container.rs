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

/// What files of chunks have in common: the file, and the chunk that is being read.
pub(super) struct Chunks {
    pub(super) input: Input,
    pub(super) topics: Topics,
    /// The chunk, decompressed, or one record that is in none; with what of it is not read yet.
    pub(super) chunk: Vec<u8>,
    pub(super) left: Range<usize>,
    /// Place of the chunk in the file.
    pub(super) chunk_at: u64,
}

impl Chunks {
    pub(super) fn new(input: Input) -> Self {
        Self {
            input,
            topics: Topics::default(),
            chunk: Vec::new(),
            left: 0..0,
            chunk_at: 0,
        }
    }
}

/// A file of records, some of which are chunks that hold records.
pub(super) trait Chunked: Send {
    /// What it has in common with others.
    fn chunks(&self) -> &Chunks;

    /// The same, to be changed.
    fn chunks_mut(&mut self) -> &mut Chunks;

    /// Reads the next record of the file: what of it matters is then in [`Chunks::chunk`]. False at the end; `None`
    /// where it would wait although it must not.
    fn next_record(&mut self, may_wait: bool) -> Result<Option<bool>, SourceError>;

    /// Takes the next record of the chunk; its topic and place if it is a message.
    fn next_in_chunk(&mut self) -> Result<Option<(usize, Range<usize>)>, String>;
}

impl<C: Chunked> Container for C {
    fn next(&mut self, may_wait: bool) -> Result<Next, SourceError> {
        loop {
            if self.chunks().left.is_empty() {
                match self.next_record(may_wait)? {
                    None => return Ok(Next::Later),
                    Some(false) => return Ok(Next::End),
                    Some(true) => {}
                }
            } else if let Some((topic, message)) = self.next_in_chunk().map_err(|what| {
                let what = format!("the chunk at byte {} {what}", self.chunks().chunk_at);
                SourceError::malformed(self.chunks().input.path(), what)
            })? {
                return Ok(Next::Message(topic, message));
            }
        }
    }

    fn chunk(&self) -> &[u8] {
        &self.chunks().chunk
    }

    fn path(&self) -> &Path {
        self.chunks().input.path()
    }

    fn progress_permille(&self) -> u64 {
        self.chunks().input.progress_permille()
    }

    fn topics(&self) -> &Topics {
        &self.chunks().topics
    }

    fn topics_mut(&mut self) -> &mut Topics {
        &mut self.chunks_mut().topics
    }
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
