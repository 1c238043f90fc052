//! Rows against the independent NumPy formulas (tests/golden, made by scripts/make_golden.py), and what must hold for
//! any image.
#![allow(clippy::unwrap_used, clippy::panic)] // in the tests' helpers too

use evpr_core::message::{ChannelOrder, FrameHeader};
use evpr_core::plan::{ParamValue, Params, Plan, Sensor, test_plan};
use evpr_core::stage::{Kept, Stage};
use evpr_extract::{build, kinds};
use ndarray::Array1;
use proptest::prelude::*;
use std::path::PathBuf;

/// SplitMix64 (Steele, Lea, Flood 2014), as in scripts/make_golden.py.
fn split_mix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// The seeded image of scripts/make_golden.py.
fn image(mut seed: u64, sensor: Sensor, channels: usize) -> Vec<u8> {
    let row = sensor.width * channels;
    let mut pixels: Vec<u8> = (0..sensor.height * row)
        .map(|_| {
            let r = split_mix(&mut seed);
            (((r >> 56) * (r >> 48 & 255)) >> 8) as u8
        })
        .collect();
    pixels[..sensor.height / 2 * row].iter_mut().for_each(|v| *v /= 3);
    if channels == 3 {
        pixels.chunks_exact_mut(3).for_each(|p| p[2] = 0);
    }
    pixels
}

/// A plan with one extractor of this kind; parameters that are not given have their defaults.
fn plan(kind: &str, given: &[(&str, ParamValue)], sensor: Sensor, order: ChannelOrder) -> Plan {
    let info = kinds().iter().find(|k| k.name == kind).unwrap();
    let defaults = info.params.iter().map(|p| (p.name.to_owned(), p.default_value()));
    let mut params = Params(defaults.collect());
    for (name, value) in given {
        assert!(
            params.0.insert((*name).to_owned(), value.clone()).is_some(),
            "{name}"
        );
    }
    let mut plan = test_plan();
    plan.sensor = sensor;
    plan.reconstructions[0].channels = order.channels();
    plan.extractors[0].kind = kind.to_owned();
    plan.extractors[0].dim = (info.dim)(&params).unwrap();
    plan.extractors[0].params = params;
    plan
}

fn row(plan: &Plan, order: ChannelOrder, pixels: &[u8]) -> Vec<f32> {
    let header = FrameHeader {
        height: plan.sensor.height as u32,
        width: plan.sensor.width as u32,
        channel_order: order as u32,
        extractors: 1,
        ..FrameHeader::default()
    };
    let mut stage = build(plan, 0).unwrap();
    let mut kept = Kept::default();
    // Twice: nothing may be left over from the frame before.
    let other: Vec<u8> = pixels.iter().map(|v| 255 - v).collect();
    stage.process(&header, &other, &mut kept).unwrap();
    stage.process(&header, pixels, &mut kept).unwrap();
    kept.messages.pop().unwrap().1
}

fn check(
    case: &str,
    seed: u64,
    (height, width): (usize, usize),
    order: ChannelOrder,
    given: &[(&str, ParamValue)],
) {
    let kind = kinds().iter().find(|k| case.starts_with(k.name)).unwrap().name;
    let sensor = Sensor { height, width };
    let row = row(
        &plan(kind, given, sensor, order),
        order,
        &image(seed, sensor, order.channels()),
    );
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("../../tests/golden/rows_{case}.npy"));
    let golden: Array1<f64> = ndarray_npy::read_npy(path).unwrap();
    assert_eq!(row.len(), golden.len(), "{case}");
    let worst = row.iter().zip(&golden).map(|(a, b)| (f64::from(*a) - b).abs());
    let worst = worst.fold(0.0, f64::max);
    assert!(worst < 1e-6, "{case}: {worst}");
    println!("{case}: largest difference {worst:.1e}");
}

fn int(value: i64) -> ParamValue {
    ParamValue::Integer(value)
}

