//! Where the camera was: files of positions, one file per format, and the [`Track`] that they become.
//!
//! Latitude and longitude (WGS 84) become metres east and north in a zone of UTM, the zone of the first position unless
//! one is given: so that drives along one route share one frame. Distances in it are right to 0.1 %. For two drives
//! that begin on different sides of a zone's edge, give the zone.

mod applanix;
mod crop;
mod csv;
mod nmea;
mod track;
mod utm;
mod wgs84;

pub use track::{Position, Track, distance_m};

use crate::formats::is_hdf5;
use crate::{Input, SourceError};
use evpr_core::plan::{PositionClock, PositionCompat, PositionKind, Positions, UtmZone};
use std::path::{Path, PathBuf};
use track::MAX_POSITIONS;

const DAY_NS: i64 = 86_400_000_000_000;
/// Bytes by which a format is known.
const HEAD_BYTES: usize = 4096;
/// Of so many positions one may be out of order; more, and the file is not a track.
const OUT_OF_ORDER: usize = 10;

/// What a file of positions holds.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct TrackInfo {
    /// Name of the format.
    pub format: &'static str,
    /// The file.
    pub path: PathBuf,
    /// The UTM zone of its metres; none where they are those of the file.
    pub zone: Option<String>,
    /// Positions that are used.
    pub positions: usize,
    /// Sensor time of the first of them, ns.
    pub first_ns: i64,
    /// Sensor time of the last of them, ns.
    pub last_ns: i64,
    /// Length of the way along them, metres.
    pub length_m: f64,
    /// Lines that could not be read and were passed over.
    pub passed_over: u64,
    /// Positions that were earlier than one before them, and left out.
    pub out_of_order: usize,
}

/// Reads a file of positions.
///
/// # Errors
/// One line, when it does not exist, cannot be read, holds no positions, does not say a date that is needed, lies
/// outside the given zone, or has nothing to crop to.
pub fn open(options: &Positions) -> Result<(Track, TrackInfo), SourceError> {
    let path = options.path.as_path();
    let wrong = |what: String| SourceError::malformed(path, what);
    let reading = read(options)?;
    let out_of_order = out_of_order(reading.fixes.all());
    if out_of_order > reading.fixes.all().len() / OUT_OF_ORDER {
        return Err(wrong(format!(
            "times go back {out_of_order} times in {} positions; sort it by time",
            reading.fixes.all().len()
        )));
    }
    let shift_ns = match options.clock {
        PositionClock::Offset(ns) => i128::from(ns),
        PositionClock::FirstAt(ns) => i128::from(ns) - i128::from(reading.first_ns),
    };
    let zone = match reading.fixes.all().first() {
        None => {
            let broken = match reading.passed_over {
                0 => String::new(),
                n => format!(" ({n} lines are broken)"),
            };
            return Err(wrong(format!("holds no valid position{broken}")));
        }
        Some(_) if !reading.geographic => None,
        Some((_, [latitude, longitude])) => match options.zone {
            Some(zone) => Some(zone),
            None => Some(utm::zone_of(*latitude, *longitude).ok_or_else(|| {
                wrong(format!(
                    "{latitude}, {longitude} lies outside of UTM, which reaches from 80° south to 84° north"
                ))
            })?),
        },
    };
    let mut positions = Vec::with_capacity(reading.fixes.all().len());
    for (t_ns, place) in reading.fixes.into_all() {
        positions.push(Position {
            t_ns: shifted(t_ns, shift_ns).map_err(wrong)?,
            place: in_zone(place, zone).map_err(wrong)?,
        });
    }
    let paper = options.compat == PositionCompat::Paper;
    // The authors' code interpolates over any gap.
    let max_gap_ns = if paper { u64::MAX } else { options.max_gap_ns };
    let track = crop::crop(Track::new(positions, max_gap_ns), options.crop, paper).map_err(wrong)?;
    let (first_ns, last_ns) = track.span_ns().unwrap_or_default();
    let steps = track
        .positions()
        .windows(2)
        .map(|w| distance_m(w[0].place, w[1].place));
    let info = TrackInfo {
        format: reading.format,
        path: path.to_owned(),
        zone: zone.map(|zone| zone.to_string()),
        positions: track.positions().len(),
        first_ns,
        last_ns,
        length_m: steps.sum(),
        passed_over: reading.passed_over,
        out_of_order,
    };
    Ok((track, info))
}

