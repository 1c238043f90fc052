//! Time per event of the mask and the filters, beside a plain copy of the same events in the same run:
//! `cargo bench -p evpr-ingest --bench noise`. One thread.
//!
//! Events lie anywhere on the sensor with equal chance, which is the hardest case for the caches, evenly over one
//! second; or they come in groups of neighbours, as edges give them.

use evpr_core::plan::{Filters, HotPixels, HotPixelsFrom, MaskedBy, Pixel, Plan, Sensor, test_plan};
use evpr_events::{BATCH_EVENTS, RawEvent};
use evpr_ingest::Noise;
use std::hint::black_box;
use std::time::Instant;

const REPEATS: u64 = 9;
const SECOND_NS: u64 = 1_000_000_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for (height, width, count) in [(260, 346, 2_000_000), (720, 1280, 10_000_000)] {
        let sensor = Sensor { height, width };
        for (name, group) in [("anywhere", 1), ("in groups of 16", 16)] {
            let events = events(sensor, count, group);
            println!("{width}×{height}, {count} events {name}");
            println!("{:>32} {:>9} {:>8}", "", "ns/event", "kept");
            println!(
                "{:>32} {:>9.2}",
                "a copy, in all of these",
                time(&events, |_| {}).0
            );
            for (label, mask, refractory, background) in [
                ("mask", true, None, None),
                ("refractory 1ms", false, Some(1_000_000), None),
                ("background activity 5ms", false, None, Some(5_000_000)),
                ("all three", true, Some(1_000_000), Some(5_000_000)),
            ] {
                let mut noise = Noise::new(&plan(sensor, mask, refractory, background))?;
                let (ns, kept) = time(&events, |batch| noise.apply(batch));
                println!("{label:>32} {ns:>9.2} {:>7.1}%", kept * 100.0);
            }
            println!();
        }
    }
    Ok(())
}

/// Median ns per event, and the share of events that is left. Times go on from one repeat to the next.
fn time(events: &[RawEvent], mut apply: impl FnMut(&mut Vec<RawEvent>)) -> (f64, f64) {
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    let (mut times, mut kept) = (Vec::new(), 0);
    for repeat in 0..=REPEATS {
        let started = Instant::now();
        let mut left = 0;
        for part in events.chunks(BATCH_EVENTS) {
            batch.clear();
            batch.extend(part.iter().map(|e| RawEvent {
                t_ns: e.t_ns + repeat * SECOND_NS,
                ..*e
            }));
            apply(black_box(&mut batch));
            left += batch.len();
        }
        // The first one does not count.
        if repeat > 0 {
            times.push(started.elapsed().as_secs_f64() * 1e9 / events.len() as f64);
            kept += left;
        }
    }
    times.sort_by(f64::total_cmp);
    let all = events.len() as f64 * REPEATS as f64;
    (times[times.len() / 2], kept as f64 / all)
}

fn plan(sensor: Sensor, mask: bool, refractory_ns: Option<u64>, background_activity_ns: Option<u64>) -> Plan {
    let mut plan = test_plan();
    plan.sensor = sensor;
    plan.source.filters = Filters {
        refractory_ns,
        background_activity_ns,
    };
    // One pixel in 1000.
    let hot = (0..sensor.pixels()).step_by(1000);
    let pixel = |at: usize| Pixel {
        x: (at % sensor.width) as u16,
        y: (at / sensor.width) as u16,
    };
    plan.source.hot_pixels = mask.then(|| HotPixels {
        from: HotPixelsFrom::File("hot.txt".into()),
        masked_by: MaskedBy::Ingest,
        pixels: Some(hot.map(pixel).collect()),
    });
    plan
}

/// Groups of events in a row, each group anywhere (xorshift64, Marsaglia 2003); over one second.
fn events(sensor: Sensor, count: usize, group: usize) -> Vec<RawEvent> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    let (mut x, mut y) = (0, 0);
    (0..count)
        .map(|i| {
            if i % group == 0 {
                (x, y) = (random(sensor.width), random(sensor.height));
            } else {
                x = (x + 1) % sensor.width;
            }
            RawEvent {
                t_ns: i as u64 * SECOND_NS / count as u64,
                x: x as u16,
                y: y as u16,
                on: i % 2 == 0,
            }
        })
        .collect()
}
