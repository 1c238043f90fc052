//! What can be wrong with a recording.

use std::borrow::Cow;
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
    #[error("{}: cannot be read: {}", path.display(), printable(&error.to_string()))]
    Read {
        /// The recording.
        path: PathBuf,
        /// What it said.
        error: std::io::Error,
    },
    /// The file as a whole is not as its format wants it.
    #[error("{}: {}", path.display(), printable(what))]
    Malformed {
        /// The recording.
        path: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
    /// A line of a text recording is not as it should be.
    #[error("{}: line {line}: {}", path.display(), printable(what))]
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

/// A message with what files can put into it, such as names: control characters are written out.
fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(char::is_control) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| {
        if c.is_control() {
            c.escape_default().to_string()
        } else {
            c.to_string()
        }
    };
    Cow::Owned(text.chars().map(shown).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_one_line_whatever_names_a_file_has() {
        let error = SourceError::malformed(Path::new("a.npz"), "the member 'x\n\u{1b}[2Jé' is damaged");
        assert_eq!(
            error.to_string(),
            "a.npz: the member 'x\\n\\u{1b}[2Jé' is damaged"
        );
        let error = SourceError::read(Path::new("a"), std::io::Error::other("b\rc"));
        assert_eq!(error.to_string(), "a: cannot be read: b\\rc");
    }
}
