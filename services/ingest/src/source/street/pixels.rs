//! The camera's pixels: from luminance to events, after v2e (Hu, Liu, Delbruck: "v2e: From Video Frames to Realistic
//! DVS Events", CVPRW 2021).
//!
//! A pixel sees the logarithm of the light through a low-pass whose cut-off grows with the light; compares it with
//! what it was at its last event; and fires when it has moved by its threshold. The memory leaks, so that it fires
//! now and then without cause; and it fires at random, the more the darker it is. Some pixels are hot.
//!
//! As in v2e, a random event moves the memory like any other, so a pixel whose other threshold is the lower one soon
//! fires again and takes it back: what is measured in the dark is about one and a half times the rate set here.

use super::random::{Draws, Purpose, number, scramble, unit};
use std::f32::consts::{LN_10, TAU};

/// Thresholds: mean, standard deviation and least, of the natural logarithm of light.
const THRESHOLD: (f32, f32, f32) = (0.25, 0.05, 0.05);
/// A pixel is blind for so long after an event, µs.
pub(super) const REFRACTORY_US: u64 = 1_000;
/// Events by leakage, per pixel and second.
const LEAK_HZ: f32 = 0.1;
/// Light that is always there: the dark current.
const DARK: f32 = 0.02;
/// Cut-off of the low-pass, Hz: so much per unit of light, at least and at most.
const CUTOFF: (f32, f32, f32) = (3.0, 2.0, 300.0);
/// Random events per pixel and second in the dark; how much of them is gone in the light; how dark the dark is, and
/// how many decades it is to the light.
const SHOT_HZ: f32 = 15.0;
const SHOT_FALL: f32 = 0.98;
const SHOT_DARK: f32 = 0.1;
const SHOT_DECADES: f32 = 3.0;
/// Part of the pixels that are hot, and at what rates they fire, Hz.
const HOT_PART: f32 = 5e-4;
const HOT_HZ: (f32, f32) = (20.0, 200.0);

/// An event within a step, made so that the order of numbers is that of time and then of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Spike(u64);

impl Spike {
    /// `after_us` from the step's start, at most 2^20; pixels count row by row.
    fn new(after_us: u64, pixel: u32, on: bool) -> Self {
        Self(after_us << 33 | u64::from(pixel) << 1 | u64::from(on))
    }

    pub(super) fn after_us(self) -> u64 {
        self.0 >> 33
    }

    pub(super) fn pixel(self) -> u32 {
        (self.0 >> 1) as u32
    }

    pub(super) fn on(self) -> bool {
        self.0 & 1 == 1
    }
}

/// When a step is, and the random numbers of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) start_us: u64,
    pub(super) length_us: u64,
    /// Drawn for this step.
    pub(super) key: u32,
}

impl Step {
    fn seconds(self) -> f32 {
        self.length_us as f32 * 1e-6
    }
}

/// Some columns of pixels, one after the other.
#[derive(Debug)]
pub(super) struct Pixels {
    /// Number of each pixel, row by row over the whole sensor.
    numbers: Vec<u32>,
    /// Logarithm of the light behind the low-pass.
    filtered: Vec<f32>,
    /// The same at the last event.
    memory: Vec<f32>,
    on: Vec<f32>,
    off: Vec<f32>,
    /// Key of the pixel's random numbers.
    keys: Vec<u32>,
    /// When it may fire again.
    ready_us: Vec<u64>,
    /// Hot pixels: where, and at what rate, Hz.
    hot: Vec<(usize, f32)>,
    /// For a stretch of pixels: before the step, and whether there is anything to do.
    before: Vec<f32>,
    busy: Vec<bool>,
}

impl Pixels {
    /// `numbers`: the pixels. `seed` makes the camera, `pass` what differs from drive to drive.
    pub(super) fn new(numbers: Vec<u32>, seed: u64, pass: u64) -> Self {
        let n = numbers.len();
        let mut pixels = Self {
            filtered: vec![0.0; n],
            memory: vec![0.0; n],
            on: Vec::with_capacity(n),
            off: Vec::with_capacity(n),
            keys: Vec::with_capacity(n),
            ready_us: vec![0; n],
            hot: Vec::new(),
            before: Vec::new(),
            busy: Vec::new(),
            numbers,
        };
        for (i, pixel) in pixels.numbers.iter().enumerate() {
            let pixel = u64::from(*pixel);
            let mut d = Draws::new(seed, Purpose::Threshold, &[pixel]);
            let mut threshold = || (THRESHOLD.0 + THRESHOLD.1 * d.normal()).max(THRESHOLD.2);
            pixels.on.push(threshold());
            pixels.off.push(threshold());
            pixels
                .keys
                .push(number(seed, Purpose::Noise, &[pass, pixel]) as u32);
            let mut hot = Draws::new(seed, Purpose::Hot, &[pixel]);
            if hot.chance(HOT_PART) {
                // Evenly over the decades.
                let rate = HOT_HZ.0 * (HOT_HZ.1 / HOT_HZ.0).powf(hot.unit());
                pixels.hot.push((i, rate));
            }
        }
        pixels
    }

