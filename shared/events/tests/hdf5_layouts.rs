//! The layouts of HDF5 beside NSAVP's, good and bad, and HDF5 that is written, through the public interface.
#![allow(clippy::unwrap_used)] // helpers of tests are not seen as tests

use evpr_core::plan::{Sensor, TimeUnit};
use evpr_events::writers::{self, WriteOptions};
use evpr_events::{RawEvent, ReadOptions, Recording, SourceError, open};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What `make_fixtures.py` adds to the times of DSEC's files, ns.
const T_OFFSET_NS: u64 = 1_600_000_000_000_000_000;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures")
        .join(name)
}

fn opened(name: &str) -> Box<dyn Recording> {
    open(&fixture(name), &ReadOptions::default()).unwrap()
}

/// All events, and the error behind them.
fn read(path: &Path) -> (Vec<RawEvent>, String) {
    let one_line = |e: SourceError| {
        let e = e.to_string();
        assert!(
            !e.contains('\n') && e.contains(&*path.file_name().unwrap().to_string_lossy()),
            "{e}"
        );
        e
    };
    let mut recording = match open(path, &ReadOptions::default()) {
        Ok(recording) => recording,
        Err(e) => return (Vec::new(), one_line(e)),
    };
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    loop {
        let outcome = recording.next_batch(&mut batch);
        all.append(&mut batch);
        match outcome {
            Ok(true) => {}
            Ok(false) => return (all, String::new()),
            Err(e) => return (all, one_line(e)),
        }
    }
}

/// Event `i` of the fixtures, whose times are cut to µs.
fn expected(i: u64, offset_ns: u64) -> RawEvent {
    RawEvent {
        t_ns: offset_ns + 1_000_000_000 + 1_000_000 * i + i % 7 / 1000 * 1000,
        x: (7 * i % 32) as u16,
        y: (3 * i % 24) as u16,
        on: i % 2 == 1,
    }
}

fn all(offset_ns: u64) -> Vec<RawEvent> {
    (0..300).map(|i| expected(i, offset_ns)).collect()
}

#[test]
fn every_layout_and_filter_is_read_exactly() {
    let sensor = Some(Sensor {
        height: 24,
        width: 32,
    });
    for (name, offset_ns, sensor, format, unit) in [
        ("dsec_blosc_zstd.h5", T_OFFSET_NS, None, "DSEC", ("us", "format")),
        ("dsec_blosc_bits.h5", T_OFFSET_NS, None, "DSEC", ("us", "format")),
        ("dsec_blosc_zlib.h5", T_OFFSET_NS, None, "DSEC", ("us", "format")),
        ("dsec_zstd.h5", T_OFFSET_NS, None, "DSEC", ("us", "format")),
        ("dsec_lz4.h5", T_OFFSET_NS, None, "DSEC", ("us", "format")),
        ("dsec_lzf.h5", T_OFFSET_NS, None, "DSEC", ("us", "format")),
        ("open_unit.h5", T_OFFSET_NS, None, "DSEC", ("us", "magnitude")),
        ("e2vid.h5", 0, sensor, "E2VID", ("s", "floating point")),
        ("e2vid_contiguous.h5", 0, sensor, "E2VID", ("s", "floating point")),
        ("e2vid_floats.h5", 0, sensor, "E2VID", ("s", "floating point")),
        ("prophesee.h5", 0, sensor, "Prophesee", ("us", "format")),
        ("prophesee_odd.h5", 0, sensor, "Prophesee", ("us", "format")),
    ] {
        let (events, error) = read(&fixture(name));
        assert_eq!(error, "", "{name}");
        assert!(events == all(offset_ns), "{name}: {:?}", events.first());
        let recording = opened(name);
        assert_eq!(recording.sensor(), sensor, "{name}");
        let about = recording.describe();
        assert!(about.format.contains(format), "{name}: {}", about.format);
        assert_eq!((about.time_unit, about.time_unit_from), unit, "{name}");
        assert_eq!(about.events, Some(300), "{name}");
    }
    let skipped = opened("prophesee.h5").skipped();
    assert_eq!(
        (skipped[0].what.as_str(), skipped[0].count),
        ("external triggers", 5)
    );
}

