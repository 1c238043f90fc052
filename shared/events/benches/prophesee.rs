//! Events per second of the decoders of Prophesee's formats, beside the crate `evt3` in the same run:
//! `cargo bench -p evpr-events --bench prophesee`. One thread.
//!
//! Each figure is the best of 401 runs: other work on the machine only adds. Made streams hold 200,000 events, and
//! are decoded 64 KiB at a time into one vector that is emptied in between,
//! as a recording does it; the real recording (single events only, 4.6 words each) is decoded again and again.
#![allow(clippy::unwrap_used)]

use evpr_events::formats::prophesee::{
    DatDecoder, Decoder, Evt2Decoder, Evt3Decoder, Evt21Decoder, Evt21Order,
};
use evpr_events::{RawEvent, ReadOptions};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

const EVENTS: usize = 200_000;
const PIECE: usize = 64 << 10;
const REPEATS: usize = 401;

fn main() {
    println!(
        "{:<44} {:>9} {:>11} {:>10} {:>8}",
        "stream", "bytes/ev", "M events/s", "ns/event", "GB/s"
    );
    for (share, name) in [(32, "all of 32"), (16, "16 of 32"), (4, "4 of 32")] {
        let stream = vectors(share);
        ours(&format!("EVT3, vectors, {name} bits"), &stream, || {
            Box::new(Evt3Decoder::new())
        });
        crate_evt3(&stream);
    }
    let stream = singles();
    ours("EVT3, single events, 2.5 words each", &stream, || {
        Box::new(Evt3Decoder::new())
    });
    crate_evt3(&stream);
    if let Some(stream) = real("hd_triggers.evt3.raw") {
        ours("EVT3, hd_triggers", &stream, || Box::new(Evt3Decoder::new()));
        crate_evt3(&stream);
    }
    if let Some(stream) = real("gen3_vga.evt2.raw") {
        ours("EVT2, gen3_vga", &stream, || Box::new(Evt2Decoder::new()));
    }
    ours("EVT2.1, 16 of 32 bits", &evt21(), || {
        Box::new(Evt21Decoder::new(Evt21Order::Little))
    });
    ours("DAT", &dat(), || Box::new(DatDecoder::new()));
    whole("hd_triggers.evt3.raw");
    whole("gen3_vga.evt2.raw");
}

fn row(name: &str, bytes: usize, mut run: impl FnMut() -> usize) {
    let events = run();
    let timed = |_| {
        let start = Instant::now();
        black_box(run());
        start.elapsed().as_secs_f64()
    };
    let time = (0..REPEATS).map(timed).fold(f64::INFINITY, f64::min) / events as f64;
    let per_event = bytes as f64 / events as f64;
    println!(
        "{name:<44} {per_event:>9.2} {:>11.0} {:>10.2} {:>8.2}",
        1e-6 / time,
        time * 1e9,
        per_event * 1e-9 / time
    );
}

fn ours(name: &str, stream: &[u8], new: fn() -> Box<dyn Decoder>) {
    let mut out: Vec<RawEvent> = Vec::new();
    row(name, stream.len(), || {
        let (mut decoder, mut events) = (new(), 0);
        for piece in stream.chunks(PIECE) {
            out.clear();
            decoder.decode(black_box(piece), &mut out);
            events += black_box(&out).len();
        }
        events
    });
}

fn crate_evt3(stream: &[u8]) {
    let (mut out, mut triggers) = (Vec::new(), Vec::new());
    row("  the crate evt3", stream.len(), || {
        let (mut decoder, mut events) = (evt3::Evt3Decoder::new(), 0);
        for piece in stream.chunks(PIECE) {
            out.clear();
            triggers.clear();
            decoder
                .decode_bytes(black_box(piece), &mut out, &mut triggers)
                .unwrap();
            events += black_box(&out).len();
        }
        events
    });
}

