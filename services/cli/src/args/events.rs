//! Recordings.

use super::{duration, weight};
use crate::commands::Crop;
use clap::{Parser, Subcommand, ValueEnum};
use evpr_core::config::{ON_BACKWARD_TIME, ON_OUTSIDE_SENSOR, parse_origin};
use evpr_core::plan::{OnBadEvent, Origin, TimeUnit};
use std::path::PathBuf;

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
