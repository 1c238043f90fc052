//! Text and CSV: an event per line, `t x y p`, separated by blanks or commas.
//!
//! Optional, in this order: a line `width height`; a header that names the columns in any order
//! (t | timestamp | ts | time, x, y, p | pol | polarity | on, and the like; further columns are passed over). Lines
//! that begin with `#` are comments. Polarity is 1, true or ON, else 0, -1, false or OFF. Without a header there are exactly
//! four columns.
//!
//! Times are read as exact decimals. Their unit is the configuration's, or else decided by the first time: a decimal
//! point or an exponent means seconds; without one, its size decides (see `times`).

use super::decimal::{DecimalError, parse_ns};
use super::lines::Lines;
use super::unit::{self, NAMES, digits};
use crate::{BATCH_EVENTS, Input, RawEvent, Recording, SourceError, SourceInfo};
use evpr_core::plan::{Sensor, TimeUnit};

/// Most columns in a line.
const MAX_COLUMNS: usize = 32;
/// Longest piece of a line that an error shows, characters.
const MAX_SHOWN: usize = 40;

/// Which column is which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Columns {
    count: usize,
    t: usize,
    x: usize,
    y: usize,
    p: usize,
}

/// See the module.
pub(super) struct Text {
    lines: Lines,
    columns: Columns,
    unit: TimeUnit,
    unit_from: &'static str,
    sensor: Option<Sensor>,
}

impl Text {
    pub(super) fn open(input: Input, unit: TimeUnit) -> Result<Self, SourceError> {
        let columns = Columns {
            count: 4,
            t: 0,
            x: 1,
            y: 2,
            p: 3,
        };
        let mut text = Self {
            lines: Lines::new(input),
            columns,
            unit,
            unit_from: "config",
            sensor: None,
        };
        text.read_start()?;
        Ok(text)
    }

    /// Reads what stands before the first event, and decides the unit by that.
    fn read_start(&mut self) -> Result<(), SourceError> {
        let (mut sized, mut named) = (false, false);
        while let Some(line) = self.lines.next()? {
            let line = content(self.lines.bytes(line));
            let mut fields = [&[][..]; MAX_COLUMNS];
            let outcome = split(line, &mut fields).and_then(|count| {
                let fields = &fields[..count];
                match fields {
                    [] => Ok(Start::Nothing),
                    [width, height] if !sized && !named => size(width, height).map(Start::Size),
                    [first, ..] if !named && is_name(first) => header(fields).map(Start::Header),
                    _ => {
                        let event = event(fields, self.columns, digits(self.unit).unwrap_or(0));
                        let t = fields.get(self.columns.t).copied().unwrap_or_default();
                        event.map(|_| Start::Event(by_first_time(t)))
                    }
                }
            });
            match outcome.map_err(|what| self.wrong(what))? {
                Start::Nothing => {}
                Start::Size(sensor) => {
                    self.sensor = Some(sensor);
                    sized = true;
                }
                Start::Header(columns) => {
                    self.columns = columns;
                    named = true;
                }
                Start::Event((unit, from)) => {
                    if self.unit == TimeUnit::Auto {
                        (self.unit, self.unit_from) = (unit, from);
                    }
                    self.lines.unread();
                    return Ok(());
                }
            }
        }
        Err(SourceError::malformed(
            self.lines.input().path(),
            "holds no events",
        ))
    }

    /// What is wrong with the line that was read last.
    fn wrong(&self, what: String) -> SourceError {
        SourceError::Line {
            path: self.lines.input().path().to_owned(),
            line: self.lines.number(),
            what,
        }
    }
}

