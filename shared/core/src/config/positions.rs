//! The section `[positions]`: where the camera was, from a file beside the recording.

use super::reader::Table;
use super::schema::key;
use super::sink::At;
use super::source::SourceKind;
use super::words::{CROPS, POSITION_COMPATS, POSITION_KINDS};
use crate::plan::{
    Crop, DEFAULT_MAX_GAP_NS, PositionClock, PositionCompat, PositionKind, Positions, UtmZone,
};
use crate::time::days_since_1970;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Seconds that are added to times, either way: three centuries.
const OFFSETS_S: RangeInclusive<f64> = -9.2e9..=9.2e9;
/// Sensor times of a first record, seconds.
const FIRST_AT_S: RangeInclusive<f64> = 0.0..=9.2e9;

/// `[positions]` as written: the path may be missing.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PositionsSection {
    pub path: Option<PathBuf>,
    kind: PositionKind,
    clock: PositionClock,
    date: Option<i64>,
    zone: Option<UtmZone>,
    compat: PositionCompat,
    max_gap_ns: u64,
    pub crop: Crop,
    /// Where the crop is written.
    pub crop_at: At,
}

impl PositionsSection {
    /// These settings for a file.
    pub(super) fn of(&self, path: &Path) -> Positions {
        Positions {
            path: path.to_owned(),
            kind: self.kind,
            clock: self.clock,
            date: self.date,
            zone: self.zone,
            compat: self.compat,
            max_gap_ns: self.max_gap_ns,
            crop: self.crop,
        }
    }
}

/// `[positions]`, beside a source of this kind, if that is known.
pub(super) fn positions(table: Table<'_>, source: Option<SourceKind>) -> Option<PositionsSection> {
    let path = table.read_optional(
        key(
            "path",
            "path",
            None,
            "The file of positions that belongs to source.path: NMEA, CSV, or NSAVP's poses. `--positions` takes \
             precedence.",
        ),
        |v| match source {
            Some(SourceKind::Street) => {
                v.refuse("has no effect with source.kind = \"street\", which knows where it is; remove it")
            }
            _ => super::source::path(v, "events.nmea"),
        },
    );
    let kind = table.read(
        key(
            "kind",
            "\"auto\", \"nmea\", \"csv\" or \"applanix\"",
            Some("\"auto\""),
            "Its format; auto: known by its content.",
        ),
        PositionKind::Auto,
        |v| v.word(&POSITION_KINDS),
    );
    let offset_ns = table.read_optional(
        key(
            "offset",
            "number of seconds",
            Some("0.0"),
            "Seconds added to the file's times to give sensor times: positive where the sensor's clock is ahead.",
        ),
        |v| v.number(OFFSETS_S).map(nanoseconds),
    );
    let offset_given = matches!(offset_ns, None | Some(Some(_)));
    let first_at_ns = table.read_optional(
        key(
            "first_at",
            "number of seconds",
            None,
            "Instead of offset: the sensor time of the file's first record, seconds.",
        ),
        |v| {
            if offset_given {
                return v.refuse("contradicts offset; write one of them");
            }
            v.number(FIRST_AT_S).map(nanoseconds)
        },
    );
    let date = table.read_optional(
        key(
            "date",
            "date, such as \"2020-04-21\"",
            None,
            "Day (UTC) of the first sentence of an NMEA file that does not say it.",
        ),
        |v| {
            let text = v.text("a date in quotes, such as \"2020-04-21\"")?;
            v.accept(parse_date(text))
        },
    );
    let zone = table.read_optional(
        key(
            "zone",
            "UTM zone, such as \"56S\"",
            None,
            "Zone of UTM for the metres, with N or S for the hemisphere. That of the first position when not given.",
        ),
        |v| {
            let text = v.text("a zone in quotes, such as \"56S\"")?;
            v.accept(parse_zone(text))
        },
    );
    let compat = table.read(
        key(
            "compat",
            "\"none\" or \"paper\"",
            Some("\"none\""),
            "paper: as in the authors' code. NMEA in whole seconds and thinned to 0.0001 degrees, poses as earth-centred \
             x and y, no limit of gaps.",
        ),
        PositionCompat::None,
        |v| v.word(&POSITION_COMPATS),
    );
    let max_gap_ns = table.read(
        key(
            "max_gap",
            "duration",
            Some("\"5s\""),
            "Between positions further apart in time nothing is known.",
        ),
        DEFAULT_MAX_GAP_NS,
        |v| v.duration_ns(),
    );
    let mut crop_at = table.below("crop", table.at.offset);
    let crop = table.read(
        key(
            "crop",
            "\"none\", \"track\", \"first_loop\" or \"first_motion\"",
            Some("\"none\""),
            "Part of the recording that is used: all, where positions are known, the first loop, or from the first \
             motion on. Events outside of it are left out.",
        ),
        Crop::None,
        |v| {
            crop_at = v.at.clone();
            v.word(&CROPS)
        },
    );
    table.close();
    Some(PositionsSection {
        path: path?,
        kind: kind?,
        clock: match (first_at_ns?, offset_ns?) {
            (Some(ns), _) => PositionClock::FirstAt(ns.unsigned_abs()),
            (None, offset) => PositionClock::Offset(offset.unwrap_or(0)),
        },
        date: date?,
        zone: zone?,
        compat: compat?,
        max_gap_ns: max_gap_ns?,
        crop: crop?,
        crop_at,
    })
}

/// Seconds as ns, to the microsecond, which is what a number of today's seconds holds; those that are read here fit.
fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e6).round() as i64 * 1_000
}

/// Days since 1970-01-01 of a date such as `2020-04-21`.
fn parse_date(text: &str) -> Result<i64, String> {
    let fields: Vec<Option<i64>> = text.split('-').map(|f| f.parse().ok()).collect();
    let days = match fields.as_slice() {
        [Some(year), Some(month), Some(day)] if *year >= 1970 => days_since_1970(*year, *month, *day),
        _ => None,
    };
    days.ok_or_else(|| format!("\"{text}\" is not a date; write year, month and day, such as \"2020-04-21\""))
}

/// A zone such as `56S`.
///
/// # Errors
/// What is wrong and what to write instead.
pub fn parse_zone(text: &str) -> Result<UtmZone, String> {
    let help =
        || format!("\"{text}\" is not a zone of UTM; write 1 to 60 and N or S (hemisphere), such as \"56S\"");
    let (number, south) = match (text.strip_suffix('S'), text.strip_suffix('N')) {
        (Some(number), _) => (number, true),
        (_, Some(number)) => (number, false),
        _ => return Err(help()),
    };
    let number = number
        .parse()
        .ok()
        .filter(|n| (1..=60).contains(n))
        .ok_or_else(help)?;
    Ok(UtmZone { number, south })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zones_and_dates_are_read() {
        let zone = parse_zone("56S").unwrap();
        assert_eq!(
            (zone.number, zone.south, zone.to_string()),
            (56, true, "56S".to_owned())
        );
        for bad in ["", "S", "0N", "61S", "56", "56K", "56s", "-5N"] {
            assert!(parse_zone(bad).unwrap_err().contains("such as \"56S\""), "{bad}");
        }
        assert_eq!(parse_date("2020-04-21"), Ok(18_373));
        for bad in ["", "2020", "21.4.2020", "2020-02-30", "1969-12-31", "2020-4-21-1"] {
            assert!(parse_date(bad).is_err(), "{bad}");
        }
    }
}
