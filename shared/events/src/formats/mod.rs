//! The formats, one file each, and the registry that finds the right one.

mod aedat2;
mod aedat4;
pub(crate) mod decimal;
mod es;
mod hdf5;
pub(crate) mod lines;
mod number;
mod numpy;
mod packed;
#[cfg(feature = "parquet")]
mod parquet;
pub mod prophesee;
mod ros;
mod text;
mod unit;

use crate::{Input, Recording, SourceError, zip};
use evpr_core::plan::{Sensor, TimeUnit};
use prophesee::Prophesee;
use std::path::Path;

/// Bytes by which a format is known.
const HEAD_BYTES: usize = 4096;

/// Bytes by which a stream is known: it may have sent only a little yet.
const LIVE_HEAD_BYTES: usize = 16;

/// What a reader needs to be told where the recording itself does not say it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Unit of times; counts where a format leaves it open, as text does.
    pub time_unit: TimeUnit,
    /// Which stream, topic or member of an archive to read where there are several; else the first one.
    pub stream: Option<String>,
    /// Size of the sensor, where the caller knows it.
    pub sensor: Option<Sensor>,
    /// Says that these are the bare words of a Prophesee sensor in this encoding, as a live pipe may carry them: no
    /// other format is looked for, and the header may be missing.
    pub encoding: Option<prophesee::Encoding>,
}

/// Where the HDF5 signature may stand: at the start, or behind a user block of these sizes.
const HDF5_SIGNATURE_AT: [usize; 4] = [0, 512, 1024, 2048];
const HDF5_SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";

/// Whether a file begins as HDF5 does.
pub(crate) fn is_hdf5(head: &[u8]) -> bool {
    let at = |at: &usize| head.get(*at..).is_some_and(|b| b.starts_with(HDF5_SIGNATURE));
    HDF5_SIGNATURE_AT.iter().any(at)
}

fn is_text(head: &[u8]) -> bool {
    !head.contains(&0)
}

type Opened = Result<Box<dyn Recording>, SourceError>;

/// How a format is opened.
enum Open {
    /// From its bytes in order: also from a pipe, or inside gzip or zip.
    Stream(fn(Input, &ReadOptions) -> Opened),
    /// By its path: it is read in any order.
    File(fn(&Path, &ReadOptions) -> Opened),
}

/// A format: one row of the registry.
struct Format {
    /// Endings of file names, without the point, in lower case.
    extensions: &'static [&'static str],
    detects: fn(&[u8]) -> bool,
    /// Whether `detects` is sure: otherwise a known ending of another format speaks against it.
    conclusive: bool,
    open: Open,
    /// What is wrong with a file of this ending that is not of this format.
    otherwise: &'static str,
}

