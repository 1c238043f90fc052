//! Parquet: columns called t, x, y and p (see [`unit::NAMES`]; others are passed over) of integers, floating-point
//! numbers or booleans, as Brisbane-Event-VPR is distributed. Polarity is 1, else 0 or -1.
//!
//! The unit of times is that of the column's type where it is a `TIMESTAMP` or `TIME`, else the configuration's, else
//! the name's (`t_ns`), else decided by the first time ([`unit::by_magnitude`], [`unit::by_float`]).
//!
//! Compression is snappy, zstd, gzip, LZ4 (raw) or none. Memory holds a page of each column (at most 32 MiB,
//! compressed and not), its dictionary, and a batch of events; the footer may have 16 MiB. Lists, nested columns, missing values,
//! encryption and files of several parts are refused.
//!
//! The footer, the headers of pages and what is compressed are read here, as nothing in them is to be trusted: the
//! `parquet` crate reserves what they claim. It decodes the values.
//!
//! Format: <https://parquet.apache.org/docs/file-format/>.

mod column;
mod footer;
mod page;
mod thrift;

use super::number::{Number, coordinate, polarity};
use super::unit;
use crate::{BATCH_EVENTS, RawEvent, Recording, SourceError, SourceInfo};
use column::Column;
use evpr_core::plan::{Sensor, TimeUnit};
use footer::{Footer, Group};
use std::fs::File;
use std::path::{Path, PathBuf};

const NAMES: [&str; 4] = ["t", "x", "y", "p"];

/// See the module.
pub(super) struct Parquet {
    path: PathBuf,
    file: File,
    footer: Footer,
    unit: TimeUnit,
    unit_from: &'static str,
    /// The row group that is read, and what is open of it.
    group: usize,
    columns: Option<[Column; 4]>,
    /// The next event.
    next: u64,
}

impl Parquet {
    pub(super) fn open(path: &Path, unit: TimeUnit) -> Result<Self, SourceError> {
        let failed = |e| SourceError::read(path, e);
        let mut file = File::open(path).map_err(failed)?;
        let len = file.metadata().map_err(failed)?.len();
        let footer = Footer::read(&mut file, len).map_err(|what| SourceError::malformed(path, what))?;
        let (unit, unit_from) = match (footer.typed, unit, footer.named) {
            (Some(typed), ..) => (typed, "format"),
            (None, TimeUnit::Auto, Some(named)) => (named, "name"),
            (None, TimeUnit::Auto, None) => (TimeUnit::Auto, "magnitude"),
            (None, unit, _) => (unit, "config"),
        };
        let mut parquet = Self {
            path: path.to_owned(),
            file,
            footer,
            unit,
            unit_from,
            group: 0,
            columns: None,
            next: 0,
        };
        if parquet.footer.groups.is_empty() {
            return Err(SourceError::malformed(path, "holds no events"));
        }
        let first = parquet.first_time(0)?;
        if parquet.unit == TimeUnit::Auto {
            (parquet.unit, parquet.unit_from) = match first {
                Number::Float(t) => unit::by_float(t),
                Number::Whole(t) => unit::by_magnitude(u64::try_from(t).unwrap_or(0)),
            };
        }
        Ok(parquet)
    }

    fn group(&self, index: usize) -> Result<&Group, SourceError> {
        let group = self.footer.groups.get(index);
        group.ok_or_else(|| SourceError::malformed(&self.path, "holds no events"))
    }

    /// An error that a column of a row group gave.
    fn failed(&self, column: usize, group: usize, what: &str) -> SourceError {
        let what = format!(
            "column {} of row group {group} (from 0) holds {what}; the file is damaged or of another kind",
            NAMES[column]
        );
        SourceError::malformed(&self.path, what)
    }

    fn column(&self, column: usize, group: usize) -> Result<Column, SourceError> {
        let kind = self.footer.kinds[column];
        let open = Column::open(&self.file, self.group(group)?, column, kind);
        open.map_err(|what| self.failed(column, group, &what))
    }

    /// The first time of a row group.
    fn first_time(&self, group: usize) -> Result<Number, SourceError> {
        let mut times = self.column(0, group)?;
        times.read(1).map_err(|what| self.failed(0, group, &what))?;
        times.first().ok_or_else(|| self.failed(0, group, "no times"))
    }

