//! AEDAT4: a real recording, files of the reference library, and what is written here read back.
#![allow(clippy::unwrap_used)] // helpers of tests are not seen as tests

use evpr_core::plan::Sensor;
use evpr_events::writers::{WriteError, WriteOptions, create};
use evpr_events::{Input, RawEvent, ReadOptions, Recording, Skipped, SourceError, formats, open};
use proptest::prelude::*;
use sha2::{Digest, Sha256};
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::process::Command;

const DAVIS: Sensor = Sensor {
    height: 260,
    width: 346,
};

fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/events")
        .join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there", path.display());
    None
}

/// The interpreter, where it has `dv_processing`.
fn dv_processing() -> Option<String> {
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = Command::new(&python)
        .args(["-c", "import dv_processing"])
        .output()
        .is_ok_and(|o| o.status.success());
    if !has {
        println!("skipped: {python} has no module dv_processing");
    }
    has.then_some(python)
}

fn run_python(python: &str, script: &str, dir: &Path) -> String {
    let output = Command::new(python)
        .args(["-c", script])
        .current_dir(dir)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// All events, or those before the error with it.
fn drain(recording: Result<Box<dyn Recording>, SourceError>) -> (Vec<RawEvent>, Option<String>) {
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    let mut recording = match recording {
        Ok(recording) => recording,
        Err(e) => return (all, Some(e.to_string())),
    };
    loop {
        let outcome = recording.next_batch(&mut batch);
        all.append(&mut batch);
        match outcome {
            Ok(true) => {}
            Ok(false) => {
                assert_eq!(recording.progress_permille(), 1000);
                return (all, None);
            }
            Err(e) => {
                let e = e.to_string();
                assert!(!e.contains('\n'), "{e}");
                return (all, Some(e));
            }
        }
    }
}

fn drain_bytes(bytes: &[u8]) -> (Vec<RawEvent>, Option<String>) {
    let input = Input::new("bytes.aedat4", Cursor::new(bytes.to_vec()));
    drain(evpr_events::open_input(input, &ReadOptions::default()))
}

/// Of the columns one after the other: all times (µs), all x, all y, all polarities.
fn sha256(events: &[RawEvent]) -> String {
    let mut hash = Sha256::new();
    events
        .iter()
        .for_each(|e| hash.update((e.t_ns / 1000).to_le_bytes()));
    events.iter().for_each(|e| hash.update(e.x.to_le_bytes()));
    events.iter().for_each(|e| hash.update(e.y.to_le_bytes()));
    events.iter().for_each(|e| hash.update([u8::from(e.on)]));
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

fn write(path: &Path, events: &[RawEvent]) {
    let options = WriteOptions { sensor: Some(DAVIS) };
    let mut writer = create(path, &options).unwrap();
    events.chunks(1000).for_each(|c| writer.write(c).unwrap());
    writer.finish().unwrap();
}

/// Events of whole µs on the sensor.
fn some_events(count: u64) -> Vec<RawEvent> {
    let event = |i: u64| RawEvent {
        t_ns: 1_700_000_000_000_000_000 + i / 3 * 7_000,
        x: (i * 31 % 346) as u16,
        y: (i * 17 % 260) as u16,
        on: i % 5 < 2,
    };
    (0..count).map(event).collect()
}

#[test]
fn the_real_recording_is_read_exactly() {
    let (Some(path), Some(golden)) = (shared("davis346_lab.aedat4"), shared("golden.json")) else {
        return;
    };
    let golden: serde_json::Value = serde_json::from_slice(&std::fs::read(golden).unwrap()).unwrap();
    let golden = &golden["davis346_lab.aedat4"];
    let mut recording = open(&path, &ReadOptions::default()).unwrap();
    assert_eq!(recording.sensor(), Some(DAVIS));
    assert_eq!(recording.describe().format, "AEDAT4");
    let (mut events, mut batch) = (Vec::new(), Vec::new());
    while recording.next_batch(&mut batch).unwrap() {
        events.append(&mut batch);
    }
    let us = |e: Option<&RawEvent>| e.unwrap().t_ns / 1000;
    assert_eq!(events.len() as u64, golden["n"].as_u64().unwrap());
    assert_eq!(
        events.iter().filter(|e| e.on).count() as u64,
        golden["on"].as_u64().unwrap()
    );
    assert_eq!(us(events.first()), golden["t_first"].as_u64().unwrap());
    assert_eq!(us(events.last()), golden["t_last"].as_u64().unwrap());
    assert_eq!(
        events.iter().map(|e| u64::from(e.x)).max(),
        golden["x_max"].as_u64()
    );
    assert_eq!(
        events.iter().map(|e| u64::from(e.y)).max(),
        golden["y_max"].as_u64()
    );
    assert_eq!(sha256(&events), golden["sha256"].as_str().unwrap());
    let skipped = |what: &str, count| Skipped {
        what: what.to_owned(),
        count,
    };
    let all = recording.skipped();
    assert_eq!(all[0], skipped("frames (stream 1)", 3));
    assert_eq!(all[1], skipped("IMU samples (stream 2)", 130));
    assert_eq!(all.len(), 3);
    assert_eq!(all[2].what, "triggers (stream 3)");
}

#[test]
fn a_cut_recording_gives_its_whole_packets_and_one_clear_line() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.aedat4");
    let events = some_events(40_000);
    write(&path, &events);
    let bytes = std::fs::read(&path).unwrap();
    let (all, error) = drain_bytes(&bytes);
    assert_eq!((all, error), (events.clone(), None));
    // In the second packet.
    let (some, error) = drain_bytes(&bytes[..bytes.len() * 2 / 3]);
    assert_eq!(some, events[..16_384]);
    let error = error.unwrap();
    assert!(
        error.contains("the packet at byte") && error.contains("is cut off"),
        "{error}"
    );
}

#[test]
fn every_truncation_gives_a_beginning_and_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.aedat4");
    let events = some_events(300);
    write(&path, &events);
    let bytes = std::fs::read(&path).unwrap();
    let table_at = u64::from_le_bytes(bytes[54..62].try_into().unwrap()) as usize;
    for len in 0..bytes.len() {
        let (some, error) = drain_bytes(&bytes[..len]);
        assert!(events.starts_with(&some));
        assert_eq!(error.is_none(), len >= table_at, "{len}: {error:?}");
    }
}

