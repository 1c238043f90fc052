//! The sensor's clock against the host's.
//!
//! An event that the sensor stamps with `t` arrives at host time `a`; `a - t` is the offset of the clocks plus the time on
//! the way. The least of it over the last 10 s is taken for the offset: some events are always quick. How much later
//! the others come is the delay. The drift is the slope of the least of each second over the last two minutes, as the
//! median of the slopes of all pairs (Theil and Sen), which a few bad seconds do not move.

use evpr_core::message::Histogram;
use std::collections::VecDeque;

/// One minimum is kept for so long, ns.
const BUCKET_NS: u64 = 1_000_000_000;
/// Host time over which the least is taken, in buckets.
const OFFSET_BUCKETS: u64 = 10;
/// Host time over which the drift is measured, in buckets.
const DRIFT_BUCKETS: u64 = 120;
/// Least buckets for it to be told whether the sensor keeps time with the host, and how far they may be apart, ns.
const MIN_TIMELY_BUCKETS: usize = 5;
const TIMELY_NS: i64 = 500_000_000;
/// Least pairs of buckets apart, and least buckets, for a drift to be told.
const MIN_DRIFT_BUCKETS: usize = 10;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct SensorClock {
    /// (bucket, least offset in it, ns), ascending.
    least: VecDeque<(u64, i64)>,
    delays: Histogram,
}

impl SensorClock {
    /// A clock of which one offset is known.
    pub(super) fn with_offset(offset_ns: i64, now_ns: u64) -> Self {
        Self {
            least: [(now_ns / BUCKET_NS, offset_ns)].into(),
            ..Self::default()
        }
    }

    /// An event of sensor time `t_ns` has arrived.
    pub(super) fn note(&mut self, arrival_ns: u64, t_ns: u64) {
        let offset = (arrival_ns as i64).saturating_sub(t_ns as i64);
        let bucket = arrival_ns / BUCKET_NS;
        match self.least.back_mut() {
            Some((newest, least)) if *newest >= bucket => *least = offset.min(*least),
            _ => self.least.push_back((bucket, offset)),
        }
        while self
            .least
            .front()
            .is_some_and(|(b, _)| b + DRIFT_BUCKETS <= bucket)
        {
            self.least.pop_front();
        }
        let least = self.offset_ns().unwrap_or(offset);
        self.delays.record(offset.saturating_sub(least).max(0) as u64);
    }

    /// Another clock runs in the camera now, which is set to go on where the old one was.
    pub(super) fn replace(&mut self) {
        if let (Some(offset), Some((bucket, _))) = (self.offset_ns(), self.least.back().copied()) {
            self.least.clear();
            self.least.push_back((bucket, offset));
        }
    }

    /// The least offsets of the last buckets, ns.
    fn lately(&self) -> impl Iterator<Item = i64> {
        let newest = self.least.back().map_or(0, |(bucket, _)| *bucket);
        let lately = self.least.iter().rev();
        let lately = lately.take_while(move |(bucket, _)| bucket + OFFSET_BUCKETS > newest);
        lately.map(|(_, offset)| *offset)
    }

    /// Host time minus sensor time, ns; `None` before the first event.
    pub(super) fn offset_ns(&self) -> Option<i64> {
        self.lately().min()
    }

    /// Whether events have come at the pace of the host's clock lately, and not faster, as out of a file.
    pub(super) fn keeps_time(&self) -> bool {
        let (least, most) = (self.lately().min(), self.lately().max());
        let apart = most.zip(least).map(|(most, least)| most.saturating_sub(least));
        self.lately().count() >= MIN_TIMELY_BUCKETS && apart.is_some_and(|ns| ns < TIMELY_NS)
    }

    /// Sensor time at this host time, ns.
    pub(super) fn sensor_ns(&self, host_ns: u64) -> Option<u64> {
        let t = (host_ns as i64).saturating_sub(self.offset_ns()?);
        Some(t.max(0) as u64)
    }

