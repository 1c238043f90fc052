//! NMEA 0183: the sentences of a GNSS receiver, as text.
//!
//! Positions are those of RMC, GGA and GLL of any talker, where the receiver says that they are valid. Their time of
//! day is UTC; the day is that of RMC or ZDA, or of the caller, and goes on at midnight. Sentences of other types are
//! passed over unseen; lines that are no sentence, or whose checksum is wrong, are counted.
//!
//! Formats: <https://gpsd.gitlab.io/gpsd/NMEA.html>.

use super::{Fixes, Reading, epoch};
use crate::formats::lines::Lines;
use crate::{Input, SourceError};
use evpr_core::plan::{PositionClock, PositionCompat, Positions};
use evpr_core::time::days_since_1970;

const SECOND_NS: u64 = 1_000_000_000;
const DAY_NS: u64 = 86_400 * SECOND_NS;
/// Times of day that go back by more than this have passed midnight; by less, the sentence is late.
const MIDNIGHT_NS: u64 = DAY_NS / 2;
/// The authors' code leaves out what lies closer than this to the position before, degrees.
const PAPER_DEGREES: f64 = 1e-4;

/// Whether a file begins as NMEA does.
pub(super) fn detects(head: &[u8]) -> bool {
    let mut lines = head.split(|b| *b == b'\n').take(10);
    lines.any(|line| matches!(Sentence::parse(line), Parsed::Sentence(_) | Parsed::Other))
}

/// What a sentence says.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sentence {
    /// Time of day, ns.
    time_ns: u64,
    /// Days since 1970-01-01.
    day: Option<i64>,
    /// Latitude and longitude, degrees.
    place: Option<[f64; 2]>,
    /// Whether the receiver stands by the place.
    valid: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Parsed {
    Sentence(Sentence),
    /// Of a type that has neither time nor place, or without them.
    Other,
    /// No sentence.
    Garbage,
}

impl Sentence {
    fn parse(line: &[u8]) -> Parsed {
        Self::try_parse(line).unwrap_or(Parsed::Garbage)
    }

    fn try_parse(line: &[u8]) -> Option<Parsed> {
        // Some loggers write their own time before the sentence.
        let start = line.iter().position(|b| *b == b'$')? + 1;
        let line = line.get(start..)?.trim_ascii_end();
        let body = match line.iter().position(|b| *b == b'*') {
            None => line,
            Some(star) => {
                let (body, sum) = (line.get(..star)?, line.get(star + 1..star + 3)?);
                let sum = u8::from_str_radix(std::str::from_utf8(sum).ok()?, 16).ok()?;
                (body.iter().fold(0, |x, b| x ^ b) == sum).then_some(body)?
            }
        };
        let body = std::str::from_utf8(body).ok()?;
        let fields: Vec<&str> = body.split(',').take(32).collect();
        let id = *fields.first()?;
        if !id.bytes().all(|b| b.is_ascii_alphanumeric()) || !(3..=8).contains(&id.len()) {
            return None;
        }
        let field = |at: usize| fields.get(at).copied().unwrap_or_default();
        // A proprietary sentence may end in the same letters.
        let kind = if id.len() == 5 && !id.starts_with('P') {
            &id[2..]
        } else {
            ""
        };
        let (time, day, place_at, valid) = match kind {
            "RMC" => (field(1), date(field(9))?, Some(3), field(2) == "A"),
            "GGA" => (field(1), None, Some(2), !matches!(field(6), "" | "0")),
            "GLL" => (field(5), None, Some(1), field(6) == "A"),
            "ZDA" => (field(1), full_date([field(4), field(3), field(2)])?, None, false),
            _ => return Some(Parsed::Other),
        };
        let place = match place_at {
            Some(at) => place([0, 1, 2, 3].map(|i| field(at + i)))?,
            None => None,
        };
        if time.is_empty() {
            return Some(Parsed::Other);
        }
        Some(Parsed::Sentence(Self {
            time_ns: time_of_day(time)?,
            day,
            place,
            valid,
        }))
    }
}

/// `hhmmss`, with or without a fraction, as ns since midnight.
fn time_of_day(text: &str) -> Option<u64> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    if whole.len() != 6 || !digits(whole) || !digits(fraction) {
        return None;
    }
    let two = |at: usize| whole.get(at..at + 2)?.parse::<u64>().ok();
    let (hours, minutes, seconds) = (two(0)?, two(2)?, two(4)?);
    // 60 is a leap second.
    if hours > 23 || minutes > 59 || seconds > 60 {
        return None;
    }
    let fraction_ns = fraction
        .bytes()
        .chain(std::iter::repeat(b'0'))
        .take(9)
        .fold(0, |ns, b| ns * 10 + u64::from(b - b'0'));
    Some(((hours * 60 + minutes) * 60 + seconds) * SECOND_NS + fraction_ns)
}

