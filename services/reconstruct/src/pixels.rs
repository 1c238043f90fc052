//! From planes of numbers to pixels.

/// How many steps [`Levels`] applies in one pass.
const GROUP: usize = 4;

/// A map from a count (0…255) to a grey level, kept as the few counts at which the level changes: comparing with each
/// of them is several times as fast as looking each pixel up, and just as exact.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Levels {
    /// Level of count 0.
    base: u8,
    /// (count from which on, wrapping difference of the level), filled up with differences of 0.
    steps: Vec<[(u8, u8); GROUP]>,
}

impl Levels {
    /// The map that equals `level` for every count.
    pub(crate) fn new(level: impl Fn(u8) -> u8) -> Self {
        let base = level(0);
        let mut steps = Vec::new();
        let mut before = base;
        for count in 1..=u8::MAX {
            let here = level(count);
            if here != before {
                steps.push((count, here.wrapping_sub(before)));
            }
            before = here;
        }
        let steps = steps
            .chunks(GROUP)
            .map(|group| {
                let mut full = [(u8::MAX, 0); GROUP];
                full[..group.len()].copy_from_slice(group);
                full
            })
            .collect();
        Self { base, steps }
    }

    /// Writes the level of each count. Both slices have one length.
    pub(crate) fn apply(&self, counts: &[u8], levels: &mut [u8]) {
        let Some((first, rest)) = self.steps.split_first() else {
            levels.fill(self.base);
            return;
        };
        for (level, count) in levels.iter_mut().zip(counts) {
            *level = add_steps(self.base, first, *count);
        }
        for group in rest {
            for (level, count) in levels.iter_mut().zip(counts) {
                *level = add_steps(*level, group, *count);
            }
        }
    }
}

#[inline]
fn add_steps(level: u8, steps: &[(u8, u8); GROUP], count: u8) -> u8 {
    steps.iter().fold(level, |level, (from, difference)| {
        level.wrapping_add(if count >= *from { *difference } else { 0 })
    })
}

/// Pixels that [`interleave`] takes at once.
const BLOCK: usize = 16;

/// Interleaves two planes into pixels of three channels: `first`, `second`, 0. `out` has three bytes per pixel.
pub(crate) fn interleave(first: &[u8], second: &[u8], out: &mut [u8]) {
    let (first_blocks, first_rest) = first.as_chunks::<BLOCK>();
    let (second_blocks, second_rest) = second.as_chunks::<BLOCK>();
    let whole = 3 * BLOCK * first_blocks.len().min(second_blocks.len());
    let (out_whole, out_rest) = out.split_at_mut(whole.min(out.len()));
    let out_blocks = out_whole.as_chunks_mut::<{ 3 * BLOCK }>().0;
    for ((a, b), out) in first_blocks.iter().zip(second_blocks).zip(out_blocks) {
        interleave_block(a, b, out);
    }
    for ((a, b), pixel) in first_rest
        .iter()
        .zip(second_rest)
        .zip(out_rest.chunks_exact_mut(3))
    {
        pixel.copy_from_slice(&[*a, *b, 0]);
    }
}

/// Pairs first, which vectorises; then four pairs at a time, in one word, are spread to twelve bytes.
#[inline]
fn interleave_block(first: &[u8; BLOCK], second: &[u8; BLOCK], out: &mut [u8; 3 * BLOCK]) {
    let mut pairs = [0u8; 2 * BLOCK];
    for ((a, b), pair) in first.iter().zip(second).zip(pairs.as_chunks_mut::<2>().0) {
        *pair = [*a, *b];
    }
    for (pairs, out) in pairs.as_chunks::<8>().0.iter().zip(out.as_chunks_mut::<12>().0) {
        let pairs = u64::from_le_bytes(*pairs);
        let low = pairs & 0xFFFF | (pairs & 0xFFFF_0000) << 8 | (pairs & 0xFFFF_0000_0000) << 16;
        let high = (pairs >> 48 << 8) as u32;
        out[..8].copy_from_slice(&low.to_le_bytes());
        out[8..].copy_from_slice(&high.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn levels_equal_their_table(table in proptest::collection::vec(0u8..=255, 256), runs in 1usize..40) {
            let table: Vec<u8> = (0..256).map(|i| table[i / runs]).collect();
            let levels = Levels::new(|count| table[usize::from(count)]);
            let counts: Vec<u8> = (0..=255).collect();
            let mut out = vec![0; 256];
            levels.apply(&counts, &mut out);
            prop_assert_eq!(out, table);
        }

        #[test]
        fn interleaving_puts_every_byte_in_its_place(planes in proptest::collection::vec((0u8..=255, 0u8..=255), 0..70)) {
            let (a, b): (Vec<u8>, Vec<u8>) = planes.iter().copied().unzip();
            let mut out = vec![7; planes.len() * 3];
            interleave(&a, &b, &mut out);
            let expected: Vec<u8> = planes.iter().flat_map(|(a, b)| [*a, *b, 0]).collect();
            prop_assert_eq!(out, expected);
        }
    }

    #[test]
    fn a_flat_map_has_one_level() {
        let mut out = [0; 3];
        Levels::new(|_| 9).apply(&[0, 1, 255], &mut out);
        assert_eq!(out, [9; 3]);
    }
}
