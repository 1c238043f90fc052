//! `time_surface`: how recent the last event of each pixel and polarity is.

use crate::age_levels::AgeLevels;
use crate::avx2::{Avx2, fill_in};
use crate::decay::Decay;
use crate::method::Method;
use crate::pixels::largest;
use evpr_core::message::Event;
use evpr_core::plan::{Params, Sensor};

/// Times that are worked on at once: merged, they stay in the nearest cache.
const STRIP: usize = 2048;

/// Channels ON, OFF, 0. The formula is [`Decay`]'s; "last" means last in stream order, and the frame's last event is
/// the last of either polarity.
#[derive(Debug)]
pub(crate) struct TimeSurface {
    width: usize,
    range: Range,
    slots: Vec<Slot>,
    /// The base that new slots take while they can, so that their times go together as they are.
    base_us: u64,
    /// The age of a frame's last event.
    lead_us: u32,
    levels: AgeLevels,
    avx2: Option<Avx2>,
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
    /// The largest of the times of ON and of OFF, where that is known without a look at all of them.
    largest: Option<[u32; 2]>,
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
    fn empty(pixels: usize) -> Self {
        Self {
            times: vec![0; 2 * pixels],
            base_us: 0,
            last_us: None,
            largest: Some([0; 2]),
        }
    }

    fn clear(&mut self) {
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

    fn accumulate(&mut self, events: &[Event], base_us: u64, width: usize, range: Range) -> usize {
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
        let decay = Decay::new(tau_us);
        Ok(Self {
            width: sensor.width,
            range: Range::new(&decay),
            slots: vec![Slot::empty(sensor.pixels()); slots],
            base_us: 0,
            lead_us: decay.lead_us(),
            levels: AgeLevels::new(decay),
            avx2: Avx2::detect(),
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

    /// Puts the times of slots together that begin at `start`, at most [`STRIP`], all from the base of the newest: in
    /// `merged`, if there is more than one slot. `older` are in stream order.
    fn strip<'a>(
        &'a self,
        older: &[usize],
        newest: usize,
        start: usize,
        merged: &'a mut [u32; STRIP],
    ) -> &'a [u32] {
        let part = |slot: &'a Slot| &slot.times[start..slot.times.len().min(start + STRIP)];
        let newest = &self.slots[newest];
        let mut older = older
            .iter()
            .rev()
            .map(|s| &self.slots[*s])
            .filter(|s| s.last_us.is_some())
            .peekable();
        if older.peek().is_none() {
            return part(newest);
        }
        let merged = &mut merged[..part(newest).len()];
        merged.copy_from_slice(part(newest));
        for slot in older {
            if slot.base_us == newest.base_us {
                match self.avx2 {
                    Some(avx2) => avx2.fill_in(merged, part(slot)),
                    None => fill_in(merged, part(slot)),
                }
            } else {
                let both = merged.iter_mut().zip(part(slot));
                let by = difference(slot.base_us, newest.base_us);
                let under = both.filter(|(time, _)| **time == 0);
                under.for_each(|(time, older)| *time = self.range.shifted(*older, by));
            }
        }
        merged
    }

    /// The largest times of ON and of OFF of these slots put together, where the slots say it: of each polarity that of
    /// the last slot that has any, if no slot before has a larger one (which later events may have replaced).
    fn largest(&self, slots: &[usize], newest: usize) -> Option<[u32; 2]> {
        let mut largest = [0; 2];
        for slot in slots
            .iter()
            .map(|s| &self.slots[*s])
            .filter(|s| s.last_us.is_some())
        {
            if slot.base_us != self.slots[newest].base_us {
                return None;
            }
            for (largest, of_slot) in largest.iter_mut().zip(slot.largest?) {
                if of_slot != 0 && of_slot < *largest {
                    return None;
                }
                *largest = of_slot.max(*largest);
            }
        }
        Some(largest)
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
        self.slots[slot].clear();
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
        let mut merged = [0; STRIP];
        let starts = || (0..self.slots[newest].times.len()).step_by(STRIP);
        let largest = self.largest(slots, newest).unwrap_or_else(|| {
            starts().fold([0; 2], |most, start| {
                let [on, off] = largest(self.strip(older, newest, start, &mut merged), u32::MAX);
                [on.max(most[0]), off.max(most[1])]
            })
        });
        let now = last_time + self.lead_us;
        self.levels.prepare(largest.map(|time| match time {
            0 => u32::MAX,
            _ => now.saturating_sub(time),
        }));
        for (start, out) in starts().zip(out.chunks_mut(STRIP / 2 * 3)) {
            let times = self.strip(older, newest, start, &mut merged);
            self.levels.render(now, times, out);
        }
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
