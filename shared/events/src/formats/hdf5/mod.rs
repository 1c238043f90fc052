//! HDF5: events in the layouts of NSAVP, DSEC, E2VID and Prophesee, one file each. What is in the file decides.
//!
//! Columns are whole or floating-point numbers of any width. Polarities are 0 and 1; where they are signed, -1 and 0
//! both mean OFF. The size of the sensor comes from attributes, of `/events` or the root: `height` and `width`,
//! `sensor_resolution` (height, width) or `geometry` (`640x480`, width first).

mod blosc;
mod body;
mod column;
mod dsec;
mod e2vid;
mod filters;
mod nsavp;
mod prophesee;
mod sensor;
mod stored;

use super::ReadOptions;
use super::unit;
use crate::{RawEvent, Recording, Skipped, SourceError, SourceInfo};
use body::{Body, Columns};
use column::{Value, coordinates, polarities, value_at};
use evpr_core::plan::{Sensor, TimeUnit};
use filters::Filters;
use hdf5_reader::error::Error;
use hdf5_reader::group::Group;
use hdf5_reader::storage::FileStorage;
use hdf5_reader::{Dataset, Datatype, Hdf5File, OpenOptions};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stored::Stored;

/// A unit, and how it is known.
type KnownUnit = (TimeUnit, &'static str);

/// Largest chunk of a dataset that is decoded, bytes: a chunk is decoded whole, so this bounds the memory.
const MAX_CHUNK_BYTES: usize = 256 << 20;
/// Most events in a chunk: what they become takes more than their bytes in the file.
const MAX_CHUNK_EVENTS: u32 = 8 << 20;
/// Largest part of a dataset that is read at once, bytes: whole chunks for a batch.
const MAX_READ_BYTES: usize = 2 * MAX_CHUNK_BYTES;
/// Most names that a message lists.
const MAX_LISTED: usize = 8;

/// Four columns in `/events`, by their names; time, x, y, polarity.
struct Layout {
    format: &'static str,
    names: [&'static str; 4],
    /// What its times mean. Asked when there are events.
    times: fn(&Events) -> Result<Times, String>,
}

/// Those that are known by their names. The first that fits best counts.
static LAYOUTS: [Layout; 3] = [nsavp::LAYOUT, dsec::LAYOUT, e2vid::LAYOUT];

/// What times mean.
struct Times {
    unit: KnownUnit,
    /// Added to each, ns.
    offset_ns: u64,
    index: Option<dsec::Index>,
}

impl Times {
    fn plain(unit: KnownUnit) -> Self {
        Self {
            unit,
            offset_ns: 0,
            index: None,
        }
    }
}

/// A file, and the filters with which it was opened.
struct Opened {
    hdf5: Hdf5File,
    filters: Filters,
    /// The same file, for what is not compressed.
    file: Arc<File>,
}

/// Columns in a file that is being opened.
struct Events<'a> {
    file: &'a Opened,
    root: Group,
    times: (String, Dataset),
    options: &'a ReadOptions,
}

impl Events<'_> {
    fn first_time(&self) -> Result<Option<Value>, String> {
        let (path, dataset) = &self.times;
        match dataset.shape() {
            [0] => Ok(None),
            _ => value_at(path, dataset, 0).map(Some),
        }
    }

    /// The unit where the layout leaves it open: that of the configuration, or what the first time speaks for.
    fn open_unit(&self) -> Result<KnownUnit, String> {
        if self.options.time_unit != TimeUnit::Auto {
            return Ok((self.options.time_unit, "config"));
        }
        Ok(match self.first_time()? {
            Some(first) if first.float => unit::by_float(first.rough),
            first => unit::by_magnitude(first.and_then(|f| f.whole).unwrap_or(0)),
        })
    }
}

/// A dataset whose filters can be read, if it is there; `place` is its group with a slash at the end.
fn dataset(file: &Opened, group: &Group, place: &str, name: &str) -> Result<Option<Dataset>, String> {
    let path = format!("{place}{name}");
    match group.dataset(name) {
        Ok(dataset) => {
            file.filters.check(&file.hdf5, &path, &dataset)?;
            Ok(Some(dataset))
        }
        Err(Error::DatasetNotFound(_)) => Ok(None),
        Err(e) => Err(unreadable(&path, &e)),
    }
}

