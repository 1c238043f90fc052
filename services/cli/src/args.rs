//! The command line.

use crate::commands::Crop;
use clap::{Parser, Subcommand, ValueEnum};
use evpr_core::config::{ON_BACKWARD_TIME, ON_OUTSIDE_SENSOR, PROVIDERS, parse_origin, parse_pace};
use evpr_core::plan::{Inference, OnBadEvent, Origin, Pace, Provider, TimeUnit};
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

#[derive(Debug, Subcommand)]
pub(crate) enum ModelsCommand {
    /// Show the registry of models
    List(ModelsListArgs),
    /// Load each network and compute one image: hashes, shapes, what the files say of themselves
    Check(ModelsCheckArgs),
    /// Time the networks, beside what their arithmetic takes at least
    Bench(ModelsBenchArgs),
}

/// Which models.
#[derive(Debug, Parser)]
pub(crate) struct ModelsArgs {
    /// Ids of models; all when left out
    #[arg(value_name = "ID")]
    pub(crate) ids: Vec<String>,
    /// The registry of models
    #[arg(long, value_name = "FILE", default_value = evpr_core::config::DEFAULT_REGISTRY)]
    pub(crate) models: PathBuf,
    /// The result as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// How networks are run.
#[derive(Debug, Parser)]
pub(crate) struct InferenceArgs {
    /// The shared library of ONNX Runtime; otherwise as `inference.library` when that is left out
    #[arg(long, value_name = "FILE")]
    pub(crate) library: Option<PathBuf>,
    /// tensorrt, cuda, openvino, xnnpack or cpu; may be repeated
    #[arg(long, value_name = "NAME", value_parser = |text: &str| PROVIDERS.parse(text), default_value = "cpu")]
    pub(crate) provider: Vec<Provider>,
    /// Idle threads spin for work
    #[arg(long)]
    pub(crate) spinning: bool,
    /// Size of the frames (height x width), such as 260x346; the network's own when left out
    #[arg(long, value_name = "HxW")]
    pub(crate) sensor: Option<String>,
}

impl InferenceArgs {
    /// As the configuration would say it.
    pub(crate) fn inference(&self) -> Inference {
        Inference {
            library: self.library.clone(),
            providers: self.provider.clone(),
            fallback: false,
            spinning: self.spinning,
        }
    }
}

#[derive(Debug, Parser)]
pub(crate) struct ModelsListArgs {
    #[command(flatten)]
    pub(crate) which: ModelsArgs,
}

#[derive(Debug, Parser)]
pub(crate) struct ModelsCheckArgs {
    #[command(flatten)]
    pub(crate) which: ModelsArgs,
    #[command(flatten)]
    pub(crate) run: InferenceArgs,
}

#[derive(Debug, Parser)]
pub(crate) struct ModelsBenchArgs {
    #[command(flatten)]
    pub(crate) which: ModelsArgs,
    #[command(flatten)]
    pub(crate) run: InferenceArgs,
    /// Numbers of threads to try, such as 1,2
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "1", value_parser = at_least_one)]
    pub(crate) threads: Vec<usize>,
    /// Numbers of images at once to try
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "1", value_parser = at_least_one)]
    pub(crate) batch: Vec<usize>,
    /// How long to time each, in seconds
    #[arg(long, value_name = "S", default_value = "2", value_parser = seconds)]
    pub(crate) seconds: f64,
}

fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(number @ 1..=1024) => Ok(number),
        _ => Err("give whole numbers from 1 to 1024".to_owned()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("give seconds from 0 to 3600".to_owned()),
    }
}

#[derive(Debug, Parser)]
pub(crate) struct ConfigArgs {
    /// The configuration (TOML)
    #[arg(short, long, value_name = "FILE")]
    pub(crate) config: PathBuf,
}

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

#[derive(Debug, Subcommand)]
pub(crate) enum EventsCommand {
    /// Format, sensor, counts, rates and oddities of a recording
    Info(EventsInfoArgs),
    /// Pixels that fire without cause, as a list for source.hot_pixels.file
    HotPixels(HotPixelsArgs),
    /// Frames of a recording as a NumPy array
    Reconstruct(ReconstructArgs),
    /// A recording in another format, or a piece of one
    Convert(ConvertArgs),
    /// Frames of a recording as pictures
    Render(RenderArgs),
}

