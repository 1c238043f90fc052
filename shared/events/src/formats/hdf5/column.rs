//! One column of events, of which one block is in memory; numbers of any width become what an event has.

use super::super::unit::{float_ns, quick_float_ns, whole_ns};
use super::stored::Stored;
use super::{type_name, unreadable};
use crate::{BATCH_EVENTS, MAX_TIME_NS};
use hdf5_reader::error::{Error, Result as Hdf5Result};
use hdf5_reader::{Dataset, Datatype, H5Type, SliceInfo, SliceInfoElem};
use std::fmt::Display;
use std::ops::Range;

/// Reads a part of a dataset in place of what is in the vector: the values up to the first that cannot be one, and what
/// is wrong with that.
pub(super) type Load<T> =
    Box<dyn FnMut(&mut Stored, Range<u64>, &mut Vec<T>) -> Hdf5Result<Option<String>> + Send>;

/// A column and the block of it that is in memory.
pub(super) struct Column<T> {
    path: String,
    stored: Stored,
    load: Load<T>,
    /// Events per block: whole chunks, so that none is decoded twice.
    block_len: u64,
    start: u64,
    end: u64,
    block: Vec<T>,
    /// What is wrong with the value behind those of the block.
    wrong: Option<String>,
}

impl<T> Column<T> {
    pub(super) fn new(path: String, stored: Stored, load: Load<T>) -> Self {
        let chunk = stored.chunk();
        Self {
            path,
            stored,
            load,
            block_len: chunk * (BATCH_EVENTS as u64).div_ceil(chunk),
            start: 0,
            end: 0,
            block: Vec::new(),
            wrong: None,
        }
    }

    pub(super) fn path(&self) -> &str {
        &self.path
    }

    pub(super) fn len(&self) -> u64 {
        self.stored.len()
    }

    pub(super) fn block_len(&self) -> u64 {
        self.block_len
    }

