//! `time_surface`: how recent the last event of each pixel and polarity is.

use crate::decay::Decay;
use crate::method::Method;
use crate::pixels::interleave;
use evpr_core::message::Event;
use evpr_core::plan::{Params, Sensor};

/// A slot's times reach so far (µs) on either side of its reference event: about 35 minutes, which is more than 21 of
/// the longest time constants, so that what lies beyond is black (before) or saturated (after) anyway.
const REACH_US: u64 = 1 << 31;

/// Channels ON, OFF, 0. The formula is [`Decay`]'s; "last" means last in stream order, and the frame's last event is
/// the last of either polarity.
#[derive(Debug)]
pub(crate) struct TimeSurface {
    width: usize,
    slots: Vec<Slot>,
    /// Ages of the frame that is being rendered; `u32::MAX` where no event is. Rows as in [`Slot::times`].
    ages: Vec<u32>,
    off_decay: Decay,
    on_decay: Decay,
    off_levels: Vec<u8>,
    on_levels: Vec<u8>,
}

/// Last times of one segment.
#[derive(Debug, Clone)]
struct Slot {
    /// Per pixel, two rows per row of the sensor (OFF, then ON): 0 where no event is, else 1 + time − `base_us`.
    times: Vec<u32>,
    base_us: u64,
    /// Time of the last event in stream order, µs.
    last_us: Option<u64>,
}

/// Where in `len` times of rows of `width` an event's is kept, if the event lies in the sensor.
#[inline]
fn index(event: &Event, width: usize, len: usize) -> Option<usize> {
    let x = usize::from(event.x);
    let index = usize::from(event.y_polarity) * width + x;
    (x < width && index < len).then_some(index)
}

impl Slot {
    /// Enters events whose times, `base` added, fit; returns how many lie in the sensor.
    fn enter(&mut self, events: &[Event], base: u32, width: usize) -> usize {
        let times = self.times.as_mut_slice();
        let mut entered = 0;
        for event in events {
            if let Some(index) = index(event, width, times.len()) {
                times[index] = base + event.t_us;
                entered += 1;
            }
        }
        entered
    }

    /// 1 + time − base, where it fits.
    fn stored(&self, time_us: u64) -> Option<u32> {
        let since = time_us.checked_sub(self.base_us)?;
        u32::try_from(since).ok()?.checked_add(1)
    }

    /// Moves the base so that times around `time_us` fit; times that no longer do go to the end of the range.
    fn rebase(&mut self, time_us: u64) {
        let base_us = time_us.saturating_sub(REACH_US);
        let shift = |distance_us: u64| u32::try_from(distance_us).unwrap_or(u32::MAX);
        let forward = shift(base_us.saturating_sub(self.base_us));
        let backward = shift(self.base_us.saturating_sub(base_us));
        for time in self.times.iter_mut().filter(|time| **time != 0) {
            *time = time.saturating_sub(forward).max(1).saturating_add(backward);
        }
        self.base_us = base_us;
    }

    fn accumulate(&mut self, events: &[Event], base_us: u64, width: usize) -> usize {
        if self.last_us.is_none() {
            self.base_us = base_us.saturating_sub(REACH_US);
        }
        let longest_us = events.iter().fold(0, |a, e| a.max(e.t_us));
        let last_fits = self.stored(base_us.saturating_add(longest_us.into())).is_some();
        let entered = match self.stored(base_us) {
            Some(base) if last_fits => self.enter(events, base, width),
            // Rare: more than half an hour between events of one segment, or as much back.
            _ => events.iter().map(|e| self.enter_far(e, base_us, width)).sum(),
        };
        let inside = |e: &&Event| index(e, width, self.times.len()).is_some();
        if let Some(last) = events.iter().rev().find(inside) {
            self.last_us = Some(base_us.saturating_add(last.t_us.into()));
        }
        entered
    }

    /// Enters one event, and moves the base where its time does not fit.
    fn enter_far(&mut self, event: &Event, base_us: u64, width: usize) -> usize {
        let Some(index) = index(event, width, self.times.len()) else {
            return 0;
        };
        let time_us = base_us.saturating_add(event.t_us.into());
        if self.stored(time_us).is_none() {
            self.rebase(time_us);
        }
        self.times[index] = self.stored(time_us).unwrap_or(u32::MAX);
        1
    }

    /// Overwrites the ages of the pixels that have an event here; with `replace` all the others become "no event".
    fn age(&self, last_us: u64, lead_us: u32, replace: bool, ages: &mut [u32]) {
        // age = reference − stored, in u32 as far as that goes.
        let reference = i128::from(last_us) + i128::from(lead_us) + 1 - i128::from(self.base_us);
        let clamp = |v: i128| v.clamp(0, i128::from(u32::MAX)) as u32;
        let (low, high) = (clamp(reference), clamp(reference - i128::from(u32::MAX)));
        for (age, time) in ages.iter_mut().zip(&self.times) {
            let without = if replace { u32::MAX } else { *age };
            let with = low.saturating_sub(*time).saturating_add(high);
            *age = if *time == 0 { without } else { with };
        }
    }
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
        Ok(Self {
            width: sensor.width,
            ages: slot.times.clone(),
            slots: vec![slot; slots],
            off_decay: Decay::new(tau_us),
            on_decay: Decay::new(tau_us),
            off_levels: vec![0; sensor.width],
            on_levels: vec![0; sensor.width],
        })
    }
}

fn youngest(ages: &[u32], at_most: u32) -> u32 {
    ages.iter().fold(at_most, |a, b| a.min(*b))
}

fn levels(decay: &Decay, ages: &[u32], levels: &mut [u8]) {
    for (level, age) in levels.iter_mut().zip(ages) {
        *level = decay.level(*age);
    }
}

impl Method for TimeSurface {
    fn accumulate(&mut self, slot: usize, events: &[Event], base_us: u64) -> usize {
        self.slots[slot].accumulate(events, base_us, self.width)
    }

    fn clear(&mut self, slot: usize) {
        let slot = &mut self.slots[slot];
        slot.times.fill(0);
        slot.last_us = None;
    }

    fn render(&mut self, slots: &[usize], out: &mut [u8]) {
        let width = self.width;
        let Some(last_us) = slots.iter().rev().find_map(|s| self.slots[*s].last_us) else {
            out.fill(0);
            return;
        };
        for (i, slot) in slots.iter().enumerate() {
            self.slots[*slot].age(last_us, self.off_decay.lead_us(), i == 0, &mut self.ages);
        }
        let (mut off_youngest, mut on_youngest) = (u32::MAX, u32::MAX);
        for rows in self.ages.chunks_exact(2 * width) {
            let (off, on) = rows.split_at(width);
            off_youngest = youngest(off, off_youngest);
            on_youngest = youngest(on, on_youngest);
        }
        self.off_decay.prepare(off_youngest);
        self.on_decay.prepare(on_youngest);
        for (rows, out) in self
            .ages
            .chunks_exact(2 * width)
            .zip(out.chunks_exact_mut(3 * width))
        {
            let (off, on) = rows.split_at(width);
            levels(&self.off_decay, off, &mut self.off_levels);
            levels(&self.on_decay, on, &mut self.on_levels);
            interleave(&self.on_levels, &self.off_levels, out);
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
