//! Events per second of CPU time on one core, HDF5 as data sets have it:
//! `EVPR_PYTHON=python cargo bench -p evpr-events --bench hdf5`. Where that interpreter has `h5py` and `hdf5plugin`, it
//! writes the files and reads them in the same run, a million events at a time: as columns, and made into what is read
//! here, events with their times in ns. Else there is nothing to read.
//!
//! The events are random: times grow by 0 to 2 µs, places and polarities are uniform.

use evpr_events::{BATCH_EVENTS, ReadOptions, open};
use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeValLike;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;

const REPEATS: usize = 7;

const SCRIPT: &str = "
import h5py, hdf5plugin, numpy as np, time
n, block = 8_000_000, 1 << 20
r = np.random.default_rng(1)
t = 1_658_700_000_000_000 + np.cumsum(r.integers(0, 3, n))
x, y, p = r.integers(0, 640, n), r.integers(0, 480, n), r.integers(0, 2, n)
def make(name, columns, **how):
    with h5py.File(name, 'w') as f:
        events = f.create_group('events')
        for column, values in columns.items():
            events.create_dataset(column, data=values, **how)
        if 't' in columns:
            f['t_offset'] = t[0]
            f['ms_to_idx'] = np.searchsorted(t - t[0], np.arange(0, t[-1] - t[0], 1000)).astype('u8')
names = ['timestamps t ts', 'x_coordinates x xs', 'y_coordinates y ys', 'polarities p ps']
event = np.dtype([('t', 'u8'), ('x', 'u2'), ('y', 'u2'), ('on', '?')], align=True)
def read(name, as_events):
    start, count = time.process_time(), 0
    with h5py.File(name, 'r') as f:
        columns = [next(f['events'][n] for n in some.split() if n in f['events']) for some in names]
        offset = f['t_offset'][()] if 't_offset' in f else 0
        for at in range(0, len(columns[0]), block):
            t, x, y, p = [c[at : at + block] for c in columns]
            if as_events:
                events = np.empty(len(t), event)
                if t.dtype == np.float64:
                    t = np.rint(t * 1e6).astype('u8') * np.uint64(1000)
                elif t.dtype == np.uint32:
                    t = (t + np.uint64(offset)) * np.uint64(1000)
                events['t'], events['x'], events['y'], events['on'] = t, x, y, p
            count += len(t)
    return count / (time.process_time() - start)
def median(name, as_events):
    return sorted(read(name, as_events) for _ in range(5))[2]
nsavp = dict(timestamps=(t * 1000).astype('u8'), x_coordinates=x.astype('u2'), y_coordinates=y.astype('u2'), polarities=p.astype('u1'))
dsec = dict(t=(t - t[0]).astype('u4'), x=x.astype('u2'), y=y.astype('u2'), p=p.astype('u1'))
e2vid = dict(ts=t / 1e6, xs=x.astype('i2'), ys=y.astype('i2'), ps=p.astype(bool))
zstd = dict(chunks=(1 << 15,), **hdf5plugin.Blosc(cname='zstd', clevel=1, shuffle=hdf5plugin.Blosc.SHUFFLE))
make('nsavp_blosc_zstd.h5', nsavp, **zstd)
make('nsavp_gzip.h5', nsavp, chunks=(1 << 15,), compression='gzip', shuffle=True)
make('dsec_blosc_zstd.h5', dsec, **zstd)
make('e2vid_plain.h5', e2vid)
make('e2vid_chunks.h5', e2vid, chunks=(1 << 15,))
for name in ['nsavp_blosc_zstd', 'nsavp_gzip', 'dsec_blosc_zstd', 'e2vid_plain', 'e2vid_chunks']:
    print(name, median(name + '.h5', False), median(name + '.h5', True), flush=True)
";

fn main() {
    let Ok(dir) = tempfile::tempdir() else { return };
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let output = Command::new(&python)
        .args(["-c", SCRIPT])
        .current_dir(dir.path())
        .output();
    let Some(output) = output.ok().filter(|o| o.status.success()) else {
        println!("skipped: {python} has no modules h5py and hdf5plugin, which write the files");
        return;
    };
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let fields: Vec<&str> = line.split(' ').collect();
        if let [name, columns, events] = fields[..] {
            let path = dir.path().join(name).with_extension("h5");
            report(&path, [columns, events].map(|rate| rate.parse().unwrap_or(0.0)));
        }
    }
}

fn report(path: &Path, [columns, events]: [f64; 2]) {
    let mut rates: Vec<f64> = (0..REPEATS).filter_map(|_| rate(path)).collect();
    rates.sort_by(f64::total_cmp);
    let rate = rates.get(REPEATS / 2).copied().unwrap_or(0.0);
    println!(
        "{:>16}: {:5.1} M events/s of CPU time; {:.2} times the time of h5py's columns ({:.1}), {:.2} of its events ({:.1})",
        path.file_stem().unwrap_or_default().to_string_lossy(),
        rate / 1e6,
        columns / rate,
        columns / 1e6,
        events / rate,
        events / 1e6
    );
}

/// Events per second of this thread's CPU time.
fn rate(path: &Path) -> Option<f64> {
    let cpu_us = || {
        let usage = getrusage(UsageWho::RUSAGE_THREAD).ok()?;
        Some((usage.user_time() + usage.system_time()).num_microseconds())
    };
    let start = cpu_us()?;
    let mut recording = open(path, &ReadOptions::default()).ok()?;
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    let mut count = 0;
    while recording.next_batch(&mut batch).ok()? {
        count += black_box(&batch).len();
    }
    Some(count as f64 * 1e6 / (cpu_us()? - start).max(1) as f64)
}
