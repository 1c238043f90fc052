//! Writing recordings, one file per format, and the registry that finds the writer by a name's ending.
//!
//! What is written stands in `<name>.partial` beside the target until [`Writer::finish`] renames it: under the real
//! name there is never half a recording.

mod aedat4;
mod appended;
mod csv;
mod error;
mod evt3;
mod hdf5_structure;
mod new_file;
mod nsavp;
mod numpy;
#[cfg(feature = "parquet")]
mod parquet;

use crate::RawEvent;
use evpr_core::plan::Sensor;
use std::path::Path;

pub use appended::{AppendedAedat4, Committed};
pub use error::WriteError;

/// A recording that is being written. Dropped before it is finished, it leaves nothing behind.
pub trait Writer: Send {
    /// Appends events. Their times do not go back.
    ///
    /// # Errors
    /// When the system fails to write, or an event does not fit the format.
    fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError>;

    /// Writes what is still held, and gives the recording its real name.
    ///
    /// # Errors
    /// When the system fails to write. The real name is then as it was before.
    fn finish(self: Box<Self>) -> Result<(), WriteError>;
}

/// What a writer needs to be told beside the events.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// Size of the sensor; some formats cannot be written without it ([`WriteError::NoSensor`]).
    pub sensor: Option<Sensor>,
}

type Created = Result<Box<dyn Writer>, WriteError>;

/// A format that can be written: one row of the registry.
struct Kind {
    /// Endings of file names, without the point, in lower case. The first is the usual one.
    extensions: &'static [&'static str],
    /// Times are kept to this many ns; finer ones are rounded down.
    resolution_ns: u64,
    create: fn(&Path, &WriteOptions) -> Created,
}

/// All formats that can be written.
static KINDS: &[Kind] = &[
    Kind {
        extensions: &["csv"],
        resolution_ns: 1,
        create: |path, _| Ok(Box::new(csv::Csv::create(path)?)),
    },
    Kind {
        extensions: &["npy"],
        resolution_ns: 1,
        create: |path, _| Ok(Box::new(numpy::Npy::create(path)?)),
    },
    Kind {
        extensions: &["npz"],
        resolution_ns: 1,
        create: |path, _| Ok(Box::new(numpy::Npz::create(path)?)),
    },
    #[cfg(feature = "parquet")]
    Kind {
        extensions: &["parquet"],
        resolution_ns: 1,
        create: |path, _| Ok(Box::new(parquet::Parquet::create(path)?)),
    },
    Kind {
        extensions: &["aedat4"],
        resolution_ns: 1000,
        create: |path, options| Ok(Box::new(aedat4::Aedat4::create(path, options)?)),
    },
    Kind {
        extensions: &["h5", "hdf5"],
        resolution_ns: 1,
        create: |path, options| Ok(Box::new(nsavp::Nsavp::create(path, options.sensor)?)),
    },
    Kind {
        extensions: &["raw"],
        resolution_ns: 1000,
        create: |path, options| Ok(Box::new(evt3::Evt3::create(path, options)?)),
    },
];

/// Begins a recording in the format that the name's ending stands for. An older file of that name stays until
/// [`Writer::finish`] replaces it.
///
/// # Errors
/// When no format that can be written has this ending, the format needs something that `options` lacks, or the system
/// refuses the file.
pub fn create(path: &Path, options: &WriteOptions) -> Created {
    (kind(path)?.create)(path, options)
}

/// Times of a recording written under this name are kept to this many ns; finer ones are rounded down.
///
/// # Errors
/// When no format that can be written has this ending.
pub fn resolution_ns(path: &Path) -> Result<u64, WriteError> {
    Ok(kind(path)?.resolution_ns)
}

/// The endings of names that stand for a format that can be written, without the point.
pub fn extensions() -> impl Iterator<Item = &'static str> {
    KINDS.iter().flat_map(|kind| kind.extensions.iter().copied())
}

/// The longest ending that fits counts, so that one may be part of another.
fn kind(path: &Path) -> Result<&'static Kind, WriteError> {
    let name = path
        .file_name()
        .map(|n| n.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let fits = |extension: &&&str| {
        name.strip_suffix(**extension)
            .is_some_and(|stem| stem.len() > 1 && stem.ends_with('.'))
    };
    let longest = |kind: &'static Kind| {
        let len = kind.extensions.iter().filter(fits).map(|e| e.len()).max();
        len.map(|len| (len, kind))
    };
    let found = KINDS.iter().filter_map(longest).max_by_key(|(len, _)| *len);
    found.map(|(_, kind)| kind).ok_or_else(|| WriteError::Ending {
        path: path.to_owned(),
    })
}
