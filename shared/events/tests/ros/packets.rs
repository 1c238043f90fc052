//! What the encodings keep from packet to packet, and what they do not.

use super::files::{bag, mcap, packet};
use super::{Got, read};
use evpr_events::RawEvent;
use sha2::{Digest, Sha256};
use std::path::PathBuf;

const PACKET: &str = "event_camera_msgs/EventPacket";

fn words(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_le_bytes()).collect()
}

/// (µs, x, y, on) of each event.
fn short(got: &Got) -> Vec<(u64, u16, u16, bool)> {
    let one = |e: &RawEvent| (e.t_ns / 1000, e.x, e.y, e.on);
    got.events.iter().map(one).collect()
}

#[test]
fn real_evt3_in_packets_is_what_it_is_in_its_own_file() {
    let data = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/events");
    let (golden, raw) = (data.join("golden.json"), data.join("hd_triggers.evt3.raw"));
    if !golden.is_file() || !raw.is_file() {
        println!("skipped: hd_triggers.evt3.raw is not in shared/data/events");
        return;
    }
    let golden: serde_json::Value = serde_json::from_slice(&std::fs::read(golden).unwrap()).unwrap();
    let want = &golden["hd_triggers.evt3.raw"];
    let raw = std::fs::read(raw).unwrap();
    // The header is lines that begin with a percent sign.
    let mut words = &raw[..];
    while words[0] == b'%' {
        words = &words[words.iter().position(|b| *b == b'\n').unwrap() + 1..];
    }
    // Packets of uneven sizes, the first of them empty.
    let sizes = (0..).map(|i| i * 1234 % 9876 * 2);
    let mut messages = Vec::new();
    for (seq, size) in (0..).zip(sizes) {
        let (now, rest) = words.split_at(words.len().min(size));
        messages.push(packet(seq, 1_600_000_000, 0, "evt3", now));
        words = rest;
        if words.is_empty() {
            break;
        }
    }
    for file in [bag(PACKET, &messages, true), mcap(PACKET, &messages)] {
        let got = read(&file);
        assert_eq!(got.error, None);
        assert_eq!(got.events.len() as u64, want["n"].as_u64().unwrap());
        let mut hash = Sha256::new();
        for e in &got.events {
            hash.update((e.t_ns / 1000).to_le_bytes());
            hash.update(e.x.to_le_bytes());
            hash.update(e.y.to_le_bytes());
            hash.update([u8::from(e.on)]);
        }
        let hash: String = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(hash, want["sha256"].as_str().unwrap());
        let triggers = want["external_triggers"].as_u64().unwrap();
        assert_eq!(got.skipped, [("external triggers".to_owned(), triggers)]);
    }
}

#[test]
fn evt3_goes_on_after_a_gap() {
    let event = [0x8001, 0x6000, 0x0003, 0x2004];
    let messages = [
        packet(8, 100, u64::MAX, "evt3", &words(&event)),
        packet(9, 100, 0, "evt3", &words(&[0x2005])),
        // One packet is missing, in which the time has gone on by 2 s.
        packet(
            11,
            102,
            0,
            "evt3",
            &words(&[0x2006, 0x8001, 0x6000, 0x0003, 0x2007]),
        ),
        // Many are missing: 100 s are about six wraps of the clock.
        packet(20, 202, 0, "evt3", &words(&[0x8001, 0x6000, 0x0003, 0x2008])),
    ];
    let got = read(&mcap(PACKET, &messages));
    let at = |wraps: u64| 4096 + wraps * 16_777_216;
    let want = [
        (at(0), 4, 3, false),
        (at(0), 5, 3, false),
        (at(0), 7, 3, false),
        (at(6), 8, 3, false),
    ];
    assert_eq!(short(&got), want);
    let skipped = [
        ("events before the first full time and place".to_owned(), 1),
        ("packets that are missing (gaps in their numbers)".to_owned(), 9),
    ];
    assert_eq!((got.error, got.skipped), (None, skipped.to_vec()));
}

#[test]
fn libcaer_wraps_within_a_packet() {
    let event = |us: u32| [((5 << 17) | (6 << 2) | 2u32).to_le_bytes(), us.to_le_bytes()].concat();
    let last = (1 << 31) - 1;
    let messages = [
        packet(
            0,
            1,
            7_000,
            "libcaer",
            &[event(last), event(0), event(9), event(8)].concat(),
        ),
        // The base of the next packet has the high bits.
        packet(1, 1, 7_000 + (1 << 31) * 1_000, "libcaer", &event(10)),
        packet(2, 1, 7_000 + (1 << 31) * 1_000, "libcaer", &[]),
    ];
    let got = read(&mcap(PACKET, &messages));
    assert_eq!(got.error, None);
    let us = [
        1 << 31,
        (1 << 31) + 1,
        (1 << 31) + 10,
        (1 << 31) + 9,
        (1 << 31) + 11,
    ];
    let want = us.map(|us| (us - 1 + 7, 5, 6, true));
    assert_eq!(short(&got), want);
}

#[test]
fn libcaer_cmp_keeps_its_column_but_not_its_time() {
    let messages = [
        packet(
            0,
            1,
            1_000_000,
            "libcaer_cmp",
            &words(&[0x3001, 0x2005, 0x0001, 0x1002, 0x3807]),
        ),
        packet(
            1,
            1,
            2_000_000,
            "libcaer_cmp",
            &words(&[0x3008, 0x4010, 0x5081, 0x5002, 0x6fff]),
        ),
        // Packets are missing: the column is not known.
        packet(3, 1, 3_000_000, "libcaer_cmp", &words(&[0x3009, 0x2006, 0x3009])),
    ];
    let got = read(&bag(PACKET, &messages, true));
    let want = [
        (1_000 + 4096 + 2, 5, 7, true),
        (2_000, 5, 8, false),
        (2_000, 5, 16, false),
        (2_000, 5, 23, false),
        (2_000, 5, 25, false),
        (3_000, 6, 9, false),
    ];
    assert_eq!((short(&got), got.error), (want.to_vec(), None));
    assert_eq!(got.skipped[0].1, 2);
}

#[test]
fn what_cannot_be_a_packet_is_said() {
    let one = |message| read(&mcap(PACKET, &[message])).error.unwrap();
    let good = packet(0, 1, 0, "mono", &[0; 8]);
    for (message, says) in [
        (
            packet(0, 1, 0, "evt4\n", &[0; 8]),
            "has the encoding \"evt4\\n\"; evt3, mono",
        ),
        (
            packet(0, 1, 0, "evt3", &[0; 3]),
            "has 3 bytes of events, no whole number of 2",
        ),
        (packet(0, 1, u64::MAX, "mono", &[0; 8]), "beyond the year 2116"),
        (good[..good.len() - 1].to_vec(), "is longer than it is"),
        (Vec::new(), "is longer than it is"),
    ] {
        let error = one(message);
        assert!(
            error.contains("message 0 (from 0) of topic /events ") && error.contains(says),
            "{error}"
        );
    }
    let mut big_endian = good.clone();
    let at = good.len() - 4 - 8 - 1;
    big_endian[at] = 1;
    assert!(one(big_endian).contains("big-endian"));
    // Those before it are given.
    let got = read(&mcap(PACKET, &[good.clone(), Vec::new()]));
    assert!(
        got.events.len() == 1 && got.error().contains("message 1 (from 0)"),
        "{got:?}"
    );
}
