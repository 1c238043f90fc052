//! `time_surface`: how recent the last event of each pixel and polarity is.

use crate::decay::Decay;
use crate::method::Method;
use crate::pixels::{largest, render_pairs};
use evpr_core::message::Event;
use evpr_core::plan::{Params, Sensor};

/// Numbers that are worked on at once: stretches of so many without an event cost little.
const RUN: usize = 32;

/// Channels ON, OFF, 0. The formula is [`Decay`]'s; "last" means last in stream order, and the frame's last event is
/// the last of either polarity.
#[derive(Debug)]
pub(crate) struct TimeSurface {
    width: usize,
    range: Range,
    slots: Vec<Slot>,
    /// The base that new slots take while they can, so that their times go together as they are.
    base_us: u64,
    /// Times of the frame that is being rendered, where it has more than one slot. As [`Slot::times`].
    merged: Vec<u32>,
    on: Decay,
    off: Decay,
}

/// Last times of one segment.
#[derive(Debug, Clone)]
struct Slot {
    /// Per pixel a pair, ON then OFF: 0 where no event is, else the time from `base_us`, in the [`Range`].
    times: Vec<u32>,
    /// Times count from here, modulo 2^64 (it may lie before 0).
    base_us: u64,
    /// Time of the last event in stream order, µs.
    last_us: Option<u64>,
}

/// Which times, from their base, are kept.
///
/// From the earliest to the latest: the 0 of "no event" is then so much before any of them that it is black, and the
/// latest plus the lead is still within u32. So a pixel's age is one subtraction, event or not.
#[derive(Debug, Clone, Copy)]
struct Range {
    earliest: u32,
    /// Where a new base puts its first event. What would come before the earliest then is black by its age.
    centre: u32,
}

impl Range {
    const LATEST: u32 = u32::MAX - Decay::MAX_TAU_US as u32;

    fn new(decay: &Decay) -> Self {
        let earliest = decay.always_black_us();
        Self {
            earliest,
            centre: (2 * earliest).max(1 << 31),
        }
    }

    /// The base with which a time is at the centre.
    fn base_for(self, time_us: u64) -> u64 {
        time_us.wrapping_sub(self.centre.into())
    }

    /// The time from a base, if it is in the range.
    fn stored(self, time_us: u64, base_us: u64) -> Option<u32> {
        let since = u32::try_from(time_us.wrapping_sub(base_us)).ok()?;
        (self.earliest..=Self::LATEST).contains(&since).then_some(since)
    }