#[test]
fn a_file_may_stand_behind_something_else() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["e2vid_contiguous.h5", "e2vid.h5", "prophesee_odd.h5"] {
        let path = folder.path().join(name);
        let mut bytes = vec![0; 512];
        bytes.extend(std::fs::read(fixture(name)).unwrap());
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read(&path), (all(0), String::new()), "{name}");
    }
}

#[test]
fn the_unit_can_be_configured_where_it_is_open() {
    let options = ReadOptions {
        time_unit: TimeUnit::Ns,
        ..ReadOptions::default()
    };
    let first = |name| {
        let mut recording = open(&fixture(name), &options).unwrap();
        let mut batch = Vec::new();
        recording.next_batch(&mut batch).unwrap();
        (batch[0].t_ns, recording.describe().time_unit_from)
    };
    assert_eq!(first("open_unit.h5"), (1_600_000_001_000_000, "config"));
    assert_eq!(first("dsec_zstd.h5"), (1_600_000_001_000_000_000, "format"));
}

#[test]
fn bad_layouts_are_named_in_one_line() {
    for (name, whole, wanted) in [
        (
            "dsec_blosclz.h5",
            0,
            "its codec BloscLZ is not read; rewrite the file",
        ),
        (
            "dsec_bitshuffle.h5",
            0,
            "/events/t is compressed by filter 32008 (",
        ),
        (
            "prophesee_ecf.h5",
            0,
            "/CD/events is compressed by Prophesee's ECF filter (36559)",
        ),
        (
            "prophesee_bad_geometry.h5",
            0,
            "attribute geometry of / is \"32 by 24\"",
        ),
        (
            "prophesee_bad_polarity.h5",
            200,
            "event 200 (from 0) has polarity 7",
        ),
        (
            "prophesee_negative_time.h5",
            200,
            "event 200 (from 0) has time -7",
        ),
        (
            "e2vid_negative_x.h5",
            200,
            "event 200 (from 0) has x -3; it must be a whole number from 0",
        ),
        ("e2vid_nan_time.h5", 100, "event 100 (from 0) has time NaN"),
        (
            "huge_chunks.h5",
            0,
            "/events/t has chunks of more than 8388608 events",
        ),
        ("other_columns.h5", 0, "in /events (found: a, b)"),
        (
            "no_events_group.h5",
            0,
            "has no group /events and no /CD/events (found: frames/)",
        ),
    ] {
        let (events, error) = read(&fixture(name));
        assert!(error.contains(wanted), "{name}: {error}");
        assert_eq!(events.len(), whole, "{name}");
    }
}

#[test]
fn layouts_seek_without_skipping_events() {
    for (name, offset_ns) in [
        ("dsec_blosc_zstd.h5", T_OFFSET_NS),
        ("dsec_wrong_index.h5", 0),
        ("prophesee.h5", 0),
        ("e2vid.h5", 0),
    ] {
        let mut recording = opened(name);
        let mut batch = Vec::new();
        for wanted in [299, 0, 1, 150] {
            let t_ns = expected(wanted, offset_ns).t_ns;
            let index = recording.seek_before(t_ns).unwrap().unwrap();
            assert!(index <= wanted, "{name}");
            assert!(recording.next_batch(&mut batch).unwrap());
            assert_eq!(batch[0], expected(index, offset_ns), "{name}");
        }
        assert!(recording.seek_before(0).unwrap() == Some(0));
        assert!(recording.seek_before(u64::MAX).unwrap().unwrap() <= 300);
    }
    // The index of DSEC is to the event, where blocks alone are not.
    let mut recording = opened("dsec_zstd.h5");
    assert_eq!(
        recording.seek_before(expected(150, T_OFFSET_NS).t_ns).unwrap(),
        Some(150)
    );
}

