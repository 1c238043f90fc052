//! What can be wrong with a source of frames.

use std::path::{Path, PathBuf};

/// Why frames cannot be read: one line with the file, what is wrong, and what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}: {what}", path.display())]
pub struct FrameError {
    path: PathBuf,
    what: String,
}

impl FrameError {
    /// Something is wrong with this file. Line breaks become spaces.
    pub(crate) fn new(path: &Path, what: impl Into<String>) -> Self {
        let what: String = what.into();
        Self {
            path: path.to_owned(),
            what: what.replace(['\n', '\r'], " "),
        }
    }

    /// An error of the system.
    pub(crate) fn read(path: &Path, error: std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::NotFound => Self::new(path, "does not exist; check the path"),
            std::io::ErrorKind::PermissionDenied => {
                Self::new(path, "permission denied; make it readable for this user")
            }
            _ => Self::new(path, format!("cannot be read: {error}")),
        }
    }
}
