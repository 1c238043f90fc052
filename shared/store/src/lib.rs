//! Traverses on disk: reference maps and recorded queries.
//!
//! A finished traverse is a folder:
//!
//! | file | holds |
//! |---|---|
//! | `traverse.json` | the manifest: format and version, sensor, slicing, members with their fingerprints, counts |
//! | `ticks.csv` | `tick,start_us,end_us,east_m,north_m`; the positions are empty where they are not known |
//! | `rows/<member>.npy` | R×D little-endian `f32` (or `f16`), C order; ticks without a row are zero rows |
//! | `rows/<member>.present.npy` | R `bool`: which ticks have a row |
//!
//! R is the number of ticks and D the member's dimension; row i belongs to tick i. A member's name holds a slash, so
//! its files lie in a subfolder: `rows/event_count@250ms/mixvpr.npy`. `numpy.load(…, mmap_mode="r")` reads them all.
//!
//! While it is recorded the folder is `<name>.partial` beside the final one. Its rows have room for their headers,
//! which are written last, and `commits.bin` holds one record per tick, written after all else of that tick
//! (see [`TraverseWriter`]). When the process dies at any point, the tick under way is lost; when the machine dies,
//! the ticks since the last synchronisation with the disk are, which begins once per second. [`repair`] closes what
//! was left.
//!
//! Files of a finished traverse are never changed in place: what is replaced is replaced by renaming.

mod commit;
mod difference;
mod disk;
mod error;
mod files;
mod ground_truth;
mod layout;
mod manifest;
mod mapped;
mod npy;
mod positions;
mod recover;
mod repair;
mod sync;
mod ticks;
mod traverse;
mod verify;
mod writer;

#[cfg(test)]
mod test_support;
#[cfg(test)]
mod tests;

pub use difference::Difference;
pub use error::StoreError;
pub use ground_truth::{GroundTruth, Orientation, Recall};
pub use layout::partial_path;
pub use manifest::{FORMAT, Manifest, MemberEntry, NewMember, NewTraverse, VERSION};
pub use npy::NpyHeader;
pub use positions::set_positions;
pub use repair::{RepairSummary, repair};
pub use ticks::TickRecord;
pub use traverse::{MemberRows, Traverse};
pub use verify::{MemberSummary, VerifySummary, verify};
pub use writer::TraverseWriter;

#[cfg(target_endian = "big")]
compile_error!("rows are little-endian and mapped as they are: evpr-store needs a little-endian machine");
