//! HDF5 in the layout of NSAVP: `/events/{timestamps u64 ns, x_coordinates u16, y_coordinates u16, polarities u8}`,
//! all of one length, with attributes `height` and `width` on `/events` (or on the root).
//!
//! Polarities are 0 and 1; where they are signed, -1 and 0 both mean OFF.

use crate::{BATCH_EVENTS, RawEvent, Recording, SourceError, SourceInfo};
use evpr_core::plan::Sensor;
use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Datatype, H5Type, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem};
use std::path::{Path, PathBuf};

/// Largest chunk of a dataset that is decoded, bytes: a chunk is decoded whole, so this bounds the memory.
const MAX_CHUNK_BYTES: usize = 256 << 20;

/// One column of events, of which one block is in memory.
struct Column<T> {
    name: &'static str,
    dataset: Dataset,
    /// Events per block: whole chunks, so that none is decoded twice.
    block_len: u64,
    start: u64,
    block: Vec<T>,
}

impl<T: H5Type + Copy> Column<T> {
    fn open(events: &Group, name: &'static str) -> Result<Self, String> {
        let dataset = dataset(events, name)?;
        let (expected, actual) = (T::hdf5_type(), dataset.dtype());
        let same = match (&expected, actual) {
            (
                Datatype::FixedPoint {
                    size: a, signed: b, ..
                },
                Datatype::FixedPoint {
                    size: c, signed: d, ..
                },
            ) => (a, b) == (c, d),
            _ => false,
        };
        if !same {
            return Err(format!(
                "/events/{name} has type {}, not {}; convert it",
                type_name(actual),
                type_name(&expected)
            ));
        }
        let chunk = dataset
            .chunks()
            .and_then(|c| c.first().copied())
            .map_or(1, u64::from)
            .max(1);
        let block_len = chunk * (BATCH_EVENTS as u64).div_ceil(chunk);
        Ok(Self {
            name,
            dataset,
            block_len,
            start: 0,
            block: Vec::new(),
        })
    }

    fn len(&self) -> u64 {
        self.dataset.shape().first().copied().unwrap_or(0)
    }

    /// The events from `at` to the end of their block; `at` must be below the length.
    fn from(&mut self, at: u64) -> Result<&[T], String> {
        let loaded = self.start..self.start + self.block.len() as u64;
        if !loaded.contains(&at) {
            let start = at - at % self.block_len;
            let end = (start + self.block_len).min(self.len());
            let selections = vec![SliceInfoElem::Slice { start, end, step: 1 }];
            let array = self
                .dataset
                .read_slice::<T>(&SliceInfo { selections })
                .map_err(|e| unreadable(&format!("/events/{}", self.name), &e))?;
            self.block = array.into_raw_vec_and_offset().0;
            self.start = start;
        }
        let offset = (at - self.start) as usize;
        self.block
            .get(offset..)
            .filter(|rest| !rest.is_empty())
            .ok_or_else(|| {
                format!(
                    "/events/{} ends before event {at}; the file is damaged",
                    self.name
                )
            })
    }
}

enum Polarities {
    Unsigned(Column<u8>),
    Signed(Column<i8>),
}

impl Polarities {
    fn open(events: &Group) -> Result<Self, String> {
        const NAME: &str = "polarities";
        match dataset(events, NAME)?.dtype() {
            Datatype::FixedPoint {
                size: 1,
                signed: true,
                ..
            } => Column::open(events, NAME).map(Self::Signed),
            _ => Column::open(events, NAME).map(Self::Unsigned),
        }
    }

    fn len(&self) -> u64 {
        match self {
            Self::Unsigned(c) => c.len(),
            Self::Signed(c) => c.len(),
        }
    }
}

fn dataset(events: &Group, name: &str) -> Result<Dataset, String> {
    let dataset = match events.dataset(name) {
        Ok(dataset) => dataset,
        Err(hdf5_reader::error::Error::DatasetNotFound(_)) => {
            let mut there = events.member_names().map(|(_, d)| d).unwrap_or_default();
            there.sort();
            there.truncate(8);
            let there = if there.is_empty() {
                "none".to_owned()
            } else {
                there.join(", ")
            };
            return Err(format!(
                "has no dataset /events/{name} (there: {there}); NSAVP's layout wants timestamps, x_coordinates, y_coordinates and polarities"
            ));
        }
        Err(e) => return Err(unreadable(&format!("/events/{name}"), &e)),
    };
    match dataset.ndim() {
        1 => Ok(dataset),
        n => Err(format!("/events/{name} has {n} dimensions; it must have one")),
    }
}

