//! The tape: what ingest sent, kept so that it can be sent again, chunk by chunk and tick by tick.
//!
//! A tape is two files. `<name>.aedat4` has the events, as any other recording in that format. `<name>.aedat4.ticks` has
//! lines of JSON: the head, the plan, and then every tick and chunk as it was sent, losses and settings included. Lines of
//! the kind `whole` say how many bytes and events of the first file belong to what stands above them; what is behind the
//! last of them was cut off, and does not count.

mod lines;
mod record;
mod replay;
#[cfg(test)]
mod tests;

pub use record::{Recorder, Taped};
pub use replay::TapeIngest;

use evpr_core::Plan;
use evpr_core::message::FuseSettings;
use evpr_events::writers::{AppendedAedat4, Committed, WriteError};
use lines::Lines;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The version of what is written; others are refused.
const VERSION: u32 = 1;
/// The ending of a tape's name.
pub const ENDING: &str = ".aedat4";

/// What is wrong with a tape: one line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct TapeError(String);

impl TapeError {
    fn about(path: &Path, what: impl std::fmt::Display) -> Self {
        Self(format!("{}: {what}", path.display()))
    }
}

impl From<WriteError> for TapeError {
    fn from(error: WriteError) -> Self {
        Self(error.to_string())
    }
}

/// The first line.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    tape: u32,
    /// Version of evpr that wrote it.
    evpr: String,
    /// SHA-256 of the second line, which is the plan.
    plan_sha256: String,
}

/// A tick that opened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Opened {
    tick: u64,
    start_us: u64,
    end_us: u64,
    epoch: u32,
    /// Metres east and north.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    position: Option<[f64; 2]>,
    /// The members enabled, by index.
    members: Vec<usize>,
    weights: Vec<f64>,
    fuse: FuseSettings,
}

/// A chunk of the tick under way.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Chunk {
    segment: u32,
    flags: u32,
    closes: u32,
    base_us: u64,
    events: usize,
    /// The disk could not take its events.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    lost: bool,
}

/// One line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Entry {
    Open(Opened),
    Chunk(Chunk),
    /// The tick under way is to be answered.
    Close {
        tick: u64,
    },
    End {
        tick: u64,
    },
    Whole(Committed),
}

/// What a tape says of itself.
#[derive(Debug, Clone)]
pub struct TapeHead {
    /// Version of evpr that wrote it.
    pub evpr: String,
    /// The plan of the run that it is of.
    pub plan: Plan,
}

/// The file of ticks that belongs to a file of events.
pub fn ticks_path(events: &Path) -> PathBuf {
    let mut path = events.as_os_str().to_owned();
    path.push(".ticks");
    PathBuf::from(path)
}

/// SHA-256 as hexadecimal digits.
pub fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// Begins a tape of a run with this plan, both files: ingest goes on with it when the run starts.
///
/// # Errors
/// When one of the files exists, or cannot be written; neither is left behind then.
pub fn create(events: &Path, plan: &Plan) -> Result<(), TapeError> {
    let named = events.to_string_lossy().ends_with(ENDING);
    if !named || events.file_name().is_none_or(|n| n == ENDING) {
        let what = format!("events are recorded as AEDAT4; give a name that ends in {ENDING}");
        return Err(TapeError::about(events, what));
    }
    let ticks = ticks_path(events);
    for path in [events, &ticks] {
        if path.exists() {
            let what = "exists already; choose another name or remove it";
            return Err(TapeError::about(path, what));
        }
    }
    let began = begin(events, &ticks, plan);
    if began.is_err() {
        discard(events);
    }
    began
}

fn begin(events: &Path, ticks: &Path, plan: &Plan) -> Result<(), TapeError> {
    let committed = AppendedAedat4::create(events, plan.sensor)?.committed();
    let failed = |e: &dyn std::fmt::Display| TapeError::about(ticks, format!("cannot be written: {e}"));
    let plan = serde_json::to_string(plan).map_err(|e| failed(&e))?;
    let head = Head {
        tape: VERSION,
        evpr: env!("CARGO_PKG_VERSION").to_owned(),
        plan_sha256: sha256_hex(plan.as_bytes()),
    };
    let head = serde_json::to_string(&head).map_err(|e| failed(&e))?;
    let whole = line(&Entry::Whole(committed));
    let mut file = File::create_new(ticks).map_err(|e| failed(&e))?;
    let written = file.write_all(format!("{head}\n{plan}\n{whole}").as_bytes());
    written.map_err(|e| failed(&e))
}

/// Removes a tape on which there is nothing.
pub fn discard(events: &Path) {
    for path in [events, &ticks_path(events)] {
        let _ = std::fs::remove_file(path);
    }
}

/// Reads what a tape says of itself.
///
/// # Errors
/// When it is no tape, of another version, or changed by somebody.
pub fn read_head(events: &Path) -> Result<TapeHead, TapeError> {
    Lines::open(events).map(|lines| lines.head().clone())
}

/// An entry as its line.
fn line(entry: &Entry) -> String {
    // Numbers that are not finite, which JSON does not have, become null; nothing else can fail.
    serde_json::to_string(entry).unwrap_or_default() + "\n"
}
