//! NumPy: an event per row of a `.npy` array, or four arrays t, x, y, p in an `.npz` (or one as in a `.npy` file).
//!
//! A `.npy` file holds a structured array with fields for t, x, y and p (see [`unit::NAMES`]; further fields are
//! passed over), or a plain array of shape (N, 4) with the columns t, x, y, p in this order, in C or Fortran order; (4, N)
//! is taken as its transpose. Numbers are integers, floats or booleans of any size and byte order. Polarity is 1, else
//! 0 or -1.
//!
//! The unit of times is the configuration's, or else the name's (`t_ns`), or else decided by the first time ([`unit::by_magnitude`],
//! [`unit::by_float`]).
//!
//! Format: <https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>.

mod decode;
mod header;
mod literal;
mod npz;

use super::number::Number;
use super::unit::{self, NAMES};
use crate::{BATCH_EVENTS, Input, RawEvent, Recording, SourceError, SourceInfo};
use decode::Column;
use evpr_core::plan::{Sensor, TimeUnit};
use header::{Header, Item};
use std::path::Path;

pub(in crate::formats) use header::MAGIC;

/// Rows decoded at once: they stay in the processor's cache from column to column.
const BLOCK_ROWS: usize = 2048;

/// Bytes of a file in which rows of one length follow one another.
struct Rows {
    input: Input,
    /// Where the first row begins.
    start: u64,
    row_bytes: usize,
}

/// See the module.
pub(super) struct Numpy {
    rows: Vec<Rows>,
    /// t, x, y and p, each with the rows that it stands in.
    columns: [(usize, Column); 4],
    events: u64,
    next: u64,
    unit: TimeUnit,
    unit_from: &'static str,
}

/// Where the four columns of an array stand.
struct Layout {
    /// Length of a row of each `Rows`, and where it begins after the header, bytes.
    rows: Vec<(usize, u64)>,
    columns: [(usize, Column); 4],
    events: u64,
    /// What the name of t says.
    unit: Option<TimeUnit>,
}

impl Layout {
    fn of(header: &Header) -> Result<Self, String> {
        match (&header.item, header.shape.as_slice()) {
            (Item::Fields { fields, bytes }, [events]) => {
                let column = |wanted: usize| {
                    let (name, names) = NAMES[wanted];
                    let mut hits = fields
                        .iter()
                        .filter_map(|f| unit::column(&f.name).filter(|c| c.0 == wanted).map(|c| (f, c.1)));
                    let (field, unit) = hits.next().ok_or_else(|| {
                        format!(
                            "is an array without a field {name}; name it {}",
                            names.join(" or ")
                        )
                    })?;
                    if hits.next().is_some() {
                        return Err(format!("is an array with two fields for {name}"));
                    }
                    let scalar = field.scalar.ok_or_else(|| {
                        format!("is an array whose field '{}' is not one number", field.name)
                    })?;
                    let column = Column {
                        offset: field.offset,
                        row_bytes: *bytes,
                        scalar,
                    };
                    Ok(((0, column), unit))
                };
                let (t, unit) = column(0)?;
                Ok(Self {
                    rows: vec![(*bytes, 0)],
                    columns: [t, column(1)?.0, column(2)?.0, column(3)?.0],
                    events: *events,
                    unit,
                })
            }
            (Item::Number(scalar), [n, 4]) if !header.fortran_order => {
                let row_bytes = 4 * scalar.bytes;
                let column = |i| {
                    (
                        0,
                        Column {
                            offset: i * scalar.bytes,
                            row_bytes,
                            scalar: *scalar,
                        },
                    )
                };
                Ok(Self {
                    rows: vec![(row_bytes, 0)],
                    columns: [0, 1, 2, 3].map(column),
                    events: *n,
                    unit: None,
                })
            }
            (Item::Number(scalar), [n, 4]) => Self::one_after_another(*scalar, *n),
            (Item::Number(scalar), [4, n]) if !header.fortran_order => Self::one_after_another(*scalar, *n),
            (_, shape) => {
                let shape: Vec<String> = shape.iter().map(u64::to_string).collect();
                Err(format!(
                    "is an array of shape ({}); events are a structured array of shape (N,) with fields t, x, y, p, or \
                     a plain one of shape (N, 4)",
                    shape.join(", ")
                ))
            }
        }
    }

