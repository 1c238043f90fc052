//! The files of a sequence: which are there, and whether they can be read.

use super::config;
use crate::preset::{Preset, Role, Sequence};
use evpr_core::plan::Sensor;
use evpr_events::{ReadOptions, SourceError, positions, rough_seconds};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// No drive begins so long before its first position, ns: 6 h.
const MAX_LEAD_NS: i64 = 6 * 3_600_000_000_000;

/// A file of a sequence.
#[derive(Debug, Serialize)]
pub(super) struct File {
    pub(super) role: Role,
    /// Where it is, or belongs.
    pub(super) path: PathBuf,
    /// Where else it may stand.
    pub(super) or: Vec<PathBuf>,
    pub(super) bytes: Option<u64>,
    #[serde(flatten)]
    pub(super) state: State,
}

#[derive(Debug, Serialize)]
#[serde(tag = "state", content = "what", rename_all = "snake_case")]
pub(super) enum State {
    Missing,
    /// It is there and cannot be used, for this reason.
    Wrong(String),
    /// It can be read, and is this.
    Good(String),
}

/// A sequence and its files.
#[derive(Debug, Serialize)]
pub(super) struct Drive {
    pub(super) name: String,
    pub(super) files: Vec<File>,
    /// Why it cannot be run; empty when it can.
    pub(super) lacks: Vec<String>,
}

impl Drive {
    /// Looks for the files of a sequence, and opens them.
    pub(super) fn look(preset: &Preset, sequence: &Sequence, folder: &Path) -> Self {
        let files = Role::ALL.iter().filter_map(|role| place(sequence, *role, folder));
        let mut drive = Self {
            name: sequence.name.clone(),
            files: files.collect(),
            lacks: Vec::new(),
        };
        let configured = config::parse(preset, sequence, &drive.files);
        let mut begins_ns = None;
        for file in &mut drive.files {
            if file.bytes.is_none() {
                continue;
            }
            let found = match (&configured, file.role) {
                (_, Role::Recording) => recording(&file.path, preset.sensor).map(|(what, first_ns)| {
                    begins_ns = Some(first_ns);
                    what
                }),
                (Ok(source), Role::Positions) => track(source, begins_ns),
                (Err(what), Role::Positions) => Err(format!("{}: {what}", preset.name)),
                (_, Role::HotPixels) => hot_pixels(&file.path, preset.sensor),
            };
            file.state = match found {
                Ok(what) => State::Good(what),
                Err(what) => State::Wrong(without(&file.path, what)),
            };
        }
        drive.lacks = drive.files.iter().filter_map(lack).collect();
        drive
    }

    /// The file of this role, if it is good.
    pub(super) fn file(&self, role: Role) -> Option<&File> {
        let good = |file: &&File| file.role == role && matches!(file.state, State::Good(_));
        self.files.iter().find(good)
    }

    pub(super) fn ready(&self) -> bool {
        self.lacks.is_empty()
    }
}

/// What keeps a sequence with this file from being run.
fn lack(file: &File) -> Option<String> {
    match (&file.state, file.role) {
        (State::Missing, Role::Recording | Role::Positions) => Some(format!("no {}", file.role.name())),
        (State::Wrong(_), Role::Recording) => Some("a wrong recording".to_owned()),
        (State::Wrong(_), role) => Some(format!("wrong {}", role.name())),
        _ => None,
    }
}

/// The file of this role, or where it belongs; `None` where the dataset has none.
fn place(sequence: &Sequence, role: Role, folder: &Path) -> Option<File> {
    let mut or: Vec<PathBuf> = sequence.places(role).iter().map(|p| folder.join(p)).collect();
    let at = or.iter().position(|path| path.exists());
    let path = (!or.is_empty()).then(|| or.remove(at.unwrap_or(0)))?;
    // A link that leads nowhere is missing; what may not be looked at fails when it is opened.
    let bytes = at.map(|_| std::fs::metadata(&path).map_or(0, |m| m.len()));
    Some(File {
        role,
        path,
        or,
        bytes,
        state: State::Missing,
    })
}

/// An error without the path that stands beside it.
fn without(path: &Path, what: String) -> String {
    match what.strip_prefix(&format!("{}: ", path.display())) {
        Some(rest) => rest.to_owned(),
        None => what,
    }
}

fn line(error: SourceError) -> String {
    error.to_string()
}

/// What a recording is, and the time of its first event, ns.
fn recording(path: &Path, sensor: Sensor) -> Result<(String, u64), String> {
    let options = ReadOptions {
        sensor: Some(sensor),
        ..ReadOptions::default()
    };
    let mut recording = evpr_events::open(path, &options).map_err(line)?;
    let mut batch = Vec::new();
    while recording.next_batch(&mut batch).map_err(line)? && batch.is_empty() {}
    let first = batch.first().ok_or("holds no events")?;
    let size = match recording.sensor() {
        Some(found) if found != sensor => {
            return Err(format!(
                "is of a sensor of {found}, but the dataset's is {sensor}; it is another recording"
            ));
        }
        Some(found) => found.to_string(),
        None => "does not tell the sensor's size".to_owned(),
    };
    let format = recording.describe().format;
    let begins = rough_seconds(first.t_ns);
    Ok((format!("{format}, {size}, begins at {begins}"), first.t_ns))
}

/// What a file of positions is, beside a recording that begins at this time.
fn track(source: &evpr_core::plan::Source, begins_ns: Option<u64>) -> Result<String, String> {
    let options = source.positions.as_ref().ok_or("is not configured")?;
    let (_, info) = positions::open(options).map_err(line)?;
    let shown = |ns: i64| u64::try_from(ns).map_or_else(|_| format!("{ns} ns"), rough_seconds);
    let (first, last) = (shown(info.first_ns), shown(info.last_ns));
    if let Some(begins) = begins_ns.and_then(|ns| i64::try_from(ns).ok()) {
        let late = info.first_ns.saturating_sub(begins) > MAX_LEAD_NS;
        if late || info.last_ns < begins {
            return Err(format!(
                "reaches from {first} to {last} of the sensor's clock, but the recording begins at {}; they are of \
                 different drives, or first_at or offset is wrong",
                shown(begins)
            ));
        }
    }
    Ok(format!(
        "{}, {} positions, {:.2} km, from {first} to {last}",
        info.format,
        info.positions,
        info.length_m / 1e3
    ))
}

fn hot_pixels(path: &Path, sensor: Sensor) -> Result<String, String> {
    let found = evpr_events::read_pixel_list(path, sensor).map_err(|e| {
        let all = e.to_string();
        let mut lines = all.lines();
        let first = lines.next().unwrap_or_default().to_owned();
        match lines.count() {
            0 => first,
            more => format!("{first} (and {more} more)"),
        }
    })?;
    Ok(format!("{} pixels", found.len()))
}