#[derive(Debug, Parser)]
pub(crate) struct EventsInfoArgs {
    /// The recording
    #[arg(value_name = "IN")]
    pub(crate) input: PathBuf,
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct HotPixelsArgs {
    /// The recording
    #[arg(value_name = "IN")]
    pub(crate) input: PathBuf,
    /// Where to write the list, a line x,y for each; stdout when left out
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Replace the list if it exists
    #[arg(long)]
    pub(crate) force: bool,
    /// A hot pixel has more than so many times the events of the third busiest of the 24 pixels around it [default: 3]
    #[arg(long, value_name = "X", value_parser = factor)]
    pub(crate) factor: Option<f64>,
    /// And at least so many events per second (and 20 in all) [default: 5]
    #[arg(long, value_name = "HZ", value_parser = weight)]
    pub(crate) min_rate_hz: Option<f64>,
    /// Sensor size, such as 260x346 (height x width), where the recording does not tell
    #[arg(long, value_name = "HxW")]
    pub(crate) sensor: Option<String>,
    /// As JSON, with the rates
    #[arg(long)]
    pub(crate) json: bool,
}

fn factor(text: &str) -> Result<f64, String> {
    let factor = text.parse::<f64>().ok().filter(|f| f.is_finite() && *f > 1.0);
    factor.ok_or_else(|| "not a factor; give a number above 1".to_owned())
}

/// What to do with events that cannot be right.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub(crate) struct BadEventArgs {
    /// An event earlier than its forerunner: "error" (stop there), "drop" or "clamp" (to the latest time) [default:
    /// error]
    #[arg(long, value_name = "WHAT", value_parser = |text: &str| ON_BACKWARD_TIME.parse(text))]
    pub(crate) on_backward_time: Option<OnBadEvent>,
    /// An event outside the sensor: "error" (stop there) or "drop" [default: error]
    #[arg(long, value_name = "WHAT", value_parser = |text: &str| ON_OUTSIDE_SENSOR.parse(text))]
    pub(crate) on_outside_sensor: Option<OnBadEvent>,
}

#[derive(Debug, Parser)]
pub(crate) struct ConvertArgs {
    /// The recording
    #[arg(value_name = "IN")]
    pub(crate) input: PathBuf,
    /// The recording to write; its ending says the format
    #[arg(value_name = "OUT")]
    pub(crate) output: PathBuf,
    /// Leave out what comes before, counted from the first event, such as 1.5s
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    pub(crate) start: Option<u64>,
    /// Write only so much, such as 2s
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    pub(crate) duration: Option<u64>,
    /// Keep only this rectangle; its corner becomes column 0, row 0
    #[arg(long, value_name = "X,Y,W,H")]
    pub(crate) crop: Option<Crop>,
    /// Leave out the pixels of this file: a line "x,y" for each
    #[arg(long, value_name = "FILE")]
    pub(crate) mask: Option<PathBuf>,
    /// Sensor size, such as 260x346 (height x width), where the recording does not tell
    #[arg(long, value_name = "HxW")]
    pub(crate) sensor: Option<String>,
    /// Unit of times of text and NumPy: s, ms, us or ns
    #[arg(long, value_name = "UNIT", value_parser = time_unit)]
    pub(crate) time_unit: Option<TimeUnit>,
    /// The stream, topic or member of an archive, where there are several
    #[arg(long, value_name = "NAME")]
    pub(crate) stream: Option<String>,
    #[command(flatten)]
    pub(crate) bad: BadEventArgs,
    /// Replace OUT if it exists
    #[arg(long)]
    pub(crate) force: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct RenderArgs {
    /// The recording
    #[arg(value_name = "IN")]
    pub(crate) input: PathBuf,
    /// An animated .gif, or a folder (that does not exist yet) of .png files
    #[arg(short, long, value_name = "OUT")]
    pub(crate) out: PathBuf,
    /// event_count, event_count_no_polarity, time_surface, or a network such as e2vid
    #[arg(short, long, value_name = "METHOD", default_value = "event_count")]
    pub(crate) method: String,
    /// The registry of models, for networks
    #[arg(long, value_name = "FILE", default_value = evpr_core::config::DEFAULT_REGISTRY)]
    pub(crate) models: PathBuf,
    /// Length of the window, such as 50ms
    #[arg(short, long, value_name = "DURATION", default_value = "50ms", value_parser = duration)]
    pub(crate) window: u64,
    /// Period of the pictures; that of the window when left out
    #[arg(short, long, value_name = "DURATION", value_parser = duration)]
    pub(crate) tick: Option<u64>,
    /// A parameter of the method, such as tau=50ms; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE")]
    pub(crate) param: Vec<String>,
    /// Sensor size, such as 260x346 (height x width), where the recording does not tell
    #[arg(long, value_name = "HxW")]
    pub(crate) sensor: Option<String>,
    #[command(flatten)]
    pub(crate) bad: BadEventArgs,
    /// At most so many pictures
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) frames: Option<u64>,
    /// Replace OUT if it is a file that exists
    #[arg(long)]
    pub(crate) force: bool,
}

