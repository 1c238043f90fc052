//! What each target does with its bytes. The normal tests replay the corpus through the same functions
//! (`shared/events/tests/corpus.rs`).

mod prophesee;
mod recordings;

pub use prophesee::{dat, evt2, evt3, evt21};
pub use recordings::{aedat2, aedat4, es, hdf5, mcap, npy, npz, rosbag, rosbag2};

/// A target by its name, which is also its folder's in `corpus`.
pub type Target = (&'static str, fn(&[u8]));

/// Every target.
pub const TARGETS: &[Target] = &[
    ("aedat2", aedat2),
    ("aedat4", aedat4),
    ("dat", dat),
    ("es", es),
    ("evt2", evt2),
    ("evt21", evt21),
    ("evt3", evt3),
    ("hdf5", hdf5),
    ("mcap", mcap),
    ("npy", npy),
    ("npz", npz),
    ("rosbag", rosbag),
    ("rosbag2", rosbag2),
];