#[test]
fn truncated_and_damaged_files_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("damaged.h5");
    for name in [
        "dsec_blosc_zstd.h5",
        "dsec_blosc_bits.h5",
        "dsec_lzf.h5",
        "prophesee.h5",
        "e2vid.h5",
    ] {
        let whole = fs::read(fixture(name)).unwrap();
        for at in (0..whole.len()).step_by(83) {
            let mut damaged = whole.clone();
            damaged[at] = !damaged[at];
            fs::write(&path, &damaged).unwrap();
            assert!(read(&path).0.len() <= 300, "{name}: {at}");
        }
        for len in (0..whole.len()).step_by(331) {
            fs::write(&path, &whole[..len]).unwrap();
            let (events, error) = read(&path);
            assert!(!error.is_empty() || events.len() == 300, "{name}: {len}");
        }
    }
}

/// Event `i` of a file that is written here.
fn made(i: u64) -> RawEvent {
    RawEvent {
        t_ns: 1_600_000_000_000_000_000 + 1_000 * i + i % 7,
        x: (i % 346) as u16,
        y: (7 * i % 260) as u16,
        on: i / 3 % 2 == 1,
    }
}

/// Writes so many events, in batches that do not fit the chunks.
fn write(path: &Path, count: u64, sensor: Option<Sensor>) {
    let mut writer = writers::create(path, &WriteOptions { sensor }).unwrap();
    let events: Vec<_> = (0..count).map(made).collect();
    for batch in events.chunks(50_001) {
        writer.write(batch).unwrap();
    }
    writer.finish().unwrap();
}

/// Full and part chunks, and more of them than one node of an index holds.
const COUNTS: [u64; 5] = [1, 32_768, 32_769, 100_000, 65 * 32_768 + 5];
const WRITTEN: Sensor = Sensor {
    height: 260,
    width: 346,
};

#[test]
fn what_is_written_is_read_back() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("written.h5");
    for count in COUNTS {
        let sensor = (count != 1).then_some(WRITTEN);
        write(&path, count, sensor);
        let (events, error) = read(&path);
        assert_eq!((events.len() as u64, error.as_str()), (count, ""));
        assert!((0..count).zip(&events).all(|(i, e)| made(i) == *e), "{count}");
        assert_eq!(open(&path, &ReadOptions::default()).unwrap().sensor(), sensor);
    }
    write(&path, 0, None);
    assert!(read(&path).1.contains("holds no events"));
}

#[test]
fn h5py_reads_what_is_written() {
    let name = "h5py_reads_what_is_written";
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let run = |script: &str, path: &Path| Command::new(&python).args(["-c", script]).arg(path).output();
    if !run("import h5py, numpy", Path::new("-")).is_ok_and(|o| o.status.success()) {
        println!("skipped: {name}: {python} has no h5py");
        return;
    }
    let script = "
import sys, h5py, numpy as np
f = h5py.File(sys.argv[1])
e = f['events']
i = np.arange(len(e['timestamps']), dtype='u8')
want = dict(timestamps=1_600_000_000_000_000_000 + 1000*i + i % 7, x_coordinates=(i % 346).astype('u2'),
            y_coordinates=(7*i % 260).astype('u2'), polarities=(i//3 % 2).astype('u1'))
assert set(e) == set(want), set(e)
for name, values in want.items():
    d = e[name]
    assert d.dtype == values.dtype and np.array_equal(d[:], values), name
    assert (d.chunks, d.compression, d.shuffle) == ((32768,), 'gzip', True), name
assert dict(e.attrs) == dict(height=260, width=346)
print(len(i))
";
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("written.h5");
    for count in COUNTS.into_iter().chain([0]) {
        write(&path, count, Some(WRITTEN));
        let output = run(script, &path).unwrap();
        let (said, error) = (
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr),
        );
        assert_eq!(said.trim(), count.to_string(), "{error}");
    }
}
