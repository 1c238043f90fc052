//! What the stages take, in a run at the pace of the street: times in an unpaced replay are those of queues.

use super::graph::Drive;
use evpr_core::message::MatchHeader;
use serde::Serialize;

/// Latency of one stage over the ticks of the run.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct StageLatency {
    pub(crate) stage: &'static str,
    /// Median over the ticks, µs.
    pub(crate) median_us: f64,
    /// The slowest tick, µs.
    pub(crate) slowest_us: f64,
    /// Per tick, µs.
    pub(crate) ticks_us: Vec<f64>,
}

/// What one process did per message.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct ProcessWork {
    pub(crate) process: String,
    /// Messages taken in.
    pub(crate) messages: u64,
    /// Median of the time from taking a message up to being done with it, µs.
    pub(crate) p50_us: f64,
    /// 99 % took at most so long, µs.
    pub(crate) p99_us: f64,
}

/// Latencies of a run in real time.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Latency {
    /// Ticks measured.
    pub(crate) ticks: usize,
    /// Ticks of the run whose latency is not known: not all of their members had a row.
    pub(crate) left_out: usize,
    /// Members that each tick was answered from.
    pub(crate) members: usize,
    /// Events per second of the street.
    pub(crate) events_per_s: f64,
    /// Processor cores that the run could use.
    pub(crate) cores: usize,
    /// Load of the machine over the minute before its end, processes; `None` where the system does not say.
    pub(crate) load_1min: Option<f64>,
    /// From the closing of a tick's last window: until the last frame, from there until the last row, from there until
    /// the answer, and all of it.
    pub(crate) stages: Vec<StageLatency>,
    /// Per process, in the order of the graph.
    pub(crate) processes: Vec<ProcessWork>,
}

type Part = fn(&MatchHeader) -> u64;

const STAGES: [(&str, Part); 4] = [
    ("reconstruct", |h| h.reconstruct_ns),
    ("extract", |h| h.extract_ns),
    ("fuse", |h| h.fuse_ns),
    ("total", |h| h.total_ns),
];

/// Sums up a run of `members` members whose ticks are `tick_s` long.
pub(crate) fn measure(drive: &Drive, members: usize, tick_s: f64) -> Latency {
    let known: Vec<&MatchHeader> = drive.answers.iter().filter(|h| h.total_ns > 0).collect();
    let us = |ns: u64| ns as f64 / 1e3;
    let stage = |(stage, part): (&'static str, Part)| {
        let ticks_us: Vec<f64> = known.iter().map(|h| us(part(h))).collect();
        StageLatency {
            stage,
            median_us: median(&ticks_us),
            slowest_us: ticks_us.iter().copied().fold(0.0, f64::max),
            ticks_us,
        }
    };
    let process = |s: &evpr_runtime::ServiceReport| ProcessWork {
        process: s.name.clone(),
        messages: s.stats.received,
        p50_us: us(s.stats.processing.quantile_ns(0.5)),
        p99_us: us(s.stats.processing.quantile_ns(0.99)),
    };
    let seconds = drive.answers.len() as f64 * tick_s;
    Latency {
        ticks: known.len(),
        left_out: drive.answers.len() - known.len(),
        members,
        events_per_s: if seconds > 0.0 {
            drive.events() as f64 / seconds
        } else {
            0.0
        },
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        load_1min: load_1min(),
        stages: STAGES.map(stage).into(),
        // Ingest takes in a recording, no messages.
        processes: drive
            .summary
            .services
            .iter()
            .filter(|s| s.stats.received > 0)
            .map(process)
            .collect(),
    }
}

/// The middle of these values, or the mean of the two in the middle; 0 without values.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match (sorted.get(middle.wrapping_sub(1)), sorted.get(middle)) {
        (Some(below), Some(above)) if sorted.len().is_multiple_of(2) => 0.5 * (below + above),
        (_, Some(value)) => *value,
        _ => 0.0,
    }
}

fn load_1min() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median(&[]), 0.0);
        assert_eq!(median(&[3.0]), 3.0);
        assert_eq!(median(&[3.0, 1.0]), 2.0);
        assert_eq!(median(&[3.0, 9.0, 1.0]), 3.0);
    }
}
