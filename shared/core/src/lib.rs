//! The contracts of evpr: what the processes say to one another, what a stage is, who the members of
//! the ensemble are, and how a configuration becomes a plan.
//!
//! Nothing here does I/O, starts threads or knows about shared memory: every other crate builds on this one.

pub mod config;
pub mod governor;
pub mod ledger;
pub mod member;
pub mod message;
pub mod plan;
pub mod stage;
pub mod time;

pub use member::{End, MemberSet, Reason};
pub use message::Message;
pub use plan::Plan;
