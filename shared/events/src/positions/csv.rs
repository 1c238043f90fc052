//! Positions as columns of text: a time, and latitude and longitude in degrees or metres east and north.
//!
//! A header names the columns, in any order and case; further columns are passed over. Without a header a line is
//! `latitude longitude time`. Columns are separated by commas, semicolons or blanks; lines that begin with `#` are
//! comments; a line whose place is empty says that it was not known then.
//!
//! | column | names |
//! |---|---|
//! | time | `t`, `ts`, `time`, `timestamp`, `timestamps`, each also with `_s`, `_ms`, `_us` or `_ns`; `start_us` |
//! | latitude, degrees | `lat`, `latitude`, `lat_deg`, `latitude_deg` |
//! | longitude, degrees | `lon`, `lng`, `long`, `longitude`, `lon_deg`, `longitude_deg` |
//! | metres east | `east`, `easting`, `east_m`, `utm_east`, `utm_easting`, `x`, `x_m` |
//! | metres north | `north`, `northing`, `north_m`, `utm_north`, `utm_northing`, `y`, `y_m` |
//!
//! Where the name does not say the unit of time, the first time does: a decimal point or an exponent means seconds;
//! without one, from 10^17 on nanoseconds, from 10^14 on microseconds, from 10^11 on milliseconds, below that seconds.

use super::{Fixes, Reading};
use crate::formats::decimal::{DecimalError, parse_ns};
use crate::formats::lines::Lines;
use crate::{Input, SourceError};

/// Most columns in a line.
const MAX_COLUMNS: usize = 64;
/// Longest piece of a line that an error shows, characters.
const MAX_SHOWN: usize = 40;
const TIMES: [&str; 5] = ["t", "ts", "time", "timestamp", "timestamps"];
const LATITUDES: [&str; 4] = ["lat", "latitude", "lat_deg", "latitude_deg"];
const LONGITUDES: [&str; 6] = ["lon", "lng", "long", "longitude", "lon_deg", "longitude_deg"];
const EASTINGS: [&str; 7] = ["east", "easting", "east_m", "utm_east", "utm_easting", "x", "x_m"];
const NORTHINGS: [&str; 7] = [
    "north",
    "northing",
    "north_m",
    "utm_north",
    "utm_northing",
    "y",
    "y_m",
];

/// Which column is which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Columns {
    time: usize,
    /// Digits of the unit of time: 9 are seconds. None: the first time decides.
    unit_digits: Option<u32>,
    /// Latitude and longitude, or metres east and north.
    place: [usize; 2],
    geographic: bool,
}

const WITHOUT_HEADER: Columns = Columns {
    time: 2,
    unit_digits: None,
    place: [0, 1],
    geographic: true,
};

/// Reads all positions.
pub(super) fn read(input: Input) -> Result<Reading, SourceError> {
    let path = input.path().to_owned();
    let mut lines = Lines::new(input);
    let mut columns: Option<Columns> = None;
    let mut fixes = Fixes::new(&path);
    let mut first = None;
    while let Some(line) = lines.next()? {
        let number = lines.number();
        let wrong = |what: String| SourceError::Line {
            path: path.clone(),
            line: number,
            what,
        };
        let line = content(lines.bytes(line)).map_err(wrong)?;
        if line.is_empty() {
            continue;
        }
        let fields = split(line);
        let known = match columns {
            Some(columns) => columns,
            None if fields.iter().all(|f| f.parse::<f64>().is_err()) => {
                columns = Some(header(&fields).map_err(wrong)?);
                continue;
            }
            None if fields.len() == 3 => WITHOUT_HEADER,
            None => {
                let what = format!(
                    "has no header, and {} columns where \"latitude longitude time\" would be 3; write a header that \
                     names time, latitude and longitude (or east_m and north_m)",
                    fields.len()
                );
                return Err(wrong(what));
            }
        };
        let (row, known) = row(&fields, known).map_err(wrong)?;
        columns = Some(known);
        first.get_or_insert(row.0);
        if let (t_ns, Some(place)) = row {
            fixes.push(t_ns, place)?;
        }
    }
    Ok(Reading {
        format: "CSV",
        geographic: columns.is_none_or(|c| c.geographic),
        first_ns: first.unwrap_or(0),
        fixes,
        passed_over: 0,
    })
}

/// The line as text, without a byte order mark; empty if it is a comment.
fn content(line: &[u8]) -> Result<&str, String> {
    let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
    let line = std::str::from_utf8(line)
        .map_err(|_| "is not text; positions are read from NMEA, CSV, and NSAVP's HDF5 poses".to_owned())?;
    let line = line.trim();
    Ok(if line.starts_with('#') { "" } else { line })
}

