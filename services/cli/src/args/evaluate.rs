//! Recorded traverses: matching, evaluating, choosing.

use super::duration;
use clap::{Parser, ValueEnum};
use std::path::PathBuf;

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
