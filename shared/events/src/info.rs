//! What is in a recording, in one pass.

use crate::grid::Grid;
use crate::rates::LongestGaps;
use crate::{
    BATCH_EVENTS, Gap, HotPixel, PixelCounts, RateOverTime, RawEvent, ReadOptions, Skipped, SourceError,
    SourceInfo, agreed_sensor, open,
};
use evpr_core::message::Event;
use evpr_core::plan::{HotPixelRule, Sensor};
use std::path::Path;

/// Length of the bins that the peak rate is taken over, ns.
const PEAK_BIN_NS: u64 = 100_000_000;
/// The bins of the rates begin with these lengths, ns.
const RATE_BIN_NS: u64 = 1_000_000_000;
const FINE_BIN_NS: u64 = 1_000_000;
/// Hot pixels that are named.
const WORST: usize = 10;

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
    /// ON events; the others are OFF.
    pub on_events: u64,
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
    /// Events over time, by the second.
    pub rate: RateOverTime,
    /// The same as finely as the recording's length allows, from 1 ms on: for a picture of it.
    #[serde(skip)]
    pub fine_rate: RateOverTime,
    /// Longest time without an event, ns.
    pub max_gap_ns: u64,
    /// The five longest times without an event, longest first.
    pub gaps: Vec<Gap>,
    /// Events earlier than the one before them.
    pub backward_times: u64,
    /// The largest such step back, ns.
    pub largest_backward_ns: u64,
    /// Events at the same time as the one before them.
    pub duplicate_times: u64,
    /// Events that say again what the event of their pixel before said: the same time and polarity.
    pub duplicate_events: u64,
    /// Events outside the sensor; `None` when its size is not known.
    pub outside_sensor: Option<u64>,
    /// Largest column.
    pub max_x: u16,
    /// Largest row.
    pub max_y: u16,
    /// Pixels that fire without cause, by the default [`HotPixelRule`]; `None` when coordinates are beyond any sensor.
    pub hot_pixels: Option<HotPixelsFound>,
    /// What else was in it.
    pub skipped: Vec<Skipped>,
}

/// The hot pixels of a recording.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct HotPixelsFound {
    /// How many there are.
    pub count: u64,
    /// How many of the events are theirs.
    pub events: u64,
    /// The ten with most events, most first.
    pub worst: Vec<HotPixel>,
}

impl HotPixelsFound {
    fn new(mut hot: Vec<HotPixel>) -> Self {
        let (count, events) = (hot.len() as u64, hot.iter().map(|h| h.events).sum());
        hot.sort_by_key(|h| std::cmp::Reverse(h.events));
        hot.truncate(WORST);
        Self {
            count,
            events,
            worst: hot,
        }
    }
}

struct Totals {
    sensor: Option<Sensor>,
    events: u64,
    on: u64,
    first_ns: u64,
    /// Time of the event before, and the latest time.
    before_ns: u64,
    last_ns: u64,
    rate: RateOverTime,
    fine_rate: RateOverTime,
    gaps: LongestGaps,
    backward: u64,
    largest_backward_ns: u64,
    duplicate_times: u64,
    duplicate_events: u64,
    counts: PixelCounts,
    /// Per pixel: its event before, as time and polarity.
    latest: Grid<u64>,
    outside: u64,
    max: (u16, u16),
    bin_end_ns: u64,
    in_bin: u64,
    peak: u64,
}

/// No event packs to this.
const NO_EVENT: u64 = u64::MAX;

impl Totals {
    fn new(sensor: Option<Sensor>) -> Self {
        Self {
            sensor,
            events: 0,
            on: 0,
            first_ns: 0,
            before_ns: 0,
            last_ns: 0,
            rate: RateOverTime::new(RATE_BIN_NS),
            fine_rate: RateOverTime::new(FINE_BIN_NS),
            gaps: LongestGaps::default(),
            backward: 0,
            largest_backward_ns: 0,
            duplicate_times: 0,
            duplicate_events: 0,
            counts: PixelCounts::new(sensor),
            latest: Grid::new(sensor, NO_EVENT),
            outside: 0,
            max: (0, 0),
            bin_end_ns: 0,
            in_bin: 0,
            peak: 0,
        }
    }

    fn add(&mut self, e: &RawEvent) {
        if self.events == 0 {
            (self.first_ns, self.before_ns, self.last_ns) = (e.t_ns, e.t_ns, e.t_ns);
            self.bin_end_ns = e.t_ns.saturating_add(PEAK_BIN_NS);
        } else {
            self.duplicate_times += u64::from(e.t_ns == self.before_ns);
            self.backward += u64::from(e.t_ns < self.before_ns);
            self.largest_backward_ns = self
                .largest_backward_ns
                .max(self.before_ns.saturating_sub(e.t_ns));
            self.gaps.add(self.last_ns, e.t_ns);
        }
        let after_first_ns = e.t_ns.saturating_sub(self.first_ns);
        self.rate.add(after_first_ns);
        self.fine_rate.add(after_first_ns);
        self.counts.add(e);
        if let Some(latest) = self.latest.at(e.x, e.y) {
            let this = e.t_ns.wrapping_shl(1) | u64::from(e.on);
            self.duplicate_events += u64::from(std::mem::replace(latest, this) == this);
        }
        self.events += 1;
        self.on += u64::from(e.on);
        self.before_ns = e.t_ns;
        self.last_ns = self.last_ns.max(e.t_ns);
        self.max = (self.max.0.max(e.x), self.max.1.max(e.y));
        if let Some(sensor) = self.sensor {
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

/// Reads a recording through and counts. A sensor among the options must be the one that the recording says,
/// if it says it. `progress` is told the permille read, after each batch and at the end.
///
/// # Errors
/// When the recording cannot be opened or read to its end, or is of another sensor than the options say.
pub fn info(
    path: &Path,
    options: &ReadOptions,
    progress: &mut dyn FnMut(u64),
) -> Result<RecordingInfo, SourceError> {
    let mut recording = open(path, options)?;
    let sensor = agreed_sensor(path, recording.sensor(), options.sensor)?;
    let mut totals = Totals::new(sensor);
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    while recording.next_batch(&mut batch)? {
        batch.iter().for_each(|e| totals.add(e));
        progress(recording.progress_permille());
    }
    progress(recording.progress_permille());
    let events = totals.events as f64;
    let duration_ns = totals.last_ns - totals.first_ns;
    let duration_s = duration_ns as f64 / 1e9;
    let gaps = totals.gaps.into_vec();
    let countable = sensor.is_some() || totals.counts.outside() == 0;
    let hot = countable.then(|| totals.counts.hot(&HotPixelRule::default(), duration_ns));
    Ok(RecordingInfo {
        source: recording.describe(),
        height: sensor.map(|s| s.height),
        width: sensor.map(|s| s.width),
        events: totals.events,
        on_events: totals.on,
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
        rate: totals.rate,
        fine_rate: totals.fine_rate,
        max_gap_ns: gaps.first().map_or(0, |gap| gap.length_ns),
        gaps,
        backward_times: totals.backward,
        largest_backward_ns: totals.largest_backward_ns,
        duplicate_times: totals.duplicate_times,
        duplicate_events: totals.duplicate_events,
        outside_sensor: sensor.map(|_| totals.outside),
        max_x: totals.max.0,
        max_y: totals.max.1,
        hot_pixels: hot.map(HotPixelsFound::new),
        skipped: recording.skipped(),
    })
}
