//! Reads a recording and says how fast: `cargo run --release -p evpr-events --example read_speed -- FILE`.

#![allow(clippy::print_stdout)]

use evpr_events::{ReadOptions, SourceError};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), SourceError> {
    for path in std::env::args_os().skip(1) {
        // The first time may wait for the disk.
        for _ in 0..3 {
            let started = Instant::now();
            let mut recording = evpr_events::open(Path::new(&path), &ReadOptions::default())?;
            let (mut batch, mut events) = (Vec::new(), 0);
            while recording.next_batch(&mut batch)? {
                events += batch.len();
            }
            let seconds = started.elapsed().as_secs_f64();
            let rate = events as f64 / seconds / 1e6;
            println!("{}: {events} events, {rate:.1} M events/s", path.display());
        }
    }
    Ok(())
}
