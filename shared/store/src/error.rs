//! What can be wrong with a traverse, in one line each.

use crate::difference::{Difference, listed};
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

/// Why a traverse cannot be opened, written or repaired.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is nothing of that name.
    #[error("{}: there is no such traverse; check the path, or record it with `evpr map build`", .0.display())]
    Missing(PathBuf),
    /// The path cannot name a traverse.
    #[error("{}: this cannot name a traverse; give the path of a folder", .0.display())]
    BadPath(PathBuf),
    /// A recording that was not closed. The path is the name it will have.
    #[error("{}.partial is an unfinished recording; close it with `evpr map repair {}`", .0.display(), .0.display())]
    Unfinished(PathBuf),
    /// A file, or a folder without a manifest.
    #[error("{} is not a traverse: {reason}; give the folder of a traverse", .path.display())]
    Foreign {
        /// The path.
        path: PathBuf,
        /// What is missing.
        reason: &'static str,
    },
    /// Made by a newer release.
    #[error(
        "{} has version {found}, this release reads version {} at most; update evpr, or record the traverse again",
        .path.display(), crate::VERSION
    )]
    NewerVersion {
        /// The traverse.
        path: PathBuf,
        /// Its version.
        found: u64,
    },
    /// A file does not hold what it must.
    #[error("{}: {reason}; restore the traverse from a copy, or record it again", .file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The traverse has no such member.
    #[error("{} has no member {member}; it has {have}", .path.display())]
    NoMember {
        /// The traverse.
        path: PathBuf,
        /// What was asked for.
        member: String,
        /// What there is.
        have: String,
    },
    /// The map was made by other parameters than the plan's.
    #[error(
        "map {} does not fit the configuration: {}; build the map again with this configuration, or change the \
         configuration to the map's",
        .path.display(), listed(.differences, "map", "configuration")
    )]
    Mismatch {
        /// The map.
        path: PathBuf,
        /// Every difference.
        differences: Vec<Difference>,
    },
    /// An unfinished recording was made by other parameters than those it shall go on with.
    #[error(
        "{}.partial cannot be continued: {}; close it with `evpr map repair {}` and record under another name",
        .path.display(), listed(.differences, "recording", "configuration"), .path.display()
    )]
    ResumeMismatch {
        /// The recording's final name.
        path: PathBuf,
        /// Every difference.
        differences: Vec<Difference>,
    },
    /// The recording had been closed but for its final name.
    #[error("{}.partial is complete and cannot be continued; finish it with `evpr map repair {}`",
        .0.display(), .0.display())]
    ResumeComplete(PathBuf),
    /// Nothing is overwritten.
    #[error("{} exists already; choose another name or remove it", .0.display())]
    Exists(PathBuf),
    /// What an earlier run left is not overwritten either. The path is the final name.
    #[error(
        "{}.partial was left by an earlier recording; close it with `evpr map repair {}` or remove it",
        .0.display(), .0.display()
    )]
    PartialExists(PathBuf),
    /// Another process writes the recording.
    #[error("{} is being recorded by a running process; stop that first", .0.display())]
    InUse(PathBuf),
    /// There is nothing to repair.
    #[error("{} is finished already; check it with `evpr map verify`", .0.display())]
    Finished(PathBuf),
    /// A recording without a single tick.
    #[error("{} holds no complete tick, so there is nothing to keep; remove it", .0.display())]
    Empty(PathBuf),
    /// The header of a new traverse is wrong.
    #[error("a traverse cannot be recorded so: {0}; change the configuration")]
    BadHeader(String),
    /// The writer was given something that does not belong there.
    #[error("{}: tick {tick} cannot be recorded: {reason}", .path.display())]
    BadTick {
        /// The recording's final name.
        path: PathBuf,
        /// The tick.
        tick: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// The recording broke off: the disk is full or failing.
    #[error(
        "{}: cannot be written: {source}; {}; {}run `evpr map repair {}`",
        .file.display(), kept(.path, *.ticks), advice(.source), .path.display()
    )]
    Broke {
        /// The file that could not be written.
        file: PathBuf,
        /// The recording's final name.
        path: PathBuf,
        /// Ticks that are kept.
        ticks: u64,
        /// What the system said.
        source: Error,
    },
    /// The writer is used after it broke.
    #[error("{}: the recording broke off after {ticks} ticks; run `evpr map repair {}`",
        .path.display(), .path.display())]
    Broken {
        /// The recording's final name.
        path: PathBuf,
        /// Ticks that are kept.
        ticks: u64,
    },
    /// Right answers cannot be had.
    #[error("ground truth: {0}")]
    GroundTruth(String),
    /// Anything else that the system refused.
    #[error("{}: cannot {action}: {source}", .file.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// On what.
        file: PathBuf,
        /// What the system said.
        source: Error,
    },
}

impl StoreError {
    /// For `map_err`: the system refused `action` on `file`.
    pub(crate) fn io(action: &'static str, file: &Path) -> impl FnOnce(Error) -> Self {
        let file = file.to_owned();
        move |source| Self::Io { action, file, source }
    }

    pub(crate) fn damaged(file: &Path, reason: impl Into<String>) -> Self {
        Self::Damaged {
            file: file.to_owned(),
            reason: reason.into(),
        }
    }
}

fn kept(path: &Path, ticks: u64) -> String {
    let path = path.display();
    match ticks.checked_sub(1) {
        Some(last) => format!("what was recorded up to tick {last} is kept in {path}.partial"),
        None => format!("nothing was recorded yet in {path}.partial"),
    }
}

fn advice(source: &Error) -> &'static str {
    match source.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space, then ",
        ErrorKind::AlreadyExists | ErrorKind::DirectoryNotEmpty => "move that away, then ",
        _ => "check the disk, then ",
    }
}
