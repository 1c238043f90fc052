//! The screen: checks every event against the sensor and the order of time.

use crate::span::Span;
use crate::{MAX_TIME_NS, RawEvent, SourceError};
use evpr_core::message::Event;
use evpr_core::plan::{OnBadEvent, Plan, Sensor};
use std::path::{Path, PathBuf};

/// What the screen has seen so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ScreenTally {
    /// Events left out because they lie outside the sensor.
    pub outside: u64,
    /// Events left out because their time goes back.
    pub backward_dropped: u64,
    /// Events whose time went back and was taken as the latest so far.
    pub backward_clamped: u64,
    /// Events of a live stream left out because their times do not go with those around them.
    pub damaged_times: u64,
}

impl ScreenTally {
    /// Events left out.
    pub fn dropped(&self) -> u64 {
        self.outside + self.backward_dropped + self.damaged_times
    }

    /// Says in the log what was left out or changed, if anything was.
    pub fn log(&self) {
        if *self != Self::default() {
            tracing::warn!(
                outside = self.outside,
                backward_dropped = self.backward_dropped,
                backward_clamped = self.backward_clamped,
                damaged_times = self.damaged_times,
                "events left out or moved"
            );
        }
    }
}

/// What passes it lies inside the sensor, in a row up to [`Event::Y_MAX`], and times do not go back.
#[derive(Debug)]
pub struct Screen {
    path: PathBuf,
    sensor: Sensor,
    on_backward_time: OnBadEvent,
    on_outside_sensor: OnBadEvent,
    latest_ns: u64,
    /// Number in the recording of the next event.
    index: u64,
    tally: ScreenTally,
    span: Span,
}

impl Screen {
    /// A screen with the policies and the sensor of the plan.
    pub fn new(plan: &Plan) -> Self {
        let source = &plan.source;
        Self::of_recording(
            &source.path,
            Some(plan.sensor),
            source.on_backward_time,
            source.on_outside_sensor,
        )
    }

    /// A screen for a recording that is read without a plan. Where its sensor is not known, what no event can have is
    /// outside.
    pub fn of_recording(
        path: &Path,
        sensor: Option<Sensor>,
        on_backward_time: OnBadEvent,
        on_outside_sensor: OnBadEvent,
    ) -> Self {
        Self {
            path: path.to_owned(),
            sensor: sensor.unwrap_or(Sensor {
                height: usize::from(Event::Y_MAX) + 1,
                width: usize::from(u16::MAX),
            }),
            on_backward_time,
            on_outside_sensor,
            latest_ns: 0,
            index: 0,
            tally: ScreenTally::default(),
            span: Span::default(),
        }
    }

    /// The same, for the part of the recording that its positions cover.
    pub(crate) fn within(self, span: Span) -> Self {
        Self { span, ..self }
    }

    /// What its positions cover.
    pub(crate) fn span(&mut self) -> &mut Span {
        &mut self.span
    }

    /// What it has left out or changed.
    pub fn tally(&self) -> ScreenTally {
        self.tally
    }

    /// So many events were left out before they came here.
    pub(crate) fn left_out_damaged(&mut self, events: u64) {
        self.tally.damaged_times += events;
    }

    /// The recording went to another place: the next event is number `index`, and times begin anew.
    pub fn restart(&mut self, index: u64) {
        (self.index, self.latest_ns) = (index, 0);
    }

    /// Takes bad events out of the batch, or sets their times right, as the policies say.
    ///
    /// # Errors
    /// [`SourceError::Event`] at the first event that a policy forbids; the batch then holds the good ones before it.
    pub fn apply(&mut self, batch: &mut Vec<RawEvent>) -> Result<(), SourceError> {
        let (width, height) = self.limits();
        // One pass without branches decides whether any event needs a closer look.
        let (mut bad, mut before) = (false, self.latest_ns);
        for e in batch.iter() {
            bad |= (e.t_ns < before) | (u32::from(e.x) >= width) | (u32::from(e.y) >= height);
            before = e.t_ns;
        }
        bad |= before > MAX_TIME_NS;
        if bad {
            return self.apply_slowly(batch);
        }
        self.latest_ns = before;
        self.index += batch.len() as u64;
        Ok(())
    }

