//! One column of events, of which one block is in memory; numbers of any width become what an event has.

use super::super::unit::{float_ns, whole_ns};
use super::{filters, type_name, unreadable};
use crate::{BATCH_EVENTS, MAX_TIME_NS};
use hdf5_reader::error::{Error, Result as Hdf5Result};
use hdf5_reader::{Dataset, Datatype, H5Type, SliceInfo, SliceInfoElem};
use std::fmt::Display;

/// Values up to the first that cannot be one, and what is wrong with that.
pub(super) struct Loaded<T> {
    pub(super) values: Vec<T>,
    pub(super) wrong: Option<String>,
}

/// Reads a part of a dataset.
pub(super) type Load<T> = Box<dyn Fn(&Dataset, &SliceInfo) -> Hdf5Result<Loaded<T>> + Send>;

/// A column and the block of it that is in memory.
pub(super) struct Column<T> {
    path: String,
    dataset: Dataset,
    load: Load<T>,
    /// Events per block: whole chunks, so that none is decoded twice.
    block_len: u64,
    start: u64,
    end: u64,
    block: Loaded<T>,
}

impl<T> Column<T> {
    pub(super) fn new(path: String, dataset: Dataset, load: Load<T>) -> Self {
        let chunk = dataset.chunks().and_then(|c| c.first().copied());
        let chunk = chunk.map_or(1, u64::from).max(1);
        Self {
            path,
            dataset,
            load,
            block_len: chunk * (BATCH_EVENTS as u64).div_ceil(chunk),
            start: 0,
            end: 0,
            block: Loaded {
                values: Vec::new(),
                wrong: None,
            },
        }
    }

    pub(super) fn path(&self) -> &str {
        &self.path
    }

    pub(super) fn len(&self) -> u64 {
        self.dataset.shape().first().copied().unwrap_or(0)
    }

    pub(super) fn block_len(&self) -> u64 {
        self.block_len
    }

    /// The values from `at` to the end of their block; `at` must be below the length.
    pub(super) fn from(&mut self, at: u64) -> Result<&[T], String> {
        if !(self.start..self.end).contains(&at) {
            let start = at - at % self.block_len;
            let end = start.saturating_add(self.block_len).min(self.len());
            self.block =
                (self.load)(&self.dataset, &slice(start, end)).map_err(|e| unreadable(&self.path, &e))?;
            (self.start, self.end) = (start, end);
        }
        let offset = (at - self.start) as usize;
        match self.block.values.get(offset..) {
            Some(rest) if !rest.is_empty() => Ok(rest),
            _ => Err(match &self.block.wrong {
                Some(wrong) => format!("event {at} (from 0) has {wrong}"),
                None => format!("{} ends before event {at}; the file is damaged", self.path),
            }),
        }
    }
}

/// A part of a dataset of one dimension.
pub(super) fn slice(start: u64, end: u64) -> SliceInfo {
    SliceInfo {
        selections: vec![SliceInfoElem::Slice { start, end, step: 1 }],
    }
}

/// A number as a file has it.
pub(super) trait Number: H5Type + Copy + Display + 'static {
    /// As a whole number from 0.
    fn whole(self) -> Option<u64>;
    /// Whether it is -1.
    fn is_minus_one(self) -> bool;
    /// As a time in units of `scale` ns.
    fn ns(self, scale: u64) -> Option<u64>;
    /// Whether it may have a fraction.
    const FLOAT: bool = false;
    /// For the choice of a unit.
    fn rough(self) -> f64;
}

macro_rules! whole_numbers {
    ($($type:ty),*) => {$(
        impl Number for $type {
            #[inline]
            fn whole(self) -> Option<u64> {
                u64::try_from(self).ok()
            }
            #[inline]
            fn is_minus_one(self) -> bool {
                self == (0 as $type).wrapping_sub(1) && <$type>::MIN != 0
            }
            #[inline]
            fn ns(self, scale: u64) -> Option<u64> {
                i64::try_from(self).ok().and_then(|v| whole_ns(v, scale))
            }
            fn rough(self) -> f64 {
                self as f64
            }
        }
    )*};
}
whole_numbers!(u8, i8, u16, i16, u32, i32, u64, i64);

