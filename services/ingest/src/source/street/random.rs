//! The counter-based random generator: a number depends on its key alone, never on what was drawn before it.

/// What a number is drawn for: keeps the streams of one seed apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    HouseKind = 1,
    House,
    Window,
    LitWindow,
    Tree,
    Ground,
    Crossing,
    Threshold,
    Hot,
    Memory,
    Noise,
    Drive,
}

/// The finaliser of splitmix64.
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// The number of `counters` for this purpose.
pub(super) fn number(seed: u64, purpose: Purpose, counters: &[u64]) -> u64 {
    let start = mix(seed ^ ((purpose as u64) << 56));
    counters.iter().fold(start, |key, counter| mix(key ^ counter))
}

/// Spreads 32 bits over 32 bits (Wellons' `lowbias32`): cheap enough for each pixel in each step.
pub(super) fn scramble(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
    x ^ (x >> 16)
}

/// A number in [0, 1) of the upper 24 of 32 bits.
pub(super) fn unit(bits: u32) -> f32 {
    (bits >> 8) as i32 as f32 * (1.0 / (1 << 24) as f32)
}

/// Numbers drawn one after the other for one thing.
#[derive(Debug, Clone)]
pub(super) struct Draws(u64);

impl Draws {
    pub(super) fn new(seed: u64, purpose: Purpose, counters: &[u64]) -> Self {
        Self(number(seed, purpose, counters))
    }

    /// Uniform in [0, 1).
    pub(super) fn unit(&mut self) -> f32 {
        self.0 = mix(self.0);
        unit((self.0 >> 32) as u32)
    }

    /// Uniform in [low, high).
    pub(super) fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// True so often.
    pub(super) fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    /// Normal, mean 0 and standard deviation 1 (Box and Muller).
    pub(super) fn normal(&mut self) -> f32 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f32::consts::TAU * self.unit()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_depend_on_every_part_of_the_key() {
        let all = [
            number(1, Purpose::Hot, &[2, 3]),
            number(2, Purpose::Hot, &[2, 3]),
            number(1, Purpose::Noise, &[2, 3]),
            number(1, Purpose::Hot, &[3, 2]),
            number(1, Purpose::Hot, &[2]),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(all[i + 1..].iter().all(|b| a != b));
        }
        assert_eq!(all[0], number(1, Purpose::Hot, &[2, 3]));
    }

    #[test]
    fn draws_have_the_moments_they_should_have() {
        let mut draws = Draws::new(7, Purpose::Threshold, &[]);
        let n = 20_000;
        let (mut sum, mut squares, mut uniform) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = f64::from(draws.normal());
            sum += x;
            squares += x * x;
            let u = draws.unit();
            assert!((0.0..1.0).contains(&u));
            uniform += f64::from(u);
        }
        let n = f64::from(n);
        assert!((sum / n).abs() < 0.03, "{}", sum / n);
        assert!((squares / n - 1.0).abs() < 0.04, "{}", squares / n);
        assert!((uniform / n - 0.5).abs() < 0.01, "{}", uniform / n);
    }

    #[test]
    fn scrambled_counters_are_uniform() {
        let mut bins = [0u32; 16];
        for i in 0..16_000u32 {
            bins[(unit(scramble(i ^ 0xABCD)) * 16.0) as usize] += 1;
        }
        assert!(bins.iter().all(|n| (850..1150).contains(n)), "{bins:?}");
    }
}
