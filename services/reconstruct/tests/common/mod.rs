//! What the tests share: plans, seeded events, a small ingest, and the formulas written straight down.
#![allow(dead_code)] // each test binary uses its part

use evpr_core::MemberSet;
use evpr_core::message::{ChunkHeader, Event, FrameHeader, Frames};
use evpr_core::plan::{
    Align, Extractor, Member, Origin, ParamValue, Params, Plan, Reconstruction, Sensor, SliceMode, Slicing,
    test_plan,
};
use evpr_core::stage::{Kept, Stage};
use evpr_reconstruct::Reconstruct;
use std::path::PathBuf;

pub(crate) const METHODS: [&str; 3] = ["event_count", "event_count_no_polarity", "time_surface"];

/// An event as a recording has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Recorded {
    pub(crate) t_ns: u64,
    pub(crate) x: u16,
    pub(crate) y: u16,
    pub(crate) on: bool,
}

impl Recorded {
    pub(crate) fn t_us(self) -> u64 {
        self.t_ns / 1000
    }
}

/// A plan with one reconstruction per kind, these windows, and so many extractors; all combinations are members,
/// in the order reconstruction, window, extractor.
pub(crate) fn plan(
    sensor: Sensor,
    kinds: &[&str],
    tick_ns: u64,
    windows_ns: &[u64],
    align: Align,
    extractors: usize,
) -> Plan {
    let mut plan = test_plan();
    plan.sensor = sensor;
    plan.slicing = Slicing {
        mode: SliceMode::Time,
        tick: tick_ns,
        windows: windows_ns.to_vec(),
        align,
        origin: Origin::FirstEvent,
    };
    plan.reconstructions = kinds.iter().map(|kind| reconstruction(kind)).collect();
    plan.extractors = vec![
        Extractor {
            id: "x".to_owned(),
            kind: "raw_pixels".to_owned(),
            dim: 3,
            params: Params::default(),
            optional: false,
            network: None,
        };
        extractors
    ];
    plan.members = (0..kinds.len())
        .flat_map(|r| (0..windows_ns.len()).flat_map(move |w| (0..extractors).map(move |e| (r, w, e))))
        .map(|(reconstruction, window, extractor)| Member {
            name: format!("{reconstruction}@{window}/{extractor}"),
            reconstruction,
            window,
            extractor,
            enabled: true,
            weight: 1.0,
        })
        .collect();
    plan
}

pub(crate) fn reconstruction(kind: &str) -> Reconstruction {
    let info = evpr_reconstruct::kinds().iter().find(|k| k.name == kind).unwrap();
    let params = info.params.iter();
    Reconstruction {
        id: kind.to_owned(),
        kind: kind.to_owned(),
        channels: info.channel_order.channels(),
        masks_hot_pixels: info.masks_hot_pixels,
        params: Params(params.map(|p| (p.name.to_owned(), p.default_value())).collect()),
        optional: false,
        network: None,
    }
}

pub(crate) fn set_tau(plan: &mut Plan, reconstruction: usize, tau_ns: i64) {
    let params = &mut plan.reconstructions[reconstruction].params.0;
    params.insert("tau".to_owned(), ParamValue::Integer(tau_ns));
}

/// SplitMix64 (Steele, Lea, Flood 2014), as in scripts/make_golden.py.
pub(crate) struct SplitMix(pub(crate) u64);

impl SplitMix {
    pub(crate) fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
}

/// A number below n that favours the small ones, as in scripts/make_golden.py.
fn below(r: u64, n: usize) -> u16 {
    let product = ((r & 0xFFFF_FFFF) * (r >> 32)) >> 32;
    ((product * n as u64) >> 32) as u16
}

/// The seeded stream of scripts/make_golden.py.
pub(crate) fn stream(seed: u64, count: usize, sensor: Sensor, spread_us: u64) -> Vec<Recorded> {
    let mut random = SplitMix(seed);
    let mut t_us = 1_000_000_007;
    (0..count)
        .map(|_| {
            let (a, b, c) = (random.draw(), random.draw(), random.draw());
            t_us += (c >> 2) % spread_us;
            Recorded {
                t_ns: t_us * 1000,
                x: below(a, sensor.width),
                y: below(b, sensor.height),
                on: c & 3 != 0,
            }
        })
        .collect()
}

pub(crate) type Chunk = (ChunkHeader, Vec<Event>);

