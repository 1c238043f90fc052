//! Networks: which there are (the registry of models) and how they are computed (ONNX Runtime). This is the only crate
//! that names `ort`.
//!
//! ONNX Runtime is a shared library that is loaded when the first network is: [`Library::load`] says how it is found. A
//! network is checked against its registry entry before it is used: the file's hash, the facts that the file says of
//! itself, and the shapes of its inputs and outputs.

mod describe;
mod error;
mod extractor;
mod library;
mod memory;
mod peak;
mod recipe;
mod reconstruction;
mod registry;
mod session;

pub use describe::{Facts, METADATA_PREFIX};
pub use error::OnnxError;
pub use extractor::{DescriptorNetwork, Descriptors};
pub use library::{LIBRARY_VARIABLE, Library, find_library};
pub use peak::peak_gmacs;
pub use recipe::Recipe;
pub use reconstruction::{FrameNetwork, State};
pub use registry::{Registry, sha256_of};
pub use session::{Loaded, pattern};
