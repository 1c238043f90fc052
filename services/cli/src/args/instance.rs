//! Running instances.

use super::{duration, weight};
use clap::{Parser, Subcommand};
use std::path::PathBuf;

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
