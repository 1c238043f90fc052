//! Where the camera was, as a file beside the recording says it.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A file of positions and how it is read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Positions {
    /// The file.
    pub path: PathBuf,
    /// Its format.
    pub kind: PositionKind,
    /// How its times become sensor times.
    pub clock: PositionClock,
    /// The day (in UTC) of its first record, days since 1970-01-01, where the file itself does not say it.
    pub date: Option<i64>,
    /// The UTM zone; else that of the first position.
    pub zone: Option<UtmZone>,
    /// Where the authors' code does something else.
    pub compat: PositionCompat,
    /// Between two positions that lie further apart in time than this nothing is known, ns.
    pub max_gap_ns: u64,
    /// Which part of the recording is used.
    pub crop: Crop,
}

/// Between positions further apart than this nothing is known, ns: at 50 km/h 5 s are 70 m, and a driven curve then
/// departs from the straight line by less than the tolerances in use.
pub const DEFAULT_MAX_GAP_NS: u64 = 5_000_000_000;

impl Positions {
    /// A file, with the defaults.
    pub fn file(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            kind: PositionKind::Auto,
            clock: PositionClock::Offset(0),
            date: None,
            zone: None,
            compat: PositionCompat::None,
            max_gap_ns: DEFAULT_MAX_GAP_NS,
            crop: Crop::None,
        }
    }
}

/// Format of a file of positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionKind {
    /// Known by its content.
    Auto,
    /// Sentences of a GNSS receiver.
    Nmea,
    /// Columns of text with a time, and latitude and longitude or metres.
    Csv,
    /// NSAVP's poses: HDF5, earth-centred metres.
    Applanix,
}

/// How times of positions become sensor times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionClock {
    /// So many ns are added to the file's times.
    Offset(i64),
    /// The file's first record is at this sensor time, ns.
    FirstAt(u64),
}

/// Whether positions are as the authors' code has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionCompat {
    /// No: everything the file says is used.
    None,
    /// Yes.
    Paper,
}

/// Which part of a recording is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Crop {
    /// All of it.
    None,
    /// From the first position to the last.
    Track,
    /// From the first position that is driven past again to where that happens.
    FirstLoop,
    /// From the first motion to the last position.
    FirstMotion,
}

/// A zone of the Universal Transverse Mercator projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct UtmZone {
    /// 1 to 60; zone 1 is centred on 177° west.
    pub number: u8,
    /// Whether northings are those of the southern hemisphere: plus 10,000,000 m.
    pub south: bool,
}

impl std::fmt::Display for UtmZone {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{}", self.number, if self.south { 'S' } else { 'N' })
    }
}
