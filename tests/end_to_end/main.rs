//! End-to-end tests over real processes. Each has an instance of its own (its own names in shared memory), a watchdog,
//! and looks afterwards whether anything was left behind.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // tests; clippy sees only #[test] functions as such

mod bad_input;
mod browser;
mod convert;
mod corridor;
mod dashboard;
mod dashboard_page;
mod dataset;
mod deaths;
mod demo;
mod evaluate;
mod evaluate_corridor;
mod evaluate_refusals;
mod frames;
mod hangs;
mod live;
mod members;
mod networks;
mod noise;
mod packaging;
mod permissions;
mod placement;
mod profile;
mod replay;
mod replay_live;
mod report;
mod rogue;
mod steering;
mod support;
