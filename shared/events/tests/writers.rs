//! Every writer, by the registry: what it wrote is read back as it was.

#![allow(clippy::unwrap_used)] // a broken fixture must fail the test

use evpr_core::plan::Sensor;
use evpr_events::writers::{self, WriteError, WriteOptions};
use evpr_events::{RawEvent, ReadOptions};
use std::path::Path;

const SENSOR: Sensor = Sensor {
    height: 260,
    width: 346,
};

/// Events in the order of time, with bursts at one time, long gaps and every corner of the sensor.
fn events(count: usize, resolution_ns: u64) -> Vec<RawEvent> {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut next = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut t = 1_000_000_123 / resolution_ns;
    let mut events = Vec::new();
    for i in 0..count {
        let r = next();
        t += match r % 16 {
            0..8 => 0,
            8..15 => r >> 8 & 0xff,
            _ => r >> 8 & 0xff_ffff,
        };
        let (x, y) = match i % 50 {
            0 => (0, 0),
            1 => (345, 259),
            _ => ((r >> 20) % 346, (r >> 40) % 260),
        };
        events.push(RawEvent {
            t_ns: t * resolution_ns,
            x: x as u16,
            y: y as u16,
            on: r >> 60 & 1 == 1,
        });
    }
    events
}

fn write(path: &Path, events: &[RawEvent], batch: usize) -> Result<(), WriteError> {
    let options = WriteOptions { sensor: Some(SENSOR) };
    let mut writer = writers::create(path, &options)?;
    for events in events.chunks(batch) {
        writer.write(events)?;
    }
    writer.finish()
}

fn read(path: &Path) -> Vec<RawEvent> {
    let mut recording = evpr_events::open(path, &ReadOptions::default()).unwrap();
    if let Some(sensor) = recording.sensor() {
        assert_eq!(sensor, SENSOR, "{}", path.display());
    }
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    while recording.next_batch(&mut batch).unwrap() {
        all.extend_from_slice(&batch);
    }
    all
}

#[test]
fn every_writer_keeps_every_event() {
    let dir = tempfile::tempdir().unwrap();
    for extension in writers::extensions() {
        let path = dir.path().join(format!("a.{extension}"));
        let resolution = writers::resolution_ns(&path).unwrap();
        let events = events(100_000, resolution);
        for batch in [7, 40_000] {
            write(&path, &events, batch).unwrap();
            let back = read(&path);
            assert_eq!(back.len(), events.len(), "{extension}");
            let differs = (0..events.len()).find(|i| back[*i] != events[*i]);
            assert_eq!(differs.map(|i| (i, events[i], back[i])), None, "{extension}");
        }
        // By way of csv, and back again.
        let csv = dir.path().join("by_way.csv");
        write(&csv, &read(&path), 1000).unwrap();
        assert!(read(&csv) == events, "{extension}");
    }
}

#[test]
fn half_a_recording_never_has_the_real_name() {
    for extension in writers::extensions() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(format!("a.{extension}"));
        std::fs::write(&path, "older").unwrap();
        let options = WriteOptions { sensor: Some(SENSOR) };
        let resolution = writers::resolution_ns(&path).unwrap();
        let mut writer = writers::create(&path, &options).unwrap();
        writer.write(&events(10_000, resolution)).unwrap();
        drop(writer);
        assert_eq!(std::fs::read(&path).unwrap(), b"older", "{extension}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "{extension}");
        write(&path, &events(10, resolution), 3).unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "{extension}");
    }
}

#[test]
fn what_cannot_be_written_is_said_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    for (name, wants) in [
        ("a.xyz", "no format to write has this ending"),
        ("csv", "use one of ."),
    ] {
        let path = dir.path().join(name);
        let said = write(&path, &[], 1).unwrap_err().to_string();
        assert!(said.contains(wants) && said.contains(name), "{said}");
    }
    for extension in writers::extensions() {
        let path = dir.path().join(format!("none/a.{extension}"));
        let said = write(&path, &[], 1).unwrap_err().to_string();
        assert!(said.contains("none") && !said.contains('\n'), "{said}");
    }
}
