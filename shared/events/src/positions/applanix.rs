//! NSAVP's poses: HDF5 with `/pose_base_link/{timestamps u64 ns, positions f64 N×3}`, positions earth-centred, in
//! metres (<https://github.com/umautobots/nsavp_tools>, `documentation/data_format.md`).
//!
//! They become latitude and longitude, so that two drives share one frame whatever their first positions are. In
//! compatibility with the authors' code they stay earth-centred x and y, in which a metre north counts as 0.67 m.

use super::{Fixes, Reading, wgs84};
use crate::SourceError;
use evpr_core::plan::{PositionCompat, Positions};
use hdf5_reader::{Dataset, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem};
use std::path::Path;

/// Largest chunk that is decoded, bytes.
const MAX_CHUNK_BYTES: usize = 64 << 20;
/// Poses that are read at once.
const BLOCK: u64 = 1 << 16;
const GROUP: &str = "pose_base_link";

/// Reads all positions.
pub(super) fn read(path: &Path, options: &Positions) -> Result<Reading, SourceError> {
    read_layout(path, options).map_err(|what| match what {
        Wrong::Layout(what) => SourceError::malformed(path, what),
        Wrong::Source(error) => error,
    })
}

enum Wrong {
    Layout(String),
    Source(SourceError),
}

impl From<String> for Wrong {
    fn from(what: String) -> Self {
        Self::Layout(what)
    }
}

fn read_layout(path: &Path, options: &Positions) -> Result<Reading, Wrong> {
    let paper = options.compat == PositionCompat::Paper;
    let options = OpenOptions::default()
        .with_chunk_cache_bytes(0)
        .with_max_chunk_bytes(MAX_CHUNK_BYTES);
    let file =
        Hdf5File::open_with_options(path, options).map_err(|e| unreadable("the HDF5 structure", &e))?;
    let root = file.root_group().map_err(|e| unreadable("the HDF5 root", &e))?;
    let group = root.group(GROUP).map_err(|e| match e {
        hdf5_reader::error::Error::GroupNotFound(_) => {
            format!("has no group /{GROUP}; of HDF5 files, NSAVP's *_applanix.h5 holds positions")
        }
        e => unreadable(&format!("/{GROUP}"), &e),
    })?;
    let dataset = |name: &str| {
        let what = format!("/{GROUP}/{name}");
        group.dataset(name).map_err(|e| unreadable(&what, &e))
    };
    let (times, places) = (dataset("timestamps")?, dataset("positions")?);
    let count = match (times.shape(), places.shape()) {
        ([n], [m, 3]) if n == m => *n,
        (times, places) => {
            return Err(Wrong::Layout(format!(
                "/{GROUP}/timestamps has the shape {times:?} and positions {places:?}; they must be [n] and [n, 3]"
            )));
        }
    };
    let mut fixes = Fixes::new(path);
    let mut first_ns = None;
    for start in (0..count).step_by(BLOCK as usize) {
        let rows = SliceInfoElem::Slice {
            start,
            end: (start + BLOCK).min(count),
            step: 1,
        };
        let all = SliceInfoElem::Slice {
            start: 0,
            end: 3,
            step: 1,
        };
        let t: Vec<u64> = read_block(&times, "timestamps", vec![rows.clone()])?;
        let xyz: Vec<f64> = read_block(&places, "positions", vec![rows, all])?;
        for ((t_ns, xyz), row) in t.iter().zip(xyz.chunks_exact(3)).zip(start..) {
            let t_ns = i64::try_from(*t_ns).map_err(|_| {
                format!("pose {row} (from 0) is at {t_ns} ns, beyond the year 2262; it is damaged")
            })?;
            first_ns.get_or_insert(t_ns);
            let xyz = [xyz[0], xyz[1], xyz[2]];
            let degrees = wgs84::geodetic(xyz).ok_or_else(|| {
                format!(
                    "pose {row} (from 0) is at {xyz:?}, which is not within 100 km of the ground; positions must be \
                     earth-centred metres"
                )
            })?;
            let place = if paper {
                [xyz[0], xyz[1]]
            } else {
                [degrees[0], degrees[1]]
            };
            fixes.push(t_ns, place).map_err(Wrong::Source)?;
        }
    }
    Ok(Reading {
        format: "HDF5 (NSAVP poses)",
        geographic: !paper,
        first_ns: first_ns.unwrap_or(0),
        fixes,
        passed_over: 0,
    })
}

fn read_block<T: hdf5_reader::H5Type + Clone>(
    dataset: &Dataset,
    name: &str,
    selections: Vec<SliceInfoElem>,
) -> Result<Vec<T>, String> {
    let array = dataset
        .read_slice::<T>(&SliceInfo { selections })
        .map_err(|e| unreadable(&format!("/{GROUP}/{name}"), &e))?;
    Ok(array.into_raw_vec_and_offset().0)
}

fn unreadable(what: &str, e: &hdf5_reader::error::Error) -> String {
    format!("{what} cannot be read: {e}; the file is truncated, damaged or of another layout")
}
