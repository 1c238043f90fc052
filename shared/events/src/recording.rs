//! What every recording is to those who read it.

use crate::{RawEvent, SourceError};
use evpr_core::plan::Sensor;
use std::path::{Path, PathBuf};

/// A recording, or a live stream, read from its start to its end.
pub trait Recording: Send {
    /// Size of the sensor, if the recording says it.
    fn sensor(&self) -> Option<Sensor>;

    /// Replaces `out` by the next events, at most [`crate::BATCH_EVENTS`] of them, in the order of the recording.
    /// False when there are no more (`out` is then empty); true with an empty `out` is possible. Once it holds an
    /// event it does not wait for bytes that are not there yet, so that a live stream is not held up.
    ///
    /// # Errors
    /// When the recording cannot be read on. `out` then holds what was decoded before.
    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError>;

    /// How much of it has been read, permille.
    fn progress_permille(&self) -> u64;

    /// What it is.
    fn describe(&self) -> SourceInfo;

    /// What else was in it so far and passed over: frames, IMU samples, triggers, and so on, each kind once.
    fn skipped(&self) -> Vec<Skipped> {
        Vec::new()
    }

    /// How often since the last call a camera has run out of room and lost events.
    fn take_overflows(&mut self) -> u64 {
        0
    }

    /// Goes to a place before which every event is earlier than `t_ns`, and says which event comes next (from 0).
    /// `None`: it cannot jump, and stays where it is. Expects that times do not go back.
    ///
    /// # Errors
    /// When the recording cannot be read.
    fn seek_before(&mut self, t_ns: u64) -> Result<Option<u64>, SourceError> {
        let _ = t_ns;
        Ok(None)
    }

    /// Where the camera was, if the recording knows. Asked once, before reading begins; what it gives is used by
    /// another thread than the recording.
    fn trajectory(&self) -> Option<Box<dyn Trajectory>> {
        None
    }
}

/// Where the camera was over the time of a recording.
pub trait Trajectory: Send {
    /// Metres east (or x) and north (or y) at sensor time `t_ns`; `None` where that is not known. Asked once per tick,
    /// for its start, in the order of time.
    fn position(&mut self, t_ns: u64) -> Option<[f64; 2]>;
}

/// The size of a recording's sensor: what it says itself, or else what was given.
///
/// # Errors
/// When the two are not the same; one line that names both.
pub fn agreed_sensor(
    path: &Path,
    said: Option<Sensor>,
    given: Option<Sensor>,
) -> Result<Option<Sensor>, SourceError> {
    match said.zip(given).filter(|(said, given)| said != given) {
        Some((said, given)) => {
            let what = format!("says that its sensor is {said}, but {given} is given; leave that out");
            Err(SourceError::malformed(path, what))
        }
        None => Ok(said.or(given)),
    }
}

/// What a recording is.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct SourceInfo {
    /// Name of the format.
    pub format: &'static str,
    /// The file.
    pub path: PathBuf,
    /// The unit its times are in: `s`, `ms`, `us` or `ns`.
    pub time_unit: &'static str,
    /// How that is known: `format`, `config`, `name`, `decimal point`, `floating point` or `magnitude`.
    pub time_unit_from: &'static str,
    /// Number of events, if known without reading them all.
    pub events: Option<u64>,
}

/// A kind of data other than events that was passed over.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Skipped {
    /// What it is, in a few words: `external triggers`, `frames (stream 1)`.
    pub what: String,
    /// How many samples, messages or packets of it.
    pub count: u64,
}