fn log1p() -> ParamValue {
    ParamValue::Text("log1p".to_owned())
}

#[test]
fn rows_equal_the_golden_ones() {
    use ChannelOrder::{Grey, OffOnZero, OnOffZero};
    check("hog_upscaled", 18, (10, 13), OffOnZero, &[]);
    check("hog_davis", 19, (260, 346), OnOffZero, &[]);
    check("hog_hd", 20, (720, 1280), Grey, &[]);
    check(
        "patch_norm_small",
        11,
        (24, 32),
        Grey,
        &[("side", int(8)), ("patch", int(4))],
    );
    check(
        "patch_norm_upscaled",
        12,
        (10, 13),
        OffOnZero,
        &[("side", int(16)), ("patch", int(2))],
    );
    check("patch_norm_davis", 13, (260, 346), OnOffZero, &[]);
    check("patch_norm_hd", 14, (720, 1280), Grey, &[]);
    check("raw_pixels_davis", 15, (260, 346), Grey, &[]);
    let seven = [("height", int(7)), ("width", int(7)), ("transform", log1p())];
    check("raw_pixels_log1p", 16, (128, 128), OnOffZero, &seven);
    check("raw_pixels_hd", 17, (720, 1280), OffOnZero, &[]);
}

const ORDERS: [ChannelOrder; 4] = [
    ChannelOrder::Grey,
    ChannelOrder::OffOnZero,
    ChannelOrder::OnOffZero,
    ChannelOrder::BlueGreenRed,
];

/// All kinds, with parameters of every sort.
fn plans(sensor: Sensor, order: ChannelOrder) -> Vec<Plan> {
    vec![
        plan("hog", &[], sensor, order),
        plan("patch_norm", &[], sensor, order),
        plan(
            "patch_norm",
            &[("side", int(6)), ("patch", int(3))],
            sensor,
            order,
        ),
        plan(
            "patch_norm",
            &[("side", int(5)), ("patch", int(1))],
            sensor,
            order,
        ),
        plan("raw_pixels", &[], sensor, order),
        plan("raw_pixels", &[("transform", log1p())], sensor, order),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(24) })]

    #[test]
    fn a_constant_image_has_a_zero_row(level in any::<u8>(), height in 1usize..80, width in 1usize..80, order in 0usize..4) {
        let (sensor, order) = (Sensor { height, width }, ORDERS[order]);
        let pixels = vec![level; sensor.pixels() * order.channels()];
        for plan in plans(sensor, order) {
            prop_assert!(row(&plan, order, &pixels).iter().all(|v| *v == 0.0));
        }
    }

    #[test]
    fn any_image_has_a_finite_row_of_length_one_or_zero(seed in any::<u64>(), height in 1usize..60, width in 1usize..60, order in 0usize..4) {
        let (sensor, order) = (Sensor { height, width }, ORDERS[order]);
        let pixels = image(seed, sensor, order.channels());
        for plan in plans(sensor, order) {
            let row = row(&plan, order, &pixels);
            prop_assert!(row.iter().all(|v| v.is_finite()));
            let length = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            prop_assert!(length == 0.0 || (length - 1.0).abs() < 1e-5, "{}", length);
        }
    }

    /// Brightness and contrast of the whole image do not matter (but for the 1e-6 beside the standard deviation).
    #[test]
    fn brightness_does_not_matter(seed in any::<u64>(), shift in 1u8..100) {
        let sensor = Sensor { height: 40, width: 40 };
        let pixels: Vec<u8> = image(seed, sensor, 1).iter().map(|v| v / 2).collect();
        let brighter: Vec<u8> = pixels.iter().map(|v| v + shift).collect();
        let order = ChannelOrder::Grey;
        for plan in plans(sensor, order).into_iter().take(5) {
            let (a, b) = (row(&plan, order, &pixels), row(&plan, order, &brighter));
            prop_assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6));
        }
    }
}
