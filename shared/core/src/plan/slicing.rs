//! Ticks, windows and segments: how a stream of events is cut.

use crate::time::format_duration;
use serde::{Deserialize, Serialize};

/// What ticks and windows are measured in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SliceMode {
    /// Nanoseconds of sensor time.
    Time,
    /// Events.
    Count,
}

/// Where in its tick a window lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Align {
    /// At the start (the paper).
    Start,
    /// At the end: freshest. A window longer than the tick reaches back into the ticks before.
    End,
}

impl Align {
    /// As in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Align::Start => "start",
            Align::End => "end",
        }
    }
}

/// Where tick 0 begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// At the first event.
    FirstEvent,
    /// At this sensor time, ns. Earlier events are left out.
    At(u64),
    /// At the last multiple of this many ns before the first event.
    Grid(u64),
}

impl Origin {
    /// Sensor time of the start of tick 0, given the first event's, ns.
    pub fn resolve(self, first_event_ns: u64) -> u64 {
        match self {
            Origin::FirstEvent => first_event_ns,
            Origin::At(ns) => ns,
            Origin::Grid(step) => first_event_ns - first_event_ns % step.max(1),
        }
    }
}

/// How a stream is cut. Tick k is `[t0 + k·tick, t0 + (k+1)·tick)`, half-open, on an integer grid.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Slicing {
    /// Unit of `tick` and `windows`.
    pub mode: SliceMode,
    /// Length of a tick, ns or events.
    pub tick: u64,
    /// Lengths of the windows, ns or events, ascending, no two alike.
    pub windows: Vec<u64>,
    /// Where in the tick windows lie.
    pub align: Align,
    /// Where tick 0 begins.
    pub origin: Origin,
}

/// The segments a tick is cut into by the edges of all windows, and the windows as runs of segments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SegmentPlan {
    /// Offsets in the tick at which segments begin, and the tick's length as the last entry.
    pub edges: Vec<u64>,
    /// The windows.
    pub windows: Vec<WindowSpan>,
    /// Whether any window covers the segment.
    pub needed: Vec<bool>,
}

/// A window as consecutive segments; it closes with its last one, which lies in its own tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WindowSpan {
    /// Index in the tick of the last segment.
    pub last: usize,
    /// Number of segments, counted back from the last, into earlier ticks where need be.
    pub len: usize,
}

impl SegmentPlan {
    /// Segments per tick.
    pub fn per_tick(&self) -> usize {
        self.needed.len()
    }

    /// Bit i is set when window i closes with this segment.
    pub fn closes(&self, segment: usize) -> u32 {
        let closing = self.windows.iter().enumerate().filter(|(_, w)| w.last == segment);
        closing.fold(0, |bits, (i, _)| bits | 1 << i)
    }

    /// The segment with which the tick's last window closes.
    pub fn last_needed(&self) -> usize {
        self.windows.iter().map(|w| w.last).max().unwrap_or(0)
    }

    /// How many ticks before its own the windows reach back into.
    pub fn look_back_ticks(&self) -> u64 {
        let before = |w: &WindowSpan| w.len.saturating_sub(w.last + 1);
        let segments = self.windows.iter().map(before).max().unwrap_or(0);
        segments.div_ceil(self.per_tick().max(1)) as u64
    }

    /// How many segments the longest window has.
    pub fn longest(&self) -> usize {
        self.windows.iter().map(|w| w.len).max().unwrap_or(0)
    }
}

impl Slicing {
    /// The segments. Expects what the configuration has checked: a tick and windows above 0, and with
    /// [`Align::Start`] no window longer than the tick.
    pub fn segments(&self) -> SegmentPlan {
        let tick = self.tick;
        // (start, end) of each window relative to its own tick's start; the start may be negative.
        let spans: Vec<(i128, i128)> = self
            .windows
            .iter()
            .map(|w| match self.align {
                Align::Start => (0, i128::from(*w)),
                Align::End => (i128::from(tick) - i128::from(*w), i128::from(tick)),
            })
            .collect();
        let period = i128::from(tick);
        let mut edges: Vec<u64> = vec![0, tick];
        for (start, end) in &spans {
            edges.push(start.rem_euclid(period) as u64);
            edges.push(end.rem_euclid(period) as u64);
        }
        edges.sort_unstable();
        edges.dedup();
        let per_tick = edges.len() - 1;
        let index_of = |at: i128| {
            let (back, offset) = (at.div_euclid(period), at.rem_euclid(period) as u64);
            let within = edges.partition_point(|e| *e < offset) as i128;
            back * per_tick as i128 + within
        };
        let windows: Vec<WindowSpan> = spans
            .iter()
            .map(|(start, end)| {
                let (first, after) = (index_of(*start), index_of(*end));
                WindowSpan {
                    last: (after - 1) as usize,
                    len: (after - first) as usize,
                }
            })
            .collect();
        let mut needed = vec![false; per_tick];
        for w in &windows {
            for back in 0..w.len.min(per_tick) {
                needed[(w.last + per_tick - back) % per_tick] = true;
            }
        }
        SegmentPlan {
            edges,
            windows,
            needed,
        }
    }

    fn id(&self, length: u64) -> String {
        match self.mode {
            SliceMode::Time => format_duration(length),
            SliceMode::Count => format!("{length}ev"),
        }
    }

    /// `250ms`, or `100000ev` in count mode.
    pub fn window_id(&self, window: usize) -> String {
        self.windows.get(window).map_or_else(String::new, |w| self.id(*w))
    }

    /// `1s`, or `1000000ev` in count mode.
    pub fn tick_id(&self) -> String {
        self.id(self.tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slicing(tick: u64, windows: &[u64], align: Align) -> Slicing {
        Slicing {
            mode: SliceMode::Time,
            tick,
            windows: windows.to_vec(),
            align,
            origin: Origin::FirstEvent,
        }
    }

    #[test]
    fn start_aligned_windows_nest() {
        let p = slicing(1000, &[100, 250, 500], Align::Start).segments();
        assert_eq!(p.edges, [0, 100, 250, 500, 1000]);
        assert_eq!(p.needed, [true, true, true, false]);
        let spans: Vec<_> = p.windows.iter().map(|w| (w.last, w.len)).collect();
        assert_eq!(spans, [(0, 1), (1, 2), (2, 3)]);
        assert_eq!(
            (p.closes(0), p.closes(1), p.closes(3), p.last_needed()),
            (1, 2, 0, 2)
        );
    }

    #[test]
    fn a_window_of_a_whole_tick_is_one_segment() {
        let p = slicing(500, &[500], Align::Start).segments();
        assert_eq!(
            (p.edges.as_slice(), p.windows[0]),
            ([0, 500].as_slice(), WindowSpan { last: 0, len: 1 })
        );
    }

    #[test]
    fn end_aligned_windows_may_reach_back() {
        let p = slicing(1000, &[100, 1000, 2300], Align::End).segments();
        assert_eq!(p.edges, [0, 700, 900, 1000]);
        let spans: Vec<_> = p.windows.iter().map(|w| (w.last, w.len)).collect();
        // 2300 ms: the last 300 ms of tick k-3 are two segments (700..900, 900..1000), then two ticks of three.
        assert_eq!(spans, [(2, 1), (2, 3), (2, 8)]);
        assert_eq!(p.needed, [true, true, true]);
        assert_eq!(p.closes(2), 0b111);
        assert_eq!(p.look_back_ticks(), 2);
    }
}
