//! AEDAT 2.0 and Event Stream: files made here of known events.
#![allow(clippy::unwrap_used)] // helpers of tests are not seen as tests

use evpr_core::plan::Sensor;
use evpr_events::{Input, RawEvent, ReadOptions, Skipped, open_input};
use proptest::prelude::*;
use std::io::Cursor;

const HEADER: &str =
    "#!AER-DAT2.0\r\n# This is a raw AE data file - do not edit\r\n# Timestamps tick is 1 us\r\n";

/// What a recording is read as.
#[derive(Debug, PartialEq)]
struct Got {
    sensor: Option<Sensor>,
    events: Vec<RawEvent>,
    skipped: Vec<(String, u64)>,
    error: Option<String>,
}

fn read(bytes: &[u8], sensor: Option<Sensor>) -> Got {
    let options = ReadOptions {
        sensor,
        ..ReadOptions::default()
    };
    let mut got = Got {
        sensor: None,
        events: Vec::new(),
        skipped: Vec::new(),
        error: None,
    };
    let mut recording = match open_input(Input::new("bytes", Cursor::new(bytes.to_vec())), &options) {
        Ok(recording) => recording,
        Err(e) => {
            got.error = Some(e.to_string());
            return got;
        }
    };
    got.sensor = recording.sensor();
    let mut batch = Vec::new();
    loop {
        let outcome = recording.next_batch(&mut batch);
        got.events.append(&mut batch);
        match outcome {
            Ok(true) => {}
            Ok(false) => {
                assert_eq!(recording.progress_permille(), 1000);
                break;
            }
            Err(e) => {
                got.error = Some(e.to_string());
                break;
            }
        }
    }
    let pair = |Skipped { what, count }| (what, count);
    got.skipped = recording.skipped().into_iter().map(pair).collect();
    assert!(!got.error.as_ref().is_some_and(|e| e.contains('\n')), "{got:?}");
    got
}

fn file(lines: &str, pairs: &[(u32, u32)]) -> Vec<u8> {
    let mut bytes = format!("{HEADER}{lines}").into_bytes();
    for (address, t) in pairs {
        bytes.extend(address.to_be_bytes());
        bytes.extend(t.to_be_bytes());
    }
    bytes
}

fn event(t_us: u64, x: u16, y: u16, on: bool) -> RawEvent {
    RawEvent {
        t_ns: t_us * 1000,
        x,
        y,
        on,
    }
}

const fn sensor(height: usize, width: usize) -> Option<Sensor> {
    Some(Sensor { height, width })
}

#[test]
fn davis_events_are_read_and_the_rest_is_counted() {
    let davis = |x: u32, y: u32, on: u32| y << 22 | x << 12 | on << 11;
    let pairs = [
        (davis(0, 0, 1), 100),
        (0x8000_0000 | davis(7, 9, 0) | 0x155, 101), // APS, reset read
        (0x8000_0400 | davis(7, 9, 0) | 0x155, 101), // APS, signal read
        (0x8000_0c00 | 0x1234 << 12, 102),           // IMU
        (0x0000_0400, 103),                          // input pin
        (davis(345, 259, 0), 104),
        (davis(346, 10, 0), 104), // outside
        (davis(3, 140, 1), 90),   // backwards, and its first byte is a #
    ];
    for lines in [
        "# AEChip: eu.seebetter.ini.chips.davis.Davis346blue\r\n#End Of ASCII Header\r\n",
        "# AEChip: DAVI346\n",
    ] {
        let got = read(&file(lines, &pairs), None);
        let want = Got {
            sensor: sensor(260, 346),
            events: vec![
                event(100, 345, 259, true),
                event(104, 0, 0, false),
                event(104, u16::MAX, 249, false),
                event(90, 342, 119, true),
            ],
            skipped: vec![
                ("APS samples".to_owned(), 2),
                ("IMU values".to_owned(), 1),
                ("external events".to_owned(), 1),
            ],
            error: None,
        };
        assert_eq!(got, want);
    }
    let got = read(&file("# AEChip: x.DAVIS240C\r\n", &pairs[..1]), None);
    assert_eq!(
        (got.sensor, got.events),
        (sensor(180, 240), vec![event(100, 239, 179, true)])
    );
}

#[test]
fn a_first_event_that_begins_like_a_comment_is_an_event() {
    let address: u32 = 0x23 << 24 | 5 << 12;
    assert_eq!(address.to_be_bytes()[0], b'#');
    let got = read(&file("# AEChip: Davis346\r\n", &[(address, 7)]), None);
    assert_eq!((got.events.len(), got.error), (1, None));
}