    /// Gets used to the light that falls on the pixels from `at` on. What they remember lies anywhere within half a
    /// threshold, or all would leak at the same time.
    pub(super) fn settle(&mut self, at: usize, light: &[f32], seed: u64, pass: u64) {
        for (i, light) in (at..).zip(light) {
            let mut d = Draws::new(seed, Purpose::Memory, &[pass, u64::from(self.numbers[i])]);
            self.filtered[i] = ln(light + DARK);
            self.memory[i] = self.filtered[i] + self.on[i] * d.between(-0.5, 0.5);
        }
    }

    /// Lets the light of a step's end fall on the pixels from `at` on.
    pub(super) fn expose(&mut self, at: usize, light: &[f32], step: Step, out: &mut Vec<Spike>) {
        self.filter(at, light, step);
        for (k, light) in light.iter().enumerate() {
            if self.busy[k] {
                self.fire(at + k, self.before[k], *light, step, out);
            }
        }
    }

    /// Moves the low-pass, and marks pixels that may fire. This is where the time goes, so it is free of branches.
    fn filter(&mut self, at: usize, light: &[f32], step: Step) {
        let n = light.len();
        self.before.resize(n, 0.0);
        self.busy.resize(n, false);
        let end = at + n;
        let seconds = step.seconds();
        let shot = ShotNoise::new(seconds);
        let leak = LEAK_HZ * seconds;
        let (filtered, memory) = (&mut self.filtered[at..end], &mut self.memory[at..end]);
        let (on, off, keys) = (&self.on[at..end], &self.off[at..end], &self.keys[at..end]);
        let (before, busy) = (&mut self.before[..n], &mut self.busy[..n]);
        for k in 0..n {
            let level = ln(light[k] + DARK);
            let cutoff = (CUTOFF.0 * light[k]).clamp(CUTOFF.1, CUTOFF.2);
            let part = (TAU * cutoff * seconds).min(1.0);
            before[k] = filtered[k];
            filtered[k] += part * (level - filtered[k]);
            memory[k] -= leak * on[k];
            let change = filtered[k] - memory[k];
            let drawn = unit(scramble(keys[k] ^ step.key));
            let odds = shot.odds(level);
            busy[k] = (change >= on[k])
                | (change <= -off[k])
                | (drawn * on[k] < odds)
                | ((1.0 - drawn) * off[k] < odds);
        }
    }

    /// The events of one pixel in a step.
    fn fire(&mut self, i: usize, before: f32, light: f32, step: Step, out: &mut Vec<Spike>) {
        let after = self.filtered[i];
        loop {
            let (on, reached) = if after - self.memory[i] >= self.on[i] {
                (true, self.memory[i] + self.on[i])
            } else if self.memory[i] - after >= self.off[i] {
                (false, self.memory[i] - self.off[i])
            } else {
                break;
            };
            // When the straight line from before to after reaches the threshold; at once, if it had been before.
            let share = (reached - before) / (after - before);
            let share = if share.is_finite() {
                share.clamp(0.0, 1.0)
            } else {
                0.0
            };
            let after_us = (share * step.length_us as f32) as u64;
            // A change within the blind time is seen after it.
            let wait_us = self.ready_us[i].saturating_sub(step.start_us);
            if !self.spike(i, after_us.max(wait_us), on, step, out) {
                break;
            }
            self.memory[i] = reached;
        }
        let drawn = unit(scramble(self.keys[i] ^ step.key));
        let odds = ShotNoise::new(step.seconds()).odds(ln(light + DARK));
        let on = drawn * self.on[i] < odds;
        if on || (1.0 - drawn) * self.off[i] < odds {
            let at = unit(scramble(self.keys[i].wrapping_add(step.key)));
            let after_us = (at * step.length_us as f32) as u64;
            let ready = step.start_us + after_us >= self.ready_us[i];
            if ready && self.spike(i, after_us, on, step, out) {
                self.memory[i] += if on { self.on[i] } else { -self.off[i] };
            }
        }
    }

