//! Extractors: the stages that turn frames into rows (descriptors).
//!
//! One [`Extract`] is one extractor of the plan; it serves every reconstruction and window of it. A kind is one file
//! and one row of the `registry`: it knows how to turn an image into numbers; headers, members and reasons are the
//! driver's affair.

mod antialias;
mod driver;
mod hog;
mod kind;
mod network;
mod normalise;
mod patch_norm;
mod preprocess;
mod raw_pixels;
mod registry;
mod resize;

pub use driver::{BuildError, Extract, build};
pub use registry::{KINDS, kinds};