#[test]
fn dvs128_is_known_by_its_name_or_size_and_times_wrap() {
    let pairs = [
        (5 << 8 | 3 << 1, 0xffff_fffe),
        (127 << 8 | 1, 1),
        (0x8000, 2),
        (0, 2),
    ];
    let want = vec![
        event(0xffff_fffe, 124, 122, true),
        event(0x1_0000_0001, 127, 0, false),
        event(0x1_0000_0002, 127, 127, true),
    ];
    for (lines, said) in [
        ("# AEChip: ch.unizh.ini.jaer.chip.retina.DVS128\r\n", None),
        ("", sensor(128, 128)),
    ] {
        let got = read(&file(lines, &pairs), said);
        assert_eq!((&got.events, &got.error), (&want, &None));
        assert_eq!(got.skipped, [("external events".to_owned(), 1)]);
    }
}

#[test]
fn what_cannot_be_known_is_said() {
    let error = |lines: &str, pairs: &[(u32, u32)]| read(&file(lines, pairs), None).error.unwrap();
    assert!(error("", &[]).contains("does not say its chip"));
    assert!(error("# AEChip: Cochlea\r\n", &[]).contains("is of the chip Cochlea"));
    let early = error("# AEChip: DVS128\r\n", &[(0, 5), (0, 0xffff_fff0)]);
    assert!(early.contains("has a time before 0"), "{early}");
    let mut cut = file("# AEChip: DVS128\r\n", &[(0, 5), (0, 6)]);
    cut.pop();
    let got = read(&cut, None);
    assert_eq!(got.events, [event(5, 127, 127, true)]);
    assert!(got.error.unwrap().contains("ends inside an event"));
    assert!(
        read(b"#!AER-DAT2.0", None)
            .error
            .unwrap()
            .contains("ends inside its header")
    );
    assert!(read(b"#!AER-DAT3.1\r\n", None).error.unwrap().contains("AEDAT 3"));
}

/// Written by the reference library (PyPI event_stream 1.6.3) from known events.
#[test]
fn event_streams_of_the_reference_library_are_read_exactly() {
    let dvs = b"Event Stream\x02\0\0\x01\x80\x02\xe0\x01\
        \x01\x01\0\x07\0\x0a\x02\0\x08\0\xfd\x2c\x01\x09\0\x02\x04\0\xc8\0\
        \xff\xff\xff\xff\xff\xff\xd5\x05\0\x0b\0\xff\xff\0\x06\0\x0c\0";
    // Rows of the file count from below.
    let want = vec![
        event(0, 1, 479 - 7, true),
        event(5, 2, 479 - 8, false),
        event(131, 300, 479 - 9, true),
        event(132, 4, 479 - 200, false),
        event(1000, 5, 479 - 11, true),
        event(1254, 6, 479 - 12, false),
    ];
    let got = read(dvs, None);
    assert_eq!(
        (got.sensor, &got.events, got.error),
        (sensor(480, 640), &want, None)
    );
    let atis = b"Event Stream\x02\0\0\x02\x80\x02\xe0\x01\
        \x02\x01\0\x07\0\x14\x02\0\x08\0\xfe\x03\x2c\x01\x09\0\x05\x04\0\xc8\0\
        \xff\xff\xff\xff\xfd\xc6\x05\0\x0b\0\xff\xfd\x08\x06\0\x0c\0";
    let got = read(atis, None);
    assert_eq!(
        (&got.events[..2], &got.events[2], got.error),
        (&want[..2], &want[4], None)
    );
    assert_eq!(got.skipped, [("measurements of brightness".to_owned(), 2)]);
    for len in 0..dvs.len() {
        let got = read(&dvs[..len], None);
        assert!(want.starts_with(&got.events));
        // Whole only between events, or where time alone goes on.
        let whole =
            [20, 25, 30, 35, 58].contains(&len) || (40..=46).contains(&len) || (51..=53).contains(&len);
        assert_eq!(got.error.is_none(), whole, "{len}: {:?}", got.error);
    }
}

#[test]
fn other_event_streams_are_refused_by_name() {
    let error = |bytes: &[u8]| read(bytes, None).error.unwrap();
    assert!(error(b"Event Stream\x01\0\0\x01\x80\x02\xe0\x01").contains("version 1"));
    assert!(error(b"Event Stream\x02\0\0\x04\x80\x02\xe0\x01").contains("colour events"));
    assert!(error(b"Event Stream\x02\0\0\x01\0\0\xe0\x01").contains("480x0 pixels"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn any_bytes_are_read_or_refused(bytes: Vec<u8>, davis: bool) {
        let chip = if davis { "# AEChip: Davis346\r\n" } else { "# AEChip: DVS128\r\n" };
        read(&[HEADER.as_bytes(), chip.as_bytes(), &bytes].concat(), None);
        read(&[&b"Event Stream\x02\0\0\x01\x10\0\x10\0"[..], &bytes].concat(), None);
    }
}
