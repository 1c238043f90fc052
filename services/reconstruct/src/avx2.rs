//! What the time surface does with AVX2, where the processor has it. The only `unsafe` of the crate.
//!
//! Levels are looked up eight at a time: safe code moves every place out of a vector and every entry back into one,
//! which takes most of a frame's time, and nothing safe compiles to a gather. All else is as in
//! [`age_levels`](crate::age_levels), with the same results.
#![allow(unsafe_code)]

use crate::age_levels::BUCKETS;

/// A table of levels and the moment from which ages count, as in [`AgeLevels`](crate::age_levels::AgeLevels).
#[derive(Debug)]
pub(crate) struct Look<'a> {
    /// An age is this less a time, or 0 where the time is later.
    pub(crate) now: u32,
    /// Per channel: longer ages are taken for this one.
    pub(crate) black_us: [u32; 2],
    /// A bucket is 2^shift µs; below 32.
    pub(crate) shift: u32,
    /// The first channel's buckets, then the second's.
    pub(crate) entries: &'a [u32; 2 * BUCKETS],
}

pub(crate) use imp::Avx2;

/// Puts times where `merged` has none (0) yet. Both have one length.
#[inline(always)]
pub(crate) fn fill_in(merged: &mut [u32], older: &[u32]) {
    for (time, older) in merged.iter_mut().zip(older) {
        let none = 0u32.wrapping_sub(u32::from(*time == 0));
        *time |= older & none;
    }
}

#[cfg(target_arch = "x86_64")]
mod imp {
    use super::Look;
    use crate::age_levels::{BUCKET_BITS, BUCKETS, LEVEL_SHIFT};
    use std::arch::x86_64::*;

    /// Times that are worked on at once, and the bytes they make.
    const RUN: usize = 32;
    const OUT: usize = RUN / 2 * 3;

    /// Says that the processor has AVX2.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Avx2(());

    impl Avx2 {
        /// `None` where the processor lacks AVX2.
        pub(crate) fn detect() -> Option<Self> {
            std::arch::is_x86_feature_detected!("avx2").then_some(Self(()))
        }

        /// Renders a plane of pairs of times: three bytes per pair into `out`, the third 0.
        pub(crate) fn render(self, look: &Look<'_>, times: &[u32], out: &mut [u8]) {
            // SAFETY: `render` asks for nothing but a processor with AVX2, which [`Self::detect`] has found.
            unsafe { render(look, times, out) }
        }

        /// [`fill_in`](super::fill_in).
        pub(crate) fn fill_in(self, merged: &mut [u32], older: &[u32]) {
            // SAFETY: as above.
            unsafe { fill_in(merged, older) }
        }
    }

    #[target_feature(enable = "avx2")]
    fn fill_in(merged: &mut [u32], older: &[u32]) {
        super::fill_in(merged, older);
    }

