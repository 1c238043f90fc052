//! Networks.

use clap::{Parser, Subcommand};
use evpr_core::config::PROVIDERS;
use evpr_core::plan::{Inference, Provider};
use std::path::PathBuf;

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
