//! What can be said for sure: differences over pairs of traverses, and intervals over queries.

mod bootstrap;
mod compare;
mod members;
mod significance;

pub use bootstrap::{Interval, recall_interval};
pub use compare::{Comparison, comparisons};
pub use members::{Members, members};
pub use significance::{paired_t, welch, wilcoxon};