macro_rules! floats {
    ($($type:ty),*) => {$(
        impl Number for $type {
            #[inline]
            fn whole(self) -> Option<u64> {
                let value = f64::from(self);
                ((0.0..9e15).contains(&value) && value.fract() == 0.0).then_some(value as u64)
            }
            #[inline]
            fn is_minus_one(self) -> bool {
                self == -1.0
            }
            #[inline]
            fn ns(self, scale: u64) -> Option<u64> {
                float_ns(f64::from(self), scale)
            }
            const FLOAT: bool = true;
            fn rough(self) -> f64 {
                f64::from(self)
            }
        }
    )*};
}
floats!(f32, f64);

/// A byte of an enumeration, which is how h5py stores truth values.
#[derive(Clone, Copy)]
pub(super) struct Truth(u8);

impl Display for Truth {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

impl H5Type for Truth {
    fn hdf5_type() -> Datatype {
        u8::hdf5_type()
    }

    fn from_bytes(bytes: &[u8], _: &Datatype) -> Hdf5Result<Self> {
        let first = bytes.first().copied().map(Self);
        first.ok_or_else(|| Error::InvalidData("a truth value of no bytes".to_owned()))
    }

    fn element_size(_: &Datatype) -> usize {
        1
    }

    fn decode_vec(raw: &[u8], _: &Datatype, count: usize) -> Option<Hdf5Result<Vec<Self>>> {
        let bytes = raw.get(..count)?;
        Some(Ok(bytes.iter().copied().map(Self).collect()))
    }
}

impl Number for Truth {
    fn whole(self) -> Option<u64> {
        Some(self.0.into())
    }
    fn is_minus_one(self) -> bool {
        false
    }
    fn ns(self, _: u64) -> Option<u64> {
        None
    }
    fn rough(self) -> f64 {
        self.0.into()
    }
}

/// Something to be done for whichever type a dataset has.
pub(super) trait ForType {
    type Out;
    fn run<S: Number>(self) -> Self::Out;
}

/// Does it for this type; `None` when that is no number.
pub(super) fn for_type<F: ForType>(dtype: &Datatype, f: F) -> Option<F::Out> {
    Some(match dtype {
        Datatype::FixedPoint { size, signed, .. } => match (size, signed) {
            (1, false) => f.run::<u8>(),
            (1, true) => f.run::<i8>(),
            (2, false) => f.run::<u16>(),
            (2, true) => f.run::<i16>(),
            (4, false) => f.run::<u32>(),
            (4, true) => f.run::<i32>(),
            (8, false) => f.run::<u64>(),
            (8, true) => f.run::<i64>(),
            _ => return None,
        },
        Datatype::FloatingPoint { size: 4, .. } => f.run::<f32>(),
        Datatype::FloatingPoint { size: 8, .. } => f.run::<f64>(),
        Datatype::Enum { base, .. } if matches!(**base, Datatype::FixedPoint { size: 1, .. }) => {
            f.run::<Truth>()
        }
        _ => return None,
    })
}

/// Reads values that need no change.
fn same<T: H5Type + 'static>() -> Load<T> {
    Box::new(|dataset, part| {
        let values = dataset.read_slice::<T>(part)?.into_raw_vec_and_offset().0;
        Ok(Loaded { values, wrong: None })
    })
}

/// Reads values and converts them; `wanted` is what a value that cannot be converted should be.
fn converted<S: Number, T>(
    convert: impl Fn(S) -> Option<T> + Send + 'static,
    name: &'static str,
    wanted: &'static str,
) -> Load<T> {
    Box::new(move |dataset, part| {
        let raw = dataset.read_slice::<S>(part)?.into_raw_vec_and_offset().0;
        let mut values = filters::room(raw.len()).map_err(Error::ResourceLimit)?;
        values.extend(raw.iter().map_while(|v| convert(*v)));
        let wrong = raw.get(values.len());
        let wrong = wrong.map(|v| format!("{name} {v}; it must be {wanted}"));
        Ok(Loaded { values, wrong })
    })
}

const TIMES: &str = "from 0 to the year 2262";

/// Reads times that need no change.
fn nanoseconds() -> Load<u64> {
    Box::new(|dataset, part| {
        let mut values = dataset.read_slice::<u64>(part)?.into_raw_vec_and_offset().0;
        let bad = values.iter().position(|t| *t > MAX_TIME_NS);
        let wrong = bad.map(|bad| format!("time {}; it must be {TIMES}", values[bad]));
        values.truncate(bad.unwrap_or(values.len()));
        Ok(Loaded { values, wrong })
    })
}

