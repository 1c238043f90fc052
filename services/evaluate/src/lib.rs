//! Evaluation of recorded traverses: which answers each ensemble gives, and how many of them are right.
//!
//! A [`Pair`] is a reference map, a query traverse and the ground truth between them. A [`Spec`] says what is compared:
//! members and subsets of them, similarities, sequence methods, lengths and fusion rules. [`evaluate`] streams the
//! queries of each pair once: every similarity row is computed once and shared by all configurations, every matched
//! score once per method and length. The answers come from the functions of `evpr-fuse` that the running fuser calls.
//! What comes out is one [`Row`] per configuration.

pub mod choose;
mod confidence;
mod error;
mod evaluate;
mod fusion;
mod measure;
mod outcome;
mod pair;
mod pair_spec;
pub mod report;
mod results;
mod spec;
pub mod statistics;
mod subsets;
mod sweep;
mod tables;
mod weights;

pub use confidence::{Bin, Trust};
pub use error::EvaluateError;
pub use evaluate::{Progress, evaluate};
pub use measure::{FRAMES, KS, Measures, PrecisionRecall, Share, TOLERANCES_M, measure};
pub use outcome::Outcome;
pub use pair::Pair;
pub use pair_spec::{PairSpec, PairsFile, Truth};
pub use results::{Results, Row};
pub use spec::{Configuration, Spec, SubsetChoice};
pub use subsets::{MemberName, Subset, SubsetKind, subsets};
pub use sweep::bytes_needed;
pub use tables::{Learnt, LearntWeights, thresholds};
pub use weights::{learnt_weights, read_weights};