    /// Constants in vectors.
    struct Vectors<'a> {
        entries: &'a [u32; 2 * BUCKETS],
        now: __m256i,
        black_us: __m256i,
        shift: __m128i,
        channel: __m256i,
    }

    /// One number in the even lanes and another in the odd ones.
    #[target_feature(enable = "avx2")]
    fn alternating([even, odd]: [u32; 2]) -> __m256i {
        _mm256_set1_epi64x((u64::from(odd) << 32 | u64::from(even)).cast_signed())
    }

    #[target_feature(enable = "avx2")]
    fn render(look: &Look<'_>, times: &[u32], out: &mut [u8]) {
        let shift = look.shift.min(31);
        // Whatever the caller says, no place is outside the table.
        let last_us = u32::try_from(((BUCKETS as u64) << shift) - 1).unwrap_or(u32::MAX);
        let vectors = Vectors {
            entries: look.entries,
            now: alternating([look.now; 2]),
            black_us: alternating(look.black_us.map(|black_us| black_us.min(last_us))),
            shift: _mm_cvtsi32_si128(shift.cast_signed()),
            channel: alternating([0, BUCKETS as u32]),
        };
        let (times, times_rest) = times.as_chunks::<RUN>();
        let (out, out_rest) = out.as_chunks_mut::<OUT>();
        for (times, out) in times.iter().zip(out) {
            run(&vectors, times, out);
        }
        let (mut times, mut out) = ([0; RUN], [0; OUT]);
        let rest = times_rest.len().min(out_rest.len() / 3 * 2);
        times[..rest].copy_from_slice(&times_rest[..rest]);
        run(&vectors, &times, &mut out);
        let rest = rest / 2 * 3;
        out_rest[..rest].copy_from_slice(&out[..rest]);
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn run(vectors: &Vectors<'_>, times: &[u32; RUN], out: &mut [u8; OUT]) {
        let [a, b, c, d] = times.as_chunks::<8>().0 else {
            return;
        };
        let (a, b, c, d) = (load(a), load(b), load(c), load(d));
        let any = _mm256_or_si256(_mm256_or_si256(a, b), _mm256_or_si256(c, d));
        if _mm256_testz_si256(any, any) == 1 {
            *out = [0; OUT];
            return;
        }
        let (a, b) = (levels(vectors, a), levels(vectors, b));
        let (c, d) = (levels(vectors, c), levels(vectors, d));
        // Packing works within the halves of a vector: they come out in the order 0 2 4 6 1 3 5 7 of four bytes.
        let packed = _mm256_packus_epi16(_mm256_packus_epi32(a, b), _mm256_packus_epi32(c, d));
        let in_order = _mm256_permutevar8x32_epi32(packed, _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7));
        if let [first, last] = out.as_chunks_mut().0 {
            spread(_mm256_castsi256_si128(in_order), first);
            spread(_mm256_extracti128_si256::<1>(in_order), last);
        }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(times: &[u32; 8]) -> __m256i {
        // SAFETY: the array is the 32 bytes that are read, and nothing is asked of its alignment.
        unsafe { _mm256_loadu_si256(times.as_ptr().cast()) }
    }

    /// Levels of eight times.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn levels(vectors: &Vectors<'_>, times: __m256i) -> __m256i {
        let ages_us = _mm256_sub_epi32(_mm256_max_epu32(vectors.now, times), times);
        let ages_us = _mm256_min_epu32(ages_us, vectors.black_us);
        let places = _mm256_or_si256(_mm256_srl_epi32(ages_us, vectors.shift), vectors.channel);
        // SAFETY: `render` has seen to it that `black_us`, and so every age, is below BUCKETS · 2^shift. So a place is
        // below BUCKETS, or that more in the odd lanes (BUCKETS is a power of two): inside the table.
        let entries = unsafe { _mm256_i32gather_epi32::<4>(vectors.entries.as_ptr().cast(), places) };
        _mm256_srli_epi32::<{ LEVEL_SHIFT as i32 }>(_mm256_sub_epi32(entries, ages_us))
    }

    const _: () = assert!(BUCKETS == 1 << BUCKET_BITS);

    /// Eight pairs of bytes to pixels, the third byte 0.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn spread(pairs: __m128i, out: &mut [u8; OUT / 2]) {
        const ZERO: i8 = -1;
        let first = _mm_setr_epi8(0, 1, ZERO, 2, 3, ZERO, 4, 5, ZERO, 6, 7, ZERO, 8, 9, ZERO, 10);
        let last = _mm_setr_epi8(11, ZERO, 12, 13, ZERO, 14, 15, ZERO, 0, 0, 0, 0, 0, 0, 0, 0);
        let first = _mm_shuffle_epi8(pairs, first);
        let last = _mm_cvtsi128_si64(_mm_shuffle_epi8(pairs, last));
        let [a, b, c] = out.as_chunks_mut::<8>().0 else {
            return;
        };
        *a = _mm_cvtsi128_si64(first).to_le_bytes();
        *b = _mm_extract_epi64::<1>(first).to_le_bytes();
        *c = last.to_le_bytes();
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod imp {
    use super::Look;

    /// There is none.
    #[derive(Debug, Clone, Copy)]
    pub(crate) enum Avx2 {}

    impl Avx2 {
        pub(crate) fn detect() -> Option<Self> {
            None
        }

        pub(crate) fn render(self, _look: &Look<'_>, _times: &[u32], _out: &mut [u8]) {
            match self {}
        }

        pub(crate) fn fill_in(self, _merged: &mut [u32], _older: &[u32]) {
            match self {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn times_are_filled_in_where_there_is_none(pairs in proptest::collection::vec((0u32..3, any::<u32>()), 0..100)) {
            let (merged, older): (Vec<u32>, Vec<u32>) = pairs.iter().map(|(a, b)| (a * 0x7F00_0001, *b)).unzip();
            let expected: Vec<u32> = merged.iter().zip(&older).map(|(a, b)| if *a == 0 { *b } else { *a }).collect();
            let mut portable = merged.clone();
            fill_in(&mut portable, &older);
            prop_assert_eq!(&portable, &expected);
            if let Some(avx2) = Avx2::detect() {
                let mut merged = merged;
                avx2.fill_in(&mut merged, &older);
                prop_assert_eq!(&merged, &expected);
            }
        }
    }
}