    /// The stored time of an event (or 0) from a base that is `by` earlier. What comes to lie before the range is
    /// black, and forgotten; what comes to lie after it goes to its end.
    fn shifted(self, time: u32, by: i128) -> u32 {
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
    /// Enters events; returns how many lie in the sensor, and the largest `t_us` of all. Their times are right if that
    /// one's, `base` added, is.
    fn enter(&mut self, events: &[Event], base: u32, width: usize) -> (usize, u32) {
        let times = self.times.as_mut_slice();
        let (mut entered, mut longest_us) = (0, 0);
        for event in events {
            longest_us = longest_us.max(event.t_us);
            if let Some(index) = index(event, width, times.len()) {
                times[index] = base.wrapping_add(event.t_us);
                entered += 1;
            }
        }
        (entered, longest_us)
    }

    fn accumulate(&mut self, events: &[Event], base_us: u64, width: usize, range: Range) -> usize {
        let mut entered = None;
        if let Some(base) = range.stored(base_us, self.base_us) {
            let (count, longest_us) = self.enter(events, base, width);
            let latest_us = base_us.saturating_add(longest_us.into());
            entered = range.stored(latest_us, self.base_us).map(|_| count);
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
fn difference(base_us: u64, other_us: u64) -> i128 {
    let time = |base_us: u64| i128::from(base_us.wrapping_add(1 << 32));
    time(base_us) - time(other_us)
}

impl TimeSurface {
    /// For this sensor, with so many slots. The parameter is `tau` (ns).
    pub(crate) fn new(sensor: Sensor, slots: usize, params: &Params) -> Result<Self, String> {
        let tau_us = params.integer("tau") as f64 / 1e3;
        if tau_us > Decay::MAX_TAU_US {
            return Err("parameter \"tau\" is above 100s; give a shorter time constant".to_owned());
        }
        let slot = Slot {
            times: vec![0; 2 * sensor.pixels()],
            base_us: 0,
            last_us: None,
        };
        let decay = Decay::new(tau_us);
        Ok(Self {
            width: sensor.width,
            range: Range::new(&decay),
            merged: if slots > 1 { slot.times.clone() } else { Vec::new() },
            slots: vec![slot; slots],
            base_us: 0,
            on: decay.clone(),
            off: decay,
        })
    }

    /// The base of a new slot whose first chunk counts from `chunk_base_us`.
    fn new_base(&mut self, chunk_base_us: u64) -> u64 {
        let since = chunk_base_us.wrapping_sub(self.base_us);
        let centre = u64::from(self.range.centre);
        if !(centre..centre.midpoint(Range::LATEST.into())).contains(&since) {
            self.base_us = self.range.base_for(chunk_base_us);
        }
        self.base_us
    }

    /// Puts the times of slots, in stream order, into `merged`, all from the base of the newest.
    fn merge(&mut self, older: &[usize], newest: usize) {
        let newest = &self.slots[newest];
        self.merged.copy_from_slice(&newest.times);
        for slot in older.iter().rev().map(|s| &self.slots[*s]) {
            if slot.last_us.is_none() {
                continue;
            }
            let both = self.merged.iter_mut().zip(&slot.times);
            if slot.base_us == newest.base_us {
                both.for_each(|(time, older)| *time = if *time == 0 { *older } else { *time });
            } else {
                let by = difference(slot.base_us, newest.base_us);
                let under = both.filter(|(time, _)| **time == 0);
                under.for_each(|(time, older)| *time = self.range.shifted(*older, by));
            }
        }
    }
}

/// What turns stored times into levels. An age is `now` less the stored time.
struct Look<'a> {
    now: u32,
    on: &'a Decay,
    off: &'a Decay,
}

impl Look<'_> {
    /// Levels of a plane of pairs.
    fn levels(&self, times: &[u32], levels: &mut [u8]) {
        let (times, times_rest) = times.as_chunks::<RUN>();
        let (levels, levels_rest) = levels.as_chunks_mut::<RUN>();
        for (levels, times) in levels.iter_mut().zip(times) {
            if times.iter().fold(0, |any, time| any | time) == 0 {
                *levels = [0; RUN];
            } else {
                self.run(times, levels);
            }
        }
        let (mut times, mut levels) = ([0; RUN], [0; RUN]);
        times[..times_rest.len()].copy_from_slice(times_rest);
        self.run(&times, &mut levels);
        levels_rest.copy_from_slice(&levels[..levels_rest.len()]);
    }

    /// First all ages, which makes vectors; then all levels, which cannot.
    fn run(&self, times: &[u32; RUN], levels: &mut [u8; RUN]) {
        let black_us = [self.on.black_us(), self.off.black_us()];
        let mut ages_us = [0; RUN];
        for i in 0..RUN {
            ages_us[i] = self.now.saturating_sub(times[i]).min(black_us[i % 2]);
        }
        let pairs = levels.as_chunks_mut::<2>().0.iter_mut();
        for ([on, off], [on_age_us, off_age_us]) in pairs.zip(ages_us.as_chunks::<2>().0) {
            *on = self.on.level(*on_age_us);
            *off = self.off.level(*off_age_us);
        }
    }
}

impl Method for TimeSurface {
    fn accumulate(&mut self, slot: usize, events: &[Event], base_us: u64) -> usize {
        if self.slots[slot].last_us.is_none() {
            self.slots[slot].base_us = self.new_base(base_us);
        }
        self.slots[slot].accumulate(events, base_us, self.width, self.range)
    }

    fn clear(&mut self, slot: usize) {
        let slot = &mut self.slots[slot];
        slot.times.fill(0);
        slot.last_us = None;
    }

    fn render(&mut self, slots: &[usize], out: &mut [u8]) {
        let last = |slot: &usize| {
            let slot = &self.slots[*slot];
            slot.last_us
                .and_then(|last_us| self.range.stored(last_us, slot.base_us))
        };
        let newest = (0..slots.len()).rev().find_map(|i| Some((i, last(&slots[i])?)));
        let Some((newest, last_time)) = newest else {
            out.fill(0);
            return;
        };
        let (older, newest) = (&slots[..newest], slots[newest]);
        let times = if older.iter().any(|slot| last(slot).is_some()) {
            self.merge(older, newest);
            &self.merged
        } else {
            &self.slots[newest].times
        };
        let now = last_time + self.on.lead_us();
        let youngest = largest(times, u32::MAX).map(|time| {
            if time == 0 {
                u32::MAX
            } else {
                now.saturating_sub(time)
            }
        });
        self.on.prepare(youngest[0]);
        self.off.prepare(youngest[1]);
        let look = Look {
            now,
            on: &self.on,
            off: &self.off,
        };
        render_pairs(times, out, |times, out| look.levels(times, out));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::ParamValue;

    const SENSOR: Sensor = Sensor { height: 1, width: 3 };
    const SECOND_US: u64 = 1_000_000;
    const HOUR_US: u64 = 3600 * SECOND_US;

    fn surface(slots: usize, tau_ns: i64) -> Result<TimeSurface, String> {
        let params = Params([("tau".to_owned(), ParamValue::Integer(tau_ns))].into());
        TimeSurface::new(SENSOR, slots, &params)
    }

    fn on(t_us: u32, x: u16) -> Event {
        Event::new(t_us, x, 0, true)
    }

    fn on_levels(m: &mut TimeSurface, slots: &[usize]) -> [u8; 3] {
        let mut out = [9; 9];
        m.render(slots, &mut out);
        assert!(out.chunks_exact(3).all(|p| p[1] == 0 && p[2] == 0));
        [out[0], out[3], out[6]]
    }

    #[test]
    fn too_long_a_time_constant_is_refused() {
        assert!(surface(1, 100_000_000_000).is_ok());
        assert!(surface(1, 100_000_000_001).is_err());
    }

    #[test]
    fn times_hold_over_hours_and_large_clocks() {
        for start_us in [0, 5, HOUR_US, 1_600_000_000 * SECOND_US, u64::MAX - 10 * HOUR_US] {
            let mut m = surface(1, 1_000_000_000).unwrap();
            m.accumulate(0, &[on(0, 0)], start_us);
            // Chunks within u32 of their base, an hour each; the third carries its own long gap.
            m.accumulate(0, &[on(7, 0), on(3_500_000_000, 1)], start_us + HOUR_US);
            let end_us = start_us + 3 * HOUR_US;
            m.accumulate(0, &[on(0, 1), on(SECOND_US as u32, 2)], end_us);
            // One second of age at τ = 1 s: tanh(e^-2) / tanh(e^-1) · 255.
            assert_eq!(on_levels(&mut m, &[0]), [0, 97, 254], "start {start_us}");
        }
    }

    #[test]
    fn slots_with_bases_hours_apart_merge() {
        let mut m = surface(3, 1_000_000_000).unwrap();
        m.accumulate(0, &[on(0, 0), on(0, 1)], 0);
        m.accumulate(1, &[on(0, 1)], 9 * HOUR_US);
        m.accumulate(2, &[on(SECOND_US as u32, 2)], 9 * HOUR_US);
        assert_eq!(on_levels(&mut m, &[0, 1, 2]), [0, 97, 254]);
        assert_eq!(on_levels(&mut m, &[0, 1]), [0, 254, 0]);
        m.clear(1);
        assert_eq!(on_levels(&mut m, &[0, 1]), [254, 254, 0]);
    }

    #[test]
    fn the_last_event_is_the_last_in_stream_order() {
        let mut m = surface(1, 1_000_000_000).unwrap();
        // Pixel 0 has time 2 s, then the stream goes back to 1 s: later than t_last by τ means s = 1.
        m.accumulate(0, &[on(2_000_000, 0), on(1_000_000, 1)], 0);
        let white = (1f64.tanh() / (1f64.tanh() + 1e-6) * 255.0) as u8;
        let last = ((-1f64).exp().tanh() / (1f64.tanh() + 1e-6) * 255.0) as u8;
        assert_eq!(on_levels(&mut m, &[0]), [white, last, 0]);
        // Back by hours.
        m.accumulate(0, &[on(0, 0)], 20 * HOUR_US);
        m.accumulate(0, &[on(0, 1)], 10 * HOUR_US);
        assert_eq!(on_levels(&mut m, &[0]), [white, last, 0]);
    }

    #[test]
    fn events_outside_the_sensor_do_not_set_the_last_time() {
        let mut m = surface(1, 1_000_000).unwrap();
        assert_eq!(
            m.accumulate(0, &[on(0, 0), on(900_000, 3), Event::new(900_000, 0, 1, true)], 5),
            1
        );
        assert_eq!(on_levels(&mut m, &[0]), [254, 0, 0]);
    }
}
