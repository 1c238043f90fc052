//! One file per command.

mod events;
mod graph;
mod map;
mod member;
mod run;
mod sequence_match;
mod service;

use crate::args::Command;
use crate::failure::Failure;
use std::process::ExitCode;

/// Does what was asked.
pub(crate) fn dispatch(command: Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Run(args) => run::run(&args),
        Command::Map(command) => map::map(command),
        Command::Events(command) => events::events(command),
        Command::Member(command) => member::member(command),
        Command::SequenceMatch(args) => sequence_match::sequence_match(&args),
        Command::Validate(args) => graph::validate(&args),
        Command::Graph(args) => graph::graph(&args),
        Command::Service(args) => service::service(&args),
    }
}
