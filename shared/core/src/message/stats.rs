//! `stats`: what a process has done so far, published a few times per second and at every change of phase.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Message, Refusal, Stamp, check, header};
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Where a process stands. Stored as its number.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ServicePhase {
    /// Loading; not connected yet.
    #[default]
    Starting = 0,
    /// Connected: what is sent from now on arrives.
    Ready = 1,
    /// Has nothing more to do (ingest: the end is sent; sinks: the last tick is done).
    Done = 2,
    /// Ingest: as [`ServicePhase::Done`], but because it was asked to stop.
    Stopped = 3,
}

/// What the main loop of a process is doing. Stored as its number.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Doing {
    /// Loading what it works with, or meeting the others.
    #[default]
    Loading = 0,
    /// Waiting for input, or for the time when it is due.
    Waiting = 1,
    /// Computing or reading.
    Working = 2,
    /// Waiting for room in a full channel: whoever reads it is slower.
    Blocked = 3,
    /// Writing what is to be kept, for as long as the disk takes.
    Writing = 4,
}

impl Doing {
    /// What has this number.
    pub fn from_code(code: u32) -> Option<Self> {
        [
            Self::Loading,
            Self::Waiting,
            Self::Working,
            Self::Blocked,
            Self::Writing,
        ]
        .into_iter()
        .find(|d| *d as u32 == code)
    }

    /// One word for a person.
    pub fn name(self) -> &'static str {
        match self {
            Self::Loading => "loading",
            Self::Waiting => "waiting",
            Self::Working => "working",
            Self::Blocked => "blocked",
            Self::Writing => "writing",
        }
    }
}

const SUB_BITS: u32 = 3;
const OCTAVES: usize = 40;
const BUCKETS: usize = (OCTAVES + 1) << SUB_BITS;

/// A latency histogram with eight buckets per octave: quantiles are right to 1/8 of their value, at any size
/// from 1 ns to 18 minutes (longer ones count as that).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("evpr.Histogram.1")]
pub struct Histogram {
    /// Number of values.
    pub count: u64,
    /// Sum of the values, ns.
    pub sum_ns: u64,
    /// Largest value, ns.
    pub max_ns: u64,
    buckets: [u32; BUCKETS],
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            count: 0,
            sum_ns: 0,
            max_ns: 0,
            buckets: [0; BUCKETS],
        }
    }
}

impl Histogram {
    fn bucket(ns: u64) -> usize {
        let sub = 1u64 << SUB_BITS;
        if ns < sub {
            return ns as usize;
        }
        let octave = 63 - ns.leading_zeros() - SUB_BITS;
        let index = ((octave as usize + 1) << SUB_BITS) + ((ns >> octave) & (sub - 1)) as usize;
        index.min(BUCKETS - 1)
    }

    fn upper_edge(bucket: usize) -> u64 {
        let sub = 1usize << SUB_BITS;
        if bucket < sub {
            return bucket as u64;
        }
        let octave = (bucket >> SUB_BITS) - 1;
        (((bucket & (sub - 1)) + sub + 1) as u64) << octave
    }

    /// Adds one value.
    pub fn record(&mut self, ns: u64) {
        self.count += 1;
        self.sum_ns = self.sum_ns.saturating_add(ns);
        self.max_ns = self.max_ns.max(ns);
        let bucket = &mut self.buckets[Self::bucket(ns)];
        *bucket = bucket.saturating_add(1);
    }

    /// The value below which the share `q` (0 to 1) of all values lies, ns; never above the largest; 0 when empty.
    pub fn quantile_ns(&self, q: f64) -> u64 {
        let wanted = ((self.count as f64 * q).ceil() as u64).max(1);
        let mut seen = 0;
        for (bucket, n) in self.buckets.iter().enumerate() {
            seen += u64::from(*n);
            if seen >= wanted {
                return Self::upper_edge(bucket).min(self.max_ns);
            }
        }
        self.max_ns
    }

    /// The values that came after `earlier`, an older state of this histogram. The largest of them is known to 1/8 of
    /// its value only.
    pub fn since(&self, earlier: &Self) -> Self {
        let mut later = Self {
            count: self.count.saturating_sub(earlier.count),
            sum_ns: self.sum_ns.saturating_sub(earlier.sum_ns),
            ..Self::default()
        };
        for (bucket, to) in later.buckets.iter_mut().enumerate() {
            *to = self.buckets[bucket].saturating_sub(earlier.buckets[bucket]);
            if *to > 0 {
                later.max_ns = Self::upper_edge(bucket).min(self.max_ns);
            }
        }
        later
    }

    /// Mean, ns; 0 when empty.
    pub fn mean_ns(&self) -> u64 {
        self.sum_ns.checked_div(self.count).unwrap_or(0)
    }
}

