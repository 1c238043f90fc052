//! `time_surface`: how recent the last event of each pixel and polarity is.

use crate::age_levels::AgeLevels;
use crate::avx2::{Avx2, fill_in};
use crate::decay::Decay;
use crate::last_times::{Range, Slot, difference};
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
    use proptest::prelude::*;

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

    /// Frames of the formula, event by event.
    fn direct(sensor: Sensor, tau_us: f64, events: &[(u64, Event)]) -> Vec<u8> {
        let decay = Decay::new(tau_us);
        let mut times = vec![None; sensor.pixels() * 2];
        for (base_us, e) in events {
            let pixel = usize::from(e.y()) * sensor.width + usize::from(e.x);
            times[2 * pixel + usize::from(!e.on())] = Some(base_us + u64::from(e.t_us));
        }
        let (base_us, last) = events[events.len() - 1];
        let now_us = base_us + u64::from(last.t_us) + u64::from(decay.lead_us());
        let ages: Vec<Option<u32>> = times
            .iter()
            .map(|t| t.map(|t| now_us.saturating_sub(t) as u32))
            .collect();
        let youngest = |channel| ages.iter().skip(channel).step_by(2).flatten().min().copied();
        let youngest = [0, 1].map(|channel| youngest(channel).unwrap_or(u32::MAX));
        let level =
            |age: Option<u32>, channel: usize| age.map_or(0, |age| decay.level(age, youngest[channel]));
        let pixels = ages.as_chunks::<2>().0.iter();
        pixels
            .flat_map(|[on, off]| [level(*on, 0), level(*off, 1), 0])
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// Slots of several strips, times in order or not, polarities that are rare or absent, any chunks.
        #[test]
        fn frames_are_the_formulas(
            seed in any::<u64>(),
            (count, slots) in (1usize..2000, 1usize..4),
            (back, off_of, chunk) in (prop_oneof![Just(0u64), 1..100_000u64], prop_oneof![Just(2), Just(700), Just(u64::MAX)], 1usize..900),
        ) {
            let sensor = Sensor { height: 33, width: 41 };
            let tau_us = 20_000.0;
            let params = Params([("tau".to_owned(), ParamValue::Integer(20_000_000))].into());
            let mut m = TimeSurface::new(sensor, slots, &params).unwrap();
            let mut state = seed;
            let mut random = |below: u64| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) % below
            };
            let events: Vec<Event> = (0..count as u64)
                .map(|i| {
                    let t_us = 200_000 + i * 300 - random(back + 1);
                    let (x, y) = (random(41) as u16, random(33) as u16);
                    Event::new(t_us as u32, x, y, random(off_of) != 0)
                })
                .collect();
            let mut all = Vec::new();
            let order: Vec<usize> = (0..slots).collect();
            for (slot, events) in events.chunks(count.div_ceil(slots)).enumerate() {
                for (i, events) in events.chunks(chunk).enumerate() {
                    let base_us = 5_000_000 + i as u64 * (back / 7);
                    prop_assert_eq!(m.accumulate(slot, events, base_us), events.len());
                    all.extend(events.iter().map(|e| (base_us, *e)));
                    let mut out = vec![9; sensor.pixels() * 3];
                    m.render(&order[..=slot], &mut out);
                    prop_assert!(out == direct(sensor, tau_us, &all));
                }
            }
        }
    }

    /// What is known of the largest times is so, and is known where events come in order.
    #[test]
    fn the_largest_times_are_known_without_a_look() {
        let mut m = surface(2, 1_000_000).unwrap();
        let off = |t_us| Event::new(t_us, 2, 0, false);
        let known = |m: &TimeSurface, slots: &[usize]| {
            let newest = slots[slots.len() - 1];
            let largest = m.largest(slots, newest)?;
            Some(largest.map(|time| time.saturating_sub(m.range.centre)))
        };
        m.accumulate(0, &[on(1, 0), off(2), on(3, 3)], 100);
        assert_eq!(known(&m, &[0]), Some([1, 2]));
        m.accumulate(0, &vec![on(5, 0); 200], 100);
        assert_eq!(known(&m, &[0]), Some([5, 2]));
        m.accumulate(1, &[off(6)], 100);
        assert_eq!(known(&m, &[0, 1]), Some([5, 6]));
        m.accumulate(0, &vec![on(7, 0); 300], 100);
        assert_eq!(known(&m, &[0]), None, "there may be an earlier OFF");
        m.clear(0);
        m.accumulate(0, &[on(7, 0), off(8)], 100);
        assert_eq!(known(&m, &[0]), Some([7, 8]));
        assert_eq!(known(&m, &[0, 1]), None, "later segments go back");
        m.accumulate(0, &[on(6, 0)], 100);
        assert_eq!(known(&m, &[0]), None, "7 is gone");
    }
}
