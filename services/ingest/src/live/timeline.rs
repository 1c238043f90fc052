//! The timeline: one time that goes on whatever the camera's clock does.
//!
//! A camera that was unplugged or reset begins its time anew, and damaged data have times out of nowhere. An event whose
//! time steps out of what was before it is kept back until it is clear which of the two it is:
//!
//! - Events after it go on with its time ([`MIN_AGREEING`] of them over [`MIN_SPAN_NS`]): the camera's time has jumped.
//!   Where it went back, or is not where the host's clock expects it, it is anchored again: shifted so that it goes on
//!   where the host's clock says that it should be. Ticks stay one grid that way.
//! - An event that goes on with the time before contradicts it: it is damaged, and left out alone.

use super::clock::SensorClock;
use evpr_events::{BATCH_EVENTS, MAX_TIME_NS, RawEvent};

/// Going back by more than this is a step; by less, what `source.on_backward_time` says.
const BACK_NS: u64 = 1_000_000_000;
/// Being ahead of both the event before and the host's clock by more than this is a step. A damaged time that is less
/// ahead costs the events up to it, so it is small: a step that is none costs nothing but a short wait.
const AHEAD_NS: u64 = 20_000_000;
/// A step ahead that is real is a stretch without events up to this length, and a jump beyond it, where the stream comes
/// faster than time; where it has kept time with the host so far, [`BACK_NS`] is the limit.
const QUIET_NS: u64 = 60_000_000_000;
/// After a connection was lost: being off the host's clock by more than this, plus a thousandth of the time away, is a
/// step.
const OFF_NS: u64 = 2_000_000_000;
/// Events that have to agree for a step to be real,
const MIN_AGREEING: usize = 8;
/// and the sensor time that they have to span, ns: longer than a damaged upper half of the time holds in any encoding.
const MIN_SPAN_NS: u64 = 10_000_000;
/// So many events that agree are believed, whatever they span.
const MAX_KEPT: usize = BATCH_EVENTS;
/// Events that agree go back by no more than this, ns.
const DISORDER_NS: u64 = 1_000_000;

