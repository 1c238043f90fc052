//! What can be wrong with what shall be evaluated, in one line each.

use std::path::PathBuf;

/// Why traverses cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// A traverse or a ground truth cannot be used.
    #[error(transparent)]
    Store(#[from] evpr_store::StoreError),
    /// A file cannot be read or written.
    #[error("{}: cannot {what}: {source}", .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried.
        what: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
    /// A file does not say what it must.
    #[error("{}: {reason}", .path.display())]
    Bad {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// The two traverses of a pair cannot be compared.
    #[error("pair {pair}: {reason}")]
    Pair {
        /// Its name.
        pair: String,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// What was asked for makes no sense.
    #[error("{0}")]
    Asked(String),
    /// A configuration needs more memory than allowed.
    #[error(
        "pair {pair} needs {needed_mib} MiB for sequences of {length} ticks, more than the {allowed_mib} MiB of --memory; allow \
         more, or evaluate fewer members at a time"
    )]
    Memory {
        /// Its name.
        pair: String,
        /// Sequence length, ticks.
        length: usize,
        /// MiB needed.
        needed_mib: u64,
        /// MiB allowed.
        allowed_mib: u64,
    },
}

impl EvaluateError {
    /// For `map_err` on an input or output operation.
    pub(crate) fn io(what: &'static str, path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Io {
            path: path.to_owned(),
            what,
            source,
        }
    }

    pub(crate) fn bad(path: &std::path::Path, reason: impl Into<String>) -> Self {
        Self::Bad {
            path: path.to_owned(),
            reason: reason.into(),
        }
    }

    pub(crate) fn pair(pair: &str, reason: impl Into<String>) -> Self {
        Self::Pair {
            pair: pair.to_owned(),
            reason: reason.into(),
        }
    }
}
