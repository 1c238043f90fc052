//! The last time of every pixel and polarity, for the time surface.

use crate::decay::Decay;
use evpr_core::message::Event;

/// Last times of one segment.
#[derive(Debug, Clone)]
pub(crate) struct Slot {
    /// Per pixel a pair, ON then OFF: 0 where no event is, else the time from `base_us`, in the [`Range`].
    pub(crate) times: Vec<u32>,
    /// Times count from here, modulo 2^64 (it may lie before 0).
    pub(crate) base_us: u64,
    /// Time of the last event in stream order, µs.
    pub(crate) last_us: Option<u64>,
    /// The largest of the times of ON and of OFF, where that is known without a look at all of them.
    pub(crate) largest: Option<[u32; 2]>,
}

/// Which times, from their base, are kept.
///
/// From the earliest to the latest: the 0 of "no event" is then so much before any of them that it is black, and the
/// latest plus the lead is still within u32. So a pixel's age is one subtraction, event or not.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Range {
    earliest: u32,
    /// Where a new base puts its first event. What would come before the earliest then is black by its age.
    pub(crate) centre: u32,
}

impl Range {
    pub(crate) const LATEST: u32 = u32::MAX - Decay::MAX_TAU_US as u32;

    pub(crate) fn new(decay: &Decay) -> Self {
        let earliest = decay.always_black_us();
        Self {
            earliest,
            centre: (2 * earliest).max(1 << 31),
        }
    }

    /// The base with which a time is at the centre.
    pub(crate) fn base_for(self, time_us: u64) -> u64 {
        time_us.wrapping_sub(self.centre.into())
    }

    /// The time from a base, if it is in the range.
    pub(crate) fn stored(self, time_us: u64, base_us: u64) -> Option<u32> {
        let since = u32::try_from(time_us.wrapping_sub(base_us)).ok()?;
        (self.earliest..=Self::LATEST).contains(&since).then_some(since)
    }

    /// The stored time of an event (or 0) from a base that is `by` earlier. What comes to lie before the range is
    /// black, and forgotten; what comes to lie after it goes to its end.
    pub(crate) fn shifted(self, time: u32, by: i128) -> u32 {
        let shifted = i128::from(time) + by;
        if time == 0 || shifted < self.earliest.into() {
            return 0;
        }
        shifted.min(Self::LATEST.into()) as u32
    }
}

/// Where in `len` times an event's is kept, if the event lies in the sensor.
#[inline]
fn index(event: &Event, width: usize, len: usize) -> Option<usize> {
    let x = usize::from(event.x);
    let index = 2 * (usize::from(event.y()) * width + x) + usize::from(!event.on());
    (x < width && index < len).then_some(index)
}

impl Slot {
    pub(crate) fn empty(pixels: usize) -> Self {
        Self {
            times: vec![0; 2 * pixels],
            base_us: 0,
            last_us: None,
            largest: Some([0; 2]),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.times.fill(0);
        self.last_us = None;
        self.largest = Some([0; 2]);
    }

    /// Enters events; returns how many lie in the sensor, and whether their times never go back. Their times are right
    /// if the largest `t_us`, `base` added, is.
    fn enter(&mut self, events: &[Event], base: u32, width: usize) -> (usize, bool) {
        let times = self.times.as_mut_slice();
        let (mut entered, mut before_us, mut in_order) = (0, 0, true);
        for event in events {
            in_order &= before_us <= event.t_us;
            before_us = event.t_us;
            if let Some(index) = index(event, width, times.len()) {
                times[index] = base.wrapping_add(event.t_us);
                entered += 1;
            }
        }
        (entered, in_order)
    }

    pub(crate) fn accumulate(&mut self, events: &[Event], base_us: u64, width: usize, range: Range) -> usize {
        let mut entered = None;
        let before = self.largest.take();
        if let Some(base) = range.stored(base_us, self.base_us) {
            let (count, in_order) = self.enter(events, base, width);
            let mut times_us = events.iter().map(|e| e.t_us);
            let longest_us = if in_order {
                times_us.next_back()
            } else {
                times_us.max()
            };
            let latest_us = base_us.saturating_add(longest_us.unwrap_or(0).into());
            if range.stored(latest_us, self.base_us).is_some() {
                entered = Some(count);
                self.largest = before
                    .filter(|_| in_order)
                    .and_then(|before| self.largest_after(before, events, base, width));
            }
        }
        // Rare: many minutes between events of one segment, or as much back. What the attempt above wrote is written
        // again.
        let far = || {
            events
                .iter()
                .map(|e| self.enter_far(e, base_us, width, range))
                .sum()
        };
        let entered = entered.unwrap_or_else(far);
        let inside = |e: &&Event| index(e, width, self.times.len()).is_some();
        if let Some(last) = events.iter().rev().find(inside) {
            self.last_us = Some(base_us.saturating_add(last.t_us.into()));
        }
        entered
    }

    /// The largest times after these events, which are in order: of each polarity that of its last event, if all began
    /// when everything before had been, and if that event is among the last few.
    fn largest_after(&self, before: [u32; 2], events: &[Event], base: u32, width: usize) -> Option<[u32; 2]> {
        const FEW: usize = 256;
        let Some(first) = events.first() else {
            return Some(before);
        };
        if base + first.t_us < before[0].max(before[1]) {
            return None;
        }
        let last_few = events.iter().rev().take(FEW);
        let last = |on: bool| {
            let mut inside = last_few
                .clone()
                .filter(|e| e.on() == on && index(e, width, self.times.len()).is_some());
            inside.next().map(|e| base + e.t_us)
        };
        let last = [last(true), last(false)];
        let known = events.len() <= FEW || last.iter().all(Option::is_some);
        known.then(|| [0, 1].map(|polarity| last[polarity].unwrap_or(before[polarity])))
    }

    /// Enters one event, and moves the base where its time is not in the range.
    fn enter_far(&mut self, event: &Event, base_us: u64, width: usize, range: Range) -> usize {
        let Some(index) = index(event, width, self.times.len()) else {
            return 0;
        };
        let time_us = base_us.saturating_add(event.t_us.into());
        self.times[index] = range.stored(time_us, self.base_us).unwrap_or_else(|| {
            let by = difference(self.base_us, range.base_for(time_us));
            self.times
                .iter_mut()
                .for_each(|time| *time = range.shifted(*time, by));
            self.base_us = range.base_for(time_us);
            range.centre
        });
        1
    }
}

/// How much later the first base is. Bases are times less the centre.
pub(crate) fn difference(base_us: u64, other_us: u64) -> i128 {
    let time = |base_us: u64| i128::from(base_us.wrapping_add(1 << 32));
    time(base_us) - time(other_us)
}
