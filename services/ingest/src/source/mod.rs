//! Recordings: one file per format, and the registry that finds the right one; and the simulated street.

mod decimal;
mod hdf5;
mod lines;
mod street;
mod text;

use crate::{RawEvent, SourceError};
use evpr_core::plan::{Sensor, Source, TimeUnit};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A recording, read from its start to its end.
pub trait Recording: Send {
    /// Size of the sensor, if the recording says it.
    fn sensor(&self) -> Option<Sensor>;

    /// Replaces `out` by the next events, at most [`crate::BATCH_EVENTS`] of them, in the order of the recording.
    /// False when there are no more (`out` is then empty).
    ///
    /// # Errors
    /// When the recording cannot be read on. `out` then holds what was decoded before.
    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError>;

    /// How much of it has been read, permille.
    fn progress_permille(&self) -> u64;

    /// What it is.
    fn describe(&self) -> SourceInfo;

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

/// What a recording is.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct SourceInfo {
    /// Name of the format.
    pub format: &'static str,
    /// The file.
    pub path: PathBuf,
    /// The unit its times are in: `s`, `ms`, `us` or `ns`.
    pub time_unit: &'static str,
    /// How that is known: `format`, `config`, `decimal point` or `magnitude`.
    pub time_unit_from: &'static str,
    /// Number of events, if known without reading them all.
    pub events: Option<u64>,
}

/// The start of a file, by which its format is known.
struct Head {
    bytes: Vec<u8>,
}

/// Where the HDF5 signature may stand: at the start, or behind a user block of these sizes.
const HDF5_SIGNATURE_AT: [usize; 4] = [0, 512, 1024, 2048];
const HDF5_SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";

impl Head {
    fn is_hdf5(&self) -> bool {
        HDF5_SIGNATURE_AT.iter().any(|at| {
            self.bytes
                .get(*at..)
                .is_some_and(|b| b.starts_with(HDF5_SIGNATURE))
        })
    }

    fn is_text(&self) -> bool {
        !self.bytes.contains(&0)
    }
}

type Opened = Result<Box<dyn Recording>, SourceError>;

/// A format: one row of the registry.
struct Format {
    /// Endings of file names, without the point, in lower case.
    extensions: &'static [&'static str],
    detects: fn(&Head) -> bool,
    open: fn(&Path, TimeUnit) -> Opened,
    /// What is wrong with a file of this ending that is not of this format.
    otherwise: &'static str,
}

/// All formats; the first that knows the content takes it.
static FORMATS: [Format; 2] = [
    Format {
        extensions: &["h5", "hdf5", "he5"],
        detects: Head::is_hdf5,
        open: |path, _| Ok(Box::new(hdf5::Hdf5::open(path)?)),
        otherwise: "has the ending of an HDF5 file but not its signature; it is damaged or of another format",
    },
    Format {
        extensions: &["txt", "csv", "tsv", "dat"],
        detects: Head::is_text,
        open: |path, unit| Ok(Box::new(text::Text::open(path, unit)?)),
        otherwise: "has the ending of a text file but is not text",
    },
];

/// Formats that are known by their first bytes, and not read.
static UNREADABLE: [(&[u8], &str); 9] = [
    (b"#!AER-DAT", "AEDAT"),
    (b"% ", "Prophesee RAW or DAT"),
    (b"#ROSBAG", "rosbag"),
    (b"\x89MCAP0", "MCAP"),
    (b"PAR1", "Parquet"),
    (b"\x93NUMPY", "NumPy"),
    (b"PK\x03\x04", "zip"),
    (b"\x1f\x8b", "gzip"),
    (
        b"version https://git-lfs",
        "a Git LFS pointer, not the file itself",
    ),
];

/// Opens a recording. Its format is known by its content; where that is not conclusive, by its name's ending.
///
/// # Errors
/// One line, when it does not exist, cannot be read, is empty or of no known format, or holds no events.
pub fn open(source: &Source) -> Result<Box<dyn Recording>, SourceError> {
    match (source.kind.as_str(), &source.street) {
        ("file", _) => open_path(&source.path, source.time_unit),
        ("street", Some(street)) => Ok(Box::new(street::Street::new(street, &source.path))),
        (kind, _) => Err(SourceError::Setup(format!(
            "source.kind \"{kind}\" is not known, or incomplete; this build reads \"file\" and \"street\""
        ))),
    }
}

/// Asks a recording for the size of its sensor: the HDF5 attributes `height` and `width` of `/events`, or a first
/// line `width height` in text. `None` when it does not say: then the configuration must. A street has the sensor that it
/// was given.
///
/// # Errors
/// As [`open`].
pub fn probe(source: &Source) -> Result<Option<Sensor>, SourceError> {
    match &source.street {
        // Without building it.
        Some(street) => Ok(Some(street.sensor)),
        None => Ok(open(source)?.sensor()),
    }
}

/// Opens a recording by its path. `time_unit` counts for text only.
pub(crate) fn open_path(path: &Path, time_unit: TimeUnit) -> Result<Box<dyn Recording>, SourceError> {
    let head = read_head(path)?;
    if let Some((_, name)) = UNREADABLE.iter().find(|(magic, _)| head.bytes.starts_with(magic)) {
        return Err(SourceError::malformed(
            path,
            format!("is {name}; this build reads HDF5 in the NSAVP layout, and text"),
        ));
    }
    let extension = path
        .extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let named = FORMATS
        .iter()
        .find(|f| f.extensions.contains(&extension.as_str()));
    match (FORMATS.iter().find(|f| (f.detects)(&head)), named) {
        // Text is a guess: it does not overrule the name.
        (Some(found), Some(named)) if !std::ptr::eq(found, named) && !head.is_hdf5() => {
            Err(SourceError::malformed(path, named.otherwise))
        }
        (Some(found), _) => (found.open)(path, time_unit),
        (None, Some(named)) => Err(SourceError::malformed(path, named.otherwise)),
        (None, None) => Err(SourceError::malformed(
            path,
            "is of no known format; this build reads HDF5 in the NSAVP layout, and text lines \"t x y p\"",
        )),
    }
}

fn read_head(path: &Path) -> Result<Head, SourceError> {
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
    let mut bytes = Vec::new();
    File::open(path)
        .map_err(failed)?
        .take(4096)
        .read_to_end(&mut bytes)
        .map_err(failed)?;
    if bytes.is_empty() {
        return Err(SourceError::malformed(
            path,
            "is empty (0 bytes); it holds no events",
        ));
    }
    Ok(Head { bytes })
}