/// All formats; the first that knows the content takes it.
static FORMATS: &[Format] = &[
    Format {
        extensions: &["raw", "dat"],
        detects: prophesee::begins,
        conclusive: true,
        open: Open::Stream(|input, options| Ok(Box::new(Prophesee::open(input, options.encoding)?))),
        otherwise: "has the ending of a Prophesee recording but not its header (lines that begin with \"% \"); it is \
                    damaged, of another format, or bare words whose encoding must be said",
    },
    Format {
        extensions: &["aedat4"],
        detects: |head| head.starts_with(aedat4::FIRST_LINE),
        conclusive: true,
        open: Open::Stream(|input, options| Ok(Box::new(aedat4::Aedat4::open(input, options)?))),
        otherwise: "has the ending of an AEDAT4 file but not its first line; it is damaged or of another format",
    },
    Format {
        extensions: &["aedat", "aedat2"],
        detects: |head| head.starts_with(aedat2::FIRST_LINE),
        conclusive: true,
        open: Open::Stream(|input, options| Ok(Box::new(aedat2::Aedat2::open(input, options)?))),
        otherwise: "has the ending of an AEDAT file but not its first line; it is of version 1.0, which is not read, \
                    damaged, or of another format",
    },
    Format {
        extensions: &["es"],
        detects: |head| head.starts_with(es::SIGNATURE),
        conclusive: true,
        open: Open::Stream(|input, options| Ok(Box::new(es::Es::open(input, options)?))),
        otherwise: "has the ending of an Event Stream file but not its signature; it is damaged or of another format",
    },
    Format {
        extensions: &["h5", "hdf5", "he5"],
        detects: is_hdf5,
        conclusive: true,
        open: Open::File(|path, options| Ok(Box::new(hdf5::Hdf5::open(path, options)?))),
        otherwise: "has the ending of an HDF5 file but not its signature; it is damaged or of another format",
    },
    Format {
        extensions: &["npy"],
        detects: |head| head.starts_with(numpy::MAGIC),
        conclusive: true,
        open: Open::Stream(|input, options| Ok(Box::new(numpy::Numpy::open(input, options.time_unit)?))),
        otherwise: "has the ending of a NumPy array but not its signature; it is damaged or of another format",
    },
    Format {
        extensions: &["bag"],
        detects: |head| head.starts_with(ros::BAG_MAGIC),
        conclusive: true,
        open: Open::Stream(|input, options| Ok(Box::new(ros::Ros::bag(input, options)?))),
        otherwise: "has the ending of a bag of ROS 1 but not its first line; it is damaged or of another format",
    },
    Format {
        extensions: &["mcap"],
        detects: |head| head.starts_with(ros::MCAP_MAGIC),
        conclusive: true,
        open: Open::Stream(|input, options| Ok(Box::new(ros::Ros::mcap(input, options)?))),
        otherwise: "has the ending of an MCAP file but not its signature; it is damaged or of another format",
    },
    Format {
        extensions: &["db3"],
        detects: |head| head.starts_with(ros::SQLITE_MAGIC),
        conclusive: true,
        open: Open::File(|path, options| Ok(Box::new(ros::Ros::bag2(path, options)?))),
        otherwise: "has the ending of a bag of ROS 2 in SQLite but not its signature; it is damaged or of another \
                    format",
    },
    Format {
        extensions: &["parquet", "pq"],
        detects: |head| head.starts_with(PARQUET_MAGIC),
        conclusive: true,
        open: Open::File(open_parquet),
        otherwise: "has the ending of a Parquet file but not its signature; it is damaged or of another format",
    },
    Format {
        extensions: &["gz"],
        detects: |head| head.starts_with(packed::GZIP_MAGIC),
        conclusive: true,
        open: Open::Stream(packed::gzip),
        otherwise: "has the ending of a gzip file but not its signature; it is damaged or not packed at all",
    },
    Format {
        extensions: &["zip", "npz"],
        detects: |head| head.starts_with(zip::MAGIC),
        conclusive: true,
        open: Open::File(packed::zip),
        otherwise: "has the ending of a zip archive but not its signature, or holds nothing; it is damaged or not \
                    packed at all",
    },
    Format {
        extensions: &["txt", "csv", "tsv"],
        detects: is_text,
        conclusive: false,
        open: Open::Stream(|input, options| Ok(Box::new(text::Text::open(input, options.time_unit)?))),
        otherwise: "has the ending of a text file but is not text",
    },
];

/// What is read, for messages.
const READ: &str = "Prophesee RAW and DAT, AEDAT4, AEDAT 2.0, Event Stream, HDF5, NumPy, bags of ROS 1 and ROS 2, \
                    MCAP, Parquet (where built in), and text lines \"t x y p\", most also inside gzip or zip";

const PARQUET_MAGIC: &[u8] = b"PAR1";

#[cfg(feature = "parquet")]
fn open_parquet(path: &Path, options: &ReadOptions) -> Opened {
    Ok(Box::new(parquet::Parquet::open(path, options.time_unit)?))
}

#[cfg(not(feature = "parquet"))]
fn open_parquet(path: &Path, _: &ReadOptions) -> Opened {
    Err(SourceError::malformed(
        path,
        "is Parquet, which this build does not read; build evpr with --features parquet",
    ))
}

