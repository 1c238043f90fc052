//! The drive: where the camera is at each time.

use super::random::{Draws, Purpose};
use evpr_core::plan::{Street, StreetPass};
use std::f64::consts::{PI, TAU};

/// Where the first pass drives, metres to the left of the street's middle: in the right lane.
const LATERAL_M: f64 = -2.5;
/// How much further to the left the others drive, metres.
const OFFSET_M: f64 = 0.5;
/// How fast the others drive, as a part of the first pass's speed.
const SLOWER: f64 = 0.9;
/// Variation of their speed: parts of it, and periods in seconds.
const VARIATION: [(f64, f64); 2] = [(0.15, 23.0), (0.08, 9.0)];
/// How long they take to stop, and to get going again, seconds.
const RAMP_S: f64 = 2.0;
/// How long they stand, seconds.
const STAND_S: f64 = 3.0;
/// Earliest and latest share of the way at which they begin to stop.
const STOP_AT: (f32, f32) = (0.3, 0.7);

/// A drive. Times are in seconds from its start.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drive {
    length_m: f64,
    speed_m_s: f64,
    lateral_m: f64,
    /// Part of the speed, angular frequency (1/s) and phase.
    variation: Vec<(f64, f64, f64)>,
    /// When it begins to slow down for its stop.
    stop_s: Option<f64>,
}

impl Drive {
    pub(super) fn new(street: &Street) -> Self {
        let steady = Self {
            length_m: street.length_m,
            speed_m_s: street.speed_m_s,
            lateral_m: LATERAL_M,
            variation: Vec::new(),
            stop_s: None,
        };
        if street.pass == StreetPass::Day {
            return steady;
        }
        let mut draws = Draws::new(street.seed, Purpose::Drive, &[street.pass as u64]);
        let variation = VARIATION.map(|(part, period_s)| {
            let phase = TAU * f64::from(draws.unit());
            (part, TAU / period_s, phase)
        });
        let speed_m_s = SLOWER * street.speed_m_s;
        let share = f64::from(draws.between(STOP_AT.0, STOP_AT.1));
        Self {
            speed_m_s,
            lateral_m: LATERAL_M + OFFSET_M,
            variation: variation.to_vec(),
            stop_s: Some(share * street.length_m / speed_m_s),
            ..steady
        }
    }

    /// Metres to the left of the street's middle, at all times.
    pub(super) fn lateral_m(&self) -> f64 {
        self.lateral_m
    }

    /// Metres along the street; never less than before. It goes on after the end.
    pub(super) fn along_m(&self, t_s: f64) -> f64 {
        let moving = self.moving_s(t_s);
        let swing = |(part, omega, phase): &(f64, f64, f64)| {
            part / omega * ((omega * moving + phase).sin() - phase.sin())
        };
        self.speed_m_s * (moving + self.variation.iter().map(swing).sum::<f64>())
    }

    /// How long the drive takes, seconds.
    pub(super) fn duration_s(&self) -> f64 {
        // The speed is never above twice nor, but for the stop, below half of the usual.
        let (mut before, mut after) = (0.0, 2.0 * self.length_m / self.speed_m_s + 2.0 * RAMP_S + STAND_S);
        for _ in 0..60 {
            let middle = 0.5 * (before + after);
            if self.along_m(middle) < self.length_m {
                before = middle;
            } else {
                after = middle;
            }
        }
        after
    }

    /// The time without what the stop takes. Speed goes down, and up again, along half a cosine.
    fn moving_s(&self, t_s: f64) -> f64 {
        let Some(stop_s) = self.stop_s else { return t_s };
        let slowing = |u: f64| 0.5 * u + RAMP_S / TAU * (PI * u / RAMP_S).sin();
        let since = t_s - stop_s;
        let standing_until = RAMP_S + STAND_S;
        if since <= 0.0 {
            t_s
        } else if since <= RAMP_S {
            stop_s + slowing(since)
        } else if since <= standing_until {
            stop_s + 0.5 * RAMP_S
        } else if since <= standing_until + RAMP_S {
            let starting = since - standing_until;
            stop_s + 0.5 * RAMP_S + starting - slowing(starting)
        } else {
            t_s - RAMP_S - STAND_S
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(pass: StreetPass, seed: u64) -> Drive {
        Drive::new(&Street {
            pass,
            seed,
            ..Street::default()
        })
    }

    #[test]
    fn the_first_pass_is_steady() {
        let d = drive(StreetPass::Day, 1);
        assert_eq!((d.along_m(0.0), d.along_m(10.0)), (0.0, 50.0));
        assert!((d.duration_s() - 80.0).abs() < 1e-9);
        assert_eq!(d.lateral_m(), -2.5);
    }

    #[test]
    fn the_others_are_slower_vary_and_stop_once() {
        for (pass, seed) in [
            (StreetPass::Day2, 1),
            (StreetPass::Night, 1),
            (StreetPass::Night, 2),
        ] {
            let d = drive(pass, seed);
            assert_eq!(d.lateral_m(), -2.0);
            let end = d.duration_s();
            assert!((d.along_m(end) - 400.0).abs() < 1e-6);
            assert!((88.0..100.0).contains(&end), "{end}");
            let dt = 0.01;
            let speeds: Vec<f64> = (0..(end / dt) as u64)
                .map(|i| (d.along_m((i + 1) as f64 * dt) - d.along_m(i as f64 * dt)) / dt)
                .collect();
            assert!(speeds.iter().all(|v| (-1e-9..9.0).contains(v)));
            let standing = speeds.iter().filter(|v| **v < 1e-6).count() as f64 * dt;
            assert!((standing - STAND_S).abs() < 0.3, "{standing}");
            let stops = speeds.windows(2).filter(|v| v[0] >= 1e-6 && v[1] < 1e-6).count();
            assert_eq!(stops, 1);
            // No jumps: at most 6 m/s².
            assert!(speeds.windows(2).all(|v| (v[1] - v[0]).abs() < 0.1));
        }
        assert_ne!(drive(StreetPass::Day2, 1), drive(StreetPass::Night, 1));
        assert_ne!(drive(StreetPass::Day2, 1), drive(StreetPass::Day2, 2));
    }
}
