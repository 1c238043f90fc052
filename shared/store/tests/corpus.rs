//! Traverses and ground truth: the seeds of the fuzz targets, and what fuzzing found, go through the same functions as there.
#![allow(unreachable_pub, clippy::print_stdout)] // it is a crate of its own there

#[path = "../../../fuzz/src/replay.rs"]
mod replay;
#[path = "../../../fuzz/src/store.rs"]
mod store;

#[test]
fn every_seed_passes_its_target() {
    replay::corpus(store::TARGETS);
}
