//! What a decoder may hold at once: an allocation beyond it fails, which ends the process as a crash does.

use cap::Cap;
use std::alloc::System;

/// 64 MiB beyond the bytes that are decoded (at most 1 MiB by libFuzzer's choice) and what they are copied to.
const LIMIT_MIB: usize = 72;

#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, LIMIT_MIB << 20);

/// Sets another limit.
pub fn allow_mib(limit: usize) {
    assert!(
        ALLOCATOR.set_limit(limit << 20).is_ok(),
        "{limit} MiB are in use already"
    );
}
