//! The demonstration: a simulated street, mapped on a first drive and recognised on two others, with everything that is
//! shown about it measured.
//!
//! 1. [`setup`]: the configuration, which is part of the executable, and the plans made of it;
//! 2. [`graph`]: a pass through the real process graph;
//! 3. [`recall`]: Recall@1 of every ensemble from the recorded rows, by the fuser's own functions, and [`matrix`], the
//!    fused scores of all of them;
//! 4. [`latency`]: what the stages took in real time;
//! 5. [`frames`]: what the methods see at one place;
//! 6. [`results`], [`pictures`] and [`page`]: the report, in the folder that [`folder`] looks after.

pub(crate) mod folder;
pub(crate) mod frames;
pub(crate) mod graph;
pub(crate) mod latency;
pub(crate) mod matrix;
pub(crate) mod page;
pub(crate) mod pictures;
pub(crate) mod recall;
pub(crate) mod results;
pub(crate) mod setup;
