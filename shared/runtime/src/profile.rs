//! What a run looks like at one moment, as `evpr status`, `evpr top` and `/metrics` show it.

use crate::control::{Change, MemberState};
use evpr_core::message::Histogram;
use serde::{Deserialize, Serialize};

/// Quantiles of some times, µs; each right to 1/8 of its value, never below it. All 0 without any.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// How many times there are.
    pub count: u64,
    /// Their sum, µs.
    pub sum_us: f64,
    /// Median, µs.
    pub p50_us: f64,
    /// 90th percentile, µs.
    pub p90_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
    /// 99.9th percentile, µs.
    pub p999_us: f64,
    /// The largest, µs.
    pub max_us: f64,
}

impl Quantiles {
    /// Of a histogram.
    pub fn of(histogram: &Histogram) -> Self {
        let us = |ns: u64| ns as f64 / 1e3;
        let quantile = |q| us(histogram.quantile_ns(q));
        Self {
            count: histogram.count,
            sum_us: us(histogram.sum_ns),
            p50_us: quantile(0.5),
            p90_us: quantile(0.9),
            p99_us: quantile(0.99),
            p999_us: quantile(0.999),
            max_us: us(histogram.max_ns),
        }
    }
}

/// Times over the last ten seconds and over the whole run (of a process: since its last start).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Times {
    /// Over the last 10 s. Their largest is known to 1/8 of its value.
    pub last_10s: Quantiles,
    /// Over the whole run.
    pub whole: Quantiles,
}

impl Times {
    pub(crate) fn of(whole: &Histogram, before: &Histogram) -> Self {
        Self {
            last_10s: Quantiles::of(&whole.since(before)),
            whole: Quantiles::of(whole),
        }
    }
}

/// One process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ServiceStatus {
    /// Its name, such as `extract/patch_norm`.
    pub name: String,
    /// `ingest`, `reconstruct`, `extract`, `fuse` or `record`.
    pub kind: String,
    /// Process id; none while it is not there.
    pub pid: Option<u32>,
    /// `starting`, `ready`, `done`, `restarting` or `down`.
    pub state: String,
    /// What its main loop does: `loading`, `waiting`, `working` or `blocked` (the next stage has no room).
    pub doing: String,
    /// For how long it has been doing that, ms.
    pub doing_ms: f64,
    /// How long ago it was last heard of, ms.
    pub heard_ms: f64,
    /// Starts after deaths.
    pub restarts: u64,
    /// Messages taken in.
    pub received: u64,
    /// Messages sent.
    pub emitted: u64,
    /// Inputs that led to nothing by decision.
    pub skipped: u64,
    /// Messages lost because it fell behind.
    pub dropped: u64,
    /// Messages refused as not of this run.
    pub refused: u64,
    /// Events sent (ingest) or counted (reconstructions).
    pub events: u64,
    /// Messages taken in per second, over the last 10 s.
    pub received_per_s: f64,
    /// Messages sent per second, over the last 10 s.
    pub emitted_per_s: f64,
    /// Events per second, over the last 10 s.
    pub events_per_s: f64,
    /// Processor time since its start, s.
    pub cpu_s: f64,
    /// Percent of one core, over the last 10 s.
    pub cpu_percent: f64,
    /// Resident memory, bytes; what it shares with other processes is counted for each.
    pub rss_bytes: u64,
    /// Of each input: from being sent to being taken up.
    pub waiting: Times,
    /// Of each input (sinks: each tick): from being taken up to done, without sending.
    pub processing: Times,
    /// Of each output: handing it over, waiting for room included.
    pub sending: Times,
    /// Of each input: from the closing of its window to being taken up.
    pub age: Times,
}

/// One member.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MemberStatus {
    /// Its settings.
    #[serde(flatten)]
    pub state: MemberState,
    /// Rows that came of it.
    pub rows: u64,
    /// What a row of the last 10 s took its reconstruction, ms: closing chunk to frame. Members that share a frame each
    /// count it. 0 when there was none.
    pub reconstruct_ms: f64,
    /// What a row of the last 10 s took its extractor, ms.
    pub extract_ms: f64,
}

impl MemberStatus {
    /// What it costs per tick, ms.
    pub fn cost_ms(&self) -> f64 {
        self.reconstruct_ms + self.extract_ms
    }
}

/// From the closing of a tick's last window to its answer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LatencyStatus {
    /// Until the last frame was written.
    pub reconstruct: Times,
    /// From there until the last row was written.
    pub extract: Times,
    /// From there until the answer.
    pub fuse: Times,
    /// All of it.
    pub total: Times,
    /// Of the newest answer, ms; 0 when it is not known.
    pub newest_ms: f64,
}

/// A run at one moment.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Name of the instance.
    pub name: String,
    /// `starting`, `running`, `draining` or `stopping`.
    pub state: String,
    /// `lossless` or `latest`.
    pub delivery: String,
    /// Since its start, s.
    pub uptime_s: f64,
    /// The newest tick that has been opened.
    pub tick: Option<u64>,
    /// Permille of the recording that is read; 0 when not known.
    pub progress_permille: u64,
    /// Ticks answered.
    pub answers: u64,
    /// Ticks answered with a place.
    pub matches: u64,
    /// Window closed to answer.
    pub latency: LatencyStatus,
    /// Messages that the supervisor refused: not of this run, or not such as the plan allows.
    #[serde(default)]
    pub refused: u64,
    /// Per process, upstream first.
    pub services: Vec<ServiceStatus>,
    /// Per member of the plan.
    pub members: Vec<MemberStatus>,
    /// The fuser's settings in force.
    pub fuse: FuseStatus,
    /// The latency governor, where there is one.
    #[serde(default)]
    pub governor: Option<GovernorStatus>,
    /// The newest changes, oldest first.
    #[serde(default)]
    pub changes: Vec<Change>,
}

/// The fuser's settings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FuseStatus {
    /// Sequence length, ticks.
    pub length: u32,
    /// Fusion rule.
    pub rule: String,
    /// Latest delivery: when an answer is due after its last window closed, ms.
    pub deadline_ms: f64,
    /// The least confidence of an answer, 0 to 1: below it there is none.
    #[serde(default)]
    pub min_confidence: f64,
}

/// The latency governor.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GovernorStatus {
    /// What it keeps the 95th percentile of window-close to answer below, ms.
    pub budget_ms: f64,
    /// That percentile over the answers that it judges; none without any.
    pub p95_ms: Option<f64>,
    /// The members that are off because of it, in the order in which they went.
    pub shed: Vec<String>,
}
