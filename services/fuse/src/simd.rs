//! Runs a loop with the widest vectors the processor has, chosen while the program runs. The only `unsafe` of the
//! crate, with its `tiles`.
//!
//! The build's baseline has vectors of 16 bytes (SSE2 on x86-64); nearly every machine since 2013 has 32 (AVX2). The
//! same code is compiled for both. Multiplications and additions are not contracted into one, so both give the same
//! numbers to the bit, and so does every other machine. On the bench (`benches/per_query.rs`) AVX2 makes the cosine
//! about 1.6 times as fast and the matching 1.2 to 1.3 times.
#![allow(unsafe_code)]

pub(crate) mod tiles;

/// A piece of work made of plain loops over slices.
///
/// The implementation of [`Kernel::run`], and all that it calls in its loops, must be `#[inline(always)]`: what is
/// not inlined is compiled for the baseline. It is as safe as any other code either way.
pub(crate) trait Kernel {
    /// Does the work.
    fn run(self);
}

/// Runs `kernel`, compiled for AVX2 where the processor has it.
#[inline]
pub(crate) fn run_widest(kernel: impl Kernel) {
    #[cfg(test)]
    if tests::BASELINE.get() {
        return kernel.run();
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: `run_avx2` asks for nothing but a processor with AVX2, which has just been found. It takes no
        // pointers: lengths are checked by the safe code of the kernel.
        return unsafe { run_avx2(kernel) };
    }
    kernel.run();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2(kernel: impl Kernel) {
    kernel.run();
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::cell::Cell;

    thread_local! {
        pub(super) static BASELINE: Cell<bool> = const { Cell::new(false) };
    }

    /// Does `work` with the baseline's vectors, as far as this thread does it.
    pub(crate) fn with_baseline<R>(work: impl FnOnce() -> R) -> R {
        BASELINE.set(true);
        let result = work();
        BASELINE.set(false);
        result
    }

    struct Count<'a>(&'a mut usize);

    impl Kernel for Count<'_> {
        fn run(self) {
            *self.0 += 1;
        }
    }

    #[test]
    fn a_kernel_runs_once_either_way() {
        let mut runs = 0;
        run_widest(Count(&mut runs));
        assert_eq!(runs, 1);
        with_baseline(|| run_widest(Count(&mut runs)));
        assert_eq!(runs, 2);
    }
}