/// A step of the sensor's time that was real.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Step {
    /// Index in what was let through of the first event after it.
    pub(super) at: usize,
    /// The sensor's own time of that event, ns.
    pub(super) sensor_ns: u64,
    /// Time that it is put at, ns.
    pub(super) at_ns: u64,
    /// How far that is after the event before, ns.
    pub(super) ahead_ns: u64,
    /// Whether the timeline was anchored anew: what was between is not known.
    pub(super) anchored: bool,
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
    /// Events after a step, in the sensor's own time, until it is known whether it is real.
    kept: Vec<RawEvent>,
    /// The least host time minus sensor time of those.
    kept_offset_ns: i64,
    damaged: u64,
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
        self.give_up();
        if self.clock.offset_ns().is_some() {
            self.away_since_ns.get_or_insert(self.arrival_ns);
        }
    }

    /// Nothing more comes: what is kept back is left out.
    pub(super) fn give_up(&mut self) {
        self.damaged += self.kept.len() as u64;
        self.kept.clear();
    }

    /// Events left out since the last call, because their times are damaged.
    pub(super) fn take_damaged(&mut self) -> u64 {
        std::mem::take(&mut self.damaged)
    }

    fn shifted(&self, t_ns: u64) -> u64 {
        let t = i64::try_from(t_ns).unwrap_or(i64::MAX);
        t.saturating_add(self.shift_ns).max(0) as u64
    }

    /// Puts the times of a batch right; takes out what is damaged, or kept back, and puts in what no longer is. Gives
    /// the steps in it.
    pub(super) fn admit(&mut self, arrival_ns: u64, events: &mut Vec<RawEvent>) -> Vec<Step> {
        let mut steps = Vec::new();
        let goes_on = self.admit_in_place(arrival_ns, events);
        if goes_on < events.len() {
            let rest = events.split_off(goes_on);
            for event in rest {
                self.take(arrival_ns, event, events, &mut steps);
            }
        }
        if let Some(latest) = self.latest_ns.filter(|_| !events.is_empty()) {
            self.clock.note(arrival_ns, latest);
            self.arrival_ns = arrival_ns;
        }
        steps
    }

    /// As long as nothing is odd; gives how many events are done.
    fn admit_in_place(&mut self, arrival_ns: u64, events: &mut [RawEvent]) -> usize {
        if !self.kept.is_empty() {
            return 0;
        }
        for (at, event) in events.iter_mut().enumerate() {
            let t = self.shifted(event.t_ns);
            if event.t_ns > MAX_TIME_NS || self.is_step(arrival_ns, t) {
                return at;
            }
            event.t_ns = self.pass(t);
        }
        events.len()
    }

    /// An event of this time goes on with the timeline.
    fn pass(&mut self, t: u64) -> u64 {
        self.away_since_ns = None;
        self.latest_ns = Some(self.latest_ns.map_or(t, |latest| latest.max(t)));
        t
    }

    /// Takes an event while others are kept back, or the first of such.
    fn take(&mut self, arrival_ns: u64, event: RawEvent, out: &mut Vec<RawEvent>, steps: &mut Vec<Step>) {
        if event.t_ns > MAX_TIME_NS {
            self.damaged += 1;
            return;
        }
        let t = self.shifted(event.t_ns);
        if !self.is_step(arrival_ns, t) {
            // What is kept back may be in order with it: the host's clock has come up to it.
            if self.kept.iter().all(|kept| self.follows(kept.t_ns, t)) {
                for kept in std::mem::take(&mut self.kept) {
                    let t_ns = self.pass(self.shifted(kept.t_ns));
                    out.push(RawEvent { t_ns, ..kept });
                }
            }
            self.give_up();
            let t_ns = self.pass(t);
            out.push(RawEvent { t_ns, ..event });
            return;
        }
        if self.kept.last().is_some_and(|last| !agree(last.t_ns, event.t_ns)) {
            self.give_up();
        }
        let offset = (arrival_ns as i64).saturating_sub(event.t_ns as i64);
        self.kept_offset_ns = match self.kept.is_empty() {
            true => offset,
            false => offset.min(self.kept_offset_ns),
        };
        self.kept.push(event);
        let span = |from: &RawEvent| event.t_ns.saturating_sub(from.t_ns) >= MIN_SPAN_NS;
        if self.kept.len() >= MAX_KEPT
            || (self.kept.len() >= MIN_AGREEING && self.kept.first().is_some_and(span))
        {
            steps.extend(self.believe(out));
        }
    }

    /// Whether a kept event, put on the timeline as it is, lies between the latest and one at `t`.
    fn follows(&self, kept_ns: u64, t: u64) -> bool {
        let kept = self.shifted(kept_ns);
        kept <= t.saturating_add(DISORDER_NS) && self.latest_ns.is_none_or(|latest| kept >= latest)
    }

    /// The step before what is kept back is real.
    fn believe(&mut self, out: &mut Vec<RawEvent>) -> Option<Step> {
        let kept = std::mem::take(&mut self.kept);
        let sensor_ns = kept.first()?.t_ns;
        let before = self.latest_ns;
        // When it came, by those of them that were quickest.
        let arrival_ns = (sensor_ns as i64).saturating_add(self.kept_offset_ns).max(0) as u64;
        let anchored = self.is_jump(arrival_ns, self.shifted(sensor_ns));
        if anchored {
            let expected = self.clock.sensor_ns(arrival_ns).unwrap_or(0);
            let anchor = expected.max(before.unwrap_or(0));
            self.shift_ns = (anchor as i64).saturating_sub(sensor_ns as i64);
            self.clock.replace();
        }
        let at_ns = self.shifted(sensor_ns);
        let at = out.len();
        for event in kept {
            let t_ns = self.pass(self.shifted(event.t_ns));
            out.push(RawEvent { t_ns, ..event });
        }
        Some(Step {
            at,
            sensor_ns,
            at_ns,
            ahead_ns: before.map_or(0, |before| at_ns.saturating_sub(before)),
            anchored,
        })
    }

    /// Whether an event at `t` steps out of what was before it.
    fn is_step(&self, arrival_ns: u64, t: u64) -> bool {
        self.is_out_by(AHEAD_NS, arrival_ns, t)
    }

    /// Whether such a step, if it is real, is another clock and not a stretch without events.
    fn is_jump(&self, arrival_ns: u64, t: u64) -> bool {
        let quiet = if self.clock.keeps_time() {
            BACK_NS
        } else {
            QUIET_NS
        };
        self.is_out_by(quiet, arrival_ns, t)
    }

    fn is_out_by(&self, ahead_ns: u64, arrival_ns: u64, t: u64) -> bool {
        let back = self.latest_ns.is_some_and(|latest| t + BACK_NS < latest);
        if let Some(since) = self.away_since_ns {
            let off = OFF_NS + arrival_ns.saturating_sub(since) / 1_000;
            let expected = self.clock.sensor_ns(arrival_ns);
            return back || expected.is_some_and(|expected| t.abs_diff(expected) > off);
        }
        let far = |from: u64, by: u64| t > from.saturating_add(by);
        // The host's clock is only asked where the event before says so: it is the dearer one.
        back || self.latest_ns.is_some_and(|latest| {
            far(latest, ahead_ns)
                && match self.clock.sensor_ns(arrival_ns) {
                    Some(expected) => far(expected, ahead_ns),
                    // The first batch is what came over a while.
                    None => far(latest, ahead_ns.max(BACK_NS)),
                }
        })
    }
}

