//! What is in a recording, in one pass.

use crate::{BATCH_EVENTS, RawEvent, ReadOptions, Skipped, SourceError, SourceInfo, open};
use evpr_core::message::Event;
use evpr_core::plan::Sensor;
use std::path::Path;

/// Length of the bins that the peak rate is taken over, ns.
const PEAK_BIN_NS: u64 = 100_000_000;

/// Facts about a recording. No policy is applied: bad events are counted, and count like the others.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct RecordingInfo {
    /// Format, path and unit of time.
    pub source: SourceInfo,
    /// Rows of the sensor, where the recording or the caller says it.
    pub height: Option<usize>,
    /// Columns of the sensor.
    pub width: Option<usize>,
    /// Number of events.
    pub events: u64,
    /// Share of ON events, 0 to 1.
    pub on_share: f64,
    /// Time of the first event, ns.
    pub first_ns: u64,
    /// Latest time, ns.
    pub last_ns: u64,
    /// `last_ns - first_ns`, s.
    pub duration_s: f64,
    /// Events per second over the duration; 0 when that is 0.
    pub mean_rate_hz: f64,
    /// Most events per second in one of the consecutive bins of 100 ms from the first event.
    pub peak_rate_hz: f64,
    /// Longest time without an event, ns.
    pub max_gap_ns: u64,
    /// Events earlier than the one before them.
    pub backward_times: u64,
    /// Events at the same time as the one before them.
    pub duplicate_times: u64,
    /// Events outside the sensor; `None` when its size is not known.
    pub outside_sensor: Option<u64>,
    /// Largest column.
    pub max_x: u16,
    /// Largest row.
    pub max_y: u16,
    /// What else was in it.
    pub skipped: Vec<Skipped>,
}

#[derive(Default)]
struct Totals {
    events: u64,
    on: u64,
    first_ns: u64,
    /// Time of the event before, and the latest time.
    before_ns: u64,
    last_ns: u64,
    max_gap_ns: u64,
    backward: u64,
    duplicates: u64,
    outside: u64,
    max: (u16, u16),
    bin_end_ns: u64,
    in_bin: u64,
    peak: u64,
}

impl Totals {
    fn add(&mut self, e: &RawEvent, sensor: Option<Sensor>) {
        if self.events == 0 {
            (self.first_ns, self.before_ns, self.last_ns) = (e.t_ns, e.t_ns, e.t_ns);
            self.bin_end_ns = e.t_ns.saturating_add(PEAK_BIN_NS);
        } else {
            self.duplicates += u64::from(e.t_ns == self.before_ns);
            self.backward += u64::from(e.t_ns < self.before_ns);
            self.max_gap_ns = self.max_gap_ns.max(e.t_ns.saturating_sub(self.last_ns));
        }
        self.events += 1;
        self.on += u64::from(e.on);
        self.before_ns = e.t_ns;
        self.last_ns = self.last_ns.max(e.t_ns);
        self.max = (self.max.0.max(e.x), self.max.1.max(e.y));
        if let Some(sensor) = sensor {
            let (x, y) = (usize::from(e.x), usize::from(e.y));
            self.outside += u64::from(x >= sensor.width || y >= sensor.height || e.y > Event::Y_MAX);
        }
        if e.t_ns >= self.bin_end_ns {
            let bins = (e.t_ns - self.bin_end_ns) / PEAK_BIN_NS + 1;
            self.bin_end_ns = self.bin_end_ns.saturating_add(bins.saturating_mul(PEAK_BIN_NS));
            self.in_bin = 0;
        }
        self.in_bin += 1;
        self.peak = self.peak.max(self.in_bin);
    }
}

/// Reads a recording through and counts. A sensor among the options takes precedence over what the recording says.
/// `progress` is told the permille read, after each batch and at the end.
///
/// # Errors
/// When the recording cannot be opened or read to its end.
pub fn info(
    path: &Path,
    options: &ReadOptions,
    progress: &mut dyn FnMut(u64),
) -> Result<RecordingInfo, SourceError> {
    let mut recording = open(path, options)?;
    let sensor = options.sensor.or(recording.sensor());
    let mut totals = Totals::default();
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    while recording.next_batch(&mut batch)? {
        batch.iter().for_each(|e| totals.add(e, sensor));
        progress(recording.progress_permille());
    }
    progress(recording.progress_permille());
    let events = totals.events as f64;
    let duration_s = (totals.last_ns - totals.first_ns) as f64 / 1e9;
    Ok(RecordingInfo {
        source: recording.describe(),
        height: sensor.map(|s| s.height),
        width: sensor.map(|s| s.width),
        events: totals.events,
        on_share: totals.on as f64 / events.max(1.0),
        first_ns: totals.first_ns,
        last_ns: totals.last_ns,
        duration_s,
        mean_rate_hz: if duration_s > 0.0 {
            events / duration_s
        } else {
            0.0
        },
        peak_rate_hz: totals.peak as f64 * (1e9 / PEAK_BIN_NS as f64),
        max_gap_ns: totals.max_gap_ns,
        backward_times: totals.backward,
        duplicate_times: totals.duplicates,
        outside_sensor: sensor.map(|_| totals.outside),
        max_x: totals.max.0,
        max_y: totals.max.1,
        skipped: recording.skipped(),
    })
}
