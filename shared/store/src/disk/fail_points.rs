//! Lets a chosen step on the disk fail, in the thread that asks for it.

use super::Step;
use std::cell::Cell;
use std::io::{self, ErrorKind};

/// How a step fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    /// The process is dead from this step on: nothing more is done.
    Death,
    /// The same, but of what this step writes, the first half gets to the disk.
    TornDeath,
    /// The disk is full at this step, and has room again afterwards.
    Full,
}

thread_local! {
    static DONE: Cell<u64> = const { Cell::new(0) };
    static FAULT: Cell<Option<(u64, Fault)>> = const { Cell::new(None) };
}

pub(super) fn step() -> io::Result<Step> {
    let this = DONE.get();
    DONE.set(this + 1);
    let dead = || Err(io::Error::other("the process is dead"));
    match FAULT.get() {
        Some((at, Fault::Full)) if this == at => Err(ErrorKind::StorageFull.into()),
        Some((at, Fault::TornDeath)) if this == at => Ok(Step::Half),
        Some((at, Fault::Death | Fault::TornDeath)) if this >= at => dead(),
        _ => Ok(Step::Whole),
    }
}

/// Runs this with the fault at its step `at` (none: undisturbed); also says how many steps it took.
pub(crate) fn with_fault<T>(fault: Option<(u64, Fault)>, run: impl FnOnce() -> T) -> (T, u64) {
    DONE.set(0);
    FAULT.set(fault);
    let result = run();
    FAULT.set(None);
    (result, DONE.get())
}