fn unreadable(what: &str, e: &hdf5_reader::error::Error) -> String {
    format!(
        "{what} cannot be read: {e}; the file is truncated, damaged or uses a filter that is not supported"
    )
}

fn type_name(dtype: &Datatype) -> String {
    match dtype {
        Datatype::FixedPoint { size, signed, .. } => {
            format!("{}{}", if *signed { "i" } else { "u" }, size * 8)
        }
        Datatype::FloatingPoint { size, .. } => format!("f{}", size * 8),
        Datatype::Enum { .. } => "enum".to_owned(),
        Datatype::Compound { .. } => "compound".to_owned(),
        _ => "neither integer nor float".to_owned(),
    }
}

/// See the module.
pub(super) struct Hdf5 {
    path: PathBuf,
    sensor: Option<Sensor>,
    timestamps: Column<u64>,
    x: Column<u16>,
    y: Column<u16>,
    polarities: Polarities,
    len: u64,
    position: u64,
}

impl Hdf5 {
    pub(super) fn open(path: &Path) -> Result<Self, SourceError> {
        Self::open_layout(path).map_err(|what| SourceError::malformed(path, what))
    }

    fn open_layout(path: &Path) -> Result<Self, String> {
        // Every chunk is read once and in order: a cache would only take memory.
        let options = OpenOptions::default()
            .with_chunk_cache_bytes(0)
            .with_max_chunk_bytes(MAX_CHUNK_BYTES);
        let file =
            Hdf5File::open_with_options(path, options).map_err(|e| unreadable("the HDF5 structure", &e))?;
        let root = file.root_group().map_err(|e| unreadable("the HDF5 root", &e))?;
        let events = root.group("events").map_err(|e| match e {
            hdf5_reader::error::Error::GroupNotFound(_) => {
                "has no group /events; NSAVP's layout wants /events/timestamps and the other columns there"
                    .to_owned()
            }
            e => unreadable("/events", &e),
        })?;
        let timestamps = Column::<u64>::open(&events, "timestamps")?;
        let x = Column::<u16>::open(&events, "x_coordinates")?;
        let y = Column::<u16>::open(&events, "y_coordinates")?;
        let polarities = Polarities::open(&events)?;
        let len = timestamps.len();
        for (name, other) in [
            ("x_coordinates", x.len()),
            ("y_coordinates", y.len()),
            ("polarities", polarities.len()),
        ] {
            if other != len {
                return Err(format!(
                    "/events/timestamps has {len} entries but /events/{name} has {other}; they must be as long"
                ));
            }
        }
        if len == 0 {
            return Err("holds no events".to_owned());
        }
        let sides = side_of(&events, &root, "height")?.zip(side_of(&events, &root, "width")?);
        let sensor = sides.map(|(height, width)| Sensor { height, width });
        Ok(Self {
            path: path.to_owned(),
            sensor,
            timestamps,
            x,
            y,
            polarities,
            len,
            position: 0,
        })
    }

    fn decode(&mut self, out: &mut Vec<RawEvent>) -> Result<(), String> {
        let at = self.position;
        let t = self.timestamps.from(at)?;
        let x = self.x.from(at)?;
        let y = self.y.from(at)?;
        match &mut self.polarities {
            Polarities::Unsigned(p) => join(at, t, x, y, p.from(at)?, |p| p <= 1, |p| p == 1, out),
            Polarities::Signed(p) => join(
                at,
                t,
                x,
                y,
                p.from(at)?,
                |p| (-1..=1).contains(&p),
                |p| p == 1,
                out,
            ),
        }
    }
}

