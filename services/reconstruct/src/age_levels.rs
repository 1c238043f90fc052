//! From times of last events to pixels: a grey level for every age, looked up exactly.

use crate::avx2::{Avx2, Look};
use crate::decay::Decay;
use crate::pixels::render_pairs;
use std::time::Instant;

/// Buckets of one channel. Enough for every τ: a bucket is longer than τ / 510 (or 1 µs), and ages end at 19.4 τ.
pub(crate) const BUCKETS: usize = 1 << BUCKET_BITS;
/// As bits of an age's place in the table.
pub(crate) const BUCKET_BITS: u32 = 14;
/// The level's place in an entry of the table. A bucket is shorter than 2^24 µs.
pub(crate) const LEVEL_SHIFT: u32 = 24;
/// Values that are worked on at once.
const RUN: usize = 32;

/// Levels of both channels of a frame by the age of a pixel's last event (an age as [`Decay`] says).
///
/// A table of buckets no longer than the closest two changes of the level has at most one change in each. An entry is
/// the level of the bucket's first age times 2^24, plus the last age (µs) that has this level: entry less age, over
/// 2^24, is then the level of every age in the bucket, as the subtraction borrows one from the level after the change.
/// So a value costs one look-up, two shifts, a subtraction and no branch.
#[derive(Debug)]
pub(crate) struct AgeLevels {
    decay: Decay,
    /// A bucket is 2^shift µs.
    shift: u32,
    /// From this age on (µs) the level is 0 in this frame. Its bucket is the last one that is looked up.
    black_us: [u32; 2],
    /// What the table was made for.
    youngest_us: [u32; 2],
    /// The first channel's buckets, then the second's.
    entries: Box<[u32; 2 * BUCKETS]>,
    /// Where look-ups by vector instructions are there and pay.
    gather: Option<Avx2>,
}

impl AgeLevels {
    /// For this decay.
    pub(crate) fn new(decay: Decay) -> Self {
        let mut levels = Self {
            shift: decay.closest_us().max(1).ilog2(),
            decay,
            black_us: [0; 2],
            youngest_us: [u32::MAX; 2],
            entries: Box::new([0; 2 * BUCKETS]),
            gather: None,
        };
        (0..2).for_each(|channel| levels.fill(channel));
        levels.gather = Avx2::detect().filter(|gather| levels.pays(*gather));
        levels
    }

    /// Makes ready for a frame whose youngest pixels have these ages; `u32::MAX` in a channel without events.
    pub(crate) fn prepare(&mut self, youngest_us: [u32; 2]) {
        for (channel, youngest_us) in youngest_us.into_iter().enumerate() {
            if self.youngest_us[channel] != youngest_us {
                self.youngest_us[channel] = youngest_us;
                self.fill(channel);
            }
        }
    }

    fn fill(&mut self, channel: usize) {
        let ends = self.decay.ends(self.youngest_us[channel]);
        self.black_us[channel] = ends[1];
        let length_us = 1 << self.shift;
        let entries = &mut self.entries[channel * BUCKETS..(channel + 1) * BUCKETS];
        let used = BUCKETS.min((ends[1] >> self.shift) as usize + 1);
        let mut bucket = 0;
        for (level, end_us) in ends.into_iter().enumerate().rev() {
            let until = used.min(end_us.div_ceil(length_us) as usize);
            let Some(entries) = entries.get_mut(bucket..until) else {
                continue;
            };
            let mut end_of_bucket_us = (bucket as u32) << self.shift;
            for entry in entries.iter_mut() {
                end_of_bucket_us += length_us;
                *entry = ((level as u32) << LEVEL_SHIFT).wrapping_add(end_of_bucket_us - 1);
            }
            if let Some(last) = entries.last_mut() {
                *last -= end_of_bucket_us.saturating_sub(end_us);
            }
            bucket = until;
        }
    }

