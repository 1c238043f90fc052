//! Room in shared memory. It is committed page by page, and running out of it kills a process by SIGBUS: so it is
//! counted before the start.

use crate::RuntimeError;
use evpr_core::Plan;

/// Service tables, connections and events, beside the payload slots.
const BOOKKEEPING_BYTES: usize = 4 << 20;

/// What a plan needs of /dev/shm and what there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShmRoom {
    /// Bytes that the plan may come to use.
    pub needed: u64,
    /// Bytes free in /dev/shm.
    pub free: u64,
}

/// Measures.
///
/// # Errors
/// When /dev/shm cannot be looked at.
pub fn room(plan: &Plan) -> Result<ShmRoom, RuntimeError> {
    let stat = nix::sys::statvfs::statvfs("/dev/shm")
        .map_err(|e| RuntimeError::Ipc(format!("cannot look at /dev/shm: {e}; is it mounted?")))?;
    let free = stat.blocks_available() as u64 * stat.fragment_size() as u64;
    Ok(ShmRoom {
        needed: (plan.shared_memory_bytes() + BOOKKEEPING_BYTES) as u64,
        free,
    })
}

/// Refuses a plan that may not fit.
pub(crate) fn check(plan: &Plan) -> Result<(), RuntimeError> {
    let ShmRoom { needed, free } = room(plan)?;
    if needed <= free {
        return Ok(());
    }
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    Err(RuntimeError::Ipc(format!(
        "too little shared memory: this plan needs {:.1} MiB and /dev/shm has {:.1} MiB free; enlarge it \
         (mount -o remount,size=…, or docker run --shm-size=…) or use fewer members (see `evpr graph`)",
        mib(needed),
        mib(free)
    )))
}