#[test]
fn what_does_not_fit_the_format_is_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.aedat4");
    let no_sensor = create(&path, &WriteOptions::default()).err();
    assert!(matches!(no_sensor, Some(WriteError::NoSensor { .. })));
    let mut writer = create(&path, &WriteOptions { sensor: Some(DAVIS) }).unwrap();
    let mut events = some_events(3);
    events[2].x = 40_000;
    let error = writer.write(&events).unwrap_err().to_string();
    assert!(error.contains("event 2 (from 0) lies at x 40000"), "{error}");
    drop(writer);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

/// Gives some bytes, then fails the test if asked for more before it is allowed.
struct Live {
    bytes: Cursor<Vec<u8>>,
    until: std::sync::Arc<std::sync::atomic::AtomicU64>,
}

impl Read for Live {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let until = self.until.load(std::sync::atomic::Ordering::Relaxed);
        let left = until - self.bytes.position();
        assert!(
            left > 0 || until == self.bytes.get_ref().len() as u64,
            "it would wait"
        );
        let n = out.len().min(left as usize);
        self.bytes.read(&mut out[..n])
    }
}

#[test]
fn a_network_stream_gives_events_as_they_arrive() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.aedat4");
    let events = some_events(40_000);
    write(&path, &events);
    let bytes = std::fs::read(&path).unwrap();
    let table_at = u64::from_le_bytes(bytes[54..62].try_into().unwrap()) as usize;
    let bytes = bytes[14..table_at].to_vec();
    let header = 4 + u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
    let body = u32::from_le_bytes(bytes[header + 4..header + 8].try_into().unwrap()) as usize;
    let first_end = header + 8 + body;
    let len = bytes.len() as u64;
    // All of the first packet and most of the second are there: exactly the first one is given.
    let until = std::sync::Arc::new(std::sync::atomic::AtomicU64::new(first_end as u64 + 1000));
    let live = Live {
        bytes: Cursor::new(bytes),
        until: until.clone(),
    };
    let input = Input::new("tcp", live);
    let mut recording = formats::aedat4_network(input, &ReadOptions::default()).unwrap();
    let mut batch = Vec::new();
    assert!(recording.next_batch(&mut batch).unwrap());
    assert_eq!(batch, events[..16_384]);
    until.store(len, std::sync::atomic::Ordering::Relaxed);
    let (rest, error) = drain(Ok(recording));
    assert_eq!((&rest[..], error), (&events[16_384..], None));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_is_written_is_read_back(
        steps in prop::collection::vec((0_u64..50_000, 0_u16..346, 0_u16..260, any::<bool>()), 0..40_000),
    ) {
        let mut t_us = 0;
        let events: Vec<_> = steps.into_iter().map(|(step, x, y, on)| {
            t_us += step / 1000;
            RawEvent { t_ns: t_us * 1000, x, y, on }
        }).collect();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.aedat4");
        write(&path, &events);
        let recording = open(&path, &ReadOptions::default()).unwrap();
        prop_assert_eq!(recording.sensor(), Some(DAVIS));
        prop_assert_eq!(drain(Ok(recording)), (events, None));
    }
}

