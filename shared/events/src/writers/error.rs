//! What can go wrong when a recording is written.

use std::path::{Path, PathBuf};

/// Why a recording cannot be written. Each message is one line: which file, what is wrong, what to do.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The ending of the name stands for no format that can be written.
    #[error("{}: no format to write has this ending; use one of {}", path.display(), endings())]
    Ending {
        /// The file that was asked for.
        path: PathBuf,
    },
    /// The format cannot be written without the size of the sensor.
    #[error(
        "{}: {format} says the size of the sensor, which the recording does not; give it, as in --sensor 260x346 (height x width)",
        path.display()
    )]
    NoSensor {
        /// The file.
        path: PathBuf,
        /// Name of the format.
        format: &'static str,
    },
    /// The operating system failed to write it.
    #[error("{}: cannot be written: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What it said.
        error: std::io::Error,
    },
    /// An event does not fit the format.
    #[error("{}: event {index} (from 0) {what}", path.display())]
    Event {
        /// The file.
        path: PathBuf,
        /// Number of the event among those written, from 0.
        index: u64,
        /// What is wrong and what to do.
        what: String,
    },
    /// The recording as a whole does not fit the format.
    #[error("{}: {what}", path.display())]
    Unfit {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
}

impl WriteError {
    /// An error of the system as one about this file.
    pub fn write(path: &Path, error: std::io::Error) -> Self {
        Self::Write {
            path: path.to_owned(),
            error,
        }
    }
}

fn endings() -> String {
    let endings: Vec<_> = super::extensions().map(|e| format!(".{e}")).collect();
    endings.join(", ")
}
