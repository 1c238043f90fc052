//! Which frame belongs to which tick.

use crate::{FrameError, FrameList};
use evpr_core::plan::{Align, FrameTicks, Slicing};

/// Most ticks between two frames: more is taken for a damaged time.
const MAX_GAP_TICKS: u64 = 100_000;

/// The ticks of a list of frames. Where frames have no times, frame k is taken at k ticks.
#[derive(Debug, Clone)]
pub struct Timeline {
    kind: FrameTicks,
    tick_ns: u64,
    /// Start of tick 0, and whether the last frame of a tick counts; for ticks of a fixed length.
    t0_ns: u64,
    last: bool,
    frames: usize,
    times: Option<Vec<u64>>,
}

/// A tick of a [`Timeline`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameTick {
    /// Its start, ns.
    pub start_ns: u64,
    /// Its end, ns.
    pub end_ns: u64,
    /// When its frame is known, ns: when it is taken, or, where a later one might be chosen, at the tick's end.
    pub due_ns: u64,
    /// Its frame, if it has one.
    pub frame: Option<usize>,
    /// Where its frame was taken, metres east and north.
    pub position: Option<[f64; 2]>,
}

impl Timeline {
    /// The ticks of these frames, with this slicing.
    ///
    /// # Errors
    /// When times jump too far ahead for ticks of this length.
    pub fn new(list: &FrameList, kind: FrameTicks, slicing: &Slicing) -> Result<Self, FrameError> {
        let tick_ns = slicing.tick.max(1);
        let times = list.times();
        let first = times
            .as_ref()
            .and_then(|times| times.first().copied())
            .unwrap_or(0);
        let timeline = Self {
            kind,
            tick_ns,
            t0_ns: slicing.origin.resolve(first),
            last: slicing.align == Align::End,
            frames: list.len(),
            times,
        };
        if kind == FrameTicks::Time {
            let jump = (1..timeline.frames)
                .find(|i| (timeline.time(*i) - timeline.time(*i - 1)) / tick_ns > MAX_GAP_TICKS);
            let late = first.saturating_sub(timeline.t0_ns) / tick_ns > MAX_GAP_TICKS;
            if let Some(frame) = jump.or(late.then_some(0)) {
                let what = format!(
                    "frame {frame} (from 0) is more than {MAX_GAP_TICKS} ticks after what comes before; check its t, \
                     source.time_unit and slicing"
                );
                return Err(FrameError::new(list.path(), what));
            }
            if timeline.ticks() == 0 {
                let what = "all frames are earlier than slicing.origin; correct the origin";
                return Err(FrameError::new(list.path(), what));
            }
        }
        Ok(timeline)
    }

    /// Number of ticks: the last one has the last frame.
    pub fn ticks(&self) -> u64 {
        match (self.kind, self.frames.checked_sub(1)) {
            (_, None) => 0,
            (FrameTicks::Frame, _) => self.frames as u64,
            (FrameTicks::Time, Some(last)) => match self.time(last).checked_sub(self.t0_ns) {
                Some(after) => after / self.tick_ns + 1,
                None => 0,
            },
        }
    }

    /// Tick `tick` of these frames; without a frame beyond the last.
    pub fn tick(&self, list: &FrameList, tick: u64) -> FrameTick {
        let (start_ns, end_ns, frame) = match self.kind {
            FrameTicks::Frame => {
                let frame = usize::try_from(tick).ok().filter(|frame| *frame < self.frames);
                let at = frame.unwrap_or(self.frames);
                let start = self.time(at);
                (start, self.time(at.saturating_add(1)).max(start), frame)
            }
            FrameTicks::Time => {
                let start = self.t0_ns.saturating_add(tick.saturating_mul(self.tick_ns));
                let end = start.saturating_add(self.tick_ns);
                (start, end, self.frame_between(start, end))
            }
        };
        let due_ns = match self.kind {
            FrameTicks::Frame => start_ns,
            FrameTicks::Time => end_ns,
        };
        FrameTick {
            start_ns,
            end_ns,
            due_ns,
            frame,
            position: frame.and_then(|frame| list.position(frame)),
        }
    }

    /// The first or the last frame in a half-open stretch of time.
    fn frame_between(&self, start: u64, end: u64) -> Option<usize> {
        let before = |t: u64| match &self.times {
            Some(times) => times.partition_point(|at| *at < t),
            None => usize::try_from(t.div_ceil(self.tick_ns)).map_or(self.frames, |n| n.min(self.frames)),
        };
        let (first, after) = (before(start), before(end));
        let frame = if self.last { after.checked_sub(1)? } else { first };
        (first..after).contains(&frame).then_some(frame)
    }

