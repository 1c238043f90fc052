//! Recordings of ROS: fixtures that `rosbags` wrote (`fixtures/ros/make_fixtures.py`), and files made here.
#![allow(clippy::unwrap_used)] // helpers of tests are not seen as tests

mod damage;
mod files;
mod packets;
mod rosbags;
mod sqlite;

use evpr_core::plan::Sensor;
use evpr_events::{
    Input, RawEvent, ReadOptions, Recording, Skipped, SourceError, SourceInfo, open, open_input,
};
use std::io::Cursor;
use std::path::{Path, PathBuf};

const SENSOR: Sensor = Sensor {
    height: 260,
    width: 346,
};
const BASE_NS: u64 = 1_600_000_000 * 1_000_000_000;

/// What a recording is read as.
#[derive(Debug, Default, PartialEq)]
struct Got {
    info: Option<SourceInfo>,
    sensor: Option<Sensor>,
    events: Vec<RawEvent>,
    skipped: Vec<(String, u64)>,
    error: Option<String>,
}

impl Got {
    fn error(&self) -> &str {
        self.error.as_deref().unwrap()
    }
}

fn read(bytes: &[u8]) -> Got {
    read_topic(bytes, None)
}

fn read_topic(bytes: &[u8], topic: Option<&str>) -> Got {
    let options = ReadOptions {
        stream: topic.map(str::to_owned),
        ..ReadOptions::default()
    };
    let input = Input::new("bytes", Cursor::new(bytes.to_vec()));
    read_opened(open_input(input, &options))
}

fn read_path(path: &Path) -> Got {
    read_opened(open(path, &ReadOptions::default()))
}

fn read_opened(recording: Result<Box<dyn Recording>, SourceError>) -> Got {
    let mut got = Got::default();
    let mut recording = match recording {
        Ok(recording) => recording,
        Err(e) => {
            got.error = Some(e.to_string());
            assert!(!got.error().contains('\n'), "{got:?}");
            return got;
        }
    };
    got.sensor = recording.sensor();
    let mut batch = Vec::new();
    loop {
        let outcome = recording.next_batch(&mut batch);
        assert!(batch.len() <= evpr_events::BATCH_EVENTS);
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
    got.info = Some(recording.describe());
    let pair = |Skipped { what, count }| (what, count);
    got.skipped = recording.skipped().into_iter().map(pair).collect();
    assert!(!got.error.as_ref().is_some_and(|e| e.contains('\n')), "{got:?}");
    got
}

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(fixture_path(name)).unwrap()
}

fn fixture_path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/ros")
        .join(name)
}

/// The events of the fixtures, from this time on.
fn events(start_ns: u64) -> Vec<RawEvent> {
    events_of(start_ns, 100)
}

fn events_of(start_ns: u64, count: u64) -> Vec<RawEvent> {
    (0..count)
        .map(|i| RawEvent {
            t_ns: start_ns + 1_000_000 * i,
            x: (i * 7 % 346) as u16,
            y: (i * 11 % 260) as u16,
            on: i % 3 == 0,
        })
        .collect()
}

#[test]
fn arrays_are_read_from_bags_and_mcap() {
    let bags = ["dvs_none.bag", "dvs_bz2.bag", "dvs_lz4.bag", "prophesee.bag"];
    let mcaps = ["dvs.mcap", "dvs_none.mcap", "dvs_lz4.mcap", "dvs_zstd.mcap"];
    for name in bags.into_iter().chain(mcaps) {
        let got = read(&fixture(name));
        assert_eq!(got.error, None, "{name}");
        assert_eq!(got.sensor, Some(SENSOR), "{name}");
        assert_eq!(got.events, events(BASE_NS), "{name}");
        let text = if name.ends_with("bag") {
            "messages of topic /text (std_msgs/String)"
        } else {
            "messages of topic /text (std_msgs/msg/String)"
        };
        assert_eq!(got.skipped, [(text.to_owned(), 5)], "{name}");
        let info = got.info.unwrap();
        let format = if name.ends_with("bag") { "rosbag" } else { "MCAP" };
        assert_eq!((info.format, info.time_unit), (format, "ns"));
    }
}

#[test]
fn packets_are_read_in_every_encoding() {
    for (encoding, unit) in [
        ("mono", "ns"),
        ("libcaer", "us"),
        ("libcaer_cmp", "us"),
        ("evt3", "us"),
    ] {
        // EVT 3.0 has the time of the sensor.
        let start_ns = if encoding == "evt3" {
            5_000_000_000
        } else {
            BASE_NS
        };
        for ending in ["bag", "mcap"] {
            let name = format!("packets_{encoding}.{ending}");
            let got = read(&fixture(&name));
            assert_eq!((got.error, got.sensor), (None, Some(SENSOR)), "{name}");
            assert_eq!(got.events, events(start_ns), "{name}");
            assert_eq!(got.info.unwrap().time_unit, unit);
            let kind = if ending == "bag" { "" } else { "msg/" };
            let triggers =
                format!("messages of topic /camera/triggers (event_camera_msgs/{kind}EventPacket)");
            assert_eq!(got.skipped, [(triggers, 1)], "{name}");
        }
    }
}

#[test]
fn a_topic_can_be_asked_for() {
    for ending in ["bag", "mcap"] {
        let bytes = fixture(&format!("packets_mono.{ending}"));
        let got = read_topic(&bytes, Some("/camera/events"));
        assert_eq!((got.error, got.events.len()), (None, 100));
        let got = read_topic(&bytes, Some("/camera/triggers"));
        assert_eq!((got.error.as_ref(), got.events.len()), (None, 0));
        assert_eq!(got.skipped[0], ("external triggers".to_owned(), 2));
        let error = read_topic(&bytes, Some("/other")).error.unwrap();
        assert!(
            error.contains("no messages of topic /other, but /camera/events (event_camera_msgs/"),
            "{error}"
        );
    }
    let error = read_topic(&fixture("dvs_none.bag"), Some("/text")).error.unwrap();
    assert!(
        error.contains("topic /text has messages of type std_msgs/String"),
        "{error}"
    );
}
