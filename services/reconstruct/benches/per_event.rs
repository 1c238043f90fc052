//! Time per event and per frame of every method, beside one plain read of the same events in the same run:
//! `cargo bench -p evpr-reconstruct --bench per_event`. One thread.
//!
//! The events lie anywhere on the sensor with equal chance, which is the hardest case for the caches, evenly over one
//! second. scripts/bench_numpy.py counts the same events with NumPy.

use evpr_core::message::{ChunkHeader, Event, FrameHeader, Frames};
use evpr_core::plan::{Align, Member, Params, Plan, Reconstruction, Sensor, test_plan};
use evpr_core::stage::{Outlet, Stage, StageError};
use evpr_reconstruct::{Reconstruct, build, kinds};
use std::hint::black_box;
use std::time::Instant;

const MS: u64 = 1_000_000;
/// As many events as ingest puts into one chunk.
const CHUNK: usize = 1 << 16;
const REPEATS: usize = 15;

fn main() {
    for (height, width, count) in [(260, 346, 2_000_000), (720, 1280, 10_000_000)] {
        let sensor = Sensor { height, width };
        let events = events(sensor, count);
        let read = median(|| timed(|| _ = black_box(plain_read(black_box(&events)))));
        let gb = (events.len() * size_of::<Event>()) as f64 / 1e9;
        println!(
            "{width}×{height}, {count} events; plain read {:.2} ns/event ({:.1} GB/s)",
            read * 1e9 / count as f64,
            gb / read
        );
        println!(
            "{:>24} {:>9} {:>8} {:>9} | {:>9} {:>9} {:>9} | {:>12} {:>12}",
            "method",
            "ns/event",
            "to read",
            "clear ms",
            "frame 5%",
            "frame 50%",
            "frame all",
            "4 windows ms",
            "from the end"
        );
        for kind in kinds() {
            measure(kind.name, sensor, &events, read);
        }
        println!();
    }
}

/// `ns/event` is with the clear; a frame is that of a window of one segment after this part of the events; the last
/// two columns are all that a tick with windows of 0.1, 0.25, 0.5 and 1 s costs beyond its events: the clears and four
/// frames, with windows that begin with the tick (one plane holds them all) and that end with it (a plane per segment).
fn measure(kind: &str, sensor: Sensor, events: &[Event], read: f64) {
    let count = events.len() as f64;
    let part = |percent: usize| &events[..events.len() / 100 * percent];
    let mut ticks = Ticks::new(kind, sensor, &[1000], Align::Start);
    let all = Times::median(&mut || ticks.one(&[part(100)]));
    let five = Times::median(&mut || ticks.one(&[part(5)]));
    let half = Times::median(&mut || ticks.one(&[part(50)]));
    let windows = |align, cuts: [usize; 5]| {
        let mut ticks = Ticks::new(kind, sensor, &[100, 250, 500, 1000], align);
        let at = cuts.map(|percent| events.len() / 100 * percent);
        let segments: [_; 4] = std::array::from_fn(|i| &events[at[i]..at[i + 1]]);
        let times = Times::median(&mut || ticks.one(&segments));
        (times.open + times.close) * 1e3
    };
    let nested = windows(Align::Start, [0, 10, 25, 50, 100]);
    let from_the_end = windows(Align::End, [0, 50, 75, 90, 100]);
    println!(
        "{kind:>24} {:>9.2} {:>8.2} {:>9.3} | {:>9.3} {:>9.3} {:>9.3} | {nested:>12.3} {from_the_end:>12.3}",
        (all.open + all.enter) * 1e9 / count,
        (all.open + all.enter) / read,
        all.open * 1e3,
        five.close * 1e3,
        half.close * 1e3,
        all.close * 1e3
    );
}

/// Seconds per tick.
#[derive(Clone, Copy)]
struct Times {
    open: f64,
    enter: f64,
    close: f64,
}

impl Times {
    /// Each time's median, after one run that does not count.
    fn median(run: &mut dyn FnMut() -> Times) -> Times {
        run();
        let times: Vec<Times> = (0..REPEATS).map(|_| run()).collect();
        let of = |which: fn(&Times) -> f64| middle(times.iter().map(which).collect());
        Times {
            open: of(|t| t.open),
            enter: of(|t| t.enter),
            close: of(|t| t.close),
        }
    }
}

/// Feeds a stage tick after tick.
struct Ticks {
    stage: Reconstruct,
    /// Per segment: the windows that close with it, as bits.
    closes: Vec<u32>,
    tick: u64,
    seq: u64,
    outlet: Reused,
}

impl Ticks {
    fn new(kind: &str, sensor: Sensor, windows_ms: &[u64], align: Align) -> Self {
        let plan = plan(kind, sensor, windows_ms, align);
        let segments = plan.slicing.segments();
        Self {
            stage: build(&plan, 0).unwrap_or_else(|error| unreachable!("{error}")),
            closes: (0..segments.per_tick()).map(|s| segments.closes(s)).collect(),
            tick: 0,
            seq: 0,
            outlet: Reused::default(),
        }
    }

