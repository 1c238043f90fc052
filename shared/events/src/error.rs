//! What can be wrong with a recording.

use std::path::{Path, PathBuf};

/// Why a recording cannot be opened or read on. Each message is one line: which file, what is wrong, what to do.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// There is no such file.
    #[error("{}: there is no such file; check the path", path.display())]
    Missing {
        /// The recording.
        path: PathBuf,
    },
    /// It is a directory.
    #[error("{}: is a directory; name the recording inside it", path.display())]
    Directory {
        /// The recording.
        path: PathBuf,
    },
    /// The operating system does not allow reading it.
    #[error("{}: permission denied; make the file readable for this user", path.display())]
    Denied {
        /// The recording.
        path: PathBuf,
    },
    /// The operating system failed to read it.
    #[error("{}: cannot be read: {error}", path.display())]
    Read {
        /// The recording.
        path: PathBuf,
        /// What it said.
        error: std::io::Error,
    },
    /// The file as a whole is not as its format wants it.
    #[error("{}: {what}", path.display())]
    Malformed {
        /// The recording.
        path: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
    /// A line of a text recording is not as it should be.
    #[error("{}: line {line}: {what}", path.display())]
    Line {
        /// The recording.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// What is wrong and what to do.
        what: String,
    },
    /// An event cannot be right.
    #[error("{}: event {index} (from 0) at {} (x {x}, y {y}) {what}", path.display(), crate::event::seconds(*t_ns))]
    Event {
        /// The recording.
        path: PathBuf,
        /// Number of the event in the recording, from 0.
        index: u64,
        /// Its time, ns.
        t_ns: u64,
        /// Its column.
        x: u16,
        /// Its row.
        y: u16,
        /// What is wrong and what to do.
        what: String,
    },
    /// The plan asks for something that this build does not have, or the system refused a thread.
    #[error("{0}")]
    Setup(String),
}

impl SourceError {
    /// An error of the system as one about this recording.
    pub fn read(path: &Path, error: std::io::Error) -> Self {
        let path = path.to_owned();
        match error.kind() {
            std::io::ErrorKind::NotFound => Self::Missing { path },
            std::io::ErrorKind::PermissionDenied => Self::Denied { path },
            std::io::ErrorKind::IsADirectory => Self::Directory { path },
            _ => Self::Read { path, error },
        }
    }

    /// The file as a whole is not as its format wants it.
    pub fn malformed(path: &Path, what: impl Into<String>) -> Self {
        Self::Malformed {
            path: path.to_owned(),
            what: what.into(),
        }
    }
}
