//! Frames against the independent NumPy formulas: tests/golden, made by scripts/make_golden.py.
#![allow(clippy::unwrap_used, clippy::panic)] // in the tests' helpers too

mod common;

use common::{Frame, METHODS, Recorded, cut, feed, from_root, plan, stream};
use evpr_core::plan::{Align, Plan, Sensor};
use evpr_reconstruct::build;
use ndarray::{Array4, ArrayD};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// A stream of the script, with its slicing.
struct Case {
    name: &'static str,
    plan: Plan,
    events: Vec<Recorded>,
    ticks: u64,
    /// Every so many pixels of the time surface are kept.
    step: usize,
}

/// seed, count, spread µs.
fn seeded(name: &'static str, random: (u64, usize, u64), plan: Plan, step: usize) -> Case {
    let events = stream(random.0, random.1, plan.sensor, random.2);
    let span = events[events.len() - 1].t_ns - events[0].t_ns;
    Case {
        name,
        ticks: span / plan.slicing.tick,
        plan,
        events,
        step,
    }
}

fn ms(values: &[u64]) -> Vec<u64> {
    values.iter().map(|v| v * 1_000_000).collect()
}

fn small() -> Case {
    let sensor = Sensor {
        height: 24,
        width: 32,
    };
    let plan = plan(sensor, &METHODS, 50_000_000, &ms(&[20, 50]), Align::Start, 1);
    seeded("small", (1, 4000, 100), plan, 1)
}

fn davis() -> Case {
    let sensor = Sensor {
        height: 260,
        width: 346,
    };
    let plan = plan(sensor, &METHODS, 200_000_000, &ms(&[50, 200]), Align::Start, 1);
    seeded("davis", (2, 200_000, 10), plan, 8)
}

fn hd() -> Case {
    let sensor = Sensor {
        height: 720,
        width: 1280,
    };
    let plan = plan(sensor, &METHODS, 200_000_000, &ms(&[100, 300]), Align::End, 1);
    seeded("hd", (3, 400_000, 5), plan, 24)
}

/// The first ticks of a real recording; `None` where it is absent.
fn corridor(test: &str) -> Option<Case> {
    let path = from_root("../shared/data/corridor/query_events.h5");
    if !path.exists() {
        println!("skipped: {test}: {} is absent", path.display());
        return None;
    }
    let file = hdf5_reader::Hdf5File::open(&path).unwrap();
    let t: ArrayD<u64> = file.dataset("/events/timestamps").unwrap().read_array().unwrap();
    let x: ArrayD<u16> = file
        .dataset("/events/x_coordinates")
        .unwrap()
        .read_array()
        .unwrap();
    let y: ArrayD<u16> = file
        .dataset("/events/y_coordinates")
        .unwrap()
        .read_array()
        .unwrap();
    let p: ArrayD<u8> = file.dataset("/events/polarities").unwrap().read_array().unwrap();
    let events = t.iter().zip(&x).zip(&y).zip(&p).map(|(((t, x), y), p)| Recorded {
        t_ns: *t,
        x: *x,
        y: *y,
        on: *p == 1,
    });
    let sensor = Sensor {
        height: 128,
        width: 128,
    };
    Some(Case {
        name: "corridor",
        plan: plan(sensor, &METHODS, 500_000_000, &ms(&[250, 500]), Align::Start, 1),
        events: events.take(600_000).collect(),
        ticks: 20,
        step: 6,
    })
}

/// The frames with an image of one method, in the order they came.
fn frames(case: &Case, method: usize) -> Vec<Frame> {
    let mut stage = build(&case.plan, method).unwrap();
    let enabled = case.plan.enabled_members();
    let mut pieces = 0;
    let mut vary = || {
        pieces = pieces % 5 + 1;
        pieces
    };
    let chunks = cut(&case.plan, &case.events, case.ticks, &mut vary, &|_| enabled);
    let mut frames = feed(&mut stage, &chunks);
    frames.retain(|(header, _)| header.reason == 0);
    frames
}

fn check_digests(case: &Case) {
    let table = std::fs::read_to_string(from_root("tests/golden/frame_digests.csv")).unwrap();
    for (method, name) in METHODS.iter().enumerate().take(2) {
        let golden: BTreeMap<String, &str> = table
            .lines()
            .filter_map(|line| line.strip_prefix(&format!("{},{name},", case.name)))
            .filter_map(|line| line.rsplit_once(',').map(|(key, sum)| (key.to_owned(), sum)))
            .collect();
        let frames = frames(case, method);
        assert!(!frames.is_empty());
        assert_eq!(frames.len(), golden.len(), "{name} of {}", case.name);
        for (header, pixels) in frames {
            let window_us = case.plan.slicing.windows[header.window as usize] / 1000;
            let key = format!("{},{window_us}", header.tick);
            let sum: String = Sha256::digest(&pixels)
                .iter()
                .map(|b| format!("{b:02x}"))
                .collect();
            assert_eq!(
                golden.get(&key),
                Some(&sum.as_str()),
                "{name} of {}, {key}",
                case.name
            );
        }
    }
}

/// At most 1 level apart, on at most 0.1 % of the pixels (times arrive as whole µs).
fn check_surface(case: &Case) {
    let path = from_root(&format!("tests/golden/time_surface_{}.npy", case.name));
    let golden: Array4<u8> = ndarray_npy::read_npy(path).unwrap();
    let frames = frames(case, 2);
    assert_eq!(frames.len(), golden.len_of(ndarray::Axis(0)));
    let width = case.plan.sensor.width;
    let (mut apart, mut bright) = (0, 0);
    for ((i, y, x, channel), expected) in golden.indexed_iter() {
        let got = frames[i].1[((y * width + x) * case.step) * 3 + channel];
        let (y, x) = (y * case.step, x * case.step);
        assert!(
            got.abs_diff(*expected) <= 1,
            "frame {i}, ({y}, {x}): {got}, not {expected}"
        );
        apart += usize::from(got != *expected);
        bright += usize::from(got > 0);
    }
    assert!(bright > 100, "only {bright} pixels say anything");
    assert!(apart * 1000 <= golden.len(), "{apart} of {} differ", golden.len());
    println!(
        "{}: {apart} of {} numbers differ by one level",
        case.name,
        golden.len()
    );
}

#[test]
fn small_frames_equal_the_golden_ones() {
    let case = small();
    for (method, name) in METHODS.iter().enumerate().take(2) {
        let path = from_root(&format!("tests/golden/frames_small_{name}.npy"));
        let golden: ArrayD<u8> = ndarray_npy::read_npy(path).unwrap();
        let frames: Vec<u8> = frames(&case, method).into_iter().flat_map(|(_, p)| p).collect();
        assert_eq!(frames, golden.into_raw_vec_and_offset().0, "{name}");
    }
    check_digests(&case);
    check_surface(&case);
}

#[test]
fn frames_of_346_by_260_equal_the_golden_ones() {
    check_digests(&davis());
    check_surface(&davis());
}

#[test]
fn frames_of_1280_by_720_equal_the_golden_ones() {
    check_digests(&hd());
    check_surface(&hd());
}

#[test]
fn frames_of_a_recording_equal_the_golden_ones() {
    if let Some(case) = corridor("frames_of_a_recording_equal_the_golden_ones") {
        check_digests(&case);
        check_surface(&case);
    }
}