/// `ddmmyy`, years 1980 to 2079; nothing when the field is empty.
fn date(text: &str) -> Option<Option<i64>> {
    if text.is_empty() {
        return Some(None);
    }
    if text.len() != 6 {
        return None;
    }
    let two = |at: usize| text.get(at..at + 2)?.parse::<i64>().ok();
    let (day, month, year) = (two(0)?, two(2)?, two(4)?);
    let year = if year < 80 { 2000 + year } else { 1900 + year };
    days_since_1970(year, month, day).map(Some)
}

/// Year, month and day in fields of their own; nothing when they are empty.
fn full_date(fields: [&str; 3]) -> Option<Option<i64>> {
    if fields.iter().all(|f| f.is_empty()) {
        return Some(None);
    }
    let [year, month, day] = fields.map(|f| f.parse::<i64>().ok());
    days_since_1970(year?, month?, day?).map(Some)
}

/// Latitude and longitude, each with its hemisphere; nothing when the fields are empty.
fn place([latitude, north, longitude, east]: [&str; 4]) -> Option<Option<[f64; 2]>> {
    if latitude.is_empty() || longitude.is_empty() {
        return Some(None);
    }
    let latitude = degrees(latitude, 90.0)?;
    let longitude = degrees(longitude, 180.0)?;
    let signed = |value: f64, letter: &str, plus: &str, minus: &str| match letter {
        _ if letter == plus => Some(value),
        _ if letter == minus => Some(-value),
        _ => None,
    };
    Some(Some([
        signed(latitude, north, "N", "S")?,
        signed(longitude, east, "E", "W")?,
    ]))
}

/// `ddmm.mmmm`: degrees and minutes in one number.
fn degrees(text: &str, largest: f64) -> Option<f64> {
    if !text.bytes().all(|b| b.is_ascii_digit() || b == b'.') {
        return None;
    }
    let value = text.parse::<f64>().ok()?;
    let whole = (value / 100.0).trunc();
    let minutes = value - whole * 100.0;
    let degrees = whole + minutes / 60.0;
    (minutes < 60.0 && degrees <= largest).then_some(degrees)
}

/// The day of each sentence, counted from the first one's, and on from midnight to midnight.
#[derive(Debug, Default)]
struct Calendar {
    day: i64,
    /// Whether `day` is days since 1970, not since the first sentence.
    known: bool,
    last_ns: Option<u64>,
}

impl Calendar {
    /// The day of this sentence, and by how many days those before it have to be moved now that the date is known.
    fn place(&mut self, sentence: &Sentence) -> (i64, i64) {
        let passed_midnight = self
            .last_ns
            .is_some_and(|last| last > sentence.time_ns.saturating_add(MIDNIGHT_NS));
        // A late sentence of yesterday does not turn the day back.
        if passed_midnight {
            self.day += 1;
        }
        self.last_ns = Some(sentence.time_ns);
        let mut moved = 0;
        if let Some(day) = sentence.day {
            if !self.known {
                moved = day - self.day;
            }
            (self.day, self.known) = (day, true);
        }
        (self.day, moved)
    }
}