fn time_unit(text: &str) -> Result<TimeUnit, String> {
    match text {
        "s" => Ok(TimeUnit::S),
        "ms" => Ok(TimeUnit::Ms),
        "us" => Ok(TimeUnit::Us),
        "ns" => Ok(TimeUnit::Ns),
        _ => Err("not a unit; give s, ms, us or ns".to_owned()),
    }
}

fn duration(text: &str) -> Result<u64, String> {
    parse_duration_ns(text)
}

fn weight(text: &str) -> Result<f64, String> {
    let weight = text.parse::<f64>().ok().filter(|w| w.is_finite() && *w >= 0.0);
    weight.ok_or_else(|| "not a weight; give a number of 0 or more".to_owned())
}

/// Where in its tick a window lies.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum AlignArg {
    /// At the start
    Start,
    /// At the end
    End,
}

#[derive(Debug, Parser)]
pub(crate) struct ReconstructArgs {
    /// The recording
    #[arg(value_name = "IN")]
    pub(crate) input: PathBuf,
    /// event_count, event_count_no_polarity, time_surface, or a network such as e2vid
    #[arg(short, long, value_name = "METHOD")]
    pub(crate) method: String,
    /// The registry of models, for networks
    #[arg(long, value_name = "FILE", default_value = evpr_core::config::DEFAULT_REGISTRY)]
    pub(crate) models: PathBuf,
    /// Length of the window, such as 250ms
    #[arg(short, long, value_name = "DURATION", value_parser = duration)]
    pub(crate) window: u64,
    /// Period of the ticks, such as 1s
    #[arg(short, long, value_name = "DURATION", value_parser = duration)]
    pub(crate) tick: u64,
    /// Where in its tick the window lies
    #[arg(long, default_value = "start")]
    pub(crate) align: AlignArg,
    /// Start of tick 0: "first_event", "grid:100ms" or sensor time in ns
    #[arg(long, value_name = "ORIGIN", default_value = "first_event", value_parser = parse_origin)]
    pub(crate) origin: Origin,
    /// A parameter of the method, such as tau=50ms; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE")]
    pub(crate) param: Vec<String>,
    /// Sensor size, such as 260x346 (height x width), where the recording does not tell
    #[arg(long, value_name = "HxW")]
    pub(crate) sensor: Option<String>,
    #[command(flatten)]
    pub(crate) bad: BadEventArgs,
    /// The array to write: (ticks, height, width) or (ticks, height, width, 3), u8; empty windows are all 0
    #[arg(short, long, value_name = "F.npy")]
    pub(crate) out: PathBuf,
}

/// A sequence method.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum SequenceMethodArg {
    /// Z-scored on both axes, summed along the diagonal
    Paper,
    /// Z-scored along the rows only, summed along the diagonal
    Rows,
    /// Local contrast, summed along the best of several lines
    Seqslam,
    /// Probabilities of a hidden Markov filter over the row z-scores
    Filter,
    /// The similarity itself
    None,
}

#[derive(Debug, Parser)]
pub(crate) struct SequenceMatchArgs {
    /// Similarity matrix, queries × references, f64 or f32
    #[arg(short, long, value_name = "S.npy")]
    pub(crate) similarity: PathBuf,
    /// Sequence length in ticks; the methods filter and none have none
    #[arg(short, long, value_name = "L")]
    pub(crate) length: Option<usize>,
    /// The method
    #[arg(short, long, default_value = "paper")]
    pub(crate) method: SequenceMethodArg,
    #[command(flatten)]
    pub(crate) parameters: MethodArgs,
    /// The array to write, queries × references, f64
    #[arg(short, long, value_name = "T.npy")]
    pub(crate) out: PathBuf,
}

/// Which axis of a ground-truth matrix the queries are on.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum OrientationArg {
    /// A row for each query
    QueryReference,
    /// A row for each reference
    ReferenceQuery,
}

impl From<OrientationArg> for evpr_store::Orientation {
    fn from(arg: OrientationArg) -> Self {
        match arg {
            OrientationArg::QueryReference => Self::QueryReference,
            OrientationArg::ReferenceQuery => Self::ReferenceQuery,
        }
    }
}

