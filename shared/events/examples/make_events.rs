//! Writes a recording of evenly spread random events, for measurements:
//! `cargo run --release -p evpr-events --example make_events -- OUT EVENTS_PER_S SECONDS [HEIGHT WIDTH]`.

use evpr_core::plan::Sensor;
use evpr_events::RawEvent;
use evpr_events::writers::{self, WriteOptions};
use std::path::Path;
use std::process::ExitCode;

/// Where measurements begin, ns: a time since 1970, as cameras give it.
const START_NS: u64 = 1_600_000_000_000_000_000;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments) {
        Ok(events) => {
            eprintln!("{events} events written to {}", arguments[0]);
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String]) -> Result<u64, String> {
    let [out, rate, seconds, size @ ..] = arguments else {
        return Err("usage: make_events OUT EVENTS_PER_S SECONDS [HEIGHT WIDTH]".to_owned());
    };
    let number = |text: &str| text.parse::<u64>().map_err(|e| format!("{text}: {e}"));
    let (rate, seconds) = (number(rate)?.max(1), number(seconds)?);
    let (height, width) = match size {
        [height, width] => (number(height)?, number(width)?),
        _ => (260, 346),
    };
    let sensor = Sensor {
        height: height as usize,
        width: width as usize,
    };
    let options = WriteOptions { sensor: Some(sensor) };
    let mut writer = writers::create(Path::new(out), &options).map_err(|e| e.to_string())?;
    let (total, mut state, mut batch) = (rate * seconds, 1u64, Vec::new());
    for event in 0..total {
        // A linear congruential generator (Knuth's MMIX constants); its upper bits are good enough here.
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let pixel = ((state >> 32) * (height * width)) >> 32;
        batch.push(RawEvent {
            // Whole µs.
            t_ns: START_NS + event * 1_000_000 / rate * 1_000,
            x: (pixel % width) as u16,
            y: (pixel / width) as u16,
            on: state >> 20 & 1 == 1,
        });
        if batch.len() == evpr_events::BATCH_EVENTS || event + 1 == total {
            writer.write(&batch).map_err(|e| e.to_string())?;
            batch.clear();
        }
    }
    writer.finish().map_err(|e| e.to_string())?;
    Ok(total)
}
