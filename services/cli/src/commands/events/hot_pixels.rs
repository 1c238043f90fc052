//! `evpr events hot-pixels`.

use super::check_target;
use crate::args::HotPixelsArgs;
use crate::failure::Failure;
use crate::output::{refuse_input, say};
use crate::progress;
use evpr_core::plan::{HotPixelRule, Sensor};
use evpr_events::{HotPixelEstimate, ReadOptions, estimate_hot_pixels};
use std::fmt::Write;
use std::process::ExitCode;

/// Tells the hot pixels of a recording: as the list that `source.hot_pixels.file` takes, or as JSON.
pub(crate) fn hot_pixels(args: &HotPixelsArgs) -> Result<ExitCode, Failure> {
    if let Some(out) = &args.out {
        check_target(out, args.force)?;
        refuse_input(out, &[&args.input])?;
    }
    let default = HotPixelRule::default();
    let rule = HotPixelRule {
        factor: args.factor.unwrap_or(default.factor),
        min_rate_hz: args.min_rate_hz.unwrap_or(default.min_rate_hz),
    };
    let sensor = args
        .sensor
        .as_deref()
        .map(crate::commands::parse_sensor)
        .transpose()?;
    let options = ReadOptions {
        sensor,
        ..ReadOptions::default()
    };
    let bar = progress::bar(args.json, "reading");
    let estimate = estimate_hot_pixels(&args.input, &options, &rule, &mut |permille| {
        bar.set_position(permille);
    });
    bar.finish_and_clear();
    let estimate = estimate?;
    let list = list(&estimate);
    if let Some(out) = &args.out {
        std::fs::write(out, &list)
            .map_err(|e| Failure::new(format!("cannot write {}: {e}", out.display())))?;
        eprintln!("{} written to {}", summary(&estimate), out.display());
    }
    if args.json {
        say!("{}", serde_json::to_string_pretty(&estimate)?);
    } else if args.out.is_none() {
        say!("{}", list.trim_end());
    }
    Ok(ExitCode::SUCCESS)
}

/// `5 hot pixels of 128×128 (height × width), 0.2 % of the events`.
fn summary(estimate: &HotPixelEstimate) -> String {
    let count = estimate.hot_pixels.len();
    let of = match (estimate.height, estimate.width) {
        (Some(height), Some(width)) => format!(" of {}", Sensor { height, width }),
        _ => String::new(),
    };
    format!(
        "{count} hot {}{of}, {:.2} % of the events,",
        if count == 1 { "pixel" } else { "pixels" },
        estimate.hot_events as f64 / (estimate.events as f64).max(1.0) * 100.0
    )
}

/// The list as text, with what it is of in comments.
fn list(estimate: &HotPixelEstimate) -> String {
    let mut text = String::new();
    // A line feed in the file's name would end the comment.
    let of = estimate
        .source
        .path
        .display()
        .to_string()
        .escape_debug()
        .to_string();
    let _ = writeln!(text, "# {} of {of}", summary(estimate).trim_end_matches(','));
    let _ = writeln!(
        text,
        "# at least {} events/s and 20 in all, and more than {} times those of the third busiest of the 24 pixels around",
        estimate.min_rate_hz, estimate.factor
    );
    let _ = writeln!(text, "# x,y");
    for hot in &estimate.hot_pixels {
        let _ = writeln!(text, "{},{}  # {:.1} events/s", hot.x, hot.y, hot.rate_hz);
    }
    text
}
