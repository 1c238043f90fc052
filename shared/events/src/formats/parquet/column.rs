//! The values of a column in a row group, by the decoders of the `parquet` crate.
//!
//! Those may panic on bytes that no writer would write (such as widths of values that overflow a sum): here is where
//! this ends, as an error.

use super::footer::{Group, Kind, Physical};
use super::page::Pages;
use crate::RawEvent;
use crate::formats::number::Number;
use parquet::basic::{Repetition, Type};
use parquet::column::reader::ColumnReaderImpl;
use parquet::data_type::{BoolType, DataType, DoubleType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::schema::types::{self, ColumnDescriptor, ColumnPath};
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// Values that were decoded last, and the reader of the next ones.
pub(super) struct Values<T: DataType> {
    reader: ColumnReaderImpl<T>,
    values: Vec<T::T>,
    levels: Vec<i16>,
}

/// A column of any of the types that are numbers.
pub(super) enum Column {
    Boolean(Values<BoolType>),
    Int32(Values<Int32Type>),
    Uint32(Values<Int32Type>),
    Int64(Values<Int64Type>),
    Uint64(Values<Int64Type>),
    Float(Values<FloatType>),
    Double(Values<DoubleType>),
}

/// The decoders' own errors as one short line; their panics too.
fn contained<R>(call: impl FnOnce() -> Result<R, ParquetError>) -> Result<R, String> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(ParquetError::General(what) | ParquetError::EOF(what))) => Err(one_line(&what)),
        Ok(Err(other)) => Err(one_line(&other.to_string())),
        Err(_) => Err("values that cannot be decoded".to_owned()),
    }
}

fn one_line(what: &str) -> String {
    let line: String = what.chars().take(200).collect();
    line.replace(['\n', '\r'], " ")
}

impl<T: DataType> Values<T> {
    fn open(physical: Type, optional: bool, pages: Pages) -> Result<Self, String> {
        let repetition = match optional {
            true => Repetition::OPTIONAL,
            false => Repetition::REQUIRED,
        };
        let reader = contained(|| {
            let kind = types::Type::primitive_type_builder("v", physical)
                .with_repetition(repetition)
                .build()?;
            let path = ColumnPath::new(vec!["v".to_owned()]);
            let column = ColumnDescriptor::new(Arc::new(kind), i16::from(optional), 0, path);
            Ok(ColumnReaderImpl::new(Arc::new(column), Box::new(pages)))
        })?;
        Ok(Self {
            reader,
            values: Vec::new(),
            levels: Vec::new(),
        })
    }

    /// How many of the values that were asked for there are, up to the first that is missing.
    fn read(&mut self, count: usize) -> Result<usize, String> {
        self.values.clear();
        self.levels.clear();
        let read = contained(|| {
            self.reader
                .read_records(count, Some(&mut self.levels), None, &mut self.values)
        });
        read?;
        let missing = self.levels.iter().position(|level| *level == 0);
        Ok(missing.unwrap_or(self.values.len()).min(self.values.len()))
    }

    /// Sets each event by its value; the first that cannot be.
    #[inline]
    fn each(
        &self,
        events: &mut [RawEvent],
        number: impl Fn(&T::T) -> Number,
        set: impl Fn(&mut RawEvent, Number) -> bool,
    ) -> Option<(usize, Number)> {
        let mut all = self.values.iter().zip(events);
        let bad = all.position(|(value, event)| !set(event, number(value)))?;
        self.values.get(bad).map(|value| (bad, number(value)))
    }
}

impl Column {
    /// One of the columns t, x, y and p (0 to 3) of a row group.
    pub(super) fn open(file: &File, group: &Group, column: usize, kind: Kind) -> Result<Self, String> {
        let file = file.try_clone().map_err(|e| format!("cannot be read: {e}"))?;
        let pages = Pages::new(file, group.chunks[column], kind);
        let optional = kind.optional;
        Ok(match (kind.physical, kind.signed) {
            (Physical::Boolean, _) => Self::Boolean(Values::open(Type::BOOLEAN, optional, pages)?),
            (Physical::Int32, true) => Self::Int32(Values::open(Type::INT32, optional, pages)?),
            (Physical::Int32, false) => Self::Uint32(Values::open(Type::INT32, optional, pages)?),
            (Physical::Int64, true) => Self::Int64(Values::open(Type::INT64, optional, pages)?),
            (Physical::Int64, false) => Self::Uint64(Values::open(Type::INT64, optional, pages)?),
            (Physical::Float, _) => Self::Float(Values::open(Type::FLOAT, optional, pages)?),
            (Physical::Double, _) => Self::Double(Values::open(Type::DOUBLE, optional, pages)?),
        })
    }

    /// Decodes the next `count` values. Fewer: the next one is missing.
    pub(super) fn read(&mut self, count: usize) -> Result<usize, String> {
        match self {
            Self::Boolean(values) => values.read(count),
            Self::Int32(values) | Self::Uint32(values) => values.read(count),
            Self::Int64(values) | Self::Uint64(values) => values.read(count),
            Self::Float(values) => values.read(count),
            Self::Double(values) => values.read(count),
        }
    }

    /// Sets each event by its value of those decoded last; the first that cannot be, with the number that it is.
    pub(super) fn set(
        &self,
        events: &mut [RawEvent],
        set: impl Fn(&mut RawEvent, Number) -> bool,
    ) -> Option<(usize, Number)> {
        let whole = |v: u64| Number::Whole(i64::try_from(v).unwrap_or(i64::MAX));
        match self {
            Self::Boolean(values) => values.each(events, |v| Number::Whole(i64::from(*v)), set),
            Self::Int32(values) => values.each(events, |v| Number::Whole(i64::from(*v)), set),
            Self::Uint32(values) => values.each(events, |v| Number::Whole(i64::from(*v as u32)), set),
            Self::Int64(values) => values.each(events, |v| Number::Whole(*v), set),
            Self::Uint64(values) => values.each(events, |v| whole(*v as u64), set),
            Self::Float(values) => values.each(events, |v| Number::Float(f64::from(*v)), set),
            Self::Double(values) => values.each(events, |v| Number::Float(*v), set),
        }
    }

    /// The first of the values decoded last.
    pub(super) fn first(&self) -> Option<Number> {
        let one = &mut [RawEvent::default()];
        self.set(one, |_, _| false).map(|(_, number)| number)
    }
}