/// Whether two events in a row may be of one clock.
fn agree(before_ns: u64, t_ns: u64) -> bool {
    (before_ns.saturating_sub(DISORDER_NS)..before_ns.saturating_add(QUIET_NS)).contains(&t_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;
    const MS: u64 = 1_000_000;

    /// What comes out, and the steps: where, and whether the timeline was anchored.
    type Admitted = (Vec<u64>, Vec<(usize, bool)>);

    fn admit(timeline: &mut Timeline, arrival_ns: u64, times: &[u64]) -> Admitted {
        let event = |t_ns: &u64| RawEvent {
            t_ns: *t_ns,
            ..RawEvent::default()
        };
        let mut events: Vec<_> = times.iter().map(event).collect();
        let steps = timeline.admit(arrival_ns, &mut events);
        let steps = steps.iter().map(|s| (s.at, s.anchored)).collect();
        (events.iter().map(|e| e.t_ns).collect(), steps)
    }

    /// Events a thousandth of a second apart, from this time on.
    fn run(from_ns: u64, count: u64) -> Vec<u64> {
        (0..count).map(|i| from_ns + i * MS).collect()
    }

    /// A stream of which every event comes at once, up to sensor time 6 s at host time 51 s.
    fn begun() -> Timeline {
        let mut timeline = Timeline::default();
        for t in run(5 * S, 1001) {
            assert_eq!(admit(&mut timeline, 45 * S + t, &[t]), (vec![t], vec![]));
        }
        timeline
    }

    #[test]
    fn a_damaged_time_costs_only_itself() {
        // Ahead by little and by much, back, and beyond all times.
        for damaged in [6 * S + 35 * MS, 36 * S, 500 * S, 10 * MS, u64::MAX] {
            let mut timeline = begun();
            let (good, more) = (run(6 * S, 5), run(6 * S + 5 * MS, 5));
            let times = [&good[..], &[damaged], &more[..]].concat();
            let all = [good, more].concat();
            assert_eq!(admit(&mut timeline, 51 * S + 10 * MS, &times), (all, vec![]));
            assert_eq!(
                (timeline.take_damaged(), timeline.take_damaged()),
                (1, 0),
                "{damaged}"
            );
            // The same at the end of a batch, and a few in a row that do not agree.
            let times = [6 * S + 10 * MS, damaged, damaged / 2, 777 * S, damaged];
            admit(&mut timeline, 51 * S + 11 * MS, &times);
            let more = run(6 * S + 11 * MS, 50);
            assert_eq!(admit(&mut timeline, 51 * S + 61 * MS, &more), (more, vec![]));
            assert_eq!(timeline.take_damaged(), 4, "{damaged}");
        }
    }

    #[test]
    fn a_damaged_stretch_costs_only_itself() {
        // As many as there are, they span less than a jump does.
        let mut timeline = begun();
        let damaged: Vec<u64> = (0..5_000).map(|i| 30 * S + i * 1_000).collect();
        assert_eq!(admit(&mut timeline, 51 * S + 5 * MS, &damaged), (vec![], vec![]));
        let more = run(6 * S + 5 * MS, 50);
        assert_eq!(admit(&mut timeline, 51 * S + 55 * MS, &more), (more, vec![]));
        assert_eq!(timeline.take_damaged(), 5_000);
    }

    #[test]
    fn a_jump_that_persists_is_anchored_once_and_nothing_of_it_is_lost() {
        // Back, and ahead by more than any quiet stretch.
        for to in [7, 500 * S] {
            let mut timeline = begun();
            // In two parts: the first is kept back, and the eleventh event confirms it. The first of them was there at
            // the host's 51.001 s, as the fifth came 4 ms after it.
            let first = admit(&mut timeline, 51 * S + 5 * MS, &run(to, 5));
            assert_eq!(first, (vec![], vec![]), "{to}");
            let second = admit(&mut timeline, 51 * S + 30 * MS, &run(to + 5 * MS, 6));
            assert_eq!(second, (run(6 * S + MS, 11), vec![(0, true)]), "{to}");
            let (more, after) = (run(to + 11 * MS, 9), run(6 * S + 12 * MS, 9));
            assert_eq!(
                admit(&mut timeline, 51 * S + 40 * MS, &more),
                (after, vec![]),
                "{to}"
            );
            assert_eq!(timeline.take_damaged(), 0);
        }
    }

    #[test]
    fn a_camera_that_kept_time_has_jumped_where_it_goes_ahead_of_it() {
        let mut timeline = begun();
        for t in run(6 * S + MS, 5_000) {
            assert_eq!(admit(&mut timeline, 45 * S + t, &[t]), (vec![t], vec![]));
        }
        let (to, at) = (30 * S, 11 * S + 5 * MS);
        let (times, steps) = admit(&mut timeline, 56 * S + 15 * MS, &run(to, 11));
        assert_eq!((times, steps), (run(at, 11), vec![(0, true)]));
        // By less than a second it is only quick.
        let (times, steps) = admit(&mut timeline, 56 * S + 30 * MS, &run(to + 500 * MS, 11));
        assert_eq!((times, steps), (run(at + 500 * MS, 11), vec![(0, false)]));
    }

    #[test]
    fn events_before_and_after_a_jump_in_one_batch_are_told_apart() {
        let mut timeline = begun();
        let times = [
            run(6 * S, 5),
            run(3 * S, 20),
            vec![400 * S],
            run(3 * S + 20 * MS, 5),
        ]
        .concat();
        let (out, steps) = admit(&mut timeline, 51 * S + 20 * MS, &times);
        assert_eq!((out.len(), steps), (30, vec![(5, true)]));
        assert!(out.is_sorted() && out[5] >= 6 * S + 4 * MS, "{out:?}");
        assert_eq!(timeline.take_damaged(), 1);
    }

    #[test]
    fn a_small_step_back_is_left_to_the_screen() {
        let mut timeline = begun();
        let times = [6 * S, 6 * S - 10, 5 * S + 1];
        assert_eq!(admit(&mut timeline, 51 * S, &times), (times.to_vec(), vec![]));
    }

    #[test]
    fn a_camera_that_kept_its_time_keeps_it() {
        let mut timeline = begun();
        timeline.reconnects();
        assert_eq!(admit(&mut timeline, 60 * S, &[15 * S]), (vec![15 * S], vec![]));
    }

    #[test]
    fn a_camera_that_began_anew_goes_on_where_the_host_is() {
        let mut timeline = begun();
        timeline.reconnects();
        let (times, steps) = admit(&mut timeline, 60 * S, &run(7, 11));
        assert_eq!((times, steps), (run(15 * S - 10 * MS, 11), vec![(0, true)]));
        // Ahead of what the host expects counts as well, and what was kept of the old connection does not.
        admit(&mut timeline, 61 * S, &run(700 * S, 5));
        timeline.reconnects();
        assert_eq!(timeline.take_damaged(), 5);
        let (times, steps) = admit(&mut timeline, 62 * S, &run(99 * S, 11));
        assert_eq!((times, steps), (run(17 * S - 10 * MS, 11), vec![(0, true)]));
        // And one damaged event at the start is no jump.
        timeline.reconnects();
        let times = [vec![5], run(101 * S, 3)].concat();
        let (out, steps) = admit(&mut timeline, 64 * S, &times);
        assert_eq!((out, steps), (run(19 * S - 10 * MS, 3), vec![]));
    }

    #[test]
    fn a_quiet_hour_is_no_step() {
        let mut timeline = begun();
        let hour = 3_600 * S;
        assert_eq!(
            admit(&mut timeline, 51 * S + hour, &[6 * S + hour]),
            (vec![6 * S + hour], vec![])
        );
    }

    #[test]
    fn a_stream_faster_than_time_loses_nothing() {
        // Dense, with quiet stretches, and so sparse that each event is far from the next.
        for gap_ms in [1, 30, 1_000, 59_000] {
            let mut timeline = Timeline::default();
            let times: Vec<u64> = (0..400).map(|i| (i + i / 40 * gap_ms) * MS).collect();
            let sparse: Vec<u64> = (1..401).map(|i| times[399] + i * gap_ms * MS).collect();
            let mut out = Vec::new();
            for part in [times.clone(), sparse.clone()].concat().chunks(33) {
                let (times, steps) = admit(&mut timeline, 7 * S, part);
                assert!(steps.iter().all(|(_, anchored)| !anchored), "{gap_ms}: {steps:?}");
                out.extend(times);
            }
            // But for what nothing has confirmed yet.
            timeline.give_up();
            let kept = timeline.take_damaged();
            assert!(kept < MIN_AGREEING as u64, "{gap_ms}: {kept}");
            assert_eq!(out.len() as u64 + kept, 800, "{gap_ms}");
            assert_eq!(out, [times, sparse].concat()[..out.len()], "{gap_ms}");
        }
    }
}
