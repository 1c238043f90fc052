//! Sums over pairs of rows, several query rows with several map rows at once, so that what is loaded is used more than
//! once. Unsafe for its vector instructions: a plain loop over a tile of sums leaves them in memory. On two cores of a
//! Xeon (`benches/per_query.rs`) a tile is four to six times as fast as a query row alone that waits for the map.
#![allow(unsafe_code)]

/// f32 lanes of a sum.
pub(crate) const LANES: usize = 16;
/// A row, as steps of all lanes.
pub(crate) type Steps<'a> = &'a [[f32; LANES]];
/// Per query row and map row the lanes of their sum.
pub(crate) type Sums<const Q: usize, const R: usize> = [[[f32; LANES]; R]; Q];

/// Work on tiles of Q query rows and R map rows.
pub(crate) trait Tiled {
    /// Does the work. `sums` adds up, step after step in each lane, (q − r)² or |q − r|; all its rows must have as many
    /// steps as the first query row.
    fn run<const Q: usize, const R: usize>(self, sums: impl Fn([Steps<'_>; Q], [Steps<'_>; R]) -> Sums<Q, R>);
}

/// Runs `work` on tiles of the size that suits the processor. The sums are of |q − r| if `ABSOLUTE`, else of (q − r)²;
/// they are the same to the bit on every processor.
pub(crate) fn run_tiled<const ABSOLUTE: bool>(work: impl Tiled) {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has what `sums_512` asks for, as has just been found.
            return work.run(|q, r| unsafe { x86::sums_512::<6, 4, ABSOLUTE>(q, r) });
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: as above, of `sums_256`.
            return work.run(|q, r| unsafe { x86::sums_256::<3, 3, ABSOLUTE>(q, r) });
        }
    }
    work.run(plain::<ABSOLUTE>);
}

