//! `evpr events`: recordings without a graph.

mod convert;
mod crop;
mod hot_pixels;
mod info;
mod pictures;
mod plan;
mod reconstruct;
mod render;

pub(crate) use crop::Crop;

use crate::args::EventsCommand;
use crate::failure::Failure;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::fmt::Display;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// `evpr events …`.
pub(crate) fn events(command: EventsCommand) -> Result<ExitCode, Failure> {
    match command {
        EventsCommand::Info(args) => info::info(&args),
        EventsCommand::HotPixels(args) => hot_pixels::hot_pixels(&args),
        EventsCommand::Reconstruct(args) => reconstruct::reconstruct(&args),
        EventsCommand::Convert(args) => convert::convert(&args),
        EventsCommand::Render(args) => render::render(&args),
    }
}

/// Refuses to write over something, unless that is wanted.
fn check_target(out: &Path, force: bool) -> Result<(), Failure> {
    if out.exists() && !out.is_file() && !out.is_dir() {
        return Err(Failure::new(format!(
            "{} is no regular file; name a file to write",
            out.display()
        )));
    }
    if out.exists() && !force {
        return Err(Failure::new(format!(
            "{} exists already; give --force to replace it",
            out.display()
        )));
    }
    Ok(())
}

/// True after the first Ctrl-C or SIGTERM.
fn interrupted() -> Result<Arc<AtomicBool>, Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, flag.clone())
            .map_err(|e| Failure::new(format!("cannot listen for signals: {e}")))?;
    }
    Ok(flag)
}

/// A recording could not be read to its end; what came of it before is kept.
fn kept(error: impl Display, count: u64, what: &str, out: &Path) -> Failure {
    if count == 0 {
        return Failure::new(format!("{error}; nothing before that could be written"));
    }
    Failure::new(format!(
        "{error}; the {count} {what} before that are kept in {}",
        out.display()
    ))
}
