//! `evpr events`: recordings without a graph.

mod chain;
mod convert;
mod crop;
mod hot_pixels;
mod info;
mod pictures;
mod reconstruct;
mod render;

pub(crate) use crop::Crop;

use crate::args::EventsCommand;
use crate::failure::Failure;
use std::process::ExitCode;

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