#[test]
fn mutated_files_are_read_or_refused_but_never_crash() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.aedat4");
    write(&path, &some_events(200));
    let bytes = std::fs::read(&path).unwrap();
    for at in 0..bytes.len() {
        for bit in [0, 3, 7] {
            let mut mutated = bytes.clone();
            mutated[at] ^= 1 << bit;
            let (events, error) = drain_bytes(&mutated);
            assert!(events.len() <= 200, "{at}: {} {error:?}", events.len());
        }
    }
}

/// A recording of these packets {stream, size as claimed, body}, with a header of this compression.
fn packets(compression: i32, packets: &[(i32, i32, &[u8])]) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.aedat4");
    write(&path, &[]);
    let mut bytes = std::fs::read(&path).unwrap();
    let table_at = u64::from_le_bytes(bytes[54..62].try_into().unwrap()) as usize;
    bytes.truncate(table_at);
    bytes[46..50].copy_from_slice(&compression.to_le_bytes());
    bytes[54..62].copy_from_slice(&(-1_i64).to_le_bytes());
    for (stream, size, body) in packets {
        bytes.extend(stream.to_le_bytes());
        bytes.extend(size.to_le_bytes());
        bytes.extend_from_slice(body);
    }
    bytes
}

/// A packet of events as it is before it is compressed.
fn body(events: &[(i64, i16, i16, u8)]) -> Vec<u8> {
    let mut bytes = [16_u32.to_le_bytes(), *b"EVTS"].concat();
    bytes.extend([0, 0, 6, 0, 8, 0, 4, 0, 6, 0, 0, 0, 4, 0, 0, 0]);
    bytes.extend((events.len() as u32).to_le_bytes());
    for (t, x, y, on) in events {
        bytes.extend(t.to_le_bytes());
        bytes.extend(x.to_le_bytes());
        bytes.extend(y.to_le_bytes());
        bytes.extend([*on, 0, 0, 0]);
    }
    [(bytes.len() as u32).to_le_bytes().to_vec(), bytes].concat()
}

#[test]
fn odd_packets_are_read_and_bad_ones_named() {
    let good = body(&[(5, 1, 2, 1), (6, -1, i16::MIN, 0)]);
    let len = good.len() as i32;
    let first = |on| RawEvent {
        t_ns: 5000,
        x: 1,
        y: 2,
        on,
    };
    // Of no bytes, of a stream that nobody named, and of pixels that cannot be.
    let bytes = packets(0, &[(0, 0, &[]), (7, 3, b"abc"), (0, len, &good)]);
    let (events, error) = drain_bytes(&bytes);
    let outside = RawEvent {
        t_ns: 6000,
        x: u16::MAX,
        y: u16::MAX,
        on: false,
    };
    assert_eq!((events, error), (vec![first(true), outside], None));
    let input = Input::new("b", Cursor::new(bytes));
    let mut recording = evpr_events::open_input(input, &ReadOptions::default()).unwrap();
    while recording.next_batch(&mut Vec::new()).unwrap() {}
    assert_eq!(
        recording.skipped()[0].what,
        "packets of streams that the header does not name"
    );
    // Times that cannot be: what stands before them is given.
    for (t, wanted) in [
        (-3, "has the time -3 µs, which is negative"),
        (i64::MAX, "beyond the year 2262"),
    ] {
        let bad = body(&[(5, 1, 2, 7), (t, 0, 0, 0), (8, 0, 0, 0)]);
        let (events, error) = drain_bytes(&packets(0, &[(0, bad.len() as i32, &bad)]));
        let error = error.unwrap();
        assert_eq!(events, [first(true)]);
        assert!(
            error.contains("event 1 (from 0)") && error.contains(wanted),
            "{error}"
        );
    }
    let mut offset = good.clone();
    offset[24..28].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut count = good.clone();
    count[28..32].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut kind = good.clone();
    kind[8] = b'X';
    for (packet, wanted) in [
        ((0, len, &offset[..]), "offsets that point outside"),
        ((0, len, &count), "offsets that point outside"),
        ((0, len, &kind), "holds something else"),
        ((0, -1, &good), "the negative size -1"),
        ((0, i32::MAX, &good), "more than 64 MiB"),
        ((0, 60 << 20, &good), "is cut off"),
        ((7, i32::MAX, &good), "is cut off"),
    ] {
        let (events, error) = drain_bytes(&packets(0, &[(0, len, &good), packet]));
        let error = error.unwrap();
        assert_eq!(events.len(), 2);
        assert!(error.contains(wanted), "{error}");
    }
    let (_, error) = drain_bytes(&packets(9, &[]));
    assert!(error.unwrap().contains("unknown compression 9"));
}