/// The sums of one query row and one map row.
fn plain<const ABSOLUTE: bool>([q]: [Steps<'_>; 1], [r]: [Steps<'_>; 1]) -> Sums<1, 1> {
    let mut sums = [0.0; LANES];
    for (q, r) in q.iter().zip(r) {
        for k in 0..LANES {
            let d = q[k] - r[k];
            sums[k] += if ABSOLUTE { d.abs() } else { d * d };
        }
    }
    [[sums]]
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{LANES, Steps, Sums};
    use std::arch::x86_64::*;

    /// # Panics
    /// When a row has fewer steps than the first query row.
    #[target_feature(enable = "avx512f")]
    pub(super) fn sums_512<const Q: usize, const R: usize, const ABSOLUTE: bool>(
        q: [Steps<'_>; Q],
        r: [Steps<'_>; R],
    ) -> Sums<Q, R> {
        let steps = q.first().map_or(0, |q| q.len());
        let (q, r) = (q.map(|q| &q[..steps]), r.map(|r| &r[..steps]));
        // SAFETY: reads the 16 numbers of the array.
        let load = |step: &[f32; LANES]| unsafe { _mm512_loadu_ps(step.as_ptr()) };
        let mut sums = [[_mm512_setzero_ps(); R]; Q];
        for i in 0..steps {
            let rows: [__m512; R] = r.map(|r| load(&r[i]));
            for a in 0..Q {
                let query = load(&q[a][i]);
                for b in 0..R {
                    let d = _mm512_sub_ps(query, rows[b]);
                    let term = if ABSOLUTE {
                        _mm512_abs_ps(d)
                    } else {
                        _mm512_mul_ps(d, d)
                    };
                    sums[a][b] = _mm512_add_ps(sums[a][b], term);
                }
            }
        }
        sums.map(|of_query| {
            of_query.map(|sum| {
                let mut lanes = [0.0; LANES];
                // SAFETY: writes the 16 numbers of the array.
                unsafe { _mm512_storeu_ps(lanes.as_mut_ptr(), sum) };
                lanes
            })
        })
    }

    /// # Panics
    /// When a row has fewer steps than the first query row.
    #[target_feature(enable = "avx2")]
    pub(super) fn sums_256<const Q: usize, const R: usize, const ABSOLUTE: bool>(
        q: [Steps<'_>; Q],
        r: [Steps<'_>; R],
    ) -> Sums<Q, R> {
        const HALF: usize = LANES / 2;
        let steps = q.first().map_or(0, |q| q.len());
        let (q, r) = (q.map(|q| &q[..steps]), r.map(|r| &r[..steps]));
        let sign = _mm256_set1_ps(-0.0);
        let mut out = [[[0.0; LANES]; R]; Q];
        // Half of the lanes after the other: the sums of both would not fit the registers.
        for half in 0..2 {
            let load = |step: &[f32; LANES]| {
                let half: &[f32; HALF] = &step.as_chunks().0[half];
                // SAFETY: reads the 8 numbers of the array.
                unsafe { _mm256_loadu_ps(half.as_ptr()) }
            };
            let mut sums = [[_mm256_setzero_ps(); R]; Q];
            for i in 0..steps {
                let rows: [__m256; R] = r.map(|r| load(&r[i]));
                for a in 0..Q {
                    let query = load(&q[a][i]);
                    for b in 0..R {
                        let d = _mm256_sub_ps(query, rows[b]);
                        let term = if ABSOLUTE {
                            _mm256_andnot_ps(sign, d)
                        } else {
                            _mm256_mul_ps(d, d)
                        };
                        sums[a][b] = _mm256_add_ps(sums[a][b], term);
                    }
                }
            }
            for (out, sums) in out.iter_mut().flatten().zip(sums.iter().flatten()) {
                let half: &mut [f32; HALF] = &mut out.as_chunks_mut().0[half];
                // SAFETY: writes the 8 numbers of the array.
                unsafe { _mm256_storeu_ps(half.as_mut_ptr(), *sums) };
            }
        }
        out
    }

    #[cfg(test)]
    mod tests {
        use super::super::plain;
        use super::*;
        use proptest::prelude::*;

        fn bits<const Q: usize, const R: usize>(sums: Sums<Q, R>) -> Vec<u32> {
            sums.iter().flatten().flatten().map(|v| v.to_bits()).collect()
        }

        proptest! {
            #[test]
            fn every_width_has_the_sums_of_plain_loops(steps in 0usize..70, seed in 0usize..1000) {
                let row = |n: usize| -> Vec<[f32; LANES]> {
                    let value = |i: usize| ((i * 7919 + n * 31 + seed) as f32 * 0.618).fract() * 3.0 - 1.4;
                    (0..steps).map(|s| std::array::from_fn(|k| value(s * LANES + k))).collect()
                };
                let rows: Vec<_> = (0..10).map(row).collect();
                let q: [Steps<'_>; 6] = std::array::from_fn(|a| &rows[a][..]);
                let r: [Steps<'_>; 4] = std::array::from_fn(|b| &rows[6 + b][..]);
                let want = |absolute: bool| -> Vec<u32> {
                    let of = if absolute { plain::<true> } else { plain::<false> };
                    q.iter().flat_map(|q| r.iter().flat_map(|r| bits(of([q], [r])))).collect()
                };
                if std::arch::is_x86_feature_detected!("avx512f") {
                    // SAFETY: the processor has it.
                    prop_assert_eq!(bits(unsafe { sums_512::<6, 4, false>(q, r) }), want(false));
                    // SAFETY: the processor has it.
                    prop_assert_eq!(bits(unsafe { sums_512::<6, 4, true>(q, r) }), want(true));
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has it.
                    prop_assert_eq!(bits(unsafe { sums_256::<6, 4, false>(q, r) }), want(false));
                    // SAFETY: the processor has it.
                    prop_assert_eq!(bits(unsafe { sums_256::<6, 4, true>(q, r) }), want(true));
                }
            }
        }
    }
}