/// Formats that are known by their first bytes, and not read.
static UNREADABLE: &[(&[u8], &str)] = &[
    (b"#!AER-DAT1", "AEDAT 1.0"),
    (b"#!AER-DAT3", "AEDAT 3"),
    (
        b"version https://git-lfs",
        "a Git LFS pointer, not the file itself",
    ),
];

/// Opens a recording. Its format is known by its content; where that is not conclusive, by its name's ending. The folder
/// of a bag of ROS 2 stands for the file in it.
///
/// # Errors
/// One line, when it does not exist, cannot be read, is empty or of no known format, or holds no events.
pub fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn Recording>, SourceError> {
    if ros::is_folder(path) {
        let storage = ros::storage(path)?;
        return open_known(Input::open(&storage)?, &storage, Place::File(&storage), options);
    }
    open_known(Input::open(path)?, path, Place::File(path), options)
}

/// Opens a recording that comes as bytes in order. Formats that are read in any order are refused.
///
/// # Errors
/// As [`open`].
pub fn open_input(input: Input, options: &ReadOptions) -> Result<Box<dyn Recording>, SourceError> {
    let path = input.path().to_owned();
    open_known(input, &path, Place::Pipe, options)
}

/// Opens what DV software serves over a network: AEDAT4 without the first line. Events are given as they arrive; the
/// end of the connection between two packets is the end of the recording.
///
/// # Errors
/// One line, when the header cannot be read or names no such stream of events as `options` ask for.
pub fn aedat4_network(input: Input, options: &ReadOptions) -> Result<Box<dyn Recording>, SourceError> {
    Ok(Box::new(aedat4::Aedat4::network(input, options)?))
}

/// Where the bytes of an input stand.
#[derive(Clone, Copy)]
enum Place<'a> {
    /// They are just those of this file.
    File(&'a Path),
    /// Inside a file that is being unpacked.
    Packed,
    /// In a pipe or a connection.
    Pipe,
}

/// `name` is what the recording itself is called: its ending may count.
fn open_known(mut input: Input, name: &Path, place: Place<'_>, options: &ReadOptions) -> Opened {
    let path = input.path().to_owned();
    let len = match place {
        // What is known already needs no look: a live stream may send little at first.
        _ if options.encoding.is_some() => 1,
        Place::Pipe => LIVE_HEAD_BYTES,
        _ => HEAD_BYTES,
    };
    let head = input.peek(len)?;
    let head = &head[..head.len().min(HEAD_BYTES)];
    if head.is_empty() {
        return Err(SourceError::malformed(
            &path,
            "is empty (0 bytes); it holds no events",
        ));
    }
    if options.encoding.is_some() {
        return Ok(Box::new(Prophesee::open(input, options.encoding)?));
    }
    if let Some((_, name)) = UNREADABLE.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Err(SourceError::malformed(
            &path,
            format!("is {name}; this build reads {READ}"),
        ));
    }
    let extension = name
        .extension()
        .filter(|_| !matches!(place, Place::Pipe))
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let named = FORMATS
        .iter()
        .find(|f| f.extensions.contains(&extension.as_str()));
    let found = match (FORMATS.iter().find(|f| (f.detects)(head)), named) {
        // A guess does not overrule the name.
        (Some(found), Some(named)) if !std::ptr::eq(found, named) && !found.conclusive => {
            return Err(SourceError::malformed(&path, named.otherwise));
        }
        (Some(found), _) => found,
        (None, Some(named)) => return Err(SourceError::malformed(&path, named.otherwise)),
        (None, None) => {
            return Err(SourceError::malformed(
                &path,
                format!("is of no known format; this build reads {READ}"),
            ));
        }
    };
    match (&found.open, place) {
        (Open::Stream(open), _) => open(input, options),
        (Open::File(open), Place::File(path)) => open(path, options),
        (Open::File(_), _) => Err(SourceError::malformed(
            &path,
            "is of a format that is read in any order, but its bytes come one after another here; \
             unpack it into a file first",
        )),
    }
}
