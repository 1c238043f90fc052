//! The bytes of a recording, in order, through one buffer of bounded size.

use crate::SourceError;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Read at once, bytes.
const READ_BYTES: usize = 512 << 10;

/// A file, what is compressed in it, a pipe or a connection: bytes that can be looked at before they are taken.
pub struct Input {
    path: PathBuf,
    reader: Box<dyn Read + Send>,
    buffer: Vec<u8>,
    /// What of the buffer is not taken yet.
    left: Range<usize>,
    ended: bool,
    taken: u64,
    /// The same file again, for [`Input::seek`]; `None` when these are not the bytes of a file, or no longer its own.
    file: Option<File>,
    /// Bytes read from the file itself, before anything is decompressed; its size, where it has one.
    read: Arc<AtomicU64>,
    size: Option<u64>,
}

impl std::fmt::Debug for Input {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Input")
            .field("path", &self.path)
            .field("taken", &self.taken)
            .finish_non_exhaustive()
    }
}

impl Input {
    /// The bytes of a file.
    ///
    /// # Errors
    /// When it does not exist, is not a regular file or cannot be opened.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let failed = |e| SourceError::read(path, e);
        let metadata = std::fs::metadata(path).map_err(failed)?;
        if metadata.is_dir() {
            return Err(SourceError::Directory {
                path: path.to_owned(),
            });
        }
        if !metadata.is_file() {
            return Err(SourceError::malformed(
                path,
                "is not a regular file; copy the recording into one",
            ));
        }
        let file = File::open(path).map_err(failed)?;
        let same = file.try_clone().map_err(failed)?;
        let mut input = Self::new(path, file);
        input.file = Some(same);
        input.size = Some(metadata.len());
        Ok(input)
    }

    /// The bytes of any reader; `path` is what it is called in messages.
    pub fn new(path: impl Into<PathBuf>, reader: impl Read + Send + 'static) -> Self {
        let read = Arc::new(AtomicU64::new(0));
        Self {
            path: path.into(),
            reader: Box::new(Counted {
                reader,
                read: read.clone(),
            }),
            buffer: Vec::new(),
            left: 0..0,
            ended: false,
            taken: 0,
            file: None,
            read,
            size: None,
        }
    }

    /// What `wrap` makes of these bytes, such as a decompressor. Progress stays that of the original.
    #[must_use]
    pub fn map<R: Read + Send + 'static>(self, wrap: impl FnOnce(Box<dyn Read + Send>) -> R) -> Self {
        let (path, read, size) = (self.path.clone(), self.read.clone(), self.size);
        let rest: Box<dyn Read + Send> = Box::new(self);
        Self {
            path,
            reader: Box::new(wrap(rest)),
            buffer: Vec::new(),
            left: 0..0,
            ended: false,
            taken: 0,
            file: None,
            read,
            size,
        }
    }

    /// What it is called in messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next bytes, not taken: at least `len` of them, or all that are left when there are fewer. Waits for them.
    /// More may be there already. `len` bounds the memory: callers cap what a file asks for.
    ///
    /// # Errors
    /// When reading fails.
    pub fn peek(&mut self, len: usize) -> Result<&[u8], SourceError> {
        while self.left.len() < len && !self.ended {
            self.fill(len)?;
        }
        Ok(&self.buffer[self.left.clone()])
    }

    /// What can be had without waiting; may be empty although more is to come.
    pub fn buffered(&self) -> &[u8] {
        &self.buffer[self.left.clone()]
    }

    /// Takes `len` bytes that were looked at.
    pub fn consume(&mut self, len: usize) {
        let len = len.min(self.left.len());
        self.left.start += len;
        self.taken += len as u64;
    }

    /// Takes `len` bytes unseen; false when the input ends before.
    ///
    /// # Errors
    /// When reading fails.
    pub fn skip(&mut self, mut len: u64) -> Result<bool, SourceError> {
        while len > 0 {
            let here = self.peek(1)?.len();
            if here == 0 {
                return Ok(false);
            }
            let n = here.min(usize::try_from(len).unwrap_or(usize::MAX));
            self.consume(n);
            len -= n as u64;
        }
        Ok(true)
    }

    /// Goes to this byte of the file, forward or back. False, and nothing has changed, when these are not the bytes of
    /// a file (but a pipe's, or what a decompressor made of one).
    ///
    /// # Errors
    /// When the system refuses.
    pub fn seek(&mut self, to: u64) -> Result<bool, SourceError> {
        // The clone shares its place with the reader.
        let Some(file) = &mut self.file else {
            return Ok(false);
        };
        file.seek(SeekFrom::Start(to))
            .map_err(|e| SourceError::read(&self.path, e))?;
        (self.left, self.ended, self.taken) = (0..0, false, to);
        self.read.store(to, Ordering::Relaxed);
        Ok(true)
    }

    /// Bytes taken so far (after decompression): the place of the next one.
    pub fn position(&self) -> u64 {
        self.taken
    }

    /// How much of the file has been read, permille. 0 while unknown; 1000 at the end.
    pub fn progress_permille(&self) -> u64 {
        if self.ended && self.left.is_empty() {
            return 1000;
        }
        let Some(size) = self.size.filter(|size| *size > 0) else {
            return 0;
        };
        let read = self
            .read
            .load(Ordering::Relaxed)
            .saturating_sub(self.left.len() as u64);
        (u128::from(read) * 1000 / u128::from(size)).min(999) as u64
    }

    fn fill(&mut self, len: usize) -> Result<(), SourceError> {
        let room = READ_BYTES.max(len.saturating_sub(self.left.len()));
        if self.buffer.len() < self.left.end + room {
            self.buffer.copy_within(self.left.clone(), 0);
            self.left = 0..self.left.len();
            let wanted = self.left.end + room;
            if self.buffer.len() < wanted {
                self.buffer.resize(wanted, 0);
            }
        }
        let got = loop {
            match self.reader.read(&mut self.buffer[self.left.end..]) {
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                other => break other.map_err(|e| SourceError::read(&self.path, e))?,
            }
        };
        self.left.end += got;
        self.ended = got == 0;
        Ok(())
    }
}

