//! Grey levels of a time surface as a function of age.

/// At this many time constants of age, tanh(s) is below 1e-6 / 255: the level is 0 whatever the channel's largest.
const BLACK_AFTER_TAUS: f64 = 18.4;

/// Level of an age in one channel of one frame.
///
/// With `t_last` the frame's last event and t a pixel's: s = clip(exp(−((t_last + τ) − t) / τ), 0, 1), T = tanh(s),
/// level = truncate(clip(T / (max T + 1e-6) · 255)), in f64, the max over the channel.
///
/// The level falls with age, so the 255 ages at which it changes say it all: they are computed once per frame and
/// channel, and checked against the formula itself, so that every level is the formula's. The slope of the level is at
/// most 255 / τ, so changes are at least τ / 255 apart.
///
/// An *age* here is `t_last + lead − t` in µs, where the lead is τ rounded up: events up to τ after `t_last` (which a
/// stream in order does not have) keep an age, and what is later still has s = 1 as well.
#[derive(Debug, Clone)]
pub(crate) struct Decay {
    tau_us: f64,
    lead_us: u32,
    always_black_us: u32,
    /// ln of every level.
    ln: [f64; 256],
}

impl Decay {
    /// The longest time constant, µs. It keeps the ages that matter within u32.
    pub(crate) const MAX_TAU_US: f64 = 100e6;

    /// For this time constant (above 0, at most [`Self::MAX_TAU_US`]), µs.
    pub(crate) fn new(tau_us: f64) -> Self {
        let lead_us = tau_us.ceil() as u32;
        Self {
            tau_us,
            lead_us,
            always_black_us: lead_us + (BLACK_AFTER_TAUS * tau_us).ceil() as u32 + 1,
            ln: std::array::from_fn(|level| (level as f64).ln()),
        }
    }

    /// The age of the last event itself, µs.
    pub(crate) fn lead_us(&self) -> u32 {
        self.lead_us
    }

    /// From this age on (µs) the level is 0 in every frame.
    pub(crate) fn always_black_us(&self) -> u32 {
        self.always_black_us
    }

    /// Ages at which the level changes are no closer than this, µs (rounded down).
    pub(crate) fn closest_us(&self) -> u32 {
        (self.tau_us / 255.0) as u32
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

    /// The formula in a channel whose youngest pixel has this age; `u32::MAX` when it has no event.
    #[cfg(test)]
    pub(crate) fn level(&self, age_us: u32, youngest_us: u32) -> u8 {
        if youngest_us == u32::MAX {
            return 0;
        }
        self.formula(age_us, self.surface(youngest_us))
    }

    /// For a channel whose youngest pixel has this age (`u32::MAX` when it has no event): entry l is the age below
    /// which the level is l or more. Of level 0 that is every age.
    pub(crate) fn ends(&self, youngest_us: u32) -> [u32; 256] {
        let mut ends = [u32::MAX; 256];
        if youngest_us == u32::MAX {
            ends[1..].fill(0);
            return ends;
        }
        let largest = self.surface(youngest_us);
        let solved = self.solved(largest);
        for level in 1..=u8::MAX {
            ends[usize::from(level)] = self.end_of(level, solved[usize::from(level)], largest);
        }
        ends
    }

    /// Per level the formula solved for the age, µs: lead − τ (ln(atanh(level / 255 · (largest + 1e-6))) + 1). NaN for a
    /// level above the formula's range.
    fn solved(&self, largest: f64) -> [f64; 256] {
        let step = (largest + 1e-6) / 255.0;
        let (lead_us, ln_step) = (f64::from(self.lead_us), step.ln());
        let mut solved = [0.0; 256];
        for (level, solved) in solved.iter_mut().enumerate() {
            let surface = level as f64 * step;
            let ln_atanh = self.ln[level] + ln_step + ln_atanh_over(surface * surface);
            *solved = lead_us - self.tau_us * (ln_atanh + 1.0);
        }
        let past = (ATANH_TO.sqrt() / step) as usize;
        for (level, solved) in solved.iter_mut().enumerate().skip(past.max(1)) {
            *solved = lead_us - self.tau_us * ((level as f64 * step).atanh().ln() + 1.0);
        }
        solved
    }

    /// The age below which the level is `level` or more, from that which is the formula solved for it. Where this is so
    /// close to a whole µs that a rounding may have put it on the wrong side, the formula itself decides.
    fn end_of(&self, level: u8, solved_us: f64, largest: f64) -> u32 {
        const ROUNDINGS: usize = 4;
        // A thousand times the error of `solved`.
        let close_us = 1e-9 * self.tau_us + 1e-6;
        // NaN becomes 0.
        let whole_us = solved_us.max(-1.0) as i64;
        let part_us = solved_us - whole_us as f64;
        let mut end = (whole_us + i64::from(part_us >= 0.0)).clamp(0, self.always_black_us.into()) as u32;
        if level < u8::MAX - 1 && (close_us..1.0 - close_us).contains(&part_us) {
            return end;
        }
        for _ in 0..ROUNDINGS {
            if end < self.always_black_us && self.formula(end, largest) >= level {
                end += 1;
            } else if end > 0 && self.formula(end - 1, largest) < level {
                end -= 1;
            } else {
                break;
            }
        }
        end
    }
}

/// Up to here [`ln_atanh_over`] holds. It is just above tanh(1/e)², the largest of a stream in order.
const ATANH_TO: f64 = 0.125;

/// ln(atanh(y) / y) from y², to 4e-13 where y² ≤ [`ATANH_TO`]: a Chebyshev fit. A loop of it makes vectors.
#[inline]
fn ln_atanh_over(y2: f64) -> f64 {
    const FIT: [f64; 7] = [
        0.333_333_333_335_705_4,
        0.144_444_442_586_811_47,
        0.088_536_391_620_409_13,
        0.062_616_646_714_946_54,
        0.048_173_966_972_114_26,
        0.035_691_959_487_482_42,
        0.047_409_967_081_655_23,
    ];
    FIT.iter().rev().fold(0.0, |sum, part| (sum + part) * y2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn level(ends: &[u32; 256], age_us: u32) -> u8 {
        (0..=u8::MAX)
            .rev()
            .find(|l| age_us < ends[usize::from(*l)])
            .unwrap_or(0)
    }

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
            let d = Decay::new(tau_us);
            let ends = d.ends(youngest_us);
            for age_us in youngest_us..d.always_black_us + 100 {
                let expected = d.level(age_us, youngest_us);
                assert_eq!(level(&ends, age_us), expected, "τ {tau_us} µs, age {age_us}");
            }
            assert_eq!(level(&ends, u32::MAX - 1), 0);
        }
    }