/// Cuts events into the chunks of whole ticks, from tick 0 at the first event on. `pieces` says into how many chunks
/// each segment is split; `members` who is enabled at a tick.
pub(crate) fn cut(
    plan: &Plan,
    events: &[Recorded],
    ticks: u64,
    pieces: &mut dyn FnMut() -> usize,
    members: &dyn Fn(u64) -> MemberSet,
) -> Vec<Chunk> {
    let segments = plan.slicing.segments();
    let t0 = events.first().map_or(0, |e| e.t_ns);
    let mut chunks: Vec<Chunk> = Vec::new();
    for tick in 0..ticks {
        for (segment, edges) in segments.edges.windows(2).enumerate() {
            let start = t0 + tick * plan.slicing.tick;
            let at = |offset: u64| events.partition_point(|e| e.t_ns < start + offset);
            let inside = &events[at(edges[0])..at(edges[1])];
            let count = pieces().max(1);
            for piece in 0..count {
                let part = &inside[inside.len() * piece / count..inside.len() * (piece + 1) / count];
                // Any base will do that is not later than the first event.
                let base_us = part.first().map_or(0, |e| e.t_us() - e.t_us() % 4);
                let mut header = ChunkHeader {
                    tick,
                    base_us,
                    epoch: 1,
                    segment: segment as u32,
                    members: members(tick),
                    ..ChunkHeader::default()
                };
                header.stamp.seq = chunks.len() as u64;
                if piece == 0 {
                    header.flags |= ChunkHeader::OPENS_SEGMENT;
                }
                if piece + 1 == count {
                    header.flags |= ChunkHeader::CLOSES_SEGMENT;
                    header.closes = segments.closes(segment);
                    header.closed_ns = 1_000 + tick;
                }
                chunks.push((header, part.iter().map(|e| packed(*e, base_us)).collect()));
            }
        }
    }
    chunks
}

fn packed(event: Recorded, base_us: u64) -> Event {
    Event::new((event.t_us() - base_us) as u32, event.x, event.y, event.on)
}

pub(crate) type Frame = (FrameHeader, Vec<u8>);

/// Feeds chunks; every one of them must be accepted.
pub(crate) fn feed(stage: &mut Reconstruct, chunks: &[Chunk]) -> Vec<Frame> {
    let mut kept = Kept::<Frames>::default();
    for (header, events) in chunks {
        stage.process(header, events, &mut kept).unwrap();
    }
    kept.messages
}

/// The events of each window of each tick, straight from the definition: (tick, window, events), `None` where the
/// window would reach before tick 0.
pub(crate) fn windows<'a>(
    plan: &Plan,
    events: &'a [Recorded],
    ticks: u64,
) -> Vec<(u64, usize, Option<&'a [Recorded]>)> {
    let t0 = events.first().map_or(0, |e| e.t_ns);
    let tick_ns = plan.slicing.tick;
    let mut all = Vec::new();
    for tick in 0..ticks {
        for (window, length) in plan.slicing.windows.iter().enumerate() {
            let end = match plan.slicing.align {
                Align::Start => tick * tick_ns + length,
                Align::End => (tick + 1) * tick_ns,
            };
            let at = |offset: u64| events.partition_point(|e| e.t_ns < t0 + offset);
            let inside = end.checked_sub(*length).map(|start| &events[at(start)..at(end)]);
            all.push((tick, window, inside));
        }
    }
    all
}

/// The frame of these events by the formulas of the method, one event at a time; at least one event.
pub(crate) fn direct(kind: &str, sensor: Sensor, tau_us: f64, events: &[Recorded]) -> Vec<u8> {
    let pixels = sensor.pixels();
    let at = |e: &Recorded| usize::from(e.y) * sensor.width + usize::from(e.x);
    let count = |wanted: &dyn Fn(&Recorded) -> bool| {
        let mut n = vec![0u32; pixels];
        events.iter().filter(|e| wanted(e)).for_each(|e| n[at(e)] += 1);
        n
    };
    let mut out = Vec::new();
    match kind {
        "event_count_no_polarity" => {
            for n in count(&|_| true) {
                out.push((((n as f32).tanh() + 1.0) / 2.0 * 255.0) as u8);
            }
        }
        "event_count" => {
            let tanh = |on: bool| -> Vec<f32> {
                count(&|e| e.on == on)
                    .into_iter()
                    .map(|n| (n as f32).tanh())
                    .collect()
            };
            let (off, on) = (tanh(false), tanh(true));
            let largest = |v: &[f32]| v.iter().copied().fold(0.0, f32::max);
            let (off_max, on_max) = (largest(&off), largest(&on));
            for i in 0..pixels {
                let level = |v: f32, max: f32| (v / (max + 1e-6) * 255.0) as u8;
                out.extend([level(off[i], off_max), level(on[i], on_max), 0]);
            }
        }
        "time_surface" => {
            let last_us = events.last().unwrap().t_us() as f64;
            let surface = |on: bool| -> Vec<f64> {
                let mut v = vec![0.0; pixels];
                for e in events.iter().filter(|e| e.on == on) {
                    let s = (-((last_us + tau_us) - e.t_us() as f64) / tau_us).exp();
                    v[at(e)] = s.clamp(0.0, 1.0).tanh();
                }
                v
            };
            let (off, on) = (surface(false), surface(true));
            let largest = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
            let (off_max, on_max) = (largest(&off), largest(&on));
            for i in 0..pixels {
                let level = |v: f64, max: f64| (v / (max + 1e-6) * 255.0) as u8;
                out.extend([level(on[i], on_max), level(off[i], off_max), 0]);
            }
        }
        other => panic!("no method {other}"),
    }
    out
}

/// A path from the project's root.
pub(crate) fn from_root(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}