    fn time_ns(&self, time: Number) -> Option<u64> {
        let scale = 10u64.pow(unit::digits(self.unit).unwrap_or(0));
        match time {
            Number::Whole(t) => unit::whole_ns(t, scale),
            Number::Float(t) => unit::float_ns(t, scale),
        }
    }

    fn wrong_event(&self, index: u64, what: &str) -> SourceError {
        SourceError::malformed(&self.path, format!("event {index} (from 0): {what}"))
    }

    /// Decodes as many of the next events of the row group as `out` has. What is wrong, and how many before that are good.
    fn decode(&self, columns: &mut [Column; 4], out: &mut [RawEvent]) -> Result<(), (usize, SourceError)> {
        let mut wrong: Option<(usize, SourceError)> = None;
        let mut worse = |at: usize, what: SourceError| {
            if wrong.as_ref().is_none_or(|(first, _)| at < *first) {
                wrong = Some((at, what));
            }
        };
        for (index, column) in columns.iter_mut().enumerate() {
            match column.read(out.len()) {
                Err(what) => worse(0, self.failed(index, self.group, &what)),
                Ok(count) if count < out.len() => {
                    let what = format!("it has no {}; every event must have one", NAMES[index]);
                    worse(count, self.wrong_event(self.next + count as u64, &what));
                }
                Ok(_) => {}
            }
        }
        for (index, column) in columns.iter().enumerate() {
            let bad = match index {
                0 => column.set(out, |e, n| {
                    let t_ns = self.time_ns(n);
                    e.t_ns = t_ns.unwrap_or(0);
                    t_ns.is_some()
                }),
                1 => column.set(out, |e, n| coordinate(n).map(|v| e.x = v).is_some()),
                2 => column.set(out, |e, n| coordinate(n).map(|v| e.y = v).is_some()),
                _ => column.set(out, |e, n| polarity(n).map(|v| e.on = v).is_some()),
            };
            if let Some((at, number)) = bad {
                let what = match index {
                    0 => format!(
                        "the time {number} is negative or lies beyond the year 2262; check source.time_unit"
                    ),
                    3 => format!("the polarity is {number}; it must be 0 or 1 (or -1)"),
                    _ => format!("{} is {number}; it must be a whole number from 0", NAMES[index]),
                };
                worse(at, self.wrong_event(self.next + at as u64, &what));
            }
        }
        wrong.map_or(Ok(()), Err)
    }
}

impl Recording for Parquet {
    fn sensor(&self) -> Option<Sensor> {
        None
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        let Some(group) = self.footer.groups.get(self.group) else {
            return Ok(false);
        };
        let left = (group.first + group.rows).saturating_sub(self.next);
        let count = usize::try_from(left).unwrap_or(usize::MAX).min(BATCH_EVENTS);
        let opened = self.columns.take();
        let open = |column| self.column(column, self.group);
        let mut columns = match opened {
            Some(columns) => columns,
            None => [open(0)?, open(1)?, open(2)?, open(3)?],
        };
        out.resize(count, RawEvent::default());
        if let Err((good, what)) = self.decode(&mut columns, out) {
            out.truncate(good);
            self.group = self.footer.groups.len();
            return Err(what);
        }
        self.next += count as u64;
        if count as u64 == left {
            self.group += 1;
        } else {
            self.columns = Some(columns);
        }
        Ok(true)
    }

    fn progress_permille(&self) -> u64 {
        (u128::from(self.next) * 1000 / u128::from(self.footer.events.max(1))) as u64
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: "parquet",
            path: self.path.clone(),
            time_unit: unit::name(self.unit),
            time_unit_from: self.unit_from,
            events: Some(self.footer.events),
        }
    }

    /// To the start of the last row group that begins before `t_ns`: statistics are not needed for that.
    fn seek_before(&mut self, t_ns: u64) -> Result<Option<u64>, SourceError> {
        let (mut low, mut high) = (0, self.footer.groups.len());
        while low < high {
            let middle = low + (high - low) / 2;
            let time = self.first_time(middle)?;
            let first = self.group(middle)?.first;
            let time = self.time_ns(time).ok_or_else(|| {
                let what = format!(
                    "the time {time} is negative or lies beyond the year 2262; check source.time_unit"
                );
                self.wrong_event(first, &what)
            })?;
            if time < t_ns {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        let group = low.saturating_sub(1);
        let first = self.group(group)?.first;
        (self.group, self.next, self.columns) = (group, first, None);
        Ok(Some(first))
    }
}
