//! Recordings, positions and lists of pixels: the seeds of the fuzz targets, and what fuzzing found, go through the same functions as there.
#![allow(unreachable_pub, clippy::print_stdout)] // it is a crate of its own there

#[path = "../../../fuzz/src/events/mod.rs"]
mod events;
#[path = "../../../fuzz/src/replay.rs"]
mod replay;

#[test]
fn every_seed_passes_its_target() {
    replay::corpus(events::TARGETS);
}
