//! Counters of few bits, made whole.

use crate::MAX_TIME_NS;

/// Follows a counter that wraps.
///
/// A new reading is taken as the nearest to the last one: of all whole values with these low bits, the one whose
/// distance is smallest, forward where both are equal. So a step back by less than half the range is a step back, a
/// wrap otherwise; and a step forward by more than half is a step back over the wrap. Nothing lies before 0: there the
/// step is forward.
#[derive(Debug, Clone)]
pub(super) struct Clock {
    bits: u32,
    tick_ns: u64,
    /// The whole counter; `None` before the first reading.
    now: Option<u64>,
}

impl Clock {
    /// A counter of `bits` bits (at most 32), each step of which is `tick_ns`.
    pub(super) fn new(bits: u32, tick_ns: u64) -> Self {
        Self {
            bits,
            tick_ns,
            now: None,
        }
    }

    /// Makes the next reading the nearest to `t_ns`.
    pub(super) fn set_ns(&mut self, t_ns: u64) {
        self.now = Some((t_ns / self.tick_ns).min(self.last()));
    }

    /// Takes a reading (its low bits count), and gives its time, ns. Times end at [`MAX_TIME_NS`]: a reading
    /// beyond is taken as the last time that was not.
    pub(super) fn read(&mut self, reading: u32) -> u64 {
        let range = 1u64 << self.bits;
        let reading = u64::from(reading) & (range - 1);
        let now = match self.now {
            None => reading,
            Some(now) => {
                let forward = reading.wrapping_sub(now) & (range - 1);
                let back = range - forward;
                let whole = if forward > range / 2 && back <= now {
                    now - back
                } else {
                    now + forward
                };
                if whole <= self.last() { whole } else { now }
            }
        };
        self.now = Some(now);
        now * self.tick_ns
    }

    /// Leaves a tick of room, as what is added to a reading is less than one.
    fn last(&self) -> u64 {
        MAX_TIME_NS / self.tick_ns - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_value_is_taken() {
        let mut clock = Clock::new(12, 10);
        let mut steps = |readings: &[u32]| readings.iter().map(|r| clock.read(*r)).collect::<Vec<_>>();
        // To the edge, over it, back over it, over it again; half the range is forward.
        assert_eq!(
            steps(&[4000, 4095, 0, 4095, 2, 2050]),
            [40_000, 40_950, 40_960, 40_950, 40_980, 61_460]
        );
        // One more than half is back.
        assert_eq!(steps(&[3, 2]), [40_990, 40_980]);
        assert_eq!(steps(&[2051]), [20_510]);
    }

    #[test]
    fn nothing_is_before_zero() {
        let mut clock = Clock::new(12, 1);
        assert_eq!([5, 4000, 3999].map(|r| clock.read(r)), [5, 4000, 3999]);
    }

    #[test]
    fn a_base_is_gone_on_from() {
        let mut clock = Clock::new(12, 1);
        clock.set_ns(10 * 4096 + 4090);
        assert_eq!(
            [3, 4000].map(|r| clock.read(r)),
            [11 * 4096 + 3, 10 * 4096 + 4000]
        );
    }

    #[test]
    fn times_end_where_they_must() {
        let mut clock = Clock::new(28, 64_000);
        clock.set_ns(u64::MAX);
        for step in 0..10 {
            let t_ns = clock.read(step << 26);
            assert!(t_ns <= MAX_TIME_NS - 64_000, "{t_ns}");
        }
    }
}