/// Pairs of traverses, and which answers are right.
#[derive(Debug, Parser)]
pub(crate) struct PairArgs {
    /// The reference map
    #[arg(short, long, value_name = "DIR")]
    pub(crate) reference: Option<PathBuf>,
    /// The query traverse
    #[arg(short, long, value_name = "DIR", requires = "reference")]
    pub(crate) query: Option<PathBuf>,
    /// Right pairs (.csv of query_id,reference_id), a matrix (.npy), or "positions": those of the traverses
    #[arg(short, long, value_name = "FILE", requires = "reference")]
    pub(crate) ground_truth: Option<PathBuf>,
    /// With positions: right is what lies within so many metres
    #[arg(long, value_name = "M", default_value_t = 25.0)]
    pub(crate) tolerance_m: f64,
    /// With a file: places so many ticks away from a right one are right too
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) tolerance_frames: usize,
    /// Of a matrix whose shape does not tell
    #[arg(long, value_name = "AXES")]
    pub(crate) orientation: Option<OrientationArg>,
    /// A list of pairs (TOML) instead, or a study such as config/paper.toml
    #[arg(short, long, value_name = "FILE", conflicts_with = "reference")]
    pub(crate) pairs: Option<PathBuf>,
    /// Only these members, such as event_count@*/hog; all when left out
    #[arg(short, long, value_name = "MEMBER", value_delimiter = ',')]
    pub(crate) members: Vec<String>,
}

impl PairArgs {
    /// What was named on the command line and is read.
    pub(crate) fn folders(&self) -> Vec<&std::path::Path> {
        let paths = [&self.reference, &self.query, &self.ground_truth, &self.pairs];
        paths.into_iter().flatten().map(PathBuf::as_path).collect()
    }
}

