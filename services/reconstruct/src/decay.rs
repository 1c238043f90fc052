//! Grey levels of a time surface as a function of age.

/// At this many time constants of age, tanh(s) is below 1e-6 / 255: the level is 0 whatever the channel's largest.
const BLACK_AFTER_TAUS: f64 = 18.4;

/// Level of an age in one channel of one frame.
///
/// With `t_last` the frame's last event and t a pixel's: s = clip(exp(−((t_last + τ) − t) / τ), 0, 1), T = tanh(s),
/// level = truncate(clip(T / (max T + 1e-6) · 255)), in f64, the max over the channel.
///
/// The level falls with age, so 255 ages at which it changes say it all: they are computed once per frame and channel,
/// and checked against the formula itself, so that every level is the formula's. A pixel then costs a look into a
/// table of buckets and at most one step, without a branch: the slope of the level is at most 255 / τ, so changes are at
/// least τ / 255 apart, and no bucket is longer than that.
///
/// An *age* here is `t_last + lead − t` in µs, where the lead is τ rounded up: events up to τ after `t_last` (which a
/// stream in order does not have) keep an age, and what is later still has s = 1 as well.
#[derive(Debug)]
pub(crate) struct Decay {
    tau_us: f64,
    lead_us: u32,
    /// From this age on the level is 0.
    black_us: u32,
    shift: u32,
    /// `ends[l]`: ages below it have level l or more; of level 0 that is all.
    ends: [u32; 256],
    /// Level of the first age of each bucket of 2^shift µs; the last is for all that is older, and black.
    buckets: Vec<u8>,
}

impl Decay {
    /// The longest time constant, µs. It keeps the ages that matter within u32.
    pub(crate) const MAX_TAU_US: f64 = 100e6;

    /// For this time constant (above 0, at most [`Self::MAX_TAU_US`]), µs.
    pub(crate) fn new(tau_us: f64) -> Self {
        let lead_us = tau_us.ceil() as u32;
        let black_us = lead_us + (BLACK_AFTER_TAUS * tau_us).ceil() as u32 + 1;
        let closest_us = (tau_us / 255.0) as u32;
        let shift = closest_us.max(1).ilog2();
        Self {
            tau_us,
            lead_us,
            black_us,
            shift,
            ends: [0; 256],
            buckets: vec![0; (black_us >> shift) as usize + 2],
        }
    }

    /// The age of the last event itself, µs.
    pub(crate) fn lead_us(&self) -> u32 {
        self.lead_us
    }

    /// tanh(s) at this age.
    fn surface(&self, age_us: u32) -> f64 {
        let after_last_us = f64::from(age_us) - f64::from(self.lead_us);
        (-(after_last_us + self.tau_us) / self.tau_us)
            .exp()
            .clamp(0.0, 1.0)
            .tanh()
    }

    /// The formula: the level at this age in a channel whose largest tanh(s) is `largest`.
    fn formula(&self, age_us: u32, largest: f64) -> u8 {
        if largest <= 0.0 {
            return 0;
        }
        (self.surface(age_us) / (largest + 1e-6) * 255.0).clamp(0.0, 255.0) as u8
    }

    /// Makes ready for a channel whose youngest pixel has this age; `u32::MAX` when it has no event.
    pub(crate) fn prepare(&mut self, youngest_us: u32) {
        if youngest_us == u32::MAX {
            self.buckets.fill(0);
            return;
        }
        let largest = self.surface(youngest_us);
        for level in 1..=u8::MAX {
            self.ends[usize::from(level)] = self.end_of(level, largest);
        }
        let mut level = u8::MAX;
        for (bucket, first) in self.buckets.iter_mut().enumerate() {
            let age_us = (bucket as u32) << self.shift;
            while level > 0 && age_us >= self.ends[usize::from(level)] {
                level -= 1;
            }
            *first = level;
        }
    }

    /// The age below which the level is `level` or more: the formula solved for the age, then checked against it,
    /// because the solution may be off by a rounding.
    fn end_of(&self, level: u8, largest: f64) -> u32 {
        const ROUNDINGS: usize = 4;
        let surface = f64::from(level) / 255.0 * (largest + 1e-6);
        let after_last_us = -self.tau_us * (surface.atanh().ln() + 1.0);
        let solved = (f64::from(self.lead_us) + after_last_us).floor() + 1.0;
        // NaN (a level above the formula's range) becomes 0.
        let mut end = (solved.max(0.0) as u32).min(self.black_us);
        for _ in 0..ROUNDINGS {
            if end < self.black_us && self.formula(end, largest) >= level {
                end += 1;
            } else if end > 0 && self.formula(end - 1, largest) < level {
                end -= 1;
            } else {
                break;
            }
        }
        end
    }

    /// The level at this age, µs; `u32::MAX` means no event.
    #[inline]
    pub(crate) fn level(&self, age_us: u32) -> u8 {
        let bucket = (age_us >> self.shift) as usize;
        let level = self.buckets[bucket.min(self.buckets.len() - 1)];
        level - u8::from(level > 0 && age_us >= self.ends[usize::from(level)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every age of a short time constant, and the youngest pixel anywhere.
    #[test]
    fn every_level_is_the_formulas() {
        for (tau_us, youngest_us) in [
            (1000.0, 1000),
            (1000.0, 3000),
            (333.3, 400),
            (1.5, 0),
            (900.0, 17_000),
        ] {
            let mut d = Decay::new(tau_us);
            d.prepare(youngest_us);
            let largest = d.surface(youngest_us);
            for age_us in youngest_us..d.black_us + 100 {
                let expected = d.formula(age_us, largest);
                assert_eq!(d.level(age_us), expected, "τ {tau_us} µs, age {age_us}");
            }
            assert_eq!(d.level(u32::MAX), 0);
        }
    }

    #[test]
    fn the_youngest_pixel_is_white_and_a_channel_without_events_black() {
        let mut d = Decay::new(100_000.0);
        d.prepare(d.lead_us());
        assert_eq!(d.level(d.lead_us()), 254);
        d.prepare(u32::MAX);
        assert_eq!((d.level(0), d.level(d.lead_us())), (0, 0));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_age_of_any_time_constant(tau_us in 1.0f64..1e8, youngest in 0.0f64..18.0, older in 0.0f64..20.0) {
            let mut d = Decay::new(tau_us);
            let youngest_us = (youngest * tau_us) as u32;
            let age_us = youngest_us.saturating_add((older * tau_us) as u32);
            d.prepare(youngest_us);
            prop_assert_eq!(d.level(age_us), d.formula(age_us, d.surface(youngest_us)));
        }
    }
}
