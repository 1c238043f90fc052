//! The command line.

mod dataset;
mod evaluate;
mod events;
mod instance;
mod models;
mod run;

pub(crate) use dataset::*;
pub(crate) use evaluate::*;
pub(crate) use events::*;
pub(crate) use instance::*;
pub(crate) use models::*;
pub(crate) use run::*;

use clap::{Parser, Subcommand};
use evpr_core::time::parse_duration_ns;
use std::path::PathBuf;

/// Onboard visual place recognition for event cameras.
#[derive(Debug, Parser)]
#[command(
    name = "evpr",
    version,
    about,
    max_term_width = 100,
    arg_required_else_help = true
)]
pub(crate) struct Args {
    #[command(subcommand)]
    pub(crate) command: Command,
}

impl Args {
    /// Whether only what is wrong shall be said.
    pub(crate) fn quiet(&self) -> bool {
        match &self.command {
            Command::Run(args) => args.graph.quiet,
            Command::Replay(args) => args.quiet,
            Command::Map(MapCommand::Build(args)) => args.graph.quiet,
            // They say themselves what they do.
            Command::Demo(_) | Command::Evaluate(_) => true,
            _ => false,
        }
    }
}

/// What to do.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Show it all on a simulated street: map it by day, recognise it by day and night, write a report
    Demo(DemoArgs),
    /// Start the graph: events in, place matches out, one JSON line per tick
    Run(RunArgs),
    /// A recorded run once more, through the same graph: the same answers, or the first that differs
    Replay(ReplayArgs),
    /// Reference maps: build, look at, check, repair
    #[command(subcommand)]
    Map(MapCommand),
    /// Recordings: look at them, convert them, turn them into frames and pictures
    #[command(subcommand)]
    Events(EventsCommand),
    /// Published datasets: what is there of one, what is missing, configurations for its pairs
    #[command(subcommand)]
    Dataset(DatasetCommand),
    /// Networks: which there are, whether they can be used, how fast they are
    #[command(subcommand)]
    Models(ModelsCommand),
    /// Members of a running instance: list them, switch them, weigh them
    #[command(subcommand)]
    Member(MemberCommand),
    /// Recall of recorded traverses: subsets of members, sequence methods and rules in one run
    Evaluate(EvaluateArgs),
    /// The members that recognise most for a given time per tick
    Choose(ChooseArgs),
    /// How a running instance is: processes, times, members
    Status(InstanceArgs),
    /// The live view of a running instance; members can be switched in it
    Top(TopArgs),
    /// Change a running instance from the next tick on: sequence length, fusion rule, deadline, confidence
    Set(SetArgs),
    /// Record what the processes of a running instance do when, for ui.perfetto.dev
    Trace(TraceArgs),
    /// The sequence matcher alone: a similarity matrix in, matched scores out
    SequenceMatch(SequenceMatchArgs),
    /// Check a configuration; prints all mistakes at once
    Validate(ConfigArgs),
    /// Show the plan of a configuration: processes, channels, bytes
    Graph(GraphArgs),
    /// Check whether this machine is fit: shared memory, limits, processor, clocks
    Doctor(DoctorArgs),
    /// Print the completions of a shell
    Completion(CompletionArgs),
    /// One process of a running graph; started by `evpr run`
    #[command(hide = true)]
    Service(ServiceArgs),
}

#[derive(Debug, Parser)]
pub(crate) struct DemoArgs {
    /// Where to write the report (a new folder, or an earlier report, which is replaced)
    #[arg(short, long, value_name = "DIR", default_value = "demo-report")]
    pub(crate) out: PathBuf,
    /// What the street is drawn from
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u32,
    /// No progress, only the results
    #[arg(short, long)]
    pub(crate) quiet: bool,
    /// The results as JSON
    #[arg(long)]
    pub(crate) json: bool,
    /// A short street and a small sensor: for tests
    #[arg(long, hide = true)]
    pub(crate) quick: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct ConfigArgs {
    /// The configuration (TOML)
    #[arg(short, long, value_name = "FILE")]
    pub(crate) config: PathBuf,
}

fn duration(text: &str) -> Result<u64, String> {
    parse_duration_ns(text)
}

#[derive(Debug, Parser)]
pub(crate) struct GraphArgs {
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// The recording (or the pass of the simulated street), instead of the configuration's
    #[arg(short, long, value_name = "FILE")]
    pub(crate) input: Option<PathBuf>,
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct DoctorArgs {
    /// Check the room for this configuration too
    #[arg(short, long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct CompletionArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    pub(crate) shell: clap_complete::Shell,
}

fn weight(text: &str) -> Result<f64, String> {
    let weight = text.parse::<f64>().ok().filter(|w| w.is_finite() && *w >= 0.0);
    weight.ok_or_else(|| "not a weight; give a number of 0 or more".to_owned())
}
