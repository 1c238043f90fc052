//! What a shift, other light and noise do to each kind, on frames of a real recording.
#![allow(clippy::unwrap_used)] // in the tests' helpers too

use evpr_core::message::{ChannelOrder, FrameHeader};
use evpr_core::plan::{Params, Plan, Sensor, test_plan};
use evpr_core::stage::{Kept, Stage};
use evpr_extract::{build, kinds};
use ndarray::ArrayD;
use std::path::PathBuf;

const SIDE: usize = 128;
const TICK_NS: u64 = 500_000_000;

/// `event_count_no_polarity` at 500 ms; `None` where the recording is absent.
fn frames(test: &str) -> Option<Vec<Vec<u8>>> {
    let shared = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let path = shared.join("data/corridor/reference_events.h5");
    if !path.exists() {
        println!("skipped: {test}: {} is absent", path.display());
        return None;
    }
    let file = hdf5_reader::Hdf5File::open(&path).unwrap();
    let t: ArrayD<u64> = file.dataset("/events/timestamps").unwrap().read_array().unwrap();
    let axis = |name: &str| -> ArrayD<u16> { file.dataset(name).unwrap().read_array().unwrap() };
    let (x, y) = (axis("/events/x_coordinates"), axis("/events/y_coordinates"));
    let start = *t.first().unwrap();
    let ticks = (t.last().unwrap() - start) / TICK_NS;
    let mut counts = vec![vec![0u32; SIDE * SIDE]; ticks as usize];
    for ((t, x), y) in t.iter().zip(&x).zip(&y) {
        if let Some(counts) = counts.get_mut(((t - start) / TICK_NS) as usize) {
            counts[usize::from(*y) * SIDE + usize::from(*x)] += 1;
        }
    }
    let level = |n: u32| (((n as f32).tanh() + 1.0) / 2.0 * 255.0) as u8;
    Some(
        counts
            .into_iter()
            .map(|c| c.into_iter().map(level).collect())
            .collect(),
    )
}

/// SplitMix64 (Steele, Lea, Flood 2014).
struct Random(u64);

impl Random {
    /// Uniform in [from, to).
    fn between(&mut self, from: f64, to: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        from + (to - from) * ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A copy moved by up to `shift` pixels each way (the border repeated), seen under other light (gain along a slope, and
/// gamma), with noise of standard deviation 25 on each pixel and 2 % of the pixels black or white.
fn spoilt(frame: &[u8], shift: f64, random: &mut Random) -> Vec<u8> {
    let mut moved_by = || random.between(-shift, shift + 1.0).floor() as isize;
    let (down, right) = (moved_by(), moved_by());
    let (gain, gamma) = (random.between(-0.7, 0.2), random.between(0.6, 1.6));
    let slope = [random.between(-0.8, 0.8), random.between(-0.8, 0.8)];
    let place = |i: usize, by: isize| (i as isize - by).clamp(0, SIDE as isize - 1) as usize;
    let middle = |i: usize| i as f64 / SIDE as f64 - 0.5;
    let mut out = Vec::with_capacity(frame.len());
    for y in 0..SIDE {
        for x in 0..SIDE {
            let level = f64::from(frame[place(y, down) * SIDE + place(x, right)]) / 255.0;
            let light = (gain + slope[0] * middle(y) + slope[1] * middle(x)).exp();
            // A sum of twelve uniform numbers is near enough normal.
            let noise: f64 = (0..12).map(|_| random.between(-0.5, 0.5)).sum();
            let value = match random.between(0.0, 1.0) {
                u if u < 0.01 => 0.0,
                u if u < 0.02 => 255.0,
                _ => 255.0 * level.powf(gamma) * light + 25.0 * noise,
            };
            out.push(value.clamp(0.0, 255.0) as u8);
        }
    }
    out
}

/// An extractor of this kind with its defaults.
fn plan(kind: &str) -> Plan {
    let info = kinds().iter().find(|k| k.name == kind).unwrap();
    let defaults = info.params.iter().map(|p| (p.name.to_owned(), p.default_value()));
    let mut plan = test_plan();
    plan.sensor = Sensor {
        height: SIDE,
        width: SIDE,
    };
    plan.reconstructions[0].channels = 1;
    plan.extractors[0].kind = kind.to_owned();
    plan.extractors[0].params = Params(defaults.collect());
    plan.extractors[0].dim = (info.dim)(&plan.extractors[0].params).unwrap();
    plan
}

fn rows(kind: &str, frames: &[Vec<u8>]) -> Vec<Vec<f32>> {
    let header = FrameHeader {
        height: SIDE as u32,
        width: SIDE as u32,
        channel_order: ChannelOrder::Grey as u32,
        extractors: 1,
        ..FrameHeader::default()
    };
    let mut stage = build(&plan(kind), 0).unwrap();
    let mut kept = Kept::default();
    for frame in frames {
        stage.process(&header, frame, &mut kept).unwrap();
    }
    kept.messages.into_iter().map(|(_, row)| row).collect()
}

/// The part of the queries whose nearest row is their own original's.
fn recall_at_1(queries: &[Vec<f32>], references: &[Vec<f32>]) -> f64 {
    let squares = |q: &[f32], r: &[f32]| -> f32 { q.iter().zip(r).map(|(q, r)| (q - r).powi(2)).sum() };
    let nearest = |q: &[f32]| {
        let distances = references.iter().map(|r| squares(q, r)).enumerate();
        distances.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0
    };
    let right = queries.iter().enumerate().filter(|(i, q)| nearest(q) == *i);
    right.count() as f64 / queries.len() as f64
}

#[test]
fn hog_stands_what_spoils_the_others() {
    let Some(frames) = frames("hog_stands_what_spoils_the_others") else {
        return;
    };
    for (shift, hog_at_least, margin) in [(3.0, 0.9, 0.1), (6.0, 0.55, 0.2)] {
        let mut random = Random(1);
        let spoilt: Vec<Vec<u8>> = frames.iter().map(|f| spoilt(f, shift, &mut random)).collect();
        let recall = |kind: &str| recall_at_1(&rows(kind, &spoilt), &rows(kind, &frames));
        let [hog, patch_norm, raw_pixels] = ["hog", "patch_norm", "raw_pixels"].map(recall);
        println!("shift {shift}: R@1 hog {hog:.3}, patch_norm {patch_norm:.3}, raw_pixels {raw_pixels:.3}");
        assert!(hog >= hog_at_least, "shift {shift}: {hog}");
        assert!(hog >= patch_norm.max(raw_pixels) + margin, "shift {shift}: {hog}");
    }
}