    /// Host time at this sensor time, ns.
    pub(super) fn host_ns(&self, t_ns: u64) -> Option<u64> {
        let host = i64::try_from(t_ns)
            .unwrap_or(i64::MAX)
            .saturating_add(self.offset_ns()?);
        Some(host.max(0) as u64)
    }

    /// How much faster than the host's the sensor's clock runs, parts per billion; `None` until that can be told.
    pub(super) fn drift_ppb(&self) -> Option<i64> {
        if self.least.len() < MIN_DRIFT_BUCKETS {
            return None;
        }
        let mut slopes = Vec::with_capacity(self.least.len() * self.least.len() / 2);
        for (i, (from, before)) in self.least.iter().enumerate() {
            for (to, after) in self.least.iter().skip(i + 1) {
                // A sensor that is fast is ahead more and more: the offset shrinks.
                let ns = before.saturating_sub(*after);
                slopes.push(ns as f64 / (to - from).max(1) as f64);
            }
        }
        let middle = slopes.len() / 2;
        let (_, median, _) = slopes.select_nth_unstable_by(middle, f64::total_cmp);
        Some(*median as i64)
    }

    /// How much later than the quickest events arrive: the value below which the share `q` lies, ns.
    pub(super) fn delay_ns(&self, q: f64) -> u64 {
        self.delays.quantile_ns(q)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn the_quickest_arrivals_of_the_last_seconds_say_the_offset() {
        let mut clock = SensorClock::default();
        assert_eq!((clock.offset_ns(), clock.sensor_ns(5)), (None, None));
        clock.note(100 * S + 700, S);
        clock.note(101 * S + 300, 2 * S);
        clock.note(101 * S + 900, 2 * S + 100);
        assert_eq!(clock.offset_ns(), Some(99 * S as i64 + 300));
        assert_eq!(clock.host_ns(3 * S), Some(102 * S + 300));
        assert_eq!(clock.sensor_ns(102 * S + 300), Some(3 * S));
        // Longer ago than 10 s does not count.
        clock.note(111 * S + 800, 12 * S);
        assert_eq!(clock.offset_ns(), Some(99 * S as i64 + 800));
        assert!(clock.delay_ns(1.0) >= 500);
    }

    #[test]
    fn a_stream_that_comes_faster_than_time_does_not_keep_it() {
        for (pace, keeps) in [(10, true), (12, false), (100, false)] {
            let mut clock = SensorClock::default();
            for tenth in 0..60 {
                assert!(!clock.keeps_time() || tenth > 40);
                clock.note(100 * S + tenth * S / 10, tenth * S / 10 * pace / 10);
            }
            assert_eq!(clock.keeps_time(), keeps, "{pace}");
        }
    }

    #[test]
    fn drift_is_measured_whatever_the_jitter_and_bad_seconds() {
        for ppm in [-80i64, 0, 35] {
            let mut clock = SensorClock::default();
            let mut state = 1u64;
            for ms in 0..60_000u64 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let jitter = (state >> 40) % 2_000_000;
                let stalled = if (20_000..23_000).contains(&ms) {
                    50_000_000
                } else {
                    0
                };
                let host = ms * 1_000_000;
                let sensor = (host as i64 + host as i64 * ppm / 1_000_000) as u64 + 7 * S;
                clock.note(host + 3 * S + jitter + stalled, sensor);
            }
            let drift = clock.drift_ppb().unwrap();
            assert!((drift - ppm * 1_000).abs() < 2_000, "{drift} for {ppm} ppm");
        }
    }

    #[test]
    fn extreme_times_do_not_overflow() {
        let mut clock = SensorClock::default();
        clock.note(0, i64::MAX as u64);
        clock.note(u64::MAX >> 1, 0);
        assert!(clock.sensor_ns(u64::MAX).is_some() && clock.host_ns(u64::MAX).is_some());
        clock.replace();
    }
}
