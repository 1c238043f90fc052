//! `evpr`: onboard visual place recognition for event cameras.

#![warn(clippy::print_stdout)] // results go through `output`, which survives a reader that hangs up

mod args;
mod canvas;
mod catalog;
mod chain;
mod colors;
mod commands;
mod comparison;
mod dashboard;
mod demo;
mod failure;
mod figure;
mod frames_npy;
mod kept;
mod matches;
mod output;
mod preset;
mod profile;
mod progress;
mod query_frames;
mod seen;
mod study;

use clap::Parser;
use std::io::IsTerminal;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// Says what is logged, as in `EVPR_LOG=debug`.
const LOG_VARIABLE: &str = "EVPR_LOG";
const DEFAULT_LOG: &str = "info,iceoryx2=error,iceoryx2_log=off,ort=warn";
/// With `--quiet`: what is degraded or wrong.
const QUIET_LOG: &str = "warn,iceoryx2=error,iceoryx2_log=off";

fn main() -> ExitCode {
    let args = args::Args::parse();
    let default = if args.quiet() { QUIET_LOG } else { DEFAULT_LOG };
    let filter = EnvFilter::try_from_env(LOG_VARIABLE).unwrap_or_else(|_| EnvFilter::new(default));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false);
    log.with_ansi(std::io::stderr().is_terminal()).init();
    match commands::dispatch(args.command) {
        Ok(code) => code,
        Err(failure) => failure.report(),
    }
}