    /// When a frame is taken, ns; beyond the last one, one tick after another.
    fn time(&self, frame: usize) -> u64 {
        let steps = |n: usize| (n as u64).saturating_mul(self.tick_ns);
        match &self.times {
            None => steps(frame),
            Some(times) => times.get(frame).copied().unwrap_or_else(|| {
                let last = times.last().copied().unwrap_or(0);
                last.saturating_add(steps((frame + 1).saturating_sub(times.len())))
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::{FrameSource, Origin, Source, test_plan};

    const MS: u64 = 1_000_000;

    fn list(times: &[&str]) -> (tempfile::TempDir, FrameList) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("l.csv");
        let lines: String = times
            .iter()
            .enumerate()
            .map(|(i, t)| format!("@{i}@7@.png,{t}\n"))
            .collect();
        std::fs::write(&path, format!("file,t\n{lines}")).unwrap();
        let list = FrameList::open(&Source::frames(path, FrameSource::default())).unwrap();
        (folder, list)
    }

    fn slicing(tick_ms: u64, align: Align, origin: Origin) -> Slicing {
        Slicing {
            tick: tick_ms * MS,
            windows: vec![tick_ms * MS],
            align,
            origin,
            ..test_plan().slicing
        }
    }

    fn frames(list: &FrameList, slicing: &Slicing) -> Vec<Option<usize>> {
        let timeline = Timeline::new(list, FrameTicks::Time, slicing).unwrap();
        (0..timeline.ticks())
            .map(|k| timeline.tick(list, k).frame)
            .collect()
    }

    #[test]
    fn every_frame_is_a_tick() {
        let (_folder, list) = list(&["1", "1.5", "4"]);
        let timeline = Timeline::new(
            &list,
            FrameTicks::Frame,
            &slicing(200, Align::Start, Origin::FirstEvent),
        )
        .unwrap();
        assert_eq!(timeline.ticks(), 3);
        let all: Vec<_> = (0..4).map(|k| timeline.tick(&list, k)).collect();
        let times: Vec<_> = all
            .iter()
            .map(|t| (t.start_ns / MS, t.end_ns / MS, t.due_ns / MS, t.frame))
            .collect();
        assert_eq!(
            times,
            [
                (1000, 1500, 1000, Some(0)),
                (1500, 4000, 1500, Some(1)),
                (4000, 4200, 4000, Some(2)),
                (4200, 4400, 4200, None)
            ]
        );
        assert_eq!(all[2].position, Some([2.0, 7.0]));
        let beyond = timeline.tick(&list, u64::MAX);
        assert_eq!((beyond.frame, beyond.position), (None, None));
    }

    #[test]
    fn ticks_by_time_have_their_first_or_last_frame() {
        let (_folder, list) = list(&["1", "1.1", "1.2", "1.9"]);
        let by = |align, origin| frames(&list, &slicing(200, align, origin));
        assert_eq!(
            by(Align::Start, Origin::FirstEvent),
            [Some(0), Some(2), None, None, Some(3)]
        );
        assert_eq!(
            by(Align::End, Origin::FirstEvent),
            [Some(1), Some(2), None, None, Some(3)]
        );
        assert_eq!(
            by(Align::Start, Origin::At(1_150 * MS)),
            [Some(2), None, None, Some(3)]
        );
        assert_eq!(
            by(Align::Start, Origin::At(900 * MS)),
            [Some(0), Some(1), None, None, None, Some(3)]
        );
        let late = Timeline::new(
            &list,
            FrameTicks::Time,
            &slicing(200, Align::Start, Origin::At(2_000 * MS)),
        );
        assert!(late.unwrap_err().to_string().contains("slicing.origin"));
    }

    #[test]
    fn time_that_jumps_far_ahead_is_refused() {
        let (_folder, list) = list(&["1", "1587452582"]);
        let slicing = slicing(200, Align::Start, Origin::FirstEvent);
        let error = Timeline::new(&list, FrameTicks::Time, &slicing).unwrap_err();
        assert!(error.to_string().contains("frame 1 (from 0)"), "{error}");
        assert!(Timeline::new(&list, FrameTicks::Frame, &slicing).is_ok());
    }
}