fn group(root: &Group, name: &str) -> Result<Option<Group>, String> {
    match root.group(name) {
        Ok(group) => Ok(Some(group)),
        Err(Error::GroupNotFound(_)) => Ok(None),
        Err(e) => Err(unreadable(&format!("/{name}"), &e)),
    }
}

/// That a dataset is a column whose chunks can be decoded in bounded memory.
fn check_shape(path: &str, dataset: &Dataset) -> Result<(), String> {
    let chunk = dataset.chunks().and_then(|c| c.first().copied());
    match dataset.ndim() {
        1 if chunk.is_some_and(|events| events > MAX_CHUNK_EVENTS) => Err(format!(
            "{path} has chunks of more than {MAX_CHUNK_EVENTS} events; make them smaller: \
             h5repack -l CHUNK=65536 IN OUT"
        )),
        1 => Ok(()),
        n => Err(format!("{path} has {n} dimensions; it must have one")),
    }
}

fn unreadable(what: &str, e: &Error) -> String {
    let e: String = e.to_string().chars().filter(|c| !c.is_control()).collect();
    format!("{what} cannot be read: {e}; the file is truncated, damaged or of a kind that is not supported")
}

fn type_name(dtype: &Datatype) -> String {
    match dtype {
        Datatype::FixedPoint { size, signed, .. } => {
            format!("{}{}", if *signed { "i" } else { "u" }, u32::from(*size) * 8)
        }
        Datatype::FloatingPoint { size, .. } => format!("f{}", u32::from(*size) * 8),
        Datatype::Enum { .. } => "enum".to_owned(),
        Datatype::Compound { .. } => "compound".to_owned(),
        Datatype::String { .. } => "string".to_owned(),
        _ => "neither integer nor float".to_owned(),
    }
}

/// Names for a message: sorted, printable, a few.
fn listed(mut names: Vec<String>) -> String {
    names.sort();
    let more = names.len() > MAX_LISTED;
    names.truncate(MAX_LISTED);
    let shown = names.iter().map(|n| {
        n.chars()
            .take(40)
            .flat_map(char::escape_debug)
            .collect::<String>()
    });
    match shown.collect::<Vec<_>>().join(", ") {
        none if none.is_empty() => "nothing".to_owned(),
        shown if more => shown + ", …",
        shown => shown,
    }
}

/// What is in a group, for a message.
fn content(group: &Group) -> String {
    let (groups, mut names) = group.member_names().unwrap_or_default();
    names.extend(groups.into_iter().map(|g| g + "/"));
    listed(names)
}

/// See the module.
pub(super) struct Hdf5 {
    path: PathBuf,
    format: &'static str,
    unit: KnownUnit,
    sensor: Option<Sensor>,
    skipped: Vec<Skipped>,
    body: Body,
    len: u64,
    position: u64,
}

impl Hdf5 {
    pub(super) fn open(path: &Path, options: &ReadOptions) -> Result<Self, SourceError> {
        Self::open_layout(path, options).map_err(|what| SourceError::malformed(path, what))
    }

    fn open_layout(path: &Path, options: &ReadOptions) -> Result<Self, String> {
        // Every chunk is read once and in order: a cache would only take memory.
        let filters = Filters::default();
        let how = OpenOptions::default()
            .with_chunk_cache_bytes(0)
            .with_max_chunk_bytes(MAX_CHUNK_BYTES)
            .with_max_read_bytes(MAX_READ_BYTES)
            .with_filter_registry(filters.registry());
        let structure = |e: Error| unreadable("the HDF5 structure", &e);
        let file = File::open(path).map_err(|e| structure(e.into()))?;
        let same = file.try_clone().map_err(|e| structure(e.into()))?;
        let storage = FileStorage::from_file(same).map_err(structure)?;
        let hdf5 = Hdf5File::from_storage_with_options(Arc::new(storage), how).map_err(structure)?;
        let file = Opened {
            hdf5,
            filters,
            file: Arc::new(file),
        };
        let root = file.hdf5.root_group();
        let root = root.map_err(|e| unreadable("the HDF5 root", &e))?;
        if let Some(cd) = group(&root, "CD")?
            && let Some(events) = dataset(&file, &cd, "/CD/", "events")?
        {
            return Self::compound(path, &file, &root, events);
        }
        let Some(events) = group(&root, "events")? else {
            return Err(format!(
                "has no group /events and no /CD/events (found: {}); the layouts of NSAVP, DSEC, E2VID and Prophesee are read",
                content(&root)
            ));
        };
        Self::columns(path, &file, root, &events, options)
    }