/// What is left, for a reader around it.
impl Read for Input {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let here = self.peek(1).map_err(std::io::Error::other)?;
        let n = here.len().min(out.len());
        out[..n].copy_from_slice(&here[..n]);
        self.consume(n);
        Ok(n)
    }
}

/// Counts what is read.
struct Counted<R> {
    reader: R,
    read: Arc<AtomicU64>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let got = self.reader.read(out)?;
        self.read.fetch_add(got as u64, Ordering::Relaxed);
        Ok(got)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    /// Gives one byte at a time.
    struct Slow(Cursor<Vec<u8>>);

    impl Read for Slow {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            let n = out.len().min(1);
            self.0.read(&mut out[..n])
        }
    }

    #[test]
    fn looks_ahead_takes_and_skips() {
        let bytes: Vec<u8> = (0..=255).collect();
        for slow in [false, true] {
            let cursor = Cursor::new(bytes.clone());
            let mut input = if slow {
                Input::new("i", Slow(cursor))
            } else {
                Input::new("i", cursor)
            };
            assert!(input.buffered().is_empty());
            assert_eq!(input.peek(3).unwrap()[..3], [0, 1, 2]);
            input.consume(2);
            assert_eq!((input.peek(2).unwrap()[0], input.position()), (2, 2));
            assert!(input.skip(250).unwrap());
            assert_eq!(input.peek(100).unwrap(), [252, 253, 254, 255]);
            assert!(!input.skip(5).unwrap());
            assert!(input.peek(1).unwrap().is_empty());
            assert_eq!((input.position(), input.progress_permille()), (256, 1000));
        }
    }

    #[test]
    fn goes_to_any_byte_of_a_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("f");
        std::fs::write(&path, [0, 1, 2, 3, 4, 5]).unwrap();
        let mut input = Input::open(&path).unwrap();
        assert!(input.skip(6).unwrap() && input.peek(1).unwrap().is_empty());
        assert!(input.seek(2).unwrap());
        assert_eq!((input.position(), input.progress_permille()), (2, 333));
        assert_eq!(input.peek(9).unwrap(), [2, 3, 4, 5]);
        assert!(input.seek(4).unwrap() && input.peek(1).unwrap() == [4, 5]);
        let mut mapped = input.map(|r| r);
        assert!(!mapped.seek(0).unwrap() && mapped.peek(1).unwrap() == [4, 5]);
    }

    #[test]
    fn more_than_one_read_fits() {
        let bytes: Vec<u8> = (0..3 * READ_BYTES).map(|i| (i / 1000) as u8).collect();
        let mut input = Input::new("i", Cursor::new(bytes.clone())).map(|r| r);
        input.peek(10).unwrap();
        input.consume(7);
        assert_eq!(
            input.peek(2 * READ_BYTES).unwrap()[..2 * READ_BYTES],
            bytes[7..7 + 2 * READ_BYTES]
        );
    }
}
