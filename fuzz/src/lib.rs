//! Fuzz targets: what is done with bytes that nobody vouches for, one module per crate that decodes. The tests of those
//! crates (`tests/corpus.rs`) replay the corpus through the same functions.

pub mod config;
pub mod events;
pub mod frames;
mod memory;
mod panics;
pub mod replay;
pub mod store;

pub use memory::allow_mib;
pub use panics::allow_panics_in;