/// What a line before the first event can be.
enum Start {
    Nothing,
    Size(Sensor),
    Header(Columns),
    Event((TimeUnit, &'static str)),
}

/// The line without a byte order mark; nothing if it is a comment.
fn content(line: &[u8]) -> &[u8] {
    let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
    match line.iter().find(|b| !b.is_ascii_whitespace()) {
        Some(b'#') => &[],
        _ => line,
    }
}

/// Splits a line at blanks or commas; blanks around a comma belong to it.
#[inline]
fn split<'a>(line: &'a [u8], fields: &mut [&'a [u8]; MAX_COLUMNS]) -> Result<usize, String> {
    let blank = |b: u8| b == b' ' || b == b'\t';
    let (mut at, mut count) = (0, 0);
    let skip_blanks = |at: &mut usize| {
        while line.get(*at).is_some_and(|b| blank(*b)) {
            *at += 1;
        }
    };
    skip_blanks(&mut at);
    while at < line.len() {
        let start = at;
        while line.get(at).is_some_and(|b| !blank(*b) && *b != b',') {
            at += 1;
        }
        let Some(slot) = fields.get_mut(count) else {
            return Err(format!("has more than {MAX_COLUMNS} columns: {}", shown(line)));
        };
        *slot = &line[start..at];
        count += 1;
        skip_blanks(&mut at);
        if line.get(at) == Some(&b',') {
            at += 1;
            skip_blanks(&mut at);
        }
    }
    Ok(count)
}

/// A field without the quotes that a header may have.
fn unquoted(field: &[u8]) -> &[u8] {
    field
        .strip_prefix(b"\"")
        .and_then(|f| f.strip_suffix(b"\""))
        .unwrap_or(field)
}

/// True where a header begins: with a word that no number begins with.
fn is_name(field: &[u8]) -> bool {
    let field = unquoted(field);
    let number_words: [&[u8]; 3] = [b"nan", b"inf", b"infinity"];
    field.first().is_some_and(u8::is_ascii_alphabetic)
        && !number_words.iter().any(|w| field.eq_ignore_ascii_case(w))
}

fn header(fields: &[&[u8]]) -> Result<Columns, String> {
    let mut places = [0; 4];
    for ((column, names), place) in NAMES.iter().zip(&mut places) {
        let found = |field: &&[u8]| {
            let field = unquoted(field);
            names.iter().any(|n| field.eq_ignore_ascii_case(n.as_bytes()))
        };
        let mut hits = fields
            .iter()
            .enumerate()
            .filter(|(_, f)| found(f))
            .map(|(i, _)| i);
        *place = hits.next().ok_or_else(|| {
            format!(
                "the header {} has no column {column}; name it {}",
                shown(&fields.join(&b' ')),
                names.join(" or ")
            )
        })?;
        if hits.next().is_some() {
            return Err(format!(
                "the header {} has two columns {column}",
                shown(&fields.join(&b' '))
            ));
        }
    }
    let [t, x, y, p] = places;
    Ok(Columns {
        count: fields.len(),
        t,
        x,
        y,
        p,
    })
}

fn size(width: &[u8], height: &[u8]) -> Result<Sensor, String> {
    let side = |field: &[u8]| {
        let value = whole(field).filter(|v| (1..=65_535).contains(v));
        value.map(|v| v as usize).ok_or_else(|| {
            format!(
                "{} is not a side of a sensor; a line of two numbers is its width and height, 1 to 65535",
                shown(field)
            )
        })
    };
    Ok(Sensor {
        height: side(height)?,
        width: side(width)?,
    })
}

/// A whole number; what is too large for `u64` counts as its largest.
#[inline]
fn whole(field: &[u8]) -> Option<u64> {
    let digit = |n: u64, b: &u8| {
        b.is_ascii_digit()
            .then(|| n.saturating_mul(10).saturating_add(u64::from(b - b'0')))
    };
    if field.is_empty() {
        None
    } else {
        field.iter().try_fold(0, digit)
    }
}

/// One event of a line's fields.
#[inline]
fn event(fields: &[&[u8]], columns: Columns, unit_digits: u32) -> Result<RawEvent, String> {
    if fields.len() != columns.count {
        return Err(format!(
            "has {} columns instead of {}: {}",
            fields.len(),
            columns.count,
            shown(&fields.join(&b' '))
        ));
    }
    let field = |at: usize| fields.get(at).copied().unwrap_or_default();
    let time = field(columns.t);
    let t_ns = parse_ns(time, unit_digits).map_err(|e| {
        let why = match e {
            DecimalError::Garbage => "is not a decimal number; correct the line or leave it out",
            DecimalError::Negative => "is negative",
            DecimalError::TooLarge => "lies beyond the year 2262; check source.time_unit",
        };
        format!("the time {} {why}", shown(time))
    })?;
    let coordinate = |at: usize, name: &str| {
        whole(field(at))
            .map(|v| u16::try_from(v).unwrap_or(u16::MAX))
            .ok_or_else(|| format!("{name} is {}; it must be a whole number from 0", shown(field(at))))
    };
    let (x, y) = (coordinate(columns.x, "x")?, coordinate(columns.y, "y")?);
    let on = match field(columns.p) {
        b"1" | b"+1" => true,
        b"0" | b"-1" => false,
        word if word.eq_ignore_ascii_case(b"true") || word.eq_ignore_ascii_case(b"on") => true,
        word if word.eq_ignore_ascii_case(b"false") || word.eq_ignore_ascii_case(b"off") => false,
        other => {
            return Err(format!(
                "the polarity is {}; it must be 0 or 1 (or -1)",
                shown(other)
            ));
        }
    };
    Ok(RawEvent { t_ns, x, y, on })
}

/// The unit that a first time speaks for, and why.
fn by_first_time(t: &[u8]) -> (TimeUnit, &'static str) {
    if t.iter().any(|b| matches!(b, b'.' | b'e' | b'E')) {
        return (TimeUnit::S, "decimal point");
    }
    unit::by_magnitude(whole(t).unwrap_or(0))
}

/// A piece of the file for an error: in quotes, printable, short.
fn shown(text: &[u8]) -> String {
    let text = String::from_utf8_lossy(&text[..text.len().min(4 * MAX_SHOWN)]);
    let mut short: String = text
        .chars()
        .take(MAX_SHOWN)
        .flat_map(char::escape_debug)
        .collect();
    if text.chars().count() > MAX_SHOWN {
        short.push('…');
    }
    format!("\"{short}\"")
}

impl Recording for Text {
    fn sensor(&self) -> Option<Sensor> {
        self.sensor
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        let unit_digits = digits(self.unit).unwrap_or(0);
        let columns = self.columns;
        while out.len() < BATCH_EVENTS && (out.is_empty() || self.lines.is_ready()) {
            let Some(line) = self.lines.next()? else { break };
            let line = self.lines.bytes(line);
            let mut fields = [&[][..]; MAX_COLUMNS];
            let parsed = split(line, &mut fields).and_then(|count| match fields.get(..count) {
                None | Some([]) => Ok(None),
                Some([first, ..]) if first.first() == Some(&b'#') => Ok(None),
                Some(fields) => event(fields, columns, unit_digits).map(Some),
            });
            match parsed {
                Ok(Some(event)) => out.push(event),
                Ok(None) => {}
                Err(what) => return Err(self.wrong(what)),
            }
        }
        Ok(!out.is_empty())
    }

    fn progress_permille(&self) -> u64 {
        self.lines.progress_permille()
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: "text",
            path: self.lines.input().path().to_owned(),
            time_unit: unit::name(self.unit),
            time_unit_from: self.unit_from,
            events: None,
        }
    }
}
