//! From planes of numbers to pixels.
//!
//! Methods with polarity keep *pairs*: per pixel, row-major, the number of one polarity and then of the other, in the
//! order of the frame's channels. A pair is a pixel but for its third channel, and planes of pairs have no rows to mind.

/// Numbers that are worked on at once: of a loop of this fixed length, and not of a short one, the compiler makes
/// vectors.
const RUN: usize = 256;
/// How many steps [`Levels`] applies in one pass.
const GROUP: usize = 4;
/// Numbers of a plane that [`render_pairs`] takes at once: their levels stay in the nearest cache.
const STRIP: usize = 4096;

/// Maps from counts (0…255) to grey levels, one for the first and one for the second of each pair, kept as the few
/// counts at which the level changes: comparing with each of them is several times as fast as looking each count up,
/// and just as exact.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Levels {
    /// Levels of count 0.
    base: [u8; RUN],
    steps: Vec<[Step; GROUP]>,
}

/// From this count on, the level is greater by the difference (wrapping). Even places are the first map's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Step {
    from: [u8; RUN],
    difference: [u8; RUN],
}

/// First and second over and over.
fn alternating(pair: [u8; 2]) -> [u8; RUN] {
    std::array::from_fn(|i| pair[i % 2])
}

impl Levels {
    /// The maps that equal `first` and `second` for every count.
    pub(crate) fn new(first: impl Fn(u8) -> u8, second: impl Fn(u8) -> u8) -> Self {
        let base = alternating([first(0), second(0)]);
        let (first, second) = (steps(first), steps(second));
        let full = first.len().max(second.len()).next_multiple_of(GROUP);
        let at = |steps: &[(u8, u8)], i: usize| steps.get(i).copied().unwrap_or((u8::MAX, 0));
        let step = |i: usize| {
            let (a, b) = (at(&first, i), at(&second, i));
            Step {
                from: alternating([a.0, b.0]),
                difference: alternating([a.1, b.1]),
            }
        };
        let groups = (0..full).step_by(GROUP);
        Self {
            base,
            steps: groups.map(|g| std::array::from_fn(|i| step(g + i))).collect(),
        }
    }

    /// Writes the levels of a plane of counts (of pairs where the maps differ). Both slices have one length.
    pub(crate) fn apply(&self, counts: &[u8], levels: &mut [u8]) {
        let (counts, counts_rest) = counts.as_chunks::<RUN>();
        let (levels, levels_rest) = levels.as_chunks_mut::<RUN>();
        for (levels, counts) in levels.iter_mut().zip(counts) {
            self.run(counts, levels);
        }
        if !counts_rest.is_empty() {
            let (mut counts, mut levels) = ([0; RUN], [0; RUN]);
            counts[..counts_rest.len()].copy_from_slice(counts_rest);
            self.run(&counts, &mut levels);
            levels_rest.copy_from_slice(&levels[..levels_rest.len()]);
        }
    }

    fn run(&self, counts: &[u8; RUN], levels: &mut [u8; RUN]) {
        let Some((first, rest)) = self.steps.split_first() else {
            *levels = self.base;
            return;
        };
        add(&self.base, first, counts, levels);
        for steps in rest {
            add(&levels.clone(), steps, counts, levels);
        }
    }
}

/// Adds these steps to levels.
fn add(to: &[u8; RUN], steps: &[Step; GROUP], counts: &[u8; RUN], levels: &mut [u8; RUN]) {
    for i in 0..RUN {
        levels[i] = steps.iter().fold(to[i], |level, Step { from, difference }| {
            let reached = 0u8.wrapping_sub(u8::from(counts[i] >= from[i]));
            level.wrapping_add(difference[i] & reached)
        });
    }
}

/// The counts at which a map changes, each with the wrapping difference of the level.
fn steps(level: impl Fn(u8) -> u8) -> Vec<(u8, u8)> {
    let difference = |count: u8| level(count).wrapping_sub(level(count - 1));
    let all = (1..=u8::MAX).map(|count| (count, difference(count)));
    all.filter(|(_, difference)| *difference != 0).collect()
}

/// The largest first and the largest second number of a plane of pairs, or some that are at least `enough`.
///
/// `iter().max()` does not vectorise; this does.
pub(crate) fn largest<T: Copy + Ord + Default>(pairs: &[T], enough: T) -> [T; 2] {
    let mut both = [T::default(); 2];
    for strip in pairs.chunks(STRIP) {
        let (blocks, rest) = strip.as_chunks::<RUN>();
        let mut run = [T::default(); RUN];
        for block in blocks {
            for i in 0..RUN {
                run[i] = run[i].max(block[i]);
            }
        }
        for [first, second] in run.as_chunks::<2>().0.iter().chain(rest.as_chunks::<2>().0) {
            both = [both[0].max(*first), both[1].max(*second)];
        }
        if both.iter().all(|value| *value >= enough) {
            break;
        }
    }
    both
}