    /// Renders a plane of pairs of times: of age `now` less the time, or 0 where it is later. `out` has three bytes per
    /// pair, the third 0.
    pub(crate) fn render(&self, now: u32, times: &[u32], out: &mut [u8]) {
        match self.gather {
            Some(gather) => gather.render(&self.look(now), times, out),
            None => render_pairs(times, out, |times, levels| self.levels(now, times, levels)),
        }
    }

    fn look(&self, now: u32) -> Look<'_> {
        Look {
            now,
            black_us: self.black_us,
            shift: self.shift,
            entries: &self.entries,
        }
    }

    /// Levels of a plane of pairs, on any processor.
    fn levels(&self, now: u32, times: &[u32], levels: &mut [u8]) {
        let (times, times_rest) = times.as_chunks::<RUN>();
        let (levels, levels_rest) = levels.as_chunks_mut::<RUN>();
        for (levels, times) in levels.iter_mut().zip(times) {
            if times.iter().fold(0, |any, time| any | time) == 0 {
                *levels = [0; RUN];
            } else {
                self.run(now, times, levels);
            }
        }
        if !times_rest.is_empty() {
            let (mut times, mut levels) = ([0; RUN], [0; RUN]);
            times[..times_rest.len()].copy_from_slice(times_rest);
            self.run(now, &times, &mut levels);
            levels_rest.copy_from_slice(&levels[..levels_rest.len()]);
        }
    }

    /// First all ages and places, which makes vectors; then the look-ups, which cannot; then all levels.
    #[inline(always)]
    fn run(&self, now: u32, times: &[u32; RUN], levels: &mut [u8; RUN]) {
        let (shift, entries) = (self.shift & 31, &*self.entries);
        let black_us: [u32; RUN] = std::array::from_fn(|i| self.black_us[i % 2]);
        let (mut ages_us, mut places, mut found) = ([0; RUN], [0; RUN], [0; RUN]);
        for i in 0..RUN {
            ages_us[i] = (now.max(times[i]) - times[i]).min(black_us[i]);
            places[i] = ages_us[i] >> shift | ((i as u32 % 2) << BUCKET_BITS);
        }
        for i in 0..RUN {
            // The mask never changes a place. It is there for the compiler.
            found[i] = entries[places[i] as usize & (2 * BUCKETS - 1)];
        }
        for i in 0..RUN {
            levels[i] = (found[i].wrapping_sub(ages_us[i]) >> LEVEL_SHIFT) as u8;
        }
    }

    /// Whether vector instructions look up faster than ordinary ones: on some processors they are far slower. Both give
    /// the same levels, so they are simply tried.
    fn pays(&self, gather: Avx2) -> bool {
        const TIMES: usize = 4096;
        const REPEATS: usize = 8;
        let last_us = self.decay.always_black_us();
        let times: Vec<u32> = (1..=TIMES as u32).map(|i| last_us / TIMES as u32 * i).collect();
        let mut out = vec![0; TIMES / 2 * 3];
        let look = Look {
            black_us: [last_us; 2],
            ..self.look(last_us)
        };
        let mut fastest = |run: &mut dyn FnMut(&mut [u8])| {
            let times = (0..REPEATS).map(|_| {
                let start = Instant::now();
                run(std::hint::black_box(&mut out));
                start.elapsed()
            });
            times.min()
        };
        let with = fastest(&mut |out| gather.render(&look, &times, out));
        let without = fastest(&mut |out| {
            render_pairs(&times, out, |times, levels| self.levels(last_us, times, levels));
        });
        with <= without
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// As it is chosen, with vector instructions where the processor has them (even if they do not pay), and without.
    fn all_ways(decay: &Decay) -> Vec<AgeLevels> {
        let chosen = AgeLevels::new(decay.clone());
        let mut ways = vec![chosen];
        for gather in [None, Avx2::detect()] {
            let mut levels = AgeLevels::new(decay.clone());
            levels.gather = gather;
            ways.push(levels);
        }
        if Avx2::detect().is_none() {
            println!("skipped: the processor has no AVX2");
        }
        ways
    }

    fn rendered(levels: &AgeLevels, now: u32, times: &[u32]) -> Vec<u8> {
        let mut out = vec![7; times.len() / 2 * 3];
        levels.render(now, times, &mut out);
        out
    }

    /// Every age, channels unlike each other, in every way.
    #[test]
    fn every_age_has_the_level_of_the_formula() {
        for (tau_us, youngest_us) in [
            (10_000.0, [10_000, 10_003]),
            (10_000.0, [10_000, u32::MAX]),
            (10_000.0, [55_000, 12_345]),
            (333.3, [400, 334]),
            (1.5, [0, 2]),
            (256.0, [100, 256]),
            (900.0, [17_000, 900]),
            (0.001, [1, 1]),
        ] {
            let decay = Decay::new(tau_us);
            let first_us = youngest_us[0].min(youngest_us[1]);
            let last_us = decay.always_black_us() + 70;
            let now = last_us + 1_000_000;
            let ages_us = (first_us..last_us).flat_map(|age_us| [age_us; 2]);
            let times: Vec<u32> = ages_us.map(|age_us| now - age_us).collect();
            for mut levels in all_ways(&decay) {
                levels.prepare(youngest_us);
                let out = rendered(&levels, now, &times);
                for (age_us, pixel) in (first_us..last_us).zip(out.as_chunks::<3>().0) {
                    for channel in 0..2 {
                        // A pixel cannot be younger than the youngest.
                        if age_us >= youngest_us[channel] || youngest_us[channel] == u32::MAX {
                            let expected = decay.level(age_us, youngest_us[channel]);
                            assert_eq!(
                                pixel[channel], expected,
                                "τ {tau_us} µs, age {age_us} in {channel}"
                            );
                        }
                    }
                    assert_eq!(pixel[2], 0);
                }
            }
        }
    }

    #[test]
    fn pixels_without_events_and_of_other_ages_are_black() {
        let decay = Decay::new(100_000.0);
        for mut levels in all_ways(&decay) {
            levels.prepare([decay.lead_us(); 2]);
            let (now, last) = (u32::MAX - 7, u32::MAX - 7 - decay.lead_us());
            let mut times = [0; 72];
            assert_eq!(rendered(&levels, now, &times), [0; 108]);
            times[41] = last;
            times[71] = last;
            let mut expected = [0; 108];
            expected[61] = 254;
            expected[106] = 254;
            assert_eq!(rendered(&levels, now, &times), expected);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Any times: later than now, too. Any number of pixels. The table is made anew for each frame.
        #[test]
        fn all_ways_agree(
            tau_us in prop_oneof![0.001f64..1e3, 1e3..1e6, 1e6..1e8],
            frames in proptest::collection::vec(
                ([0.0f64..3.0, 0.0..19.0], any::<u32>(), proptest::collection::vec([any::<u32>(), any::<u32>()], 0..80)),
                1..4,
            ),
            near in any::<bool>(),
        ) {
            let decay = Decay::new(tau_us);
            let mut ways = all_ways(&decay);
            for (youngest, now, pairs) in frames {
                let youngest_us = youngest.map(|taus| (taus * tau_us) as u32);
                let span_us = decay.always_black_us() + 2;
                let time = |time: u32| if near { now.wrapping_sub(time % span_us) } else { time };
                let times: Vec<u32> = pairs.iter().flatten().map(|t| time(*t)).collect();
                let mut all = ways.iter_mut().map(|levels| {
                    levels.prepare(youngest_us);
                    rendered(levels, now, &times)
                });
                let first = all.next().unwrap();
                all.for_each(|other| assert_eq!(first, other));
                for (i, time) in times.iter().enumerate() {
                    let (age_us, channel) = (now.saturating_sub(*time), i % 2);
                    if age_us >= youngest_us[channel] && times.iter().any(|time| *time != 0) {
                        let expected = decay.level(age_us.min(span_us), youngest_us[channel]);
                        let in_empty_run = times.chunks(RUN).nth(i / RUN).unwrap().iter().all(|time| *time == 0);
                        prop_assert_eq!(first[i / 2 * 3 + channel], if in_empty_run { 0 } else { expected });
                    }
                }
            }
        }
    }
}
