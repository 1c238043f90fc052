//! Real recordings, beside what other programs found in them.

use super::words::read_all;
use evpr_core::plan::Sensor;
use evpr_events::formats::prophesee::{Decoder, Evt3Decoder};
use evpr_events::{RawEvent, ReadOptions, Skipped};
use sha2::{Digest, Sha256};
use std::fs;
use std::path::PathBuf;

/// The recording of this name; `None`, said by name, where the data is not at hand.
fn real(name: &str) -> Option<PathBuf> {
    let dir = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/events/");
    let path = PathBuf::from(format!("{dir}{name}"));
    if path.is_file() {
        return Some(path);
    }
    println!("skipped: {name} is not in shared/data/events");
    None
}

fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

/// {i64 t µs, u16 x, u16 y, u8 p} of event after event, little endian.
fn by_event(events: &[RawEvent]) -> String {
    let mut hash = Sha256::new();
    for e in events {
        hash.update((e.t_ns / 1000).to_le_bytes());
        hash.update(e.x.to_le_bytes());
        hash.update(e.y.to_le_bytes());
        hash.update([u8::from(e.on)]);
    }
    hex(hash)
}

/// The same column after column: all t, all x, all y, all p.
fn by_column(events: &[RawEvent]) -> String {
    let mut hash = Sha256::new();
    events
        .iter()
        .for_each(|e| hash.update((e.t_ns / 1000).to_le_bytes()));
    events.iter().for_each(|e| hash.update(e.x.to_le_bytes()));
    events.iter().for_each(|e| hash.update(e.y.to_le_bytes()));
    events.iter().for_each(|e| hash.update([u8::from(e.on)]));
    hex(hash)
}

#[test]
fn real_recordings_are_read_as_other_programs_read_them() {
    let Some(golden) = real("golden.json") else { return };
    let golden: serde_json::Value = serde_json::from_slice(&fs::read(golden).unwrap()).unwrap();
    type Hash = fn(&[RawEvent]) -> String;
    // The hash of the first was taken column by column.
    let recordings: [(_, _, _, Hash); 2] = [
        ("gen3_vga.evt2.raw", "EVT2", (480, 640), by_column),
        ("hd_triggers.evt3.raw", "EVT3", (720, 1280), by_event),
    ];
    for (name, format, (height, width), sha256) in recordings {
        let Some(path) = real(name) else { continue };
        let want = &golden[name];
        let mut recording = evpr_events::open(&path, &ReadOptions::default()).unwrap();
        let (events, end) = read_all(recording.as_mut());
        end.unwrap();
        let number = |key: &str| want[key].as_u64().unwrap();
        assert_eq!(events.len() as u64, number("n"), "{name}");
        assert_eq!(events.iter().filter(|e| e.on).count() as u64, number("on"));
        assert_eq!(events[0].t_ns, number("t_first") * 1000);
        assert_eq!(events[events.len() - 1].t_ns, number("t_last") * 1000);
        assert_eq!(
            u64::from(events.iter().map(|e| e.x).max().unwrap()),
            number("x_max")
        );
        assert_eq!(
            u64::from(events.iter().map(|e| e.y).max().unwrap()),
            number("y_max")
        );
        assert_eq!(sha256(&events), want["sha256"].as_str().unwrap(), "{name}");
        let triggers = want["external_triggers"].as_u64().map(|count| Skipped {
            what: "external triggers".to_owned(),
            count,
        });
        assert_eq!(recording.skipped(), Vec::from_iter(triggers), "{name}");
        assert_eq!(recording.sensor(), Some(Sensor { height, width }));
        let about = recording.describe();
        assert_eq!((about.format, about.time_unit), (format, "us"));
        assert_eq!(recording.progress_permille(), 1000);
    }
}

#[test]
fn another_decoder_of_evt3_finds_the_same_in_a_real_recording() {
    let Some(path) = real("hd_triggers.evt3.raw") else {
        return;
    };
    let theirs = evt3::Evt3Decoder::new().decode_file(&path).unwrap();
    let file = fs::read(path).unwrap();
    let end = b"% end\n";
    let at = file.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let (mut ours, mut decoder) = (Vec::new(), Evt3Decoder::new());
    decoder.decode(&file[at..], &mut ours);
    assert_eq!(ours.len(), theirs.cd_events.len());
    for (ours, theirs) in ours.iter().zip(&theirs.cd_events) {
        assert_eq!(
            (ours.t_ns, ours.x, ours.y, u8::from(ours.on)),
            (theirs.timestamp * 1000, theirs.x, theirs.y, theirs.polarity)
        );
    }
    let passed = decoder.passed_over();
    assert_eq!(passed.triggers, theirs.trigger_events.len() as u64);
    assert_eq!(passed.before_start, 0);
}