fn split(line: &str) -> Vec<&str> {
    let separator = [',', ';'].into_iter().find(|c| line.contains(*c));
    let fields: Vec<&str> = match separator {
        Some(separator) => line.split(separator).take(MAX_COLUMNS).collect(),
        None => line.split_whitespace().take(MAX_COLUMNS).collect(),
    };
    fields.into_iter().map(unquoted).collect()
}

fn unquoted(field: &str) -> &str {
    let field = field.trim();
    let inside = field.strip_prefix('"').and_then(|f| f.strip_suffix('"'));
    inside.map_or(field, str::trim)
}

fn header(fields: &[&str]) -> Result<Columns, String> {
    let names: Vec<String> = fields.iter().map(|f| f.to_lowercase()).collect();
    let find = |what: &str, wanted: &dyn Fn(&str) -> bool| {
        let mut found = names
            .iter()
            .enumerate()
            .filter(|(_, name)| wanted(name))
            .map(|(at, _)| at);
        match (found.next(), found.next()) {
            (Some(_), Some(_)) => Err(format!("the header has two columns of {what}; rename one")),
            (first, _) => Ok(first),
        }
    };
    let one_of = |what: &str, wanted: &[&str]| find(what, &|name| wanted.contains(&name));
    let degrees = one_of("latitude", &LATITUDES)?.zip(one_of("longitude", &LONGITUDES)?);
    let place = match degrees {
        Some((latitude, longitude)) => Some([latitude, longitude]),
        None => one_of("metres east", &EASTINGS)?
            .zip(one_of("metres north", &NORTHINGS)?)
            .map(|(east, north)| [east, north]),
    };
    let time = find("time", &|name| unit_of(name).is_some())?;
    let (Some(place), Some(time)) = (place, time) else {
        return Err(format!(
            "the header {} lacks a column; it needs a time (t or timestamp, or with the unit: t_us), and lat and lon or \
             east_m and north_m",
            shown(&fields.join(","))
        ));
    };
    Ok(Columns {
        time,
        unit_digits: names.get(time).and_then(|name| unit_of(name)).flatten(),
        place,
        geographic: degrees.is_some(),
    })
}

/// Whether a column of this name is a time, and the digits of its unit if the name says it.
fn unit_of(name: &str) -> Option<Option<u32>> {
    if TIMES.contains(&name) {
        return Some(None);
    }
    if name == "start_us" {
        return Some(Some(3));
    }
    let (name, unit) = name.rsplit_once('_')?;
    let digits = [("s", 9), ("ms", 6), ("us", 3), ("ns", 0)];
    let (_, digits) = digits.into_iter().find(|(known, _)| *known == unit)?;
    TIMES.contains(&name).then_some(Some(digits))
}

/// Time and place of a line, and the columns with the unit of time that is known from now on.
type Row = ((i64, Option<[f64; 2]>), Columns);

fn row(fields: &[&str], columns: Columns) -> Result<Row, String> {
    let field = |at: usize| {
        let value = fields.get(at).copied();
        value.ok_or_else(|| format!("has {} columns, too few for its header", fields.len()))
    };
    let time = field(columns.time)?;
    let unit_digits = columns.unit_digits.unwrap_or_else(|| digits_of(time));
    let t_ns = parse_ns(time.as_bytes(), unit_digits).map_err(|e| {
        let why = match e {
            DecimalError::Garbage => "is not a decimal number",
            DecimalError::Negative => "is negative",
            DecimalError::TooLarge => {
                "lies beyond the year 2262; name the column with its unit, such as t_us"
            }
        };
        format!("the time {} {why}", shown(time))
    })?;
    let known = Columns {
        unit_digits: Some(unit_digits),
        ..columns
    };
    // `parse_ns` gives no more than fits.
    let t_ns = i64::try_from(t_ns).unwrap_or(i64::MAX);
    let (a, b) = (field(columns.place[0])?, field(columns.place[1])?);
    if a.is_empty() && b.is_empty() {
        return Ok(((t_ns, None), known));
    }
    let limits = if columns.geographic {
        [("latitude", 90.0), ("longitude", 180.0)]
    } else {
        [("east", 1e9), ("north", 1e9)]
    };
    let number = |text: &str, (name, largest): (&str, f64)| {
        let value = text.parse::<f64>().ok().filter(|v| v.abs() <= largest);
        value.ok_or_else(|| {
            format!(
                "{name} is {}; it must be a number from -{largest} to {largest}",
                shown(text)
            )
        })
    };
    let place = [number(a, limits[0])?, number(b, limits[1])?];
    Ok(((t_ns, Some(place)), known))
}

