//! End-to-end tests over real processes. Each has an instance of its own (its own names in shared memory), a watchdog,
//! and looks afterwards whether anything was left behind.

mod bad_input;
mod corridor;
mod deaths;
mod members;
mod replay;
mod support;
