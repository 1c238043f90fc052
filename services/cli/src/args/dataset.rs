//! Published datasets.

use clap::{Parser, Subcommand};
use std::path::PathBuf;

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
