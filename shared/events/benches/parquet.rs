//! Events per second of CPU time on one core, Parquet:
//! `EVPR_PYTHON=python cargo bench -p evpr-events --features parquet --bench parquet`. Where that interpreter has
//! `pyarrow`, it writes files in its usual way, and reads the same files in the same run, batch by batch.
//!
//! The events are random: times grow by 0 to 2 µs, places and polarities are uniform.

use evpr_events::writers::{WriteOptions, create};
use evpr_events::{BATCH_EVENTS, RawEvent, ReadOptions, open};
use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeValLike;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;

const EVENTS: u64 = 5_000_000;
const REPEATS: usize = 5;

const SCRIPT: &str = "
import pyarrow as pa, pyarrow.parquet as pq, time
pa.set_cpu_count(1)
def rate(name):
    t, n = time.process_time(), 0
    for batch in pq.ParquetFile(name).iter_batches(65536, use_threads=False):
        n += len([c.to_numpy(zero_copy_only=False) for c in batch.columns][0])
    return n / (time.process_time() - t)
def median(name):
    print(name, sorted(rate(name) for _ in range(5))[2], flush=True)
ours = pq.read_table('ours.parquet')
t = ours['t_ns'].to_numpy()
rest = [ours[c] for c in 'xyp']
pq.write_table(pa.table([t, *rest], list('txyp')), 'ns.parquet')
pq.write_table(pa.table([t // 1000 / 1e6, *rest], list('txyp')), 'seconds.parquet')
pq.write_table(pa.table([t // 1000, *rest], list('txyp')), 'zstd.parquet', compression='zstd')
for name in ['ours', 'ns', 'seconds', 'zstd']:
    median(name + '.parquet')
";

fn main() {
    let Ok(dir) = tempfile::tempdir() else { return };
    let ours = dir.path().join("ours.parquet");
    let written = rate(|| write(&ours));
    println!("written here: {:.1} M events/s of CPU time", written / 1e6);
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let output = Command::new(&python)
        .args(["-c", SCRIPT])
        .current_dir(dir.path())
        .output();
    let Some(output) = output.ok().filter(|o| o.status.success()) else {
        report(&ours, None);
        println!("skipped: {python} has no module pyarrow to compare with");
        return;
    };
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        if let Some((name, rate)) = line.split_once(' ') {
            report(&dir.path().join(name), rate.parse().ok());
        }
    }
}

fn report(path: &Path, reference: Option<f64>) {
    let mut rates: Vec<f64> = (0..REPEATS).map(|_| rate(|| read(path))).collect();
    rates.sort_by(f64::total_cmp);
    let rate = rates[REPEATS / 2];
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let bytes = path.metadata().map_or(0, |m| m.len());
    let size = bytes as f64 / EVENTS as f64;
    print!(
        "{name:>16}, {size:4.1} bytes per event: {:6.1} M events/s of CPU time",
        rate / 1e6
    );
    match reference {
        Some(reference) => println!(", pyarrow {:6.1}: {:.2} times", reference / 1e6, rate / reference),
        None => println!(),
    }
}

/// Events per second of CPU time.
fn rate(run: impl FnOnce() -> Option<u64>) -> f64 {
    let cpu = || {
        let usage = getrusage(UsageWho::RUSAGE_SELF).ok()?;
        Some((usage.user_time() + usage.system_time()).num_microseconds())
    };
    let before = cpu();
    let events = run().unwrap_or(0);
    let spent = cpu().zip(before).map_or(0, |(after, before)| after - before);
    events as f64 * 1e6 / spent.max(1) as f64
}

fn write(path: &Path) -> Option<u64> {
    let mut writer = create(path, &WriteOptions::default()).ok()?;
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut t_ns = 1_587_452_582_350_000_000;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        t_ns += (state >> 32) % 2001;
        RawEvent {
            t_ns,
            x: (state % 346) as u16,
            y: ((state >> 16) % 260) as u16,
            on: state >> 60 & 1 == 1,
        }
    };
    for _ in 0..EVENTS / 50_000 {
        let events: Vec<_> = (0..50_000).map(|_| next()).collect();
        writer.write(&events).ok()?;
    }
    writer.finish().ok()?;
    Some(EVENTS)
}

fn read(path: &Path) -> Option<u64> {
    let mut recording = open(path, &ReadOptions::default()).ok()?;
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    let mut count = 0;
    while recording.next_batch(&mut batch).ok()? {
        count += black_box(&batch).len() as u64;
    }
    Some(count)
}