fn read(options: &Positions) -> Result<Reading, SourceError> {
    let path = options.path.as_path();
    let mut input = Input::open(path)?;
    let head = input.peek(HEAD_BYTES)?;
    if head.is_empty() {
        return Err(SourceError::malformed(
            path,
            "is empty (0 bytes); it holds no positions",
        ));
    }
    let kind = match options.kind {
        PositionKind::Auto if is_hdf5(head) => PositionKind::Applanix,
        PositionKind::Auto if nmea::detects(head) => PositionKind::Nmea,
        PositionKind::Auto => PositionKind::Csv,
        kind => kind,
    };
    match kind {
        PositionKind::Applanix => applanix::read(path, options),
        PositionKind::Nmea => nmea::read(input, options),
        PositionKind::Csv | PositionKind::Auto => csv::read(input),
    }
}

/// What a format gives: positions by its own clock.
#[derive(Debug)]
struct Reading {
    format: &'static str,
    /// Whether places are latitude and longitude in degrees; else they are metres.
    geographic: bool,
    /// Time of the first record, with or without a place, ns.
    first_ns: i64,
    fixes: Fixes,
    passed_over: u64,
}

/// Places with their times, of bounded number.
#[derive(Debug)]
struct Fixes {
    path: PathBuf,
    all: Vec<(i64, [f64; 2])>,
}

impl Fixes {
    fn new(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            all: Vec::new(),
        }
    }

    fn push(&mut self, t_ns: i64, place: [f64; 2]) -> Result<(), SourceError> {
        if self.all.len() >= MAX_POSITIONS {
            return Err(SourceError::malformed(
                &self.path,
                format!("holds more than {MAX_POSITIONS} positions; thin it out"),
            ));
        }
        self.all.push((t_ns, place));
        Ok(())
    }

    fn move_by(&mut self, ns: i64) {
        for (t_ns, _) in &mut self.all {
            *t_ns = t_ns.saturating_add(ns);
        }
    }

    fn all(&self) -> &[(i64, [f64; 2])] {
        &self.all
    }

    fn into_all(self) -> Vec<(i64, [f64; 2])> {
        self.all
    }
}

/// A day since 1970 and a time of day as one time, ns.
fn epoch(path: &Path, day: i64, time_ns: u64) -> Result<i64, SourceError> {
    let ns = day
        .checked_mul(DAY_NS)
        .zip(i64::try_from(time_ns).ok())
        .and_then(|(day, time)| day.checked_add(time));
    ns.ok_or_else(|| SourceError::malformed(path, "has a date beyond the year 2262"))
}

fn shifted(t_ns: i64, by_ns: i128) -> Result<i64, String> {
    i64::try_from(i128::from(t_ns) + by_ns).map_err(|_| {
        "has times that positions.offset or positions.first_at move beyond the year 2262".to_owned()
    })
}

fn in_zone(place: [f64; 2], zone: Option<UtmZone>) -> Result<[f64; 2], String> {
    let Some(zone) = zone else { return Ok(place) };
    let [latitude, longitude] = place;
    utm::project(latitude, longitude, zone).ok_or_else(|| {
        format!(
            "the position {latitude}, {longitude} is too far from UTM zone {zone}; correct positions.zone"
        )
    })
}

/// How many times lie before the latest so far.
fn out_of_order(fixes: &[(i64, [f64; 2])]) -> usize {
    let mut latest = i64::MIN;
    let late = fixes.iter().filter(|(t_ns, _)| {
        latest = latest.max(*t_ns);
        *t_ns < latest
    });
    late.count()
}
