//! The timeline: one time that goes on whatever the camera's clock does.
//!
//! A camera that was unplugged or reset begins its time anew, and damaged data jump. Where the sensor's time goes back, or
//! is not where the host's clock expects it, it is anchored again: shifted so that it goes on where the host's
//! clock says that it should be. Ticks stay one grid that way.

use super::clock::SensorClock;
use evpr_events::{MAX_TIME_NS, RawEvent};

/// Going back by more than this is a jump; by less, what `source.on_backward_time` says.
const BACK_NS: u64 = 1_000_000_000;
/// Being ahead of both the event before and the host's clock by more than this is a jump.
const AHEAD_NS: u64 = 60_000_000_000;
/// After a connection was lost: being off the host's clock by more than this, plus a thousandth of the time away, is a
/// jump.
const OFF_NS: u64 = 2_000_000_000;

/// A jump of the sensor's time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Jump {
    /// Index in the batch of the first event after it.
    pub(super) at: usize,
    /// The sensor's own time of that event, ns.
    pub(super) sensor_ns: u64,
    /// Time that it is put at, ns.
    pub(super) anchored_ns: u64,
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Timeline {
    pub(super) clock: SensorClock,
    /// Added to the sensor's time, ns.
    shift_ns: i64,
    latest_ns: Option<u64>,
    /// When the last event before a lost connection came (host monotonic ns), until the next event.
    away_since_ns: Option<u64>,
    arrival_ns: u64,
}

impl Timeline {
    /// Goes on with the clock of an earlier ingest.
    pub(super) fn resumed(offset_ns: i64, now_ns: u64) -> Self {
        Self {
            clock: SensorClock::with_offset(offset_ns, now_ns),
            away_since_ns: Some(now_ns),
            arrival_ns: now_ns,
            ..Self::default()
        }
    }

    /// The connection is lost: the next event is of a new one.
    pub(super) fn reconnects(&mut self) {
        if self.clock.offset_ns().is_some() {
            self.away_since_ns.get_or_insert(self.arrival_ns);
        }
    }

    fn shifted(&self, t_ns: u64) -> u64 {
        let t = i64::try_from(t_ns).unwrap_or(i64::MAX);
        t.saturating_add(self.shift_ns).max(0) as u64
    }

    /// Puts the times of a batch right. Gives the first jump in it, if there is one.
    pub(super) fn admit(&mut self, arrival_ns: u64, events: &mut [RawEvent]) -> Option<Jump> {
        let mut jump = None;
        for (at, event) in events.iter_mut().enumerate() {
            if event.t_ns > MAX_TIME_NS {
                continue; // damaged, which the screen says
            }
            let sensor_ns = event.t_ns;
            let mut t = self.shifted(sensor_ns);
            if self.is_jump(arrival_ns, t) {
                let expected = self.clock.sensor_ns(arrival_ns).unwrap_or(0);
                let anchored = expected.max(self.latest_ns.unwrap_or(0));
                self.shift_ns = (anchored as i64).saturating_sub(sensor_ns as i64);
                t = self.shifted(sensor_ns);
                self.clock.replace();
                jump.get_or_insert(Jump {
                    at,
                    sensor_ns,
                    anchored_ns: t,
                });
            }
            self.away_since_ns = None;
            self.latest_ns = Some(self.latest_ns.map_or(t, |latest| latest.max(t)));
            event.t_ns = t;
        }
        if let Some(latest) = self.latest_ns.filter(|_| !events.is_empty()) {
            self.clock.note(arrival_ns, latest);
            self.arrival_ns = arrival_ns;
        }
        jump
    }

    fn is_jump(&self, arrival_ns: u64, t: u64) -> bool {
        let back = self.latest_ns.is_some_and(|latest| t + BACK_NS < latest);
        if let Some(since) = self.away_since_ns {
            let off = OFF_NS + arrival_ns.saturating_sub(since) / 1_000;
            let expected = self.clock.sensor_ns(arrival_ns);
            return back || expected.is_some_and(|expected| t.abs_diff(expected) > off);
        }
        let far = |from: Option<u64>| from.is_some_and(|from| t > from.saturating_add(AHEAD_NS));
        // The second is only asked where the first says so: it is the dearer one.
        back || (far(self.latest_ns) && far(self.clock.sensor_ns(arrival_ns)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    fn admit(timeline: &mut Timeline, arrival_ns: u64, times: &[u64]) -> (Vec<u64>, Option<usize>) {
        let event = |t_ns: &u64| RawEvent {
            t_ns: *t_ns,
            ..RawEvent::default()
        };
        let mut events: Vec<_> = times.iter().map(event).collect();
        let jump = timeline.admit(arrival_ns, &mut events);
        (events.iter().map(|e| e.t_ns).collect(), jump.map(|j| j.at))
    }

    #[test]
    fn a_camera_that_kept_its_time_keeps_it() {
        let mut timeline = Timeline::default();
        admit(&mut timeline, 50 * S, &[5 * S]);
        timeline.reconnects();
        assert_eq!(admit(&mut timeline, 60 * S, &[15 * S]), (vec![15 * S], None));
    }

    #[test]
    fn a_camera_that_began_anew_goes_on_where_the_host_is() {
        let mut timeline = Timeline::default();
        admit(&mut timeline, 50 * S, &[5 * S]);
        timeline.reconnects();
        let (times, at) = admit(&mut timeline, 60 * S, &[7, 8]);
        assert_eq!((times, at), (vec![15 * S, 15 * S + 1], Some(0)));
        assert_eq!(admit(&mut timeline, 61 * S, &[S]), (vec![16 * S - 7], None));
        // Ahead of what the host expects counts as well.
        timeline.reconnects();
        assert_eq!(
            admit(&mut timeline, 62 * S, &[99 * S]),
            (vec![17 * S + 1], Some(0))
        );
    }

    #[test]
    fn a_jump_within_a_connection_is_anchored_and_a_small_step_back_is_not() {
        let mut timeline = Timeline::default();
        admit(&mut timeline, 50 * S, &[5 * S]);
        let (times, at) = admit(&mut timeline, 51 * S, &[6 * S, 6 * S - 10, 3 * S, 3 * S + 5]);
        assert_eq!((times, at), (vec![6 * S, 6 * S - 10, 6 * S, 6 * S + 5], Some(2)));
        // A quiet hour is no jump, an hour out of nowhere is.
        let quiet = 3_600 * S;
        assert_eq!(
            admit(&mut timeline, 51 * S + quiet, &[3 * S + quiet]),
            (vec![6 * S + quiet], None)
        );
        let (times, at) = admit(&mut timeline, 52 * S + quiet, &[3 * S + 2 * quiet]);
        assert_eq!((times, at), (vec![7 * S + quiet], Some(0)));
    }

    #[test]
    fn a_stream_faster_than_time_is_no_jump() {
        let mut timeline = Timeline::default();
        for second in 0..100 {
            assert_eq!(admit(&mut timeline, 7 * S, &[second * S]).1, None);
        }
    }
}