    fn one_after_another(scalar: header::Scalar, events: u64) -> Result<Self, String> {
        let bytes = events
            .checked_mul(scalar.bytes as u64)
            .filter(|bytes| bytes.checked_mul(4).is_some())
            .ok_or("has a .npy header with a shape that no file can hold")?;
        let column = |i| {
            (
                i,
                Column {
                    offset: 0,
                    row_bytes: scalar.bytes,
                    scalar,
                },
            )
        };
        Ok(Self {
            rows: (0..4).map(|i| (scalar.bytes, i * bytes)).collect(),
            columns: [0, 1, 2, 3].map(column),
            events,
            unit: None,
        })
    }
}

impl Numpy {
    /// A `.npy` array. Where its columns stand one after another, the input must be a file.
    pub(super) fn open(mut input: Input, unit: TimeUnit) -> Result<Self, SourceError> {
        let header = Header::read(&mut input)?;
        let layout = Layout::of(&header).map_err(|what| SourceError::malformed(input.path(), what))?;
        let path = input.path().to_owned();
        let data = input.position();
        if layout.rows.len() > 1 && !input.seek(data)? {
            return Err(SourceError::malformed(
                &path,
                "is an array with its columns one after another, which is read in any order; unpack it into a file, \
                 or save it with numpy.ascontiguousarray",
            ));
        }
        let mut rows = Vec::new();
        let mut first = Some(input);
        for (row_bytes, offset) in layout.rows {
            let start = data.saturating_add(offset);
            let input = match first.take() {
                Some(input) => input,
                None => {
                    let mut input = Input::open(&path)?;
                    input.seek(start)?;
                    input
                }
            };
            rows.push(Rows {
                input,
                start,
                row_bytes,
            });
        }
        Self::start(rows, layout.columns, layout.events, (unit, layout.unit))
    }

    /// Decides the unit: by the configuration, the name of t, or the first time.
    fn start(
        rows: Vec<Rows>,
        columns: [(usize, Column); 4],
        events: u64,
        (unit, named): (TimeUnit, Option<TimeUnit>),
    ) -> Result<Self, SourceError> {
        let mut numpy = Self {
            rows,
            columns,
            events,
            next: 0,
            unit,
            unit_from: "config",
        };
        if events == 0 {
            return Err(SourceError::malformed(numpy.path(), "holds no events"));
        }
        numpy.wait_for_a_row()?;
        if let (TimeUnit::Auto, Some(named)) = (unit, named) {
            (numpy.unit, numpy.unit_from) = (named, "name");
        } else if unit == TimeUnit::Auto {
            (numpy.unit, numpy.unit_from) = match numpy.number(0, 0) {
                Some(Number::Float(t)) => unit::by_float(t),
                Some(Number::Whole(t)) => unit::by_magnitude(u64::try_from(t).unwrap_or(0)),
                None => (TimeUnit::Us, "magnitude"),
            };
        }
        Ok(numpy)
    }

    fn path(&self) -> &Path {
        self.rows.first().map_or(Path::new(""), |rows| rows.input.path())
    }

    fn scale(&self) -> u64 {
        10u64.pow(unit::digits(self.unit).unwrap_or(0))
    }

    /// Has at least one whole row of each column at hand.
    fn wait_for_a_row(&mut self) -> Result<(), SourceError> {
        for rows in &mut self.rows {
            if rows.input.peek(rows.row_bytes)?.len() < rows.row_bytes {
                let what = format!(
                    "ends after {} of the {} events that its header tells of; it is cut short",
                    self.next, self.events
                );
                return Err(SourceError::malformed(rows.input.path(), what));
            }
        }
        Ok(())
    }

    /// The rows at hand from this one on, as one of the four columns sees them.
    fn at(&self, column: usize, row: usize) -> (&[u8], Column) {
        let (rows, column) = self.columns[column];
        let here = self.rows.get(rows).map(|r| r.input.buffered());
        let rest = here.and_then(|here| here.get(row * column.row_bytes..));
        (rest.unwrap_or_default(), column)
    }

    /// The number of this column in a row that is at hand.
    fn number(&self, column: usize, row: usize) -> Option<Number> {
        let (rows, column) = self.at(column, row);
        decode::number(rows, column)
    }