#[derive(Debug, Parser)]
pub(crate) struct EvaluateArgs {
    #[command(flatten)]
    pub(crate) pairs: PairArgs,
    /// Where to write report.html, results.csv and more; an interrupted run goes on from what is there
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Ensembles: single, temporal, reconstruction, extractor, combined, or none; all when left out
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    pub(crate) subsets: Vec<String>,
    /// An ensemble with a name: NAME=MEMBER,MEMBER; may be repeated
    #[arg(long, value_name = "NAME=MEMBERS")]
    pub(crate) subset: Vec<String>,
    /// Sequence lengths, ticks [default: 10]
    #[arg(short, long, value_name = "L", value_delimiter = ',')]
    pub(crate) length: Vec<usize>,
    /// Sequence methods, with parameters as in seqslam:window=10:velocities=0.9..1.1 or filter:transition=0.1/0.9
    /// [default: paper]
    #[arg(long, value_name = "METHOD", value_delimiter = ',')]
    pub(crate) method: Vec<String>,
    /// Fusion rules, such as trimmed_mean:trim=0.1; sum when left out, but mean with the method filter
    #[arg(long, value_name = "RULE", value_delimiter = ',')]
    pub(crate) rule: Vec<String>,
    /// Similarities [default: l2]
    #[arg(long, value_name = "SIMILARITY", value_delimiter = ',')]
    pub(crate) similarity: Vec<String>,
    /// For the confidence: candidates within so many references of the best are no rivals
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub(crate) exclusion: usize,
    /// Also find the least confidence at which this share of the answers is right (thresholds.csv)
    #[arg(long, value_name = "P", value_parser = precision)]
    pub(crate) wanted_precision: Option<f64>,
    /// Also evaluate all pairs with these weights: a TOML file of "member" = weight; members that are not in it have 1
    #[arg(long, value_name = "FILE")]
    pub(crate) weights: Option<PathBuf>,
    /// Also learn weights of members from this pair's labels (weights.csv), and evaluate all pairs with them (weights
    /// learnt:PAIR)
    #[arg(long, value_name = "PAIR")]
    pub(crate) learn_weights: Option<String>,
    /// Also find how alike members are in what they see and get wrong, with the first method and length (members.json)
    #[arg(long)]
    pub(crate) likeness: bool,
    /// For the report: what stages take, as `evpr choose` takes it: a TOML file, or the statistics of a run or of the demo
    #[arg(long, value_name = "FILE")]
    pub(crate) costs: Option<PathBuf>,
    /// For the report: the configuration that the traverses were recorded with, to show frames of queries
    #[arg(short, long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Memory for scores and sequences, MiB, besides the mapped rows
    #[arg(long, value_name = "MIB", default_value_t = 2048, value_parser = clap::value_parser!(u64).range(16..1 << 24))]
    pub(crate) memory: u64,
    /// No progress and no table
    #[arg(long)]
    pub(crate) quiet: bool,
    /// All rows as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Parameters that only some methods have.
#[derive(Debug, Parser)]
pub(crate) struct MethodArgs {
    /// Method seqslam: references that the local contrast is measured against [default: 20]
    #[arg(long, value_name = "N")]
    pub(crate) window: Option<usize>,
    /// Method seqslam: least and greatest velocity, references per tick [default: 0.8,1.2]
    #[arg(long, value_name = "V,V", value_delimiter = ',')]
    pub(crate) velocities: Option<Vec<f64>>,
    /// Method seqslam: how many velocities are tried [default: 10]
    #[arg(long, value_name = "N")]
    pub(crate) velocity_steps: Option<usize>,
    /// Method filter: how much a z-score of 1 speaks for a place [default: 1.5]
    #[arg(long, value_name = "B")]
    pub(crate) beta: Option<f64>,
    /// Method filter: probabilities that a tick moves on by 0, 1, 2, ... references [default: 0.2,0.5,0.2,0.1]
    #[arg(long, value_name = "P,P,...", value_delimiter = ',')]
    pub(crate) transition: Option<Vec<f64>>,
    /// Method filter: probability that a tick starts anywhere anew [default: 0.02]
    #[arg(long, value_name = "P")]
    pub(crate) restart: Option<f64>,
}

#[derive(Debug, Parser)]
pub(crate) struct ChooseArgs {
    #[command(flatten)]
    pub(crate) pairs: PairArgs,
    /// Time per tick that the members may take, one after the other, such as 80ms
    #[arg(short, long, value_name = "DURATION", value_parser = duration)]
    pub(crate) budget: u64,
    /// What stages take: a TOML file, or the statistics of a run (JSON, `evpr run --stats`) or of the demo
    #[arg(short, long, value_name = "FILE")]
    pub(crate) costs: PathBuf,
    /// Sequence length, ticks
    #[arg(short, long, value_name = "L", default_value_t = 10, value_parser = sequence_length)]
    pub(crate) length: usize,
    /// Sequence method, with parameters as in seqslam:window=10:velocities=0.9..1.1
    #[arg(long, value_name = "METHOD", default_value = "paper")]
    pub(crate) method: String,
    /// Fusion rule; sum when left out, but mean with the method filter
    #[arg(long, value_name = "RULE")]
    pub(crate) rule: Option<String>,
    /// Similarity
    #[arg(long, value_name = "SIMILARITY", default_value = "l2")]
    pub(crate) similarity: String,
    /// Up to so many members all sets are tried, as a check of the search
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = exact)]
    pub(crate) exact: usize,
    /// Memory for scores, MiB
    #[arg(long, value_name = "MIB", default_value_t = 2048, value_parser = clap::value_parser!(u64).range(16..1 << 24))]
    pub(crate) memory: u64,
    /// The configuration that the traverses were recorded with
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Where to write it with the members that are chosen
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// No progress
    #[arg(long)]
    pub(crate) quiet: bool,
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

fn precision(text: &str) -> Result<f64, String> {
    let precision = text.parse::<f64>().ok().filter(|p| *p > 0.0 && *p <= 1.0);
    precision.ok_or_else(|| "not a precision; give a number above 0, up to 1".to_owned())
}

fn sequence_length(text: &str) -> Result<usize, String> {
    let length = text.parse().ok().filter(|l| (1..=1000).contains(l));
    length.ok_or_else(|| "a sequence has 1 to 1000 ticks".to_owned())
}

fn exact(text: &str) -> Result<usize, String> {
    let members = text.parse().ok().filter(|m| *m <= 16);
    members.ok_or_else(|| "all sets can be tried of at most 16 members; give 0 to 16".to_owned())
}

#[derive(Debug, Subcommand)]
pub(crate) enum DatasetCommand {
    /// Show the presets: their sequences, files and pairs
    List(DatasetListArgs),
    /// Say what is there, what is missing and where it belongs; exit code 1 when no pair can be run
    Check(DatasetCheckArgs),
    /// Write the configurations of a reference and a query
    Config(DatasetConfigArgs),
}