    /// Columns and rows that an event may have.
    fn limits(&self) -> (u32, u32) {
        let limit = |side: usize, most: u16| side.min(usize::from(most) + 1) as u32;
        (
            limit(self.sensor.width, u16::MAX - 1),
            limit(self.sensor.height, Event::Y_MAX),
        )
    }

    fn apply_slowly(&mut self, batch: &mut Vec<RawEvent>) -> Result<(), SourceError> {
        let mut kept = 0;
        let mut outcome = Ok(());
        for at in 0..batch.len() {
            match self.check(batch[at]) {
                Ok(Some(event)) => {
                    batch[kept] = event;
                    kept += 1;
                }
                Ok(None) => {}
                Err(e) => {
                    outcome = Err(e);
                    break;
                }
            }
            self.index += 1;
        }
        batch.truncate(kept);
        outcome
    }

    fn check(&mut self, mut event: RawEvent) -> Result<Option<RawEvent>, SourceError> {
        let (width, height) = self.limits();
        if u32::from(event.x) >= width || u32::from(event.y) >= height {
            if self.on_outside_sensor == OnBadEvent::Error {
                let what = format!(
                    "lies outside the sensor of {}; correct its size, or leave such events out with source.on_outside_sensor = \"drop\" (events: --on-outside-sensor drop)",
                    self.sensor
                );
                return Err(self.refuse(event, what));
            }
            self.tally.outside += 1;
            return Ok(None);
        }
        if event.t_ns > MAX_TIME_NS {
            return Err(self.refuse(event, "lies beyond the year 2262; its time is damaged".to_owned()));
        }
        if event.t_ns < self.latest_ns {
            match self.on_backward_time {
                OnBadEvent::Error => {
                    let what = format!(
                        "goes back in time: the one before it is at {}; leave such events out or move them with source.on_backward_time = \"drop\" or \"clamp\" (events: --on-backward-time)",
                        evpr_events::seconds(self.latest_ns)
                    );
                    return Err(self.refuse(event, what));
                }
                OnBadEvent::Drop => {
                    self.tally.backward_dropped += 1;
                    return Ok(None);
                }
                OnBadEvent::Clamp => {
                    self.tally.backward_clamped += 1;
                    event.t_ns = self.latest_ns;
                }
            }
        }
        self.latest_ns = event.t_ns;
        Ok(Some(event))
    }

