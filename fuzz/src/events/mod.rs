//! Recordings, files of positions, and lists of pixels.

mod positions;
mod prophesee;
mod recordings;

pub use positions::{applanix, nmea, pixels, positions_csv};
pub use prophesee::{dat, evt2, evt3, evt21};
pub use recordings::{aedat2, aedat4, es, gzip, hdf5, mcap, npy, npz, parquet, rosbag, rosbag2, text};

use crate::replay::Target;
use std::path::PathBuf;
use std::{env, fs, process, thread};

/// Every target of this module.
pub const TARGETS: &[Target] = &[
    ("aedat2", aedat2),
    ("aedat4", aedat4),
    ("applanix", applanix),
    ("dat", dat),
    ("es", es),
    ("evt2", evt2),
    ("evt21", evt21),
    ("evt3", evt3),
    ("gzip", gzip),
    ("hdf5", hdf5),
    ("mcap", mcap),
    ("nmea", nmea),
    ("npy", npy),
    ("npz", npz),
    ("parquet", parquet),
    ("pixels", pixels),
    ("positions_csv", positions_csv),
    ("rosbag", rosbag),
    ("rosbag2", rosbag2),
    ("text", text),
];

/// A file of these bytes, for as long as this lives.
struct Written(PathBuf);

impl Written {
    fn new(data: &[u8], extension: &str) -> Self {
        let (process, thread) = (process::id(), thread::current().id());
        let path = env::temp_dir().join(format!("evpr-fuzz-{process}-{thread:?}.{extension}"));
        assert!(
            fs::write(&path, data).is_ok(),
            "{} cannot be written",
            path.display()
        );
        Self(path)
    }
}

impl Drop for Written {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}