/// Reads all positions.
pub(super) fn read(input: Input, options: &Positions) -> Result<Reading, SourceError> {
    let paper = options.compat == PositionCompat::Paper;
    let path = input.path().to_owned();
    let mut lines = Lines::new(input);
    let mut fixes = Fixes::new(&path);
    let mut calendar = Calendar::default();
    let (mut first, mut passed_over, mut last_place) = (None, 0, [0.0; 2]);
    while let Some(line) = lines.next()? {
        let mut sentence = match Sentence::parse(lines.bytes(line.clone())) {
            Parsed::Sentence(sentence) => sentence,
            Parsed::Other => continue,
            Parsed::Garbage => {
                passed_over += u64::from(!lines.bytes(line).trim_ascii().is_empty());
                continue;
            }
        };
        if paper {
            sentence.time_ns -= sentence.time_ns % SECOND_NS;
        }
        let (day, moved) = calendar.place(&sentence);
        if moved != 0 {
            let moved_ns = epoch(&path, moved, 0)?;
            fixes.move_by(moved_ns);
            first = first.map(|ns: i64| ns.saturating_add(moved_ns));
        }
        let t_ns = epoch(&path, day, sentence.time_ns)?;
        first.get_or_insert(t_ns);
        match sentence.place {
            Some(place) if paper => {
                let apart = [0, 1].map(|i| place[i] - last_place[i]);
                let moved = apart[0].hypot(apart[1]) > PAPER_DEGREES;
                if moved && apart.iter().all(|v| *v != 0.0) && place.iter().all(|v| *v != 0.0) {
                    fixes.push(t_ns, place)?;
                    last_place = place;
                }
            }
            Some(place) if sentence.valid => fixes.push(t_ns, place)?,
            _ => {}
        }
    }
    let undated = !calendar.known && !fixes.all().is_empty();
    if undated && matches!(options.clock, PositionClock::Offset(_)) {
        let Some(date) = options.date else {
            return Err(SourceError::malformed(
                &path,
                "says the time of day but no date (it has no RMC or ZDA sentence); write positions.date, such as \
                 \"2020-04-21\", or positions.first_at",
            ));
        };
        let moved_ns = epoch(&path, date, 0)?;
        fixes.move_by(moved_ns);
        first = first.map(|ns| ns.saturating_add(moved_ns));
    }
    Ok(Reading {
        format: "NMEA 0183",
        geographic: true,
        first_ns: first.unwrap_or(0),
        fixes,
        passed_over,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sum(body: &str) -> String {
        format!("${body}*{:02X}\n", body.bytes().fold(0, |x, b| x ^ b))
    }

    fn read_text(text: &str, options: &Positions) -> Result<Reading, String> {
        let input = Input::new("drive.nmea", std::io::Cursor::new(text.to_owned().into_bytes()));
        read(input, options).map_err(|e| e.to_string())
    }

    fn times(text: &str, options: &Positions) -> Vec<i64> {
        let reading = read_text(text, options).unwrap();
        reading.fixes.all().iter().map(|(t_ns, _)| *t_ns).collect()
    }

    const OPTIONS: fn() -> Positions = || Positions::file("drive.nmea");

    #[test]
    fn published_sentences_are_understood() {
        // 123519 on 23 March 1994, 48°07.038' N, 11°31.000' E (gpsd's description of RMC and GGA).
        for (line, day) in [
            (
                "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n",
                Some(8_847),
            ),
            (
                "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47",
                None,
            ),
            ("$GNGLL,4807.038,N,01131.000,E,123519,A", None),
        ] {
            let expected = Sentence {
                time_ns: (12 * 3_600 + 35 * 60 + 19) * SECOND_NS,
                day,
                place: Some([48.0 + 7.038 / 60.0, 11.0 + 31.0 / 60.0]),
                valid: true,
            };
            let Parsed::Sentence(found) = Sentence::parse(line.as_bytes()) else {
                panic!("{line}");
            };
            let apart = std::iter::zip(found.place.unwrap(), expected.place.unwrap());
            assert!(apart.into_iter().all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
            assert_eq!(
                (found.time_ns, found.day, found.valid),
                (expected.time_ns, expected.day, true)
            );
        }
        let southwest = "$GPRMC,055056.25,V,3348.10000,S,07407.6789,W,,,070620,,";
        let Parsed::Sentence(found) = Sentence::parse(southwest.as_bytes()) else {
            panic!()
        };
        assert_eq!(found.place.map(|p| p.map(|v| v.round())), Some([-34.0, -74.0]));
        assert_eq!((found.valid, found.time_ns % SECOND_NS), (false, 250_000_000));
        let zda = Sentence::parse(sum("GPZDA,201530.00,04,07,2002,00,00").as_bytes());
        assert!(matches!(
            zda,
            Parsed::Sentence(Sentence {
                day: Some(11_872),
                place: None,
                ..
            })
        ));
    }

    #[test]
    fn other_sentences_and_garbage_are_told_apart() {
        for other in [
            "$GPGSV,3,1,11,03,03,111,00,04,15,270,00*71",
            "$GPVTG,054.7,T,034.4,M,005.5,N,010.2,K",
            "$PGRMC,123519,A,4807.038,N,01131.000,E",
            "$GPGGA,,,,,,0,,,,,,,,",
        ] {
            let body = other.split('*').next().unwrap();
            assert_eq!(Sentence::parse(body.as_bytes()), Parsed::Other, "{other}");
        }
        for garbage in [
            "",
            "hello",
            "$",
            "$GPRMC*",
            "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6B",
            "$GPRMC,243519,A,4807.038,N,01131.000,E,022.4,084.4,230394",
            "$GPRMC,123519,A,4860.038,N,01131.000,E,022.4,084.4,230394",
            "$GPRMC,123519,A,9107.038,N,01131.000,E,022.4,084.4,230394",
            "$GPRMC,123519,A,4807.038,X,01131.000,E,022.4,084.4,230394",
            "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,310294",
            "$GPGGA,12351,4807.038,N,01131.000,E,1",
            "$GPGGA,123519,-807.038,N,01131.000,E,1",
        ] {
            assert_eq!(Sentence::parse(garbage.as_bytes()), Parsed::Garbage, "{garbage}");
        }
        assert!(detects(b"\n# log\n$GPGSV,3,1,11\n") && !detects(b"lat,lon,t\n1,2,3\n"));
    }

    #[test]
    fn midnight_is_passed_in_either_order_of_sentences() {
        let rmc = |time: &str, date: &str| sum(&format!("GPRMC,{time},A,2730.000,S,15257.000,E,,,{date},,"));
        let gga = |time: &str| sum(&format!("GPGGA,{time},2730.000,S,15257.000,E,1,,,,,,,,"));
        let day: i64 = 18_373 * DAY_NS as i64; // 2020-04-21
        let second = SECOND_NS as i64;
        let expected = [day - 2 * second, day - second, day, day + second];
        let dated = [
            rmc("235958", "200420"),
            gga("235959"),
            gga("000000"),
            rmc("000001", "210420"),
        ]
        .concat();
        assert_eq!(times(&dated, &OPTIONS()), expected);
        let date_after = [
            gga("235958"),
            gga("235959"),
            rmc("000000", "210420"),
            gga("000001"),
        ]
        .concat();
        assert_eq!(times(&date_after, &OPTIONS()), expected);
        let undated = ["235958", "235959", "000000", "000001"].map(gga).concat();
        let given = Positions {
            date: Some(18_372),
            ..OPTIONS()
        };
        assert_eq!(times(&undated, &given), expected);
        let error = read_text(&undated, &OPTIONS()).unwrap_err();
        assert!(error.contains("no date") && error.lines().count() == 1, "{error}");
        let anchored = Positions {
            clock: PositionClock::FirstAt(7),
            ..OPTIONS()
        };
        let reading = read_text(&undated, &anchored).unwrap();
        let since_first: Vec<i64> = reading
            .fixes
            .all()
            .iter()
            .map(|(t, _)| t - reading.first_ns)
            .collect();
        assert_eq!(since_first, [0, 1, 2, 3].map(|s| s * second));
    }

    #[test]
    fn places_without_a_fix_and_broken_lines_are_not_used() {
        let text = [
            sum("GPRMC,100000,V,,,,,,,210420,,"),
            "rubbish\n\n".to_owned(),
            sum("GPGGA,100001,2730.000,S,15257.000,E,0,,,,,,,,"),
            sum("GPGGA,100002,2730.000,S,15257.000,E,1,,,,,,,,"),
        ]
        .concat();
        let reading = read_text(&text, &OPTIONS()).unwrap();
        assert_eq!((reading.fixes.all().len(), reading.passed_over), (1, 1));
        assert_eq!(reading.fixes.all()[0].0 - reading.first_ns, 2 * SECOND_NS as i64);
    }

    #[test]
    fn as_in_the_paper_near_places_are_left_out_and_seconds_are_whole() {
        let gga = |time: &str, latitude: &str, longitude: &str| {
            sum(&format!("GPGGA,{time},{latitude},S,{longitude},E,1,,,,,,,,"))
        };
        let text = [
            sum("GPRMC,100000.9,V,,,,,,,210420,,"),
            gga("100001.9", "2730.0000", "15257.0000"),
            // 0.00005 degrees each: too near.
            gga("100002.9", "2730.0030", "15257.0030"),
            // Far enough, but the longitude has not changed.
            gga("100003.9", "2730.0300", "15257.0000"),
            gga("100004.9", "2730.0300", "15257.0001"),
        ]
        .concat();
        let paper = Positions {
            compat: PositionCompat::Paper,
            ..OPTIONS()
        };
        let reading = read_text(&text, &paper).unwrap();
        let seconds = |t: i64| (t - reading.first_ns) / SECOND_NS as i64;
        let kept: Vec<i64> = reading.fixes.all().iter().map(|(t, _)| seconds(*t)).collect();
        assert_eq!(kept, [1, 4]);
        assert_eq!(reading.fixes.all()[0].0 % SECOND_NS as i64, 0);
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken_without_a_panic(
            lines in proptest::collection::vec("(\\$G[PN](RMC|GGA|GLL|ZDA))?[0-9A-Z,.*\\-]{0,60}", 0..20),
        ) {
            let _ = read_text(&lines.join("\n"), &OPTIONS());
        }

        #[test]
        fn places_come_back_to_a_millimetre(latitude in -89.9..89.9f64, longitude in -179.9..179.9f64) {
            let write = |v: f64, width| format!("{:0width$.0}{:010.7}", v.abs().trunc(), v.abs().fract() * 60.0);
            let (north, east) = (if latitude < 0.0 { "S" } else { "N" }, if longitude < 0.0 { "W" } else { "E" });
            let fields = [&write(latitude, 2), north, &write(longitude, 3), east];
            // Minutes that are rounded up to 60 are refused, as they should be.
            if let Some(Some(found)) = place(fields) {
                prop_assert!((found[0] - latitude).abs() < 1e-8 && (found[1] - longitude).abs() < 1e-8);
            }
        }
    }
}