/// The digits of the unit that a first time speaks for.
fn digits_of(time: &str) -> u32 {
    let whole = time.parse::<u64>();
    match whole {
        Ok(100_000_000_000_000_000..) => 0,
        Ok(100_000_000_000_000..) => 3,
        Ok(100_000_000_000..) => 6,
        _ => 9,
    }
}

fn shown(text: &str) -> String {
    let mut shown: String = text.chars().take(MAX_SHOWN).collect();
    if shown.len() < text.len() {
        shown.push('…');
    }
    format!("{shown:?}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read_text(text: &[u8]) -> Result<Reading, String> {
        let input = Input::new("gps.csv", std::io::Cursor::new(text.to_vec()));
        read(input).map_err(|e| e.to_string())
    }

    #[test]
    fn headers_of_all_sorts_are_understood() {
        let expected = [
            (1_587_452_582_350_000_000, [-27.5, 152.95]),
            (1_587_452_583_350_000_000, [-27.5001, 152.9501]),
        ];
        for text in [
            "lat,lon,t\n-27.5,152.95,1587452582.35\n-27.5001,152.9501,1587452583.35\n",
            "# drive\n\"Timestamp\"; \"Longitude\" ;Latitude;speed\r\n1587452582.35;152.95;-27.5;3\r\n1587452583.35;152.9501;-27.5001;4",
            "\u{feff}t_us,lng,lat_deg\n1587452582350000,152.95,-27.5\n1587452583350000,152.9501,-27.5001\n",
            "-27.5 152.95 1.58745258235e9\n-27.5001\t152.9501  1587452583.35\n",
            "time lat lon\n1587452582350 -27.5 152.95\n1587452583350 -27.5001 152.9501\n",
            "ts_ns,lat,lon,x,y\n1587452582350000000,-27.5,152.95,1,2\n1587452583350000000,-27.5001,152.9501,3,4\n",
        ] {
            let reading = read_text(text.as_bytes()).unwrap();
            assert!(reading.geographic);
            assert_eq!(reading.fixes.all(), expected, "{text}");
            assert_eq!(reading.first_ns, expected[0].0);
        }
    }

    #[test]
    fn ticks_of_a_traverse_are_metres_some_unknown() {
        let text = "tick,start_us,end_us,east_m,north_m\n0,1000,2000,,\n1,2000,3000,5.5,-6\n";
        let reading = read_text(text.as_bytes()).unwrap();
        assert!(!reading.geographic);
        assert_eq!(reading.fixes.all(), [(2_000_000, [5.5, -6.0])]);
        assert_eq!(reading.first_ns, 1_000_000);
    }

    #[test]
    fn whole_seconds_are_seconds() {
        let reading = read_text(b"lat,lon,t\n1,2,0\n1,2,7\n").unwrap();
        let times: Vec<i64> = reading.fixes.all().iter().map(|(t, _)| *t).collect();
        assert_eq!(times, [0, 7_000_000_000]);
    }

    #[test]
    fn wrong_lines_are_named_in_one_line() {
        for (text, words) in [
            (
                &b"lat,lon\n1,2\n"[..],
                "line 1: the header \"lat,lon\" lacks a column",
            ),
            (b"t,lat,lon,latitude\n", "two columns of latitude"),
            (b"t,ts,lat,lon\n", "two columns of time"),
            (b"1,2,3,4\n", "line 1: has no header, and 4 columns"),
            (b"lat,lon,t\n1,2,3\n1,2\n", "line 3: has 2 columns, too few"),
            (
                b"lat,lon,t\n91,2,3\n",
                "line 2: latitude is \"91\"; it must be a number from -90 to 90",
            ),
            (b"lat,lon,t\n1,NaN,3\n", "longitude is \"NaN\""),
            (b"lat,lon,t\n1,,3\n", "longitude is \"\""),
            (
                b"lat,lon,t\n1,2,soon\n",
                "the time \"soon\" is not a decimal number",
            ),
            (b"lat,lon,t\n1,2,-3\n", "the time \"-3\" is negative"),
            (b"lat,lon,t_s\n1,2,15874525823500\n", "beyond the year 2262"),
            (b"east,north,t\n1,2e9,3\n", "north is \"2e9\""),
            (b"lat,lon,t\n\xff\xfe\n", "line 2: is not text"),
        ] {
            let error = read_text(text).err().unwrap_or_default();
            assert!(error.contains(words), "{words}: {error}");
            assert_eq!(error.lines().count(), 1);
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken_without_a_panic(text in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = read_text(&text);
        }
    }
}