    fn compound(path: &Path, file: &Opened, root: &Group, events: Dataset) -> Result<Self, String> {
        check_shape(prophesee::PATH, &events)?;
        let events = prophesee::column(Stored::new(file, events))?;
        let triggers = Skipped {
            what: "external triggers".to_owned(),
            count: prophesee::triggers(root),
        };
        let mut skipped = vec![triggers];
        skipped.retain(|s| s.count > 0);
        Ok(Self {
            path: path.to_owned(),
            format: prophesee::FORMAT,
            unit: (TimeUnit::Us, "format"),
            sensor: sensor::of(&[("/", root)])?,
            skipped,
            len: not_empty(events.len())?,
            body: Body::Compound(Box::new(events)),
            position: 0,
        })
    }

    fn columns(
        path: &Path,
        file: &Opened,
        root: Group,
        events: &Group,
        options: &ReadOptions,
    ) -> Result<Self, String> {
        let there = events.member_names().map_err(|e| unreadable("/events", &e))?.1;
        let has = |name: &&&str| there.iter().any(|n| n == **name);
        let fits = |layout: &Layout| layout.names.iter().filter(has).count();
        let best = LAYOUTS.iter().map(fits).max().unwrap_or(0);
        let layout = LAYOUTS
            .iter()
            .find(|l| best > 0 && fits(l) == best)
            .ok_or_else(|| {
                let wanted = LAYOUTS.each_ref().map(|l| l.names.join(" "));
                format!(
                    "has none of the columns {} in /events (found: {}); rename them",
                    wanted.join(" or "),
                    content(events)
                )
            })?;
        let column = |name: &str| {
            let dataset = dataset(file, events, "/events/", name)?.ok_or_else(|| {
                format!(
                    "has no dataset /events/{name} (there: {}); its layout wants {}",
                    content(events),
                    layout.names.join(", ")
                )
            })?;
            let path = format!("/events/{name}");
            check_shape(&path, &dataset)?;
            Ok::<_, String>((path, dataset))
        };
        let [t, x, y, p] = layout.names;
        let (t, x, y, p) = (column(t)?, column(x)?, column(y)?, column(p)?);
        let x = coordinates(x.0, Stored::new(file, x.1), "x")?;
        let y = coordinates(y.0, Stored::new(file, y.1), "y")?;
        let p = polarities(p.0, Stored::new(file, p.1))?;
        let len = t.1.shape().first().copied().unwrap_or(0);
        for (path, other) in [(x.path(), x.len()), (y.path(), y.len()), (p.path(), p.len())] {
            if other != len {
                return Err(format!(
                    "{} has {len} entries but {path} has {other}; they must be as long",
                    t.0
                ));
            }
        }
        not_empty(len)?;
        let sensor = sensor::of(&[("/events", events), ("/", &root)])?;
        let events = Events {
            file,
            root,
            times: t,
            options,
        };
        let Times {
            unit,
            offset_ns,
            index,
        } = (layout.times)(&events)?;
        let scale = 10u64.pow(unit::digits(unit.0).unwrap_or(0));
        let t = column::times(
            events.times.0,
            Stored::new(file, events.times.1),
            scale,
            offset_ns,
        )?;
        Ok(Self {
            path: path.to_owned(),
            format: layout.format,
            unit,
            sensor,
            skipped: Vec::new(),
            body: Body::Columns(Box::new(Columns { t, x, y, p, index })),
            len,
            position: 0,
        })
    }
}

fn not_empty(len: u64) -> Result<u64, String> {
    if len == 0 {
        Err("holds no events".to_owned())
    } else {
        Ok(len)
    }
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
        let outcome = self.body.decode(self.position, out);
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
            format: self.format,
            path: self.path.clone(),
            time_unit: unit::name(self.unit.0),
            time_unit_from: self.unit.1,
            events: Some(self.len),
        }
    }

    fn skipped(&self) -> Vec<Skipped> {
        self.skipped.clone()
    }

    fn seek_before(&mut self, t_ns: u64) -> Result<Option<u64>, SourceError> {
        let before = self
            .body
            .seek(t_ns, self.len)
            .map_err(|what| SourceError::malformed(&self.path, what))?;
        self.position = before;
        Ok(Some(before))
    }
}