    #[test]
    fn the_fit_of_the_logarithm_holds_where_it_is_used() {
        for i in 1..=10_000 {
            let y2 = ATANH_TO * f64::from(i) / 1e4;
            let y = y2.sqrt();
            let error = ln_atanh_over(y2) - (y.atanh() / y).ln();
            assert!(error.abs() < 1e-12, "y² {y2}: {error}");
        }
    }

    /// All changes of the level, by the formula on both sides of them.
    #[test]
    fn levels_change_where_the_formula_does() {
        for tau_us in [1.0, 7.7, 255.0, 20_000.0, 100_000.0, 1e6, 3.3e7, 1e8] {
            let d = Decay::new(tau_us);
            for part in [0.0, 0.5, 0.97, 1.0, 1.0001, 1.003, 1.1, 2.0, 5.0, 11.0, 18.0] {
                let youngest_us = (part * f64::from(d.lead_us)) as u32;
                let ends = d.ends(youngest_us);
                for level in 1..=255u8 {
                    let end = ends[usize::from(level)];
                    let case = format!("τ {tau_us} µs, youngest {youngest_us}, level {level}, end {end}");
                    assert!(d.level(end, youngest_us) < level, "{case}");
                    assert!(end == 0 || d.level(end - 1, youngest_us) >= level, "{case}");
                }
            }
        }
    }

    #[test]
    fn the_youngest_pixel_is_white_and_a_channel_without_events_black() {
        let d = Decay::new(100_000.0);
        assert_eq!(level(&d.ends(d.lead_us()), d.lead_us()), 254);
        let none = d.ends(u32::MAX);
        assert_eq!((level(&none, 0), level(&none, d.lead_us())), (0, 0));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_age_of_any_time_constant(tau_us in 1.0f64..1e8, youngest in 0.0f64..18.0, older in 0.0f64..20.0) {
            let d = Decay::new(tau_us);
            let youngest_us = (youngest * tau_us) as u32;
            let age_us = youngest_us.saturating_add((older * tau_us) as u32);
            prop_assert_eq!(level(&d.ends(youngest_us), age_us), d.level(age_us, youngest_us));
        }
    }
}