    /// Sends an event, unless it falls behind the step's end.
    fn spike(&mut self, i: usize, after_us: u64, on: bool, step: Step, out: &mut Vec<Spike>) -> bool {
        if after_us >= step.length_us {
            return false;
        }
        self.ready_us[i] = step.start_us + after_us + REFRACTORY_US;
        out.push(Spike::new(after_us, self.numbers[i], on));
        true
    }

    /// Numbers of the hot pixels.
    #[cfg(test)]
    pub(super) fn hot_numbers(&self) -> impl Iterator<Item = u32> {
        self.hot.iter().map(|(i, _)| self.numbers[*i])
    }

    /// The events of hot pixels in a step, after [`Pixels::expose`] of all.
    pub(super) fn hot(&mut self, step: Step, out: &mut Vec<Spike>) {
        for h in 0..self.hot.len() {
            let (i, rate) = self.hot[h];
            let mut draws = Draws::new(u64::from(self.keys[i]), Purpose::Hot, &[u64::from(step.key)]);
            let events = (rate * step.seconds() + draws.unit()) as u32;
            for event in 0..events {
                let share = (event as f32 + draws.unit()) / events as f32;
                let after_us = (share * step.length_us as f32) as u64;
                if step.start_us + after_us >= self.ready_us[i] {
                    self.spike(i, after_us, true, step, out);
                }
            }
        }
    }
}

/// How likely a random event is. With `odds` o, drawn number u and threshold θ: u < o/θ is an ON event, and as many
/// are OFF events; so pixels with low thresholds have more of them.
struct ShotNoise {
    dark: f32,
    fall: f32,
}

impl ShotNoise {
    fn new(seconds: f32) -> Self {
        Self {
            dark: 0.5 * SHOT_HZ * seconds * THRESHOLD.0,
            fall: SHOT_FALL / (SHOT_DECADES * LN_10),
        }
    }

    /// `level`: logarithm of light.
    #[inline]
    fn odds(&self, level: f32) -> f32 {
        const LN_SHOT_DARK: f32 = -LN_10;
        const _: () = assert!(SHOT_DARK == 0.1);
        let over_dark = (level - LN_SHOT_DARK).clamp(0.0, SHOT_DECADES * LN_10);
        self.dark * (1.0 - self.fall * over_dark)
    }
}

