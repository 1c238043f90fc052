//! One file per command.

mod choose;
mod dataset;
mod demo;
mod doctor;
mod evaluate;
mod events;
mod graph;
mod map;
mod member;
mod models;
mod replay;
pub(crate) mod run;
mod sequence_match;
mod service;
mod status;
mod top;
mod trace;

pub(crate) use events::Crop;
pub(crate) use status::{ask as ask_status, count as count_text, doing as doing_text, time as time_text};

use crate::args::{Args, Command, CompletionArgs};
use crate::failure::Failure;
use crate::output::say;
use clap::CommandFactory;
use evpr_core::plan::Sensor;
use std::process::ExitCode;

/// Does what was asked.
pub(crate) fn dispatch(command: Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Demo(args) => demo::demo(&args),
        Command::Run(args) => run::run(&args),
        Command::Replay(args) => replay::replay(&args),
        Command::Map(command) => map::map(command),
        Command::Events(command) => events::events(command),
        Command::Dataset(command) => dataset::dataset(&command),
        Command::Models(command) => models::models(&command),
        Command::Member(command) => member::member(command),
        Command::Evaluate(args) => evaluate::evaluate(&args),
        Command::Choose(args) => choose::choose(&args),
        Command::Status(args) => status::status(&args),
        Command::Top(args) => top::top(&args),
        Command::Set(args) => member::set(args),
        Command::Trace(args) => trace::trace(&args),
        Command::SequenceMatch(args) => sequence_match::sequence_match(&args),
        Command::Validate(args) => graph::validate(&args),
        Command::Graph(args) => graph::graph(&args),
        Command::Doctor(args) => doctor::doctor(&args),
        Command::Completion(args) => Ok(completion(&args)),
        Command::Service(args) => service::service(&args),
    }
}

/// `evpr completion`.
fn completion(args: &CompletionArgs) -> ExitCode {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), "evpr", &mut script);
    say!("{}", String::from_utf8_lossy(&script).trim_end());
    ExitCode::SUCCESS
}

/// Reads the size of a sensor, such as `260x346`.
pub(crate) fn parse_sensor(text: &str) -> Result<Sensor, Failure> {
    let parsed = text
        .split_once('x')
        .and_then(|(h, w)| Some((h.parse().ok()?, w.parse().ok()?)));
    let (height, width) = parsed.ok_or_else(|| {
        Failure::usage(format!(
            "--sensor {text} is not a size; write HEIGHTxWIDTH, such as 260x346"
        ))
    })?;
    Ok(Sensor { height, width })
}