/// A recording opened by its path and read to its end.
fn whole(name: &str) {
    let Some(path) = path(name) else { return };
    let bytes = std::fs::metadata(&path).unwrap().len() as usize;
    row(&format!("{name}, opened and read"), bytes, || {
        let mut recording = evpr_events::open(Path::new(&path), &ReadOptions::default()).unwrap();
        let (mut batch, mut events) = (Vec::new(), 0);
        while recording.next_batch(&mut batch).unwrap() {
            events += black_box(&batch).len();
        }
        events
    });
}

fn path(name: &str) -> Option<String> {
    let path = format!(
        "{}/../../../shared/data/events/{name}",
        env!("CARGO_MANIFEST_DIR")
    );
    if Path::new(&path).is_file() {
        return Some(path);
    }
    println!("skipped: {name} is not in shared/data/events");
    None
}

/// The words of a real recording, behind its header.
fn real(name: &str) -> Option<Vec<u8>> {
    let mut bytes = std::fs::read(path(name)?).unwrap();
    let mut at = 0;
    while bytes[at..].starts_with(b"% ") {
        at += bytes[at..].iter().position(|b| *b == b'\n').unwrap() + 1;
    }
    Some(bytes.split_off(at))
}

/// The same numbers each time.
fn random() -> impl FnMut() -> u64 {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    }
}

/// 32 bits with about `share` of them set.
fn mask(share: u32, next: &mut impl FnMut() -> u64) -> u32 {
    (0..32).fold(0, |mask, bit| {
        mask | u32::from(next() % 32 < u64::from(share)) << bit
    })
}

/// A row of 4 blocks of 32 pixels each 20 µs, as a sensor of 1280 × 720 sends them.
fn vectors(share: u32) -> Vec<u8> {
    let mut next = random();
    let (mut words, mut events, mut t) = (Vec::new(), 0, 0_u32);
    while events < EVENTS {
        words.extend([0x8000 | (t >> 12 & 0xfff) as u16, 0x6000 | (t & 0xfff) as u16]);
        words.push((next() % 720) as u16);
        for _ in 0..4 {
            let mask = mask(share, &mut next);
            let r = next();
            words.push(0x3000 | (r % 40 * 32) as u16 | (r >> 32 & 0x800) as u16);
            words.push(0x4000 | (mask & 0xfff) as u16);
            words.push(0x4000 | (mask >> 12 & 0xfff) as u16);
            words.push(0x5000 | (mask >> 24) as u16);
            events += mask.count_ones() as usize;
        }
        t += 20;
    }
    words.iter().flat_map(|w: &u16| w.to_le_bytes()).collect()
}

fn singles() -> Vec<u8> {
    let mut next = random();
    let (mut words, mut t) = (vec![0x8000], 0_u32);
    for i in 0..EVENTS {
        let r = next();
        if i % 2 == 0 {
            t += 1;
            words.push(0x6000 | (t & 0xfff) as u16);
            if t & 0xfff == 0 {
                words.push(0x8000 | (t >> 12 & 0xfff) as u16);
            }
        }
        words.push((r % 720) as u16);
        words.push(0x2000 | ((r >> 16) % 1280) as u16 | (r >> 40 & 0x800) as u16);
    }
    words.iter().flat_map(|w: &u16| w.to_le_bytes()).collect()
}

fn evt21() -> Vec<u8> {
    let mut next = random();
    let mut words = Vec::new();
    for t in 0..(EVENTS / 16) as u64 {
        if t % 64 == 0 {
            words.push(0x8 << 60 | (t / 64) << 32);
        }
        let r = next();
        let (x, y) = (r % 40 * 32, (r >> 16) % 720);
        words.push((r >> 63) << 60 | (t & 63) << 54 | x << 43 | y << 32 | u64::from(mask(16, &mut next)));
    }
    words.iter().flat_map(|w: &u64| w.to_le_bytes()).collect()
}

fn dat() -> Vec<u8> {
    let mut next = random();
    let event = |t: u64| {
        let r = next();
        (t / 8) | ((r % 1280) << 32) | (((r >> 16) % 720) << 46) | ((r >> 63) << 60)
    };
    let words: Vec<u64> = (0..EVENTS as u64).map(event).collect();
    words.iter().flat_map(|w| w.to_le_bytes()).collect()
}
