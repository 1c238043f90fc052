//! Simulates a drive along the street, and says how fast and how many events:
//! `cargo run --release -p evpr-ingest --example street -- [PASS [HEIGHT WIDTH]]`.

use evpr_core::config::STREET_PASSES;
use evpr_core::plan::{Sensor, Source, Street};
use evpr_ingest::open;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let mut street = Street::default();
    if let Some(pass) = args.first() {
        street.pass = STREET_PASSES.parse(pass)?;
    }
    if let [_, height, width] = args.as_slice() {
        street.sensor = Sensor {
            height: height.parse()?,
            width: width.parse()?,
        };
    }
    let started = Instant::now();
    let mut recording = open(&Source::street(street.clone()))?;
    println!("built in {:.3} s", started.elapsed().as_secs_f64());
    let started = Instant::now();
    let (mut batch, mut events, mut last_ns) = (Vec::new(), 0, 0);
    while recording.next_batch(&mut batch)? {
        events += batch.len();
        last_ns = batch.last().map_or(last_ns, |e| e.t_ns);
    }
    let (took, seconds) = (started.elapsed().as_secs_f64(), last_ns as f64 / 1e9);
    println!(
        "{}, {}: {events} events over {seconds:.1} s, {:.2} per pixel and second; simulated in {took:.2} s, {:.1} times as \
         fast as real time",
        street.pass.name(),
        street.sensor,
        events as f64 / (seconds * street.sensor.pixels() as f64),
        seconds / took
    );
    Ok(())
}