    /// Decodes the rows at hand from this one on into `events`. False when one of them is not as it should be.
    fn decode(&self, row: usize, events: &mut [RawEvent]) -> bool {
        let (t, x, y, p) = (self.at(0, row), self.at(1, row), self.at(2, row), self.at(3, row));
        let mut good = decode::times(t.0, t.1, self.scale(), events);
        good &= decode::coordinates(x.0, x.1, events, |e, v| e.x = v);
        good &= decode::coordinates(y.0, y.1, events, |e, v| e.y = v);
        good & decode::polarities(p.0, p.1, events)
    }

    /// What is wrong with a row that is at hand.
    fn wrong(&self, row: usize) -> SourceError {
        let shown = |column| {
            let number = self.number(column, row);
            number.map_or_else(|| "missing".to_owned(), |n| n.to_string())
        };
        let (t, x, y) = (self.at(0, row), self.at(1, row), self.at(2, row));
        let one = &mut [RawEvent::default()];
        let what = if !decode::times(t.0, t.1, self.scale(), one) {
            format!(
                "the time {} is negative or lies beyond the year 2262; check source.time_unit",
                shown(0)
            )
        } else if !decode::coordinates(x.0, x.1, one, |_, _| ()) {
            format!("x is {}; it must be a whole number from 0", shown(1))
        } else if !decode::coordinates(y.0, y.1, one, |_, _| ()) {
            format!("y is {}; it must be a whole number from 0", shown(2))
        } else {
            format!("the polarity is {}; it must be 0 or 1 (or -1)", shown(3))
        };
        SourceError::malformed(
            self.path(),
            format!("event {} (from 0): {what}", self.next + row as u64),
        )
    }

    /// Goes to this event; false when the input cannot.
    fn go_to(&mut self, event: u64) -> Result<bool, SourceError> {
        for rows in &mut self.rows {
            let at = event
                .saturating_mul(rows.row_bytes as u64)
                .saturating_add(rows.start);
            if !rows.input.seek(at)? {
                return Ok(false);
            }
        }
        self.next = event;
        Ok(true)
    }
}

impl Recording for Numpy {
    fn sensor(&self) -> Option<Sensor> {
        None
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        while out.len() < BATCH_EVENTS && self.next < self.events {
            if out.is_empty() {
                self.wait_for_a_row()?;
            }
            let ready = self
                .rows
                .iter()
                .map(|r| r.input.buffered().len() / r.row_bytes.max(1));
            let left = usize::try_from(self.events - self.next).unwrap_or(usize::MAX);
            let count = ready
                .fold(BLOCK_ROWS.min(BATCH_EVENTS - out.len()), usize::min)
                .min(left);
            if count == 0 {
                break;
            }
            let start = out.len();
            out.resize(start + count, RawEvent::default());
            if !self.decode(0, &mut out[start..]) {
                let one = &mut [RawEvent::default()];
                let bad = (0..count).find(|row| !self.decode(*row, one)).unwrap_or(0);
                out.truncate(start + bad);
                return Err(self.wrong(bad));
            }
            for rows in &mut self.rows {
                rows.input.consume(count * rows.row_bytes);
            }
            self.next += count as u64;
        }
        if out.is_empty() {
            // What is left of a packed input is its check sum.
            for rows in &mut self.rows {
                rows.input.peek(1)?;
            }
        }
        Ok(!out.is_empty())
    }

    fn progress_permille(&self) -> u64 {
        (u128::from(self.next) * 1000 / u128::from(self.events.max(1))) as u64
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: "numpy",
            path: self.path().to_owned(),
            time_unit: unit::name(self.unit),
            time_unit_from: self.unit_from,
            events: Some(self.events),
        }
    }

    fn seek_before(&mut self, t_ns: u64) -> Result<Option<u64>, SourceError> {
        let before = self.next;
        if !self.go_to(before)? {
            return Ok(None);
        }
        // The first event that is not earlier lies in low..=high.
        let (mut low, mut high) = (0, self.events);
        while low < high {
            let middle = low + (high - low) / 2;
            self.go_to(middle)?;
            self.wait_for_a_row()?;
            let one = &mut [RawEvent::default()];
            if !self.decode(0, one) {
                return Err(self.wrong(0));
            }
            if one[0].t_ns < t_ns {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        self.go_to(low)?;
        Ok(Some(low))
    }
}
