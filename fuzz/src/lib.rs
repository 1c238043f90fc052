//! What each target does with its bytes. The normal tests replay the corpus through the same functions
//! (`shared/events/tests/corpus.rs`).

mod prophesee;

pub use prophesee::{dat, evt2, evt3, evt21};

/// A target by its name, which is also its folder's in `corpus`.
pub type Target = (&'static str, fn(&[u8]));

/// Every target.
pub const TARGETS: &[Target] = &[
    ("dat", dat), //
    ("evt2", evt2),
    ("evt21", evt21),
    ("evt3", evt3),
];