    /// One tick, an opening chunk, chunks of events and a closing chunk per segment. Ticks in a row differ in their
    /// last few events, so that nothing is kept from one frame to the next that could not be in a real stream.
    fn one(&mut self, segments: &[&[Event]]) -> Times {
        let mut times = Times {
            open: 0.0,
            enter: 0.0,
            close: 0.0,
        };
        for (segment, events) in segments.iter().enumerate() {
            times.open += timed(|| self.chunk(segment, ChunkHeader::OPENS_SEGMENT, &[]));
            let events = &events[..events.len() - (self.tick % 16) as usize];
            times.enter += timed(|| {
                for chunk in events.chunks(CHUNK) {
                    self.chunk(segment, 0, chunk);
                }
            });
            times.close += timed(|| self.chunk(segment, ChunkHeader::CLOSES_SEGMENT, &[]));
        }
        assert!(self.outlet.frames > 0, "every tick gives frames");
        self.outlet.frames = 0;
        self.tick += 1;
        times
    }

    fn chunk(&mut self, segment: usize, flags: u32, events: &[Event]) {
        let closes = flags & ChunkHeader::CLOSES_SEGMENT != 0;
        let mut header = ChunkHeader {
            tick: self.tick,
            base_us: 1_000_000_000 + self.tick * 1_000_000,
            epoch: 1,
            segment: segment as u32,
            flags,
            closes: if closes { self.closes[segment] } else { 0 },
            members: test_members(),
            ..ChunkHeader::default()
        };
        header.stamp.seq = self.seq;
        self.seq += 1;
        if let Err(error) = self.stage.process(&header, black_box(events), &mut self.outlet) {
            eprintln!("{error}");
        }
    }
}

/// An outlet with one buffer, as a slot of shared memory is used again and again.
#[derive(Default)]
struct Reused {
    buffer: Vec<u8>,
    frames: usize,
}

impl Outlet<Frames> for Reused {
    fn emit(
        &mut self,
        header: FrameHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), StageError> {
        self.buffer.resize(self.buffer.len().max(len), 0);
        fill(&mut self.buffer[..len]);
        self.frames += usize::from(header.reason == 0);
        black_box(&mut self.buffer);
        Ok(())
    }
}

/// All members of the plans of [`plan`].
fn test_members() -> evpr_core::MemberSet {
    (0..4).collect()
}

/// One reconstruction of this kind with these windows (ms) in a tick of one second.
fn plan(kind: &str, sensor: Sensor, windows_ms: &[u64], align: Align) -> Plan {
    let mut plan: Plan = test_plan();
    let found = kinds().iter().filter(|k| k.name == kind);
    plan.reconstructions = found
        .map(|info| Reconstruction {
            id: kind.to_owned(),
            kind: kind.to_owned(),
            channels: info.channel_order.channels(),
            masks_hot_pixels: info.masks_hot_pixels,
            params: Params(
                info.params
                    .iter()
                    .map(|p| (p.name.to_owned(), p.default_value()))
                    .collect(),
            ),
            optional: false,
            network: None,
        })
        .collect();
    plan.sensor = sensor;
    plan.slicing.tick = 1000 * MS;
    plan.slicing.align = align;
    plan.slicing.windows = windows_ms.iter().map(|ms| ms * MS).collect();
    plan.members = (0..windows_ms.len())
        .map(|window| Member {
            name: format!("{kind}@{window}/x"),
            reconstruction: 0,
            window,
            extractor: 0,
            enabled: true,
            weight: 1.0,
        })
        .collect();
    plan
}

/// Reads every event once.
fn plain_read(events: &[Event]) -> u32 {
    let mut lanes = [0u32; 16];
    for block in events.as_chunks::<16>().0 {
        for (lane, e) in lanes.iter_mut().zip(block) {
            *lane = lane
                .wrapping_add(e.t_us)
                .wrapping_add(u32::from(e.x) << 16 | u32::from(e.y_polarity));
        }
    }
    lanes.iter().fold(0, |sum, lane| sum.wrapping_add(*lane))
}

/// Event i of n from number i of SplitMix64 (Steele, Lea, Flood 2014): low half column, high half row, lowest bit
/// polarity; time i / n s. scripts/bench_numpy.py makes the same.
fn events(sensor: Sensor, count: usize) -> Vec<Event> {
    let within = |half: u64, n: usize| ((half * n as u64) >> 32) as u16;
    (0..count)
        .map(|i| {
            let mut z = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            z ^= z >> 31;
            let t_us = (i as u64 * 1_000_000 / count as u64) as u32;
            let (x, y) = (
                within(z & 0xFFFF_FFFF, sensor.width),
                within(z >> 32, sensor.height),
            );
            Event::new(t_us, x, y, z & 1 == 1)
        })
        .collect()
}

fn timed(run: impl FnOnce()) -> f64 {
    let start = Instant::now();
    run();
    start.elapsed().as_secs_f64()
}

fn median(mut run: impl FnMut() -> f64) -> f64 {
    run();
    middle((0..REPEATS).map(|_| run()).collect())
}

fn middle(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