#[derive(Debug, Parser)]
pub(crate) struct DatasetListArgs {
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct DatasetCheckArgs {
    /// The dataset's folder
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// brisbane, nsavp, or a file like those in config/datasets; those of which a file is there when left out
    #[arg(short, long, value_name = "PRESET")]
    pub(crate) preset: Option<String>,
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct DatasetConfigArgs {
    /// The dataset's folder
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
    /// Two sequences: that of the map and that which is recognised, such as sunset1:sunset2
    #[arg(long, value_name = "REFERENCE:QUERY")]
    pub(crate) pair: String,
    /// brisbane, nsavp, or a file like those in config/datasets; the one of which a file is there when left out
    #[arg(short, long, value_name = "PRESET")]
    pub(crate) preset: Option<String>,
    /// A configuration, such as config/paper.toml, whose stages and matching are taken instead of some to begin with
    #[arg(long, value_name = "FILE")]
    pub(crate) methods: Option<PathBuf>,
    /// Where to write reference.toml and query.toml (a folder, made if need be)
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

#[derive(Debug, Parser)]
pub(crate) struct InstanceArgs {
    /// Name of the running instance
    #[arg(long, value_name = "NAME", default_value = "evpr")]
    pub(crate) name: String,
    /// As JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct TopArgs {
    /// Name of the running instance
    #[arg(long, value_name = "NAME", default_value = "evpr")]
    pub(crate) name: String,
}

#[derive(Debug, Parser)]
pub(crate) struct SetArgs {
    #[command(flatten)]
    pub(crate) instance: InstanceArgs,
    #[command(subcommand)]
    pub(crate) setting: Setting,
}

/// What of a running instance is set.
#[derive(Debug, Subcommand)]
pub(crate) enum Setting {
    /// Sequence length in ticks
    Length {
        /// 1 to 1000
        #[arg(value_name = "TICKS", value_parser = clap::value_parser!(u32).range(1..=i64::from(evpr_runtime::MAX_LENGTH)))]
        ticks: u32,
    },
    /// How members' scores become one
    Rule {
        /// sum, mean, max, median, product or trimmed_mean
        #[arg(value_name = "RULE")]
        rule: String,
    },
    /// Latest delivery: when an answer is due after its last window closed
    Deadline {
        /// Such as 300ms
        #[arg(value_name = "DURATION", value_parser = duration)]
        deadline: u64,
    },
    /// The least confidence of an answer: below it there is none
    #[command(alias = "min_confidence")]
    MinConfidence {
        /// 0 to 1
        #[arg(value_name = "CONFIDENCE")]
        least: f64,
    },
}

#[derive(Debug, Parser)]
pub(crate) struct TraceArgs {
    /// Name of the running instance
    #[arg(long, value_name = "NAME", default_value = "evpr")]
    pub(crate) name: String,
    /// The trace to write: JSON
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// For how long; it ends earlier with the instance, or by Ctrl-C
    #[arg(short, long, value_name = "DURATION", default_value = "10s", value_parser = duration)]
    pub(crate) duration: u64,
}

#[derive(Debug, Subcommand)]
pub(crate) enum MemberCommand {
    /// Show the members with their settings
    List(InstanceArgs),
    /// Switch members on, from the next tick
    Enable(MemberSetArgs),
    /// Switch members off, from the next tick
    Disable(MemberDisableArgs),
    /// Set the weight of members, from the next tick
    Weight(MemberWeightArgs),
}

#[derive(Debug, Parser)]
pub(crate) struct MemberSetArgs {
    #[command(flatten)]
    pub(crate) instance: InstanceArgs,
    /// Members such as event_count@250ms/patch_norm, or "all"
    #[arg(value_name = "MEMBER", required = true)]
    pub(crate) members: Vec<String>,
}

#[derive(Debug, Parser)]
pub(crate) struct MemberDisableArgs {
    #[command(flatten)]
    pub(crate) set: MemberSetArgs,
    /// Free the memory of networks that work for no other member; they are loaded again when they are needed
    #[arg(long)]
    pub(crate) unload: bool,
}

#[derive(Debug, Parser)]
pub(crate) struct MemberWeightArgs {
    #[command(flatten)]
    pub(crate) instance: InstanceArgs,
    /// The weight: 0 or more
    #[arg(value_name = "WEIGHT", allow_negative_numbers = true, value_parser = weight)]
    pub(crate) weight: f64,
    /// Members such as event_count@250ms/patch_norm, or "all"
    #[arg(value_name = "MEMBER", required = true)]
    pub(crate) members: Vec<String>,
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