/// Joins the columns as far as all of them reach. A polarity out of range ends it; what lies before it is kept.
#[allow(clippy::too_many_arguments)] // the four columns and what a polarity means
fn join<P: Copy + std::fmt::Display>(
    at: u64,
    t: &[u64],
    x: &[u16],
    y: &[u16],
    p: &[P],
    valid: fn(P) -> bool,
    on: impl Fn(P) -> bool,
    out: &mut Vec<RawEvent>,
) -> Result<(), String> {
    let len = t.len().min(x.len()).min(y.len()).min(p.len()).min(BATCH_EVENTS);
    let good = p.iter().take(len).position(|p| !valid(*p)).unwrap_or(len);
    let columns = t.iter().zip(x).zip(y).zip(p).take(good);
    out.extend(columns.map(|(((t_ns, x), y), p)| RawEvent {
        t_ns: *t_ns,
        x: *x,
        y: *y,
        on: on(*p),
    }));
    match p.get(good) {
        Some(bad) if good < len => Err(format!(
            "event {} (from 0) has polarity {bad}; it must be 0 or 1 (or -1 where the type is signed)",
            at + good as u64
        )),
        _ => Ok(()),
    }
}

/// The attribute `height` or `width`, of `/events` or else of the root.
fn side_of(events: &Group, root: &Group, name: &str) -> Result<Option<usize>, String> {
    for (place, group) in [("/events", events), ("/", root)] {
        match group.attribute(name) {
            Ok(attribute) => {
                let value = attribute
                    .read_as_f64()
                    .map_err(|e| unreadable(&format!("attribute {name} of {place}"), &e))?;
                if value.fract() != 0.0 || !(1.0..=65_535.0).contains(&value) {
                    return Err(format!(
                        "attribute {name} of {place} is {value}; it must be a whole number from 1 to 65535"
                    ));
                }
                return Ok(Some(value as usize));
            }
            Err(hdf5_reader::error::Error::AttributeNotFound(_)) => {}
            Err(e) => return Err(unreadable(&format!("attribute {name} of {place}"), &e)),
        }
    }
    Ok(None)
}

impl Recording for Hdf5 {
    fn sensor(&self) -> Option<Sensor> {
        self.sensor
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        if self.position >= self.len {
            return Ok(false);
        }
        let outcome = self.decode(out);
        self.position += out.len() as u64;
        outcome
            .map(|()| true)
            .map_err(|what| SourceError::malformed(&self.path, what))
    }

    fn progress_permille(&self) -> u64 {
        (u128::from(self.position) * 1000 / u128::from(self.len.max(1))) as u64
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: "HDF5 (NSAVP layout)",
            path: self.path.clone(),
            time_unit: "ns",
            time_unit_from: "format",
            events: Some(self.len),
        }
    }

    fn seek_before(&mut self, t_ns: u64) -> Result<Option<u64>, SourceError> {
        let timestamps = &mut self.timestamps;
        let (len, block_len) = (self.len, timestamps.block_len);
        let before = search(len, block_len, t_ns, |at| {
            timestamps.from(at).map(|t| t.first().copied())
        })
        .map_err(|what| SourceError::malformed(&self.path, what))?;
        self.position = before;
        Ok(Some(before))
    }
}

/// An index, at most `block_len` before the first time that is not below `t_ns`, or 0; `time_at` does not decrease.
fn search(
    len: u64,
    block_len: u64,
    t_ns: u64,
    mut time_at: impl FnMut(u64) -> Result<Option<u64>, String>,
) -> Result<u64, String> {
    // `before` is 0 or earlier than `t_ns`; `after` is the end or not. Finer than a block need not be told apart.
    let (mut before, mut after) = (0, len);
    while after - before > block_len {
        let middle = before + (after - before) / 2;
        if time_at(middle)?.is_some_and(|t| t < t_ns) {
            before = middle;
        } else {
            after = middle;
        }
    }
    Ok(before)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn search_stops_shortly_before_the_time(
            mut times in proptest::collection::vec(0u64..100, 1..200),
            block_len in 1u64..20,
            t_ns in 0u64..110,
        ) {
            times.sort_unstable();
            let found = search(times.len() as u64, block_len, t_ns, |at| Ok(times.get(at as usize).copied()));
            let found = found.unwrap();
            let first = times.partition_point(|t| *t < t_ns) as u64;
            prop_assert!(found <= first && first - found <= block_len);
        }
    }
}