/// What ingest of a live source knows about it. All zero for recordings.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.LiveStats.1")]
pub struct LiveStats {
    /// 1 for a live source, else 0.
    pub is_live: u32,
    /// 1 while it is connected, else 0.
    pub connected: u32,
    /// Ticks that are not whole because ingest fell behind.
    pub dropped_ticks: u64,
    /// Ticks that are not whole because the camera, or ingest, was away.
    pub missed_ticks: u64,
    /// Events that were thrown away in such ticks.
    pub lost_events: u64,
    /// Events left out because their window had closed before they came.
    pub late_events: u64,
    /// How often a connection was lost.
    pub disconnects: u64,
    /// How often the sensor's time jumped.
    pub jumps: u64,
    /// Host monotonic time minus sensor time, ns: the smallest lately, so of the quickest arrivals.
    pub offset_ns: i64,
    /// How much faster the sensor's clock is than the host's, parts per billion; 0 until there is enough to tell.
    pub drift_ppb: i64,
    /// Median and 99th percentile of how much later than the quickest events arrive, ns.
    pub delay_p50_ns: u64,
    /// The 99th percentile.
    pub delay_p99_ns: u64,
}

/// What one member has cost so far, as its rows say: written by sinks.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.MemberCost.1")]
pub struct MemberCost {
    /// Its rows.
    pub rows: u64,
    /// From taking up the chunk that closed the window until the frame was written, summed over its rows, ns. Members
    /// that share a frame each count it.
    pub reconstruct_ns: u64,
    /// From taking up the frame until the row was written, summed, ns; where rows are computed together, its share.
    pub extract_ns: u64,
}

/// Counters of one process since its start. The payload is one [`MemberCost`] per member of the plan, from sinks.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("evpr.StatsHeader.3")]
pub struct StatsHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// Number of a [`ServicePhase`].
    pub phase: u32,
    /// Operating-system process id.
    pub pid: u32,
    /// Sinks: the first tick that is not done yet. Ingest: the first tick not opened yet.
    pub next_tick: u64,
    /// Messages taken in.
    pub received: u64,
    /// Messages sent.
    pub emitted: u64,
    /// Inputs that led to no output by decision (empty window, bad input), each with a reason downstream.
    pub skipped: u64,
    /// Messages lost or dropped because this process fell behind.
    pub dropped: u64,
    /// Messages refused because they were not of this run or their sizes were wrong.
    pub refused: u64,
    /// Events (ingest: sent; reconstructions: counted).
    pub events: u64,
    /// Ingest: permille of the recording that has been read, or 0 when not known.
    pub progress_permille: u64,
    /// Ingest: the live source.
    pub live: LiveStats,
    /// Number of a [`Doing`].
    pub doing: u32,
    /// Unused.
    pub _pad: u32,
    /// Host monotonic time (ns) at which the main loop last took up something or began to wait.
    pub progress_ns: u64,
    /// Of each input: from being sent to being taken up.
    pub waiting: Histogram,
    /// Of each input: from being taken up to done, without sending.
    pub processing: Histogram,
    /// Of each output: handing it over, waiting for room included.
    pub sending: Histogram,
    /// Of each input that belongs to a window that is over: from the window's closing to being taken up.
    pub age: Histogram,
}

header!(StatsHeader);

/// Stats messages.
#[derive(Debug)]
pub struct Stats;

impl Message for Stats {
    type Header = StatsHeader;
    type Item = MemberCost;

    fn check(plan: &Plan, header: &StatsHeader, payload: &[MemberCost]) -> Result<(), Refusal> {
        check::stats(plan, header, payload)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_to_an_eighth() {
        let mut h = Histogram::default();
        for v in 1..=100_000u64 {
            h.record(v * 100);
        }
        for q in [0.01, 0.5, 0.9, 0.99] {
            let exact = q * 10_000_000.0;
            let got = h.quantile_ns(q) as f64;
            assert!(
                got >= exact * 0.999 && got <= exact * 1.126,
                "{q}: {got} against {exact}"
            );
        }
        assert_eq!(h.quantile_ns(1.0), 10_000_000);
        assert_eq!(Histogram::default().quantile_ns(0.5), 0);
    }

    #[test]
    fn what_came_since_is_told_apart() {
        let mut h = Histogram::default();
        (0..100).for_each(|_| h.record(1_000));
        let before = h;
        (0..50).for_each(|_| h.record(9_000));
        let since = h.since(&before);
        assert_eq!((since.count, since.sum_ns), (50, 450_000));
        assert!(
            (9_000..=9_000 * 9 / 8).contains(&since.quantile_ns(0.01)),
            "{}",
            since.quantile_ns(0.01)
        );
        assert!(since.max_ns >= 9_000 && since.max_ns <= h.max_ns);
        assert_eq!(h.since(&h), Histogram::default());
        assert_eq!(h.since(&Histogram::default()).count, h.count);
    }

    #[test]
    fn huge_values_count_as_the_last_bucket() {
        let mut h = Histogram::default();
        h.record(u64::MAX);
        h.record(0);
        assert_eq!((h.count, h.max_ns), (2, u64::MAX));
        assert_eq!(h.quantile_ns(0.1), 0);
    }
}