/// Natural logarithm of a positive, normal number, to 1e-4: the same on every machine, and made of plain arithmetic.
#[inline]
fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let m = f32::from_bits((bits & 0x007F_FFFF) | 0x3F80_0000);
    // log2(m) = (m - 1) p(m), a minimax fit over [1, 2).
    let p = 3.115_79
        + m * (-3.324_199 + m * (2.598_845_2 + m * (-1.231_530_3 + m * (0.318_212_3 - 0.034_436_006 * m))));
    (exponent as f32 + (m - 1.0) * p) * std::f32::consts::LN_2
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(index: u64, length_us: u64) -> Step {
        Step {
            start_us: index * length_us,
            length_us,
            key: number(9, Purpose::Noise, &[index]) as u32,
        }
    }

    /// Rate of events per pixel, Hz, and part of them ON, under light that may change with time (s).
    fn rate(light: impl Fn(f32) -> f32, seconds: f32) -> (f32, f32) {
        let n = 4_000;
        let mut pixels = Pixels::new((0..n as u32).collect(), 1, 0);
        pixels.hot.clear();
        let mut out = Vec::new();
        pixels.settle(0, &vec![light(0.0); n], 1, 0);
        let steps = (seconds / 2e-3) as u64;
        for i in 0..steps {
            let light = vec![light((i + 1) as f32 * 2e-3); n];
            pixels.expose(0, &light, step(i, 2_000), &mut out);
        }
        let on = out.iter().filter(|s| s.on()).count() as f32;
        (
            out.len() as f32 / (n as f32 * seconds),
            on / (out.len() as f32).max(1.0),
        )
    }

    #[test]
    fn the_logarithm_is_one() {
        let mut x = 1e-3f32;
        while x < 400.0 {
            assert!((ln(x) - x.ln()).abs() < 1e-4, "{x}: {} {}", ln(x), x.ln());
            x *= 1.003;
        }
    }

    #[test]
    fn still_light_gives_noise_that_falls_with_light() {
        let (dark, on) = rate(|_| 0.01, 2.0);
        // 15 Hz over thresholds that vary; the leak; and for every other of them an event that takes it back.
        assert!((20.0..26.0).contains(&dark), "{dark}");
        assert!((0.45..0.55).contains(&on), "{on}");
        let (lit, _) = rate(|_| 3.2, 2.0);
        assert!(
            (0.45 * dark..0.6 * dark).contains(&lit),
            "half of the decades: {lit}"
        );
        let (bright, _) = rate(|_| 100.0, 4.0);
        assert!(
            (0.3..0.55).contains(&bright),
            "2 % of the noise, and the leak: {bright}"
        );
    }

    #[test]
    fn light_that_grows_gives_as_many_on_events_as_thresholds_are_crossed() {
        // By e^2 in a second: 8 mean thresholds, and a little noise.
        let (rate, on) = rate(|t| 100.0 * (2.0 * t.min(1.0) - 2.0).exp(), 1.0);
        assert!((8.5..11.5).contains(&rate), "{rate}");
        assert!(on > 0.85, "{on}");
    }

    #[test]
    fn the_dark_is_slow() {
        // 20 Hz flicker by a factor of 4: passes in the light, drowns in the dark.
        let flicker = |level: f32| {
            move |t: f32| {
                level
                    * if ((t * 40.0) as u32).is_multiple_of(2) {
                        1.0
                    } else {
                        4.0
                    }
            }
        };
        let (bright, _) = rate(flicker(25.0), 1.0);
        let (dark, _) = rate(flicker(0.1), 1.0);
        assert!(bright > 100.0, "{bright}");
        assert!(dark < 40.0, "{dark}");
    }

    #[test]
    fn a_pixel_keeps_its_refractory_period_and_its_step() {
        let mut pixels = Pixels::new(vec![0, 1, 2], 1, 0);
        pixels.settle(0, &[1.0; 3], 1, 0);
        let mut last = [None; 3];
        let mut fired = 0;
        for i in 0..200 {
            let light = [if i % 2 == 0 { 250.0 } else { 60.0 }; 3];
            let mut out = Vec::new();
            pixels.expose(0, &light, step(i, 4_000), &mut out);
            out.sort();
            fired += out.len();
            for s in out {
                assert!(s.after_us() < 4_000);
                let t = i * 4_000 + s.after_us();
                let before = last[s.pixel() as usize].replace(t);
                assert!(before.is_none_or(|before| t >= before + REFRACTORY_US));
            }
        }
        assert!(fired > 600, "{fired}");
    }

    #[test]
    fn thresholds_and_hot_pixels_belong_to_the_camera() {
        let camera = |seed, pass| Pixels::new((0..40_000).collect(), seed, pass);
        let (a, b, other) = (camera(1, 0), camera(1, 2), camera(2, 0));
        assert_eq!((&a.on, &a.off, &a.hot), (&b.on, &b.off, &b.hot));
        assert_ne!(a.keys, b.keys);
        assert_ne!(a.on, other.on);
        assert_ne!(a.hot, other.hot);
        assert!((8..36).contains(&a.hot.len()), "{}", a.hot.len());
        assert!(a.hot.iter().all(|(_, rate)| (20.0..=200.0).contains(rate)));
        let mean = a.on.iter().sum::<f32>() / 40_000.0;
        let spread = a.on.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / 40_000.0;
        assert!((mean - 0.25).abs() < 0.002 && (spread.sqrt() - 0.05).abs() < 0.002);
    }

    #[test]
    fn hot_pixels_fire_at_their_rates() {
        let mut pixels = Pixels::new((0..40_000).collect(), 1, 0);
        let mut out = Vec::new();
        for i in 0..4_000 {
            pixels.hot(step(i, 4_000), &mut out);
        }
        for (i, rate) in &pixels.hot {
            let events = out.iter().filter(|s| s.pixel() as usize == *i).count() as f32 / 16.0;
            assert!(
                (0.75 * rate..1.2 * rate).contains(&events),
                "{events} at {rate} Hz"
            );
        }
        assert!(out.iter().all(|s| s.on()));
    }
}
