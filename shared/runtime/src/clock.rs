//! The one clock that all processes of a machine share.

use nix::time::{ClockId, clock_gettime};

/// Host monotonic time, ns. The same in every process of the machine.
pub fn now_ns() -> u64 {
    // CLOCK_MONOTONIC always exists on Linux; 0 would only spoil latencies.
    clock_gettime(ClockId::CLOCK_MONOTONIC)
        .map_or(0, |t| t.tv_sec() as u64 * 1_000_000_000 + t.tv_nsec() as u64)
}
