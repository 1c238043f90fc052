//! Pace: when a sensor time comes on the wall clock.

/// Longest stretch of wall time whose events leave together, ns.
const SLOT_NS: f64 = 10_000_000.0;

/// Maps sensor time to host monotonic time: `wall = anchor_wall + (t - anchor) / factor`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace {
    anchor_ns: u64,
    anchor_wall_ns: u64,
    factor: f64,
}

impl Pace {
    /// Sensor time `anchor_ns` is now; from there `factor` seconds of the recording go by per second.
    pub(crate) fn new(anchor_ns: u64, now_ns: u64, factor: f64) -> Self {
        let factor = if factor.is_finite() && factor > 0.0 {
            factor
        } else {
            1.0
        };
        Self {
            anchor_ns,
            anchor_wall_ns: now_ns,
            factor,
        }
    }

    /// Host monotonic time, ns, at which sensor time `t_ns` comes.
    pub(crate) fn wall_ns(&self, t_ns: u64) -> u64 {
        let after = t_ns.saturating_sub(self.anchor_ns) as f64 / self.factor;
        self.anchor_wall_ns.saturating_add(after as u64)
    }

    /// Sensor time at which a chunk that begins at `t_ns` has to leave at the latest.
    pub(crate) fn slot_end_ns(&self, t_ns: u64) -> u64 {
        t_ns.saturating_add(((SLOT_NS * self.factor) as u64).max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wall_time_runs_at_the_factor() {
        let p = Pace::new(1_000, 50, 2.0);
        assert_eq!(
            (p.wall_ns(1_000), p.wall_ns(3_000), p.wall_ns(0)),
            (50, 1_050, 50)
        );
        assert_eq!(p.slot_end_ns(7), 20_000_007);
        assert_eq!(Pace::new(0, 0, 1e-9).slot_end_ns(7), 8);
        assert_eq!(Pace::new(0, u64::MAX, 1.0).wall_ns(5), u64::MAX);
    }
}
