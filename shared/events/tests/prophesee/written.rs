//! EVT 3.0 as we write it.

use super::words::read_all;
use evpr_core::plan::Sensor;
use evpr_events::writers::{self, WriteError, WriteOptions};
use evpr_events::{RawEvent, ReadOptions};
use proptest::prelude::*;
use std::path::Path;

const SENSOR: Sensor = Sensor {
    height: 720,
    width: 1280,
};

fn event(t_us: u64, x: u16, y: u16, on: bool) -> RawEvent {
    RawEvent {
        t_ns: t_us * 1000,
        x,
        y,
        on,
    }
}

fn write(path: &Path, events: &[RawEvent], batch: usize) -> Result<(), WriteError> {
    let options = WriteOptions { sensor: Some(SENSOR) };
    let mut writer = writers::create(path, &options)?;
    for events in events.chunks(batch) {
        writer.write(events)?;
    }
    writer.finish()
}

fn back(path: &Path) -> Vec<RawEvent> {
    let mut recording = evpr_events::open(path, &ReadOptions::default()).unwrap();
    assert_eq!(recording.sensor(), Some(SENSOR));
    let (events, end) = read_all(recording.as_mut());
    end.unwrap();
    assert!(recording.skipped().is_empty());
    events
}

#[test]
fn neighbours_become_vectors() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.raw");
    // A row of 64 at once: base, twice 12, 12 and 8, and the start.
    let events: Vec<_> = (32..96).map(|x| event(4097, x, 5, true)).collect();
    write(&path, &events, 1000).unwrap();
    assert_eq!(back(&path), events);
    let file = std::fs::read(&path).unwrap();
    let words: Vec<u16> = file[file.len() - 20..]
        .chunks(2)
        .map(|w| u16::from_le_bytes([w[0], w[1]]))
        .collect();
    let want = [
        0x8001, 0x6001, 0x0005, 0x3820, 0x4fff, 0x4fff, 0x50ff, 0x4fff, 0x4fff, 0x50ff,
    ];
    assert_eq!(words, want);
}

#[test]
fn times_beyond_the_range_and_long_gaps_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.raw");
    for first in [0, 1 << 24, 1_633_953_690_975_950] {
        let mut t = first;
        let mut events = vec![event(t, 1, 2, true)];
        for gap in [
            1,
            4096,
            8_388_608,
            8_388_609,
            16_777_215,
            16_777_216,
            86_400_000_000,
        ] {
            t += gap;
            events.push(event(t, 3, 4, false));
        }
        write(&path, &events, 3).unwrap();
        assert_eq!(back(&path), events);
        // The other decoder sees the same from 0 on; what it cannot know is how often the time had wrapped before.
        let theirs = evt3::Evt3Decoder::new().decode_file(&path).unwrap();
        let shift = first >> 24 << 24;
        let theirs: Vec<u64> = theirs.cd_events.iter().map(|e| e.timestamp + shift).collect();
        assert_eq!(theirs, events.iter().map(|e| e.t_ns / 1000).collect::<Vec<_>>());
    }
}

#[test]
fn what_does_not_fit_is_refused_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.raw");
    for (bad, wanted) in [
        (
            event(4, 0, 0, true),
            "event 2 (from 0) at 0.000004000 s is earlier than the one before it at 5 us",
        ),
        (
            event(5, 2048, 0, true),
            "event 2 (from 0) lies at x 2048 and y 0; EVT3 has columns and rows up to 2047",
        ),
        (
            event(86_400_000_006, 0, 0, true),
            "event 2 (from 0) at 86400.000006000 s comes more than a day after",
        ),
    ] {
        let events = [event(5, 1, 1, true), event(5, 1, 1, true), bad];
        for batch in [1, 3] {
            let said = write(&path, &events, batch).unwrap_err().to_string();
            assert!(said.contains(wanted) && !said.contains('\n'), "{said}");
            assert!(!path.exists());
        }
    }
    let no_sensor = writers::create(&path, &WriteOptions::default()).err().unwrap();
    assert!(no_sensor.to_string().contains("EVT3 says the size of the sensor"));
}

#[test]
fn finer_times_are_rounded_down_and_empty_recordings_are_refused_when_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.raw");
    let mut fine = event(7, 1, 1, true);
    fine.t_ns += 999;
    write(&path, &[fine], 1).unwrap();
    assert_eq!(back(&path), [event(7, 1, 1, true)]);
    write(&path, &[], 1).unwrap();
    let error = evpr_events::open(&path, &ReadOptions::default()).err().unwrap();
    assert!(error.to_string().contains("holds no events"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn whatever_is_written_is_read(
        steps in prop::collection::vec((0_u64..3, 0_u16..4, 0_u16..2048, 1_u16..40, any::<bool>()), 1..60),
        first in prop_oneof![0_u64..100, 16_777_000_u64..16_778_000, any::<u32>().prop_map(u64::from)],
        batch in 1_usize..200,
    ) {
        let (mut t, mut events) = (first, Vec::new());
        for (step, y, x, run, on) in steps {
            t += step * step * 1500;
            // Runs with holes; the last of some are beyond the sensor.
            events.extend((x..2048).step_by(1 + usize::from(y)).take(usize::from(run)).map(|x| event(t, x, y, on)));
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.raw");
        write(&path, &events, batch).unwrap();
        prop_assert_eq!(back(&path), events);
    }
}
