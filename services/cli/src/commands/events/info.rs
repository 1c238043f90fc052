//! `evpr events info`.

use crate::args::EventsInfoArgs;
use crate::failure::Failure;
use crate::output::say;
use crate::progress;
use evpr_core::plan::Sensor;
use evpr_events::{HotPixelsFound, RateOverTime, ReadOptions, RecordingInfo, rough_seconds};
use std::process::ExitCode;

/// Columns of the picture of the rate.
const COLUMNS: usize = 60;
/// Hot pixels that are named.
const NAMED: usize = 5;

/// Tells what is in a recording.
pub(crate) fn info(args: &EventsInfoArgs) -> Result<ExitCode, Failure> {
    let bar = progress::bar(args.json, "reading");
    let info = evpr_events::info(&args.input, &ReadOptions::default(), &mut |permille| {
        bar.set_position(permille);
    });
    bar.finish_and_clear();
    let info = info?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&info)?);
    } else {
        for (label, value) in report(&info) {
            say!("{label:<16} {value}");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The report for a person: labels and what they say.
fn report(info: &RecordingInfo) -> Vec<(&'static str, String)> {
    let mut rows: Vec<(&'static str, String)> = Vec::new();
    let mut row = |label, value| rows.push((label, value));
    let source = &info.source;
    row("recording", source.path.display().to_string());
    row(
        "format",
        format!(
            "{}, times in {} (by {})",
            source.format, source.time_unit, source.time_unit_from
        ),
    );
    row(
        "sensor",
        match (info.height, info.width) {
            (Some(height), Some(width)) => Sensor { height, width }.to_string(),
            _ => format!(
                "not told; largest row {}, largest column {}",
                info.max_y, info.max_x
            ),
        },
    );
    row(
        "events",
        format!(
            "{}: {:.1} % ON, {:.1} % OFF",
            info.events,
            info.on_share * 100.0,
            100.0 - info.on_share * 100.0
        ),
    );
    row(
        "time",
        format!(
            "{} to {} ns, {:.3} s",
            info.first_ns, info.last_ns, info.duration_s
        ),
    );
    row(
        "rate",
        format!(
            "{} events/s, at most {} over 100 ms",
            short(info.mean_rate_hz),
            short(info.peak_rate_hz)
        ),
    );
    let (picture, scale) = sparkline(&info.fine_rate);
    row("rate over time", format!("▕{picture}▏ {scale}"));
    for (nth, gap) in info.gaps.iter().enumerate() {
        let label = if nth == 0 { "longest gaps" } else { "" };
        let at = rough_seconds(gap.from_ns.saturating_sub(info.first_ns));
        row(
            label,
            format!("{:.3} ms, {at} after the start", gap.length_ns as f64 / 1e6),
        );
    }
    row(
        "backward times",
        match info.backward_times {
            0 => "0".to_owned(),
            n => format!(
                "{n}, the largest by {:.3} ms (see source.on_backward_time)",
                info.largest_backward_ns as f64 / 1e6
            ),
        },
    );
    row(
        "equal times",
        format!(
            "{}; {} events are there twice (same time, pixel and polarity)",
            info.duplicate_times, info.duplicate_events
        ),
    );
    row(
        "outside sensor",
        match info.outside_sensor {
            None => "unknown".to_owned(),
            Some(0) => "0".to_owned(),
            Some(n) => format!("{n} (see source.on_outside_sensor)"),
        },
    );
    row(
        "hot pixels",
        match &info.hot_pixels {
            None => "unknown: there are coordinates beyond any sensor".to_owned(),
            Some(hot) => hot_pixels(hot, info.events),
        },
    );
    for (nth, skipped) in info.skipped.iter().enumerate() {
        let label = if nth == 0 { "passed over" } else { "" };
        row(label, format!("{} {}", skipped.count, skipped.what));
    }
    rows
}

fn hot_pixels(hot: &HotPixelsFound, events: u64) -> String {
    if hot.count == 0 {
        return "none".to_owned();
    }
    let share = hot.events as f64 / (events as f64).max(1.0) * 100.0;
    let worst: Vec<String> = hot
        .worst
        .iter()
        .take(NAMED)
        .map(|h| {
            let (x, y, rate) = (h.x, h.y, h.rate_hz);
            format!("{x},{y} at {rate:.1}/s")
        })
        .collect();
    let more = if hot.count > worst.len() as u64 {
        ", …"
    } else {
        ""
    };
    format!(
        "{}, {share:.2} % of the events: {}{more}",
        hot.count,
        worst.join(", ")
    )
}

/// A picture of the rate, and what its heights and columns are.
fn sparkline(rate: &RateOverTime) -> (String, String) {
    const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let (rates, column_ns) = rate.columns(COLUMNS);
    let most = rates.iter().copied().fold(0.0, f64::max);
    let bar = |rate: &f64| match (rate / most * BARS.len() as f64).ceil() {
        height if height >= 1.0 => BARS[(height as usize).min(BARS.len()) - 1],
        _ => ' ',
    };
    let scale = format!("{} each, up to {} events/s", length(column_ns), short(most));
    (rates.iter().map(bar).collect(), scale)
}

/// A length of time to two or three digits.
fn length(ns: u64) -> String {
    match ns as f64 {
        ns if ns < 1e9 => format!("{:.3} ms", ns / 1e6).replace(".000", ""),
        ns if ns < 100e9 => format!("{:.2} s", ns / 1e9),
        ns => format!("{:.1} min", ns / 60e9),
    }
}

/// A number to three or four digits: `812`, `23.9 k`, `1.25 M`.
fn short(number: f64) -> String {
    match number {
        n if n < 1e4 => format!("{n:.0}"),
        n if n < 1e6 => format!("{:.1} k", n / 1e3),
        n => format!("{:.2} M", n / 1e6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_drawn_to_its_own_scale() {
        let rate = |events: &[u64]| RateOverTime {
            bin_ns: 500_000_000,
            events: events.to_vec(),
        };
        let (picture, scale) = sparkline(&rate(&[1, 0, 50, 51, 100]));
        assert_eq!(
            (picture.as_str(), scale.as_str()),
            ("▁ ▄▅█", "500 ms each, up to 200 events/s")
        );
        assert_eq!(sparkline(&rate(&[])).0, "");
        assert_eq!(sparkline(&rate(&[0, 0])).0, "  ");
        let (picture, scale) = sparkline(&rate(&[30_000; 61]));
        assert_eq!(
            (picture.chars().count(), scale.as_str()),
            (31, "1.00 s each, up to 60.0 k events/s")
        );
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [812.4, 23_912.0, 1_251_000.0].map(short),
            ["812", "23.9 k", "1.25 M"]
        );
        assert_eq!(length(600_000_000_000), "10.0 min");
    }
}