#[test]
fn a_small_packet_that_grows_without_end_is_refused() {
    let mut lz4 = lz4_flex::frame::FrameEncoder::new(Vec::new());
    std::io::copy(&mut std::io::repeat(0).take(65 << 20), &mut lz4).unwrap();
    let lz4 = lz4.finish().unwrap();
    // Frames that say their size, 65 MiB, and that do not: blocks of one repeated byte each.
    let block = [2, 0, 0x10, 0];
    let mut said = vec![0x28, 0xb5, 0x2f, 0xfd, 0xa0];
    said.extend((65_u32 << 20).to_le_bytes());
    let mut unsaid = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 0x38];
    for frame in [&mut said, &mut unsaid] {
        (0..65 * 8).for_each(|_| frame.extend_from_slice(&block));
        frame.extend([1, 0, 0]);
    }
    for (compression, frame, wanted) in [
        (1, &lz4, "more than 64 MiB"),
        (3, &said, "more than 64 MiB"),
        (3, &unsaid, "too small"),
        (1, &said, "is no LZ4 frame"),
        (4, &lz4, "is no ZSTD frame"),
    ] {
        let (events, error) = drain_bytes(&packets(compression, &[(0, frame.len() as i32, frame)]));
        let error = error.unwrap();
        assert!(events.is_empty() && error.contains(wanted), "{error}");
    }
}

/// Files of every compression, written by the reference library.
#[test]
fn files_of_dv_processing_are_read_exactly() {
    let Some(python) = dv_processing() else { return };
    let dir = tempfile::tempdir().unwrap();
    let script = "
import dv_processing as dv, random
r = random.Random(7)
s, t, rows = dv.EventStore(), 1_700_000_000_000_000, []
for i in range(25_000):
    t += r.randrange(0, 3)
    e = (t, r.randrange(346), r.randrange(260), r.randrange(2))
    rows.append(e)
    s.push_back(e[0], e[1], e[2], bool(e[3]))
for name in ['NONE', 'LZ4', 'LZ4_HIGH', 'ZSTD', 'ZSTD_HIGH']:
    config = dv.io.MonoCameraWriter.EventOnlyConfig('CAM', (346, 260), getattr(dv.CompressionType, name))
    w = dv.io.MonoCameraWriter(name + '.aedat4', config)
    w.writeEvents(s)
    del w
print('\\n'.join(' '.join(map(str, e)) for e in rows))
";
    let rows = run_python(&python, script, dir.path());
    let parse = |row: &str| {
        let n: Vec<u64> = row.split(' ').map(|w| w.parse().unwrap()).collect();
        RawEvent {
            t_ns: n[0] * 1000,
            x: n[1] as u16,
            y: n[2] as u16,
            on: n[3] == 1,
        }
    };
    let want: Vec<_> = rows.lines().map(parse).collect();
    for name in ["NONE", "LZ4", "LZ4_HIGH", "ZSTD", "ZSTD_HIGH"] {
        let path = dir.path().join(format!("{name}.aedat4"));
        let recording = open(&path, &ReadOptions::default()).unwrap();
        assert_eq!(recording.sensor(), Some(DAVIS), "{name}");
        assert!(drain(Ok(recording)) == (want.clone(), None), "{name}");
    }
}

/// The reference library reads what is written here: the events, the size, and by time through the table at the end.
#[test]
fn dv_processing_reads_what_is_written() {
    let Some(python) = dv_processing() else { return };
    let dir = tempfile::tempdir().unwrap();
    let events = some_events(40_000);
    write(&dir.path().join("a.aedat4"), &events);
    let script = "
import dv_processing as dv, hashlib, numpy
r = dv.io.MonoCameraRecording('a.aedat4')
print(r.getEventResolution(), r.getTimeRange())
parts = []
while (s := r.getNextEventBatch()) is not None:
    parts.append(s.numpy())
e = numpy.concatenate(parts)
h = hashlib.sha256()
for column in ['timestamp', 'x', 'y', 'polarity']:
    h.update(e[column].tobytes())
print(len(e), h.hexdigest())
t0, t1 = r.getTimeRange()
print(r.getEventsTimeRange(t0 + 50_000, t0 + 60_000).size())
";
    let said = run_python(&python, script, dir.path());
    let (first, last) = (events[0].t_ns / 1000, events[39_999].t_ns / 1000);
    let inside = events
        .iter()
        .filter(|e| (first + 50_000..first + 60_000).contains(&(e.t_ns / 1000)))
        .count();
    let want = format!(
        "(346, 260) ({first}, {last})\n40000 {}\n{inside}\n",
        sha256(&events)
    );
    assert_eq!(said, want);
}