fn is_unsigned(dtype: &Datatype, bytes: u8) -> bool {
    matches!(dtype, Datatype::FixedPoint { size, signed: false, .. } if *size == bytes)
}

fn not_a_number(path: &str, dtype: &Datatype) -> String {
    format!("{path} has type {}, not a number; convert it", type_name(dtype))
}

struct Coordinate(&'static str);

impl ForType for Coordinate {
    type Out = Load<u16>;
    fn run<S: Number>(self) -> Load<u16> {
        let convert = |v: S| v.whole().map(|v| u16::try_from(v).unwrap_or(u16::MAX));
        converted(convert, self.0, "a whole number from 0")
    }
}

/// A column of columns (`x`) or rows (`y`) of pixels.
pub(super) fn coordinates(path: String, dataset: Dataset, name: &'static str) -> Result<Column<u16>, String> {
    let load = match dataset.dtype() {
        dtype if is_unsigned(dtype, 2) => same(),
        dtype => for_type(dtype, Coordinate(name)).ok_or_else(|| not_a_number(&path, dtype))?,
    };
    Ok(Column::new(path, dataset, load))
}

struct Polarity;

impl ForType for Polarity {
    type Out = Load<bool>;
    fn run<S: Number>(self) -> Load<bool> {
        let convert = |v: S| match v.whole() {
            Some(1) => Some(true),
            Some(0) => Some(false),
            _ => v.is_minus_one().then_some(false),
        };
        converted(convert, "polarity", "0 or 1 (or -1 where the type is signed)")
    }
}

/// A column of polarities: true for ON.
pub(super) fn polarities(path: String, dataset: Dataset) -> Result<Column<bool>, String> {
    let load = for_type(dataset.dtype(), Polarity).ok_or_else(|| not_a_number(&path, dataset.dtype()))?;
    Ok(Column::new(path, dataset, load))
}

struct Time {
    scale: u64,
    offset_ns: u64,
}

impl ForType for Time {
    type Out = Load<u64>;
    fn run<S: Number>(self) -> Load<u64> {
        let Self { scale, offset_ns } = self;
        let convert = move |v: S| {
            let ns = v.ns(scale)?.checked_add(offset_ns);
            ns.filter(|ns| *ns <= MAX_TIME_NS)
        };
        converted(convert, "time", TIMES)
    }
}

/// A column of times in units of `scale` ns, with what is to be added to them.
pub(super) fn times(
    path: String,
    dataset: Dataset,
    scale: u64,
    offset_ns: u64,
) -> Result<Column<u64>, String> {
    let load = match dataset.dtype() {
        dtype if is_unsigned(dtype, 8) && scale == 1 && offset_ns == 0 => nanoseconds(),
        dtype => {
            let time = Time { scale, offset_ns };
            for_type(dtype, time).ok_or_else(|| not_a_number(&path, dtype))?
        }
    };
    Ok(Column::new(path, dataset, load))
}

/// One value of a dataset as any number.
struct At<'a>(&'a Dataset, SliceInfo);

impl ForType for At<'_> {
    type Out = Hdf5Result<Option<Value>>;
    fn run<S: Number>(self) -> Self::Out {
        let values = self.0.read_slice::<S>(&self.1)?;
        Ok(values.iter().next().map(|v| Value {
            whole: v.whole(),
            rough: v.rough(),
            float: S::FLOAT,
        }))
    }
}

/// A number of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Value {
    /// As a whole number from 0, if it is one.
    pub(super) whole: Option<u64>,
    pub(super) rough: f64,
    /// Whether it is stored in floating point.
    pub(super) float: bool,
}

/// The value at a place, from 0; of a scalar at 0.
pub(super) fn value_at(path: &str, dataset: &Dataset, at: u64) -> Result<Value, String> {
    let part = match dataset.ndim() {
        0 => SliceInfo { selections: vec![] },
        1 if dataset.shape().first().is_some_and(|len| at < *len) => slice(at, at + 1),
        _ => return Err(format!("{path} has no value {at}; the file is damaged")),
    };
    for_type(dataset.dtype(), At(dataset, part))
        .ok_or_else(|| not_a_number(path, dataset.dtype()))?
        .map_err(|e| unreadable(path, &e))?
        .ok_or_else(|| format!("{path} is empty; the file is damaged"))
}
