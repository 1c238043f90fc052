//! Running the graph: live, over recordings, into maps.

use super::ConfigArgs;
use clap::{Parser, Subcommand, ValueEnum};
use evpr_core::config::parse_pace;
use evpr_core::plan::Pace;
use std::path::PathBuf;

/// How processes hand data on.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum DeliveryArg {
    /// Every stage waits for the next
    Lossless,
    /// The newest data wins; answers at the deadline
    Latest,
}

/// What every command that starts the graph takes.
#[derive(Debug, Parser)]
pub(crate) struct GraphRunArgs {
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// The recording (or the pass of the simulated street), instead of the configuration's
    #[arg(short, long, value_name = "FILE")]
    pub(crate) input: Option<PathBuf>,
    /// The file of positions that belongs to the recording, instead of the configuration's
    #[arg(long, value_name = "FILE")]
    pub(crate) positions: Option<PathBuf>,
    /// "unpaced", "realtime" or how many times as fast as recorded, instead of the configuration's
    #[arg(long, value_name = "PACE", value_parser = parse_pace)]
    pub(crate) pace: Option<Pace>,
    /// Delivery, instead of the configuration's
    #[arg(long, value_name = "DELIVERY")]
    pub(crate) delivery: Option<DeliveryArg>,
    /// Name of the instance, instead of the configuration's
    #[arg(long, value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// Where to write what each process took (JSON), as `evpr choose --costs` reads it
    #[arg(long, value_name = "FILE")]
    pub(crate) stats: Option<PathBuf>,
    /// No progress bar and no summary
    #[arg(short, long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    pub(crate) graph: GraphRunArgs,
    /// The reference map to match against
    #[arg(short, long, value_name = "DIR")]
    pub(crate) map: Option<PathBuf>,
    /// Where to write the matches: JSON lines, or CSV or MCAP by the name's ending; stdout when left out, but with --keep.
    /// May be repeated
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: Vec<PathBuf>,
    /// Keep the run in this new folder: configuration, versions, hashes, matches, statistics; for `evpr replay`
    #[arg(long, value_name = "DIR")]
    pub(crate) keep: Option<PathBuf>,
    /// Also record the events as they are cut, for `evpr replay`: a new .aedat4; in the folder of --keep when left out
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub(crate) record_events: Option<Option<PathBuf>>,
    /// Also record the rows of this run as a traverse
    #[arg(short, long, value_name = "DIR")]
    pub(crate) record: Option<PathBuf>,
    /// Also serve metrics for Prometheus at this address, such as 127.0.0.1:9464, under /metrics
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) metrics: Option<std::net::SocketAddr>,
    /// Also show the run in a browser, at this address, such as 127.0.0.1:8080
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) dashboard: Option<std::net::SocketAddr>,
    /// Let whoever has the token change members and settings from there; it is printed once, in the page's address
    #[arg(long, requires = "dashboard")]
    pub(crate) allow_control: bool,
    /// The token, in a file, instead of one that is made up and printed
    #[arg(long, value_name = "FILE", requires = "allow_control")]
    pub(crate) token_file: Option<PathBuf>,
    /// Also write what every process does when, for ui.perfetto.dev
    #[arg(long, value_name = "FILE")]
    pub(crate) trace: Option<PathBuf>,
}

#[derive(Debug, Parser)]
pub(crate) struct ReplayArgs {
    /// The folder of a kept run, or the events (.aedat4) that --record-events made
    #[arg(value_name = "RUN")]
    pub(crate) path: PathBuf,
    /// Compare with the answers of the run instead of printing matches; other answers than the kept ones as --check=FILE
    #[arg(long, value_name = "MATCHES", num_args = 0..=1, require_equals = true)]
    pub(crate) check: Option<Option<PathBuf>>,
    /// Another map to match against
    #[arg(short, long, value_name = "DIR")]
    pub(crate) map: Option<PathBuf>,
    /// Where to write the matches: JSON lines, or CSV or MCAP by the name's ending; stdout when left out, but with --check.
    /// May be repeated
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: Vec<PathBuf>,
    /// "unpaced", "realtime" or how many times as fast as recorded
    #[arg(long, value_name = "PACE", value_parser = parse_pace)]
    pub(crate) pace: Option<Pace>,
    /// Name of the instance, instead of the run's
    #[arg(long, value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// Where to write what each process took (JSON)
    #[arg(long, value_name = "FILE")]
    pub(crate) stats: Option<PathBuf>,
    /// No progress bar and no summary
    #[arg(short, long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum MapCommand {
    /// Run the graph over a recording and keep its rows as a reference map
    Build(MapBuildArgs),
    /// Show what a map holds
    Info(MapArgs),
    /// Check every file of a map; exit code 1 when something is wrong
    Verify(MapArgs),
    /// Close an unfinished recording, keeping every committed tick
    Repair(MapArgs),
}

#[derive(Debug, Parser)]
pub(crate) struct MapBuildArgs {
    #[command(flatten)]
    pub(crate) graph: GraphRunArgs,
    /// The map to write (a folder that does not exist yet)
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

#[derive(Debug, Parser)]
pub(crate) struct MapArgs {
    /// The map's folder
    #[arg(value_name = "DIR")]
    pub(crate) path: PathBuf,
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct ServiceArgs {
    /// The run folder of the instance
    #[arg(long, value_name = "DIR")]
    pub(crate) run_folder: PathBuf,
    /// Index of the service in the plan
    #[arg(long)]
    pub(crate) service: usize,
    /// How often it has been started
    #[arg(long)]
    pub(crate) incarnation: u32,
    /// How often ingest has been started
    #[arg(long)]
    pub(crate) epoch: u32,
    /// The tick to begin with
    #[arg(long)]
    pub(crate) first_tick: u64,
    /// The first tick to answer
    #[arg(long)]
    pub(crate) answer_from: u64,
    /// The tick at which the stream ends at the latest
    #[arg(long)]
    pub(crate) end_tick: Option<u64>,
    /// What the service is, for a person who looks at the process list
    #[arg(value_name = "KIND")]
    pub(crate) kind: String,
}