/// Renders a plane of pairs as pixels of three channels, the third 0: `levels` turns a part of the plane (whole pairs)
/// into as many levels. `out` has three bytes per pair.
pub(crate) fn render_pairs<T>(pairs: &[T], out: &mut [u8], mut levels: impl FnMut(&[T], &mut [u8])) {
    let mut strip = [0; STRIP];
    for (pairs, out) in pairs.chunks(STRIP).zip(out.chunks_mut(STRIP / 2 * 3)) {
        let strip = &mut strip[..pairs.len()];
        levels(pairs, strip);
        spread(strip, out);
    }
}

/// Pairs of bytes to pixels, the third byte 0. Eight pairs at a time, in two words, become three words.
fn spread(pairs: &[u8], out: &mut [u8]) {
    let (pairs, pairs_rest) = pairs.as_chunks::<16>();
    let (out, out_rest) = out.as_chunks_mut::<24>();
    for (pairs, out) in pairs.iter().zip(out) {
        let pairs = u128::from_le_bytes(*pairs);
        let (a, b) = (pairs as u64, (pairs >> 64) as u64);
        let words = [
            a & 0xFFFF | (a & 0xFFFF_0000) << 8 | (a & 0xFFFF_0000_0000) << 16,
            a >> 48 << 8 | (b & 0xFFFF) << 32 | b >> 16 << 56,
            b >> 24 & 0xFF | (b & 0xFFFF_0000_0000) >> 16 | b >> 48 << 40,
        ];
        for (out, word) in out.as_chunks_mut::<8>().0.iter_mut().zip(words) {
            *out = word.to_le_bytes();
        }
    }
    let pairs_rest = pairs_rest.as_chunks::<2>().0;
    for ([first, second], pixel) in pairs_rest.iter().zip(out_rest.as_chunks_mut::<3>().0) {
        *pixel = [*first, *second, 0];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn levels_equal_their_tables(
            first in proptest::collection::vec(0u8..=255, 256),
            second in proptest::collection::vec(0u8..=255, 256),
            runs in (1usize..40, 1usize..100),
            counts in proptest::collection::vec(0u8..=255, 0..100),
        ) {
            let first: Vec<u8> = (0..256).map(|i| first[i / runs.0]).collect();
            let second: Vec<u8> = (0..256).map(|i| second[i / runs.1]).collect();
            let levels = Levels::new(|count| first[usize::from(count)], |count| second[usize::from(count)]);
            let mut out = vec![0; counts.len()];
            levels.apply(&counts, &mut out);
            for (i, (count, level)) in counts.iter().zip(out).enumerate() {
                let table = if i % 2 == 0 { &first } else { &second };
                prop_assert_eq!(level, table[usize::from(*count)]);
            }
        }

        #[test]
        fn the_largest_of_each_side(pairs in proptest::collection::vec(any::<[u32; 2]>(), 0..50)) {
            let expected = [0, 1].map(|side| pairs.iter().map(|pair| pair[side]).max().unwrap_or(0));
            prop_assert_eq!(largest(pairs.as_flattened(), u32::MAX), expected);
            let enough = expected[0].min(expected[1]) / 2;
            let pairs = pairs.repeat(100);
            for (some, most) in largest(pairs.as_flattened(), enough).iter().zip(expected) {
                prop_assert!((enough..=most).contains(some));
            }
        }

        #[test]
        fn every_byte_gets_into_its_place(pairs in proptest::collection::vec(any::<[u8; 2]>(), 0..70), times in 1usize..60) {
            let pairs = pairs.repeat(times);
            let mut out = vec![7; pairs.len() * 3];
            render_pairs(pairs.as_flattened(), &mut out, |pairs, levels| {
                levels.copy_from_slice(pairs);
                levels.iter_mut().for_each(|level| *level ^= 1);
            });
            let expected: Vec<u8> = pairs.iter().flat_map(|[a, b]| [a ^ 1, b ^ 1, 0]).collect();
            prop_assert_eq!(out, expected);
        }
    }

    #[test]
    fn a_flat_map_has_one_level() {
        let mut out = [0; 4];
        Levels::new(|_| 9, |_| 3).apply(&[0, 1, 255, 7], &mut out);
        assert_eq!(out, [9, 3, 9, 3]);
    }
}