    /// The values from `at` to the end of their block; `at` must be below the length.
    pub(super) fn from(&mut self, at: u64) -> Result<&[T], String> {
        if !(self.start..self.end).contains(&at) {
            let start = at - at % self.block_len;
            let end = start.saturating_add(self.block_len).min(self.len());
            // Until it is read there is no block.
            (self.start, self.end) = (0, 0);
            let read = (self.load)(&mut self.stored, start..end, &mut self.block);
            self.wrong = read.map_err(|e| unreadable(&self.path, &e))?;
            (self.start, self.end) = (start, end);
        }
        let offset = (at - self.start) as usize;
        match self.block.get(offset..) {
            Some(rest) if !rest.is_empty() => Ok(rest),
            _ => Err(match &self.wrong {
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
    /// As `ns` with what is to be added and whether it is a time, for most values, and without branches.
    fn quick_ns(self, time: &Time) -> (u64, bool);
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
            #[inline]
            fn quick_ns(self, time: &Time) -> (u64, bool) {
                // What is negative becomes larger than any time.
                let units = self as u64;
                (units.wrapping_mul(time.scale).wrapping_add(time.offset_ns), units <= time.most_units)
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
            #[inline]
            fn quick_ns(self, time: &Time) -> (u64, bool) {
                let (ns, good) = quick_float_ns(f64::from(self), time.us_scale);
                (ns.wrapping_add(time.offset_ns), good & (ns <= MAX_TIME_NS - time.offset_ns))
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
    fn quick_ns(self, _: &Time) -> (u64, bool) {
        (0, false)
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

/// Values that are converted at once, before it is asked whether all of them could be.
const PIECE: usize = 1024;

/// Reads values and converts them: all with `quick`, which says whether that is right, and where it is not for one, those
/// around it with `convert`. `wanted` is what a value that cannot be converted should be.
fn converted<S: Number, T>(
    quick: impl Fn(S) -> (T, bool) + Send + 'static,
    convert: impl Fn(S) -> Option<T> + Send + 'static,
    name: &'static str,
    wanted: &'static str,
) -> Load<T> {
    Box::new(move |stored, part, out| {
        out.clear();
        let mut wrong = None;
        stored.read::<S>(part, |raw| {
            let room = out.try_reserve(raw.len());
            room.map_err(|e| Error::ResourceLimit(e.to_string()))?;
            for piece in raw.chunks(PIECE) {
                let (start, mut all_good) = (out.len(), true);
                out.extend(piece.iter().map(|v| {
                    let (value, good) = quick(*v);
                    all_good &= good;
                    value
                }));
                if all_good {
                    continue;
                }
                out.truncate(start);
                out.extend(piece.iter().map_while(|v| convert(*v)));
                if let Some(v) = piece.get(out.len() - start) {
                    wrong = Some(format!("{name} {v}; it must be {wanted}"));
                    return Ok(false);
                }
            }
            Ok(true)
        })?;
        Ok(wrong)
    })
}

/// As `converted`, where one conversion is quick enough.
fn simply_converted<S: Number, T: Default>(
    convert: impl Fn(S) -> Option<T> + Copy + Send + 'static,
    name: &'static str,
    wanted: &'static str,
) -> Load<T> {
    let quick = move |v| {
        let value = convert(v);
        let good = value.is_some();
        (value.unwrap_or_default(), good)
    };
    converted(quick, convert, name, wanted)
}

fn not_a_number(path: &str, dtype: &Datatype) -> String {
    format!("{path} has type {}, not a number; convert it", type_name(dtype))
}

struct Coordinate(&'static str);

impl ForType for Coordinate {
    type Out = Load<u16>;
    fn run<S: Number>(self) -> Load<u16> {
        let convert = |v: S| v.whole().map(|v| u16::try_from(v).unwrap_or(u16::MAX));
        simply_converted(convert, self.0, "a whole number from 0")
    }
}

/// A column of columns (`x`) or rows (`y`) of pixels.
pub(super) fn coordinates(path: String, stored: Stored, name: &'static str) -> Result<Column<u16>, String> {
    let load = for_type(stored.dtype(), Coordinate(name));
    let load = load.ok_or_else(|| not_a_number(&path, stored.dtype()))?;
    Ok(Column::new(path, stored, load))
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
        simply_converted(convert, "polarity", "0 or 1 (or -1 where the type is signed)")
    }
}

/// A column of polarities: true for ON.
pub(super) fn polarities(path: String, stored: Stored) -> Result<Column<bool>, String> {
    let load = for_type(stored.dtype(), Polarity).ok_or_else(|| not_a_number(&path, stored.dtype()))?;
    Ok(Column::new(path, stored, load))
}

/// What times in a file mean.
#[derive(Clone, Copy)]
pub(super) struct Time {
    /// The unit, ns.
    scale: u64,
    /// The unit, µs; below 1 for nanoseconds.
    us_scale: f64,
    /// Added to each. At most [`MAX_TIME_NS`].
    offset_ns: u64,
    /// The latest time in units.
    most_units: u64,
}

impl ForType for Time {
    type Out = Load<u64>;
    fn run<S: Number>(self) -> Load<u64> {
        let convert = move |v: S| {
            let ns = v.ns(self.scale)?.checked_add(self.offset_ns);
            ns.filter(|ns| *ns <= MAX_TIME_NS)
        };
        let quick = move |v: S| v.quick_ns(&self);
        converted(quick, convert, "time", "from 0 to the year 2262")
    }
}

/// A column of times in units of `scale` ns each, with what is to be added to them.
pub(super) fn times(path: String, stored: Stored, scale: u64, offset_ns: u64) -> Result<Column<u64>, String> {
    let offset_ns = offset_ns.min(MAX_TIME_NS);
    let time = Time {
        scale,
        us_scale: scale as f64 / 1e3,
        offset_ns,
        most_units: (MAX_TIME_NS - offset_ns) / scale.max(1),
    };
    let load = for_type(stored.dtype(), time).ok_or_else(|| not_a_number(&path, stored.dtype()))?;
    Ok(Column::new(path, stored, load))
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