    fn refuse(&self, event: RawEvent, what: String) -> SourceError {
        SourceError::Event {
            path: self.path.clone(),
            index: self.index,
            t_ns: event.t_ns,
            x: event.x,
            y: event.y,
            what,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::test_plan;
    use proptest::prelude::*;

    fn screen(time: OnBadEvent, outside: OnBadEvent) -> Screen {
        let mut plan = test_plan();
        plan.source.on_backward_time = time;
        plan.source.on_outside_sensor = outside;
        Screen::new(&plan)
    }

    fn event(t_ns: u64, x: u16, y: u16) -> RawEvent {
        RawEvent { t_ns, x, y, on: true }
    }

    #[test]
    fn an_error_names_the_event_and_the_setting_and_keeps_what_is_before() {
        let mut s = screen(OnBadEvent::Error, OnBadEvent::Error);
        s.apply(&mut vec![event(5, 0, 0)]).unwrap();
        let mut batch = vec![event(6, 5, 3), event(7, 6, 0), event(8, 0, 0)];
        let e = s.apply(&mut batch).unwrap_err().to_string();
        assert_eq!(batch, [event(6, 5, 3)]);
        assert_eq!(
            e,
            "events.h5: event 2 (from 0) at 0.000000007 s (x 6, y 0) lies outside the sensor of 4×6 (height × width); \
             correct its size, or leave such events out with source.on_outside_sensor = \"drop\" \
             (events: --on-outside-sensor drop)"
        );
        let e = screen(OnBadEvent::Error, OnBadEvent::Drop)
            .apply(&mut vec![
                event(1_500_000_000, 0, 0),
                event(3, 6, 0),
                event(2, 0, 0),
            ])
            .unwrap_err()
            .to_string();
        assert!(
            e.contains("event 2 ") && e.contains("1.500000000 s") && e.contains("on_backward_time"),
            "{e}"
        );
    }

    #[test]
    fn drop_and_clamp_count() {
        let all = [
            event(5, 0, 0),
            event(4, 1, 0),
            event(9, 9, 0),
            event(3, 2, 0),
            event(6, 3, 0),
        ];
        let mut s = screen(OnBadEvent::Drop, OnBadEvent::Drop);
        let mut batch = all.to_vec();
        s.apply(&mut batch).unwrap();
        assert_eq!(batch, [event(5, 0, 0), event(6, 3, 0)]);
        assert_eq!(
            s.tally(),
            ScreenTally {
                outside: 1,
                backward_dropped: 2,
                ..ScreenTally::default()
            }
        );
        let mut s = screen(OnBadEvent::Clamp, OnBadEvent::Drop);
        let mut batch = all.to_vec();
        s.apply(&mut batch).unwrap();
        assert_eq!(
            batch,
            [event(5, 0, 0), event(5, 1, 0), event(5, 2, 0), event(6, 3, 0)]
        );
        assert_eq!(
            s.tally(),
            ScreenTally {
                outside: 1,
                backward_clamped: 2,
                ..ScreenTally::default()
            }
        );
    }

    #[test]
    fn rows_that_do_not_fit_an_event_are_outside() {
        let mut plan = test_plan();
        plan.sensor = Sensor {
            height: 65_535,
            width: 70_000,
        };
        let mut s = Screen::new(&plan);
        s.apply(&mut vec![event(0, u16::MAX - 1, Event::Y_MAX)]).unwrap();
        assert!(s.apply(&mut vec![event(0, 0, Event::Y_MAX + 1)]).is_err());
        assert!(s.apply(&mut vec![event(0, u16::MAX, 0)]).is_err());
    }

    #[test]
    fn times_beyond_reason_are_refused_whatever_the_policy() {
        let mut s = screen(OnBadEvent::Drop, OnBadEvent::Drop);
        assert!(
            s.apply(&mut vec![event(MAX_TIME_NS, 0, 0), event(MAX_TIME_NS + 1, 0, 0)])
                .is_err()
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn any_split_gives_the_same(
            raw in proptest::collection::vec((0u64..40, 0u16..8, 0u16..6), 0..60),
            cut in 0usize..60,
            clamp: bool,
        ) {
            let all: Vec<_> = raw.into_iter().map(|(t, x, y)| event(t, x, y)).collect();
            let policy = if clamp { OnBadEvent::Clamp } else { OnBadEvent::Drop };
            let mut whole = all.clone();
            let mut a = screen(policy, OnBadEvent::Drop);
            a.apply(&mut whole).unwrap();
            let (left, right) = all.split_at(cut.min(all.len()));
            let (mut left, mut right) = (left.to_vec(), right.to_vec());
            let mut b = screen(policy, OnBadEvent::Drop);
            b.apply(&mut left).unwrap();
            b.apply(&mut right).unwrap();
            left.extend(right);
            prop_assert_eq!(&left, &whole);
            prop_assert_eq!(a.tally(), b.tally());
            prop_assert_eq!(whole.len() as u64 + a.tally().dropped(), all.len() as u64);
            prop_assert!(whole.is_sorted_by_key(|e| e.t_ns));
            prop_assert!(whole.iter().all(|e| e.x < 6 && e.y < 4));
        }
    }
}
