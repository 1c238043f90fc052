//! Images, stacks and lists of them: the seeds of the fuzz targets, and what fuzzing found, go through the same functions as there.
#![allow(unreachable_pub, clippy::print_stdout)] // it is a crate of its own there

#[path = "../../../fuzz/src/frames.rs"]
mod frames;
#[path = "../../../fuzz/src/replay.rs"]
mod replay;

#[test]
fn every_seed_passes_its_target() {
    replay::corpus(frames::TARGETS);
}
