//! Events per second of CPU time on one core, AEDAT4 with every compression:
//! `EVPR_PYTHON=python cargo bench -p evpr-events --bench aedat4`. Where that interpreter has `dv_processing`, it writes
//! the files and reads them in the same run; else only what is written here is read.
//!
//! The events are those of a moving edge with noise: times grow by 0 or 1 µs.

use evpr_core::plan::Sensor;
use evpr_events::writers::{WriteOptions, create};
use evpr_events::{BATCH_EVENTS, RawEvent, ReadOptions, open};
use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeValLike;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;

const EVENTS: usize = 4_000_000;
const REPEATS: usize = 7;

/// Reads a.aedat4 and writes it again with every compression; says how many events per CPU second it reads of each.
const SCRIPT: &str = "
import dv_processing as dv, sys, time
def read(name):
    r, n, store = dv.io.MonoCameraRecording(name), 0, dv.EventStore()
    t = time.process_time()
    while (s := r.getNextEventBatch()) is not None:
        n += s.size()
        store.add(s)
    return n / (time.process_time() - t), store
def median(name):
    return sorted(read(name)[0] for _ in range(5))[2]
_, events = read('a.aedat4')
for name in ['NONE', 'LZ4', 'LZ4_HIGH', 'ZSTD', 'ZSTD_HIGH']:
    c = dv.io.MonoCameraWriter.EventOnlyConfig('C', (1280, 720), getattr(dv.CompressionType, name))
    w = dv.io.MonoCameraWriter(name + '.aedat4', c)
    w.writeEvents(events)
    del w
    print(name, median(name + '.aedat4'), flush=True)
";

fn main() {
    let Ok(dir) = tempfile::tempdir() else { return };
    let path = dir.path().join("a.aedat4");
    let written = write(&path);
    println!(
        "written here, LZ4: {:.1} M events/s of CPU time written",
        written / 1e6
    );
    report("written here, LZ4", &path, None);
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let output = Command::new(&python)
        .args(["-c", SCRIPT])
        .current_dir(dir.path())
        .output();
    let Some(output) = output.ok().filter(|o| o.status.success()) else {
        println!("skipped: {python} has no module dv_processing to compare with");
        return;
    };
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let Some((name, rate)) = line.split_once(' ') else {
            continue;
        };
        let path = dir.path().join(format!("{name}.aedat4"));
        report(name, &path, rate.parse().ok());
    }
}

fn report(name: &str, path: &Path, reference: Option<f64>) {
    let mut rates: Vec<f64> = (0..REPEATS).map(|_| rate(|| read(path))).collect();
    rates.sort_by(f64::total_cmp);
    let rate = rates[REPEATS / 2];
    print!("{name:>18}: {:6.1} M events/s of CPU time", rate / 1e6);
    match reference {
        Some(reference) => println!(
            ", dv-processing {:6.1}: {:.2} times",
            reference / 1e6,
            rate / reference
        ),
        None => println!(),
    }
}

/// Events per second of this thread's CPU time.
fn rate(work: impl FnOnce() -> usize) -> f64 {
    let cpu_us = || {
        let usage = getrusage(UsageWho::RUSAGE_THREAD);
        usage.map_or(0, |u| (u.user_time() + u.system_time()).num_microseconds())
    };
    let start = cpu_us();
    let count = work();
    count as f64 * 1e6 / (cpu_us() - start).max(1) as f64
}

fn read(path: &Path) -> usize {
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    let mut count = 0;
    let Ok(mut recording) = open(path, &ReadOptions::default()) else {
        return 0;
    };
    while recording.next_batch(&mut batch).unwrap_or(false) {
        count += black_box(&batch).len();
    }
    count
}

fn write(path: &Path) -> f64 {
    let mut state = 1_u64;
    let mut random = |most: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) % most
    };
    let mut t_us = 1_700_000_000_000_000;
    let events: Vec<RawEvent> = (0..EVENTS)
        .map(|_| {
            t_us += random(2);
            let edge = t_us / 500 % 1280;
            let x = if random(4) == 0 {
                random(1280)
            } else {
                (edge + random(12)) % 1280
            };
            RawEvent {
                t_ns: t_us * 1000,
                x: x as u16,
                y: random(720) as u16,
                on: random(3) > 0,
            }
        })
        .collect();
    let options = WriteOptions {
        sensor: Some(Sensor {
            height: 720,
            width: 1280,
        }),
    };
    rate(|| {
        let written = create(path, &options).and_then(|mut writer| {
            writer.write(&events)?;
            writer.finish()
        });
        written.map_or(0, |()| events.len())
    })
}
