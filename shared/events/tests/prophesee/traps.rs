//! What decoders get wrong, each with its right answer.

use super::words::*;
use evpr_events::MAX_TIME_NS;
use evpr_events::formats::prophesee::{Decoder, Encoding, Evt3Decoder, Evt21Order, PassedOver};

/// The range of the time in EVT 3.0, µs, and of EVT 2.
const EVT3_RANGE: u64 = 1 << 24;
const EVT2_RANGE: u64 = 1 << 34;

fn evt3_times(words: &[u16]) -> Vec<u64> {
    let (events, _) = decode(Encoding::Evt3, &evt3(words));
    events.iter().map(|e| e.0).collect()
}

#[test]
fn evt3_time_wraps_every_16_777216_s() {
    let words = [
        high(4095),
        low(4095),
        y(1),
        on(0), // last µs of the first range
        high(0),
        low(0),
        on(0),
        high(2048),
        low(7),
        on(0),
        high(4095),
        low(0),
        on(0),
        high(1),
        low(0),
        on(0), // another wrap, with high 0 missing
    ];
    let half = EVT3_RANGE + 2048 * 4096 + 7;
    let want = [
        EVT3_RANGE - 1,
        EVT3_RANGE,
        half,
        2 * EVT3_RANGE - 4096,
        2 * EVT3_RANGE + 4096,
    ];
    assert_eq!(evt3_times(&words), want);
}

#[test]
fn evt3_wraps_although_the_highs_around_it_are_missing() {
    // 4000 to 300 is 396 × 4096 µs = 1.6 s on, not 15 s back.
    let words = [high(4000), low(1), y(1), on(0), high(300), low(2), on(0)];
    assert_eq!(evt3_times(&words), [4000 * 4096 + 1, EVT3_RANGE + 300 * 4096 + 2]);
}

#[test]
fn a_small_step_back_of_evt3_is_no_wrap() {
    let words = [
        high(10),
        low(5),
        y(1),
        on(0),
        high(9),
        low(6),
        on(0), // 4 ms back
        high(10),
        low(7),
        on(0),
        high(4000),
        low(0),
        high(1),
        low(0),
        on(0), // a wrap
        high(4095),
        low(9),
        on(0), // back over its edge
        high(1),
        low(1),
        on(0), // and on over it again: once in all
    ];
    let want = [
        10 * 4096 + 5,
        9 * 4096 + 6,
        10 * 4096 + 7,
        EVT3_RANGE + 4096,
        EVT3_RANGE - 4096 + 9,
        EVT3_RANGE + 4097,
    ];
    assert_eq!(evt3_times(&words), want);
}

#[test]
fn half_the_range_of_evt3_decides() {
    // 2047 back is back; 2048 back is on.
    let words = [high(3000), low(0), y(1), high(953), low(0), on(0)];
    assert_eq!(evt3_times(&words), [953 * 4096]);
    let words = [high(3000), low(0), y(1), high(952), low(0), on(0)];
    assert_eq!(evt3_times(&words), [EVT3_RANGE + 952 * 4096]);
}

#[test]
fn a_new_high_begins_at_low_zero_and_the_same_high_changes_nothing() {
    let words = [
        high(1),
        low(9),
        y(1),
        high(1),
        on(0),
        high(2),
        on(1),
        low(3),
        on(2),
    ];
    assert_eq!(evt3_times(&words), [4096 + 9, 8192, 8192 + 3]);
}

#[test]
fn times_of_evt3_may_repeat_and_go_back() {
    let words = [
        high(1),
        low(9),
        y(1),
        on(0),
        low(9),
        on(0),
        low(4),
        on(0),
        low(9),
        on(0),
    ];
    assert_eq!(evt3_times(&words), [4105, 4105, 4100, 4105]);
}

#[test]
fn evt3_joined_in_its_middle_leaves_out_what_cannot_be_known() {
    let words = [
        0x4fff, // 12 events of a vector without base, row and time
        on(1),
        low(5),
        y(3),
        on(2),
        0x3864, // base 100, ON
        0x5003, // 2 events without time
        high(1),
        on(3), // the low half is not known yet
        low(6),
        on(4),
        0x4001, // the vector goes on: its base has moved by 8
    ];
    let (events, passed) = decode(Encoding::Evt3, &evt3(&words));
    assert_eq!(events, [(4096 + 6, 4, 3, true), (4096 + 6, 108, 3, true)]);
    let want = PassedOver {
        triggers: 0,
        before_start: 12 + 1 + 1 + 2 + 1,
    };
    assert_eq!(passed, want);

    // A time, but no row, and no base.
    let words = [
        high(1),
        low(6),
        on(1),
        0x4007,
        y(0),
        on(2),
        0x4007,
        0x3000,
        0x4001,
    ];
    let (events, passed) = decode(Encoding::Evt3, &evt3(&words));
    assert_eq!(events, [(4102, 2, 0, true), (4102, 0, 0, false)]);
    assert_eq!(passed.before_start, 1 + 3 + 3);
}

#[test]
fn pixels_that_no_sensor_has_are_kept_for_the_screen() {
    let mut words = vec![high(1), low(0), y(2047), on(2047), 0x3fff];
    words.extend([0x4800; 6000]); // the base moves on far beyond
    let (events, _) = decode(Encoding::Evt3, &evt3(&words));
    assert_eq!(events[0], (4096, 2047, 2047, true));
    assert_eq!(events[1], (4096, 2047 + 11, 2047, true));
    assert_eq!(events[2], (4096, 2047 + 23, 2047, true));
    assert_eq!(events[6000], (4096, u16::MAX, 2047, true));
}

const EVT2_HIGH_END: u32 = 0x8fff_ffff;

fn evt2_event(low: u32, x: u32, y: u32, on: u32) -> u32 {
    on << 28 | low << 22 | x << 11 | y
}

#[test]
fn evt2_time_is_of_34_bits_and_wraps() {
    let words = [
        evt2_event(1, 2, 3, 1), // before any time
        EVT2_HIGH_END,
        evt2_event(63, 2047, 5, 1),
        0x8000_0000,
        evt2_event(0, 0, 2047, 0),
        EVT2_HIGH_END, // back over the edge
        evt2_event(0, 7, 8, 0),
        0x8000_0001,
        0xa000_0000,
        0xe000_0000,
        0xf000_0000,
        0x2000_0000,
        evt2_event(2, 7, 8, 1),
        0x8000_0000, // a small step back
        evt2_event(2, 7, 8, 1),
        evt2_event(2, 7, 8, 1),
        evt2_event(1, 7, 8, 1),
    ];
    let (events, passed) = decode(Encoding::Evt2, &evt2(&words));
    let want = [
        (EVT2_RANGE - 1, 2047, 5, true),
        (EVT2_RANGE, 0, 2047, false),
        (EVT2_RANGE - 64, 7, 8, false),
        (EVT2_RANGE + 66, 7, 8, true),
        (EVT2_RANGE + 2, 7, 8, true),
        (EVT2_RANGE + 2, 7, 8, true),
        (EVT2_RANGE + 1, 7, 8, true),
    ];
    assert_eq!(events, want);
    let want = PassedOver {
        triggers: 1,
        before_start: 1,
    };
    assert_eq!(passed, want);
}

#[test]
fn evt21_has_vectors_of_32_in_two_orders_of_bytes() {
    let word = |upper: u32, lower: u32| u64::from(upper) << 32 | u64::from(lower);
    let words = [
        word(evt2_event(1, 32, 3, 1), 0x8000_0001), // before any time
        word(0x8000_0002, 0),
        word(evt2_event(5, 64, 3, 1), 0x8000_0005),
        word(evt2_event(6, 2047, 4, 0), u32::MAX),
        word(evt2_event(6, 0, 4, 0), 0),
        word(0xa000_0000, 0xffff_ffff),
        word(0xe000_0000, 0xffff_ffff),
        word(0x3000_0000, 0xffff_ffff),
        word(EVT2_HIGH_END, 0),
        word(0x8000_0000, 0),
        word(evt2_event(0, 1, 1, 1), 1),
    ];
    let mut want = vec![(133, 64, 3, true), (133, 66, 3, true), (133, 95, 3, true)];
    want.extend((0..32).map(|i| (134, 2047 + i, 4, false)));
    // To the end of the range is nearer back than on, but nothing lies before 0.
    want.push((EVT2_RANGE, 1, 1, true));
    let passed = PassedOver {
        triggers: 1,
        before_start: 2,
    };
    let little = Encoding::Evt21(Evt21Order::Little);
    assert_eq!(decode(little, &evt21(&words)), (want.clone(), passed));
    let swapped: Vec<u64> = words.iter().map(|w| w.rotate_left(32)).collect();
    let legacy = Encoding::Evt21(Evt21Order::HalvesSwapped);
    assert_eq!(decode(legacy, &evt21(&swapped)), (want, passed));
    // The vendor's example of the two orders.
    let word = 0x0102_0304_0506_0708_u64;
    assert_eq!(word.to_le_bytes(), [8, 7, 6, 5, 4, 3, 2, 1]);
    assert_eq!(word.rotate_left(32).to_le_bytes(), [4, 3, 2, 1, 8, 7, 6, 5]);
}

#[test]
fn dat_time_overflows_after_71_minutes() {
    let bytes = [
        dat(u32::MAX - 1, 16383, 0, 1),
        dat(0, 0, 16383, 0),
        dat(u32::MAX, 1, 2, 2), // back over the edge
        dat(5, 1, 2, 0),
        dat(5, 1, 2, 0),
        dat(4, 1, 2, 1),
    ]
    .concat();
    let end = u64::from(u32::MAX);
    let want = [
        (end - 1, 16383, 0, true),
        (end + 1, 0, 16383, false),
        (end, 1, 2, true),
        (end + 6, 1, 2, false),
        (end + 6, 1, 2, false),
        (end + 5, 1, 2, true),
    ];
    assert_eq!(decode(Encoding::Dat, &bytes).0, want);
}

#[test]
fn times_never_pass_the_greatest() {
    let mut decoder = Evt3Decoder::with_time_base(u64::MAX);
    let mut out = Vec::new();
    for step in 0..100_u32 {
        let words = [high((step * 1000 % 4096) as u16), low(4095), y(0), on(0)];
        decoder.decode(&evt3(&words), &mut out);
    }
    assert!(out.len() == 100 && out.iter().all(|e| e.t_ns <= MAX_TIME_NS));
}

#[test]
fn the_other_decoder_of_evt3_wraps_as_ours_does_where_it_sees_the_wrap() {
    // Over several ranges in steps of 40 ms, and once over the edge at its very end.
    let mut words = vec![y(0)];
    for step in 0..4000_u32 {
        words.extend([
            high((step * 10 % 4096) as u16),
            low((step % 4096) as u16),
            on(step as u16 & 0x7ff),
        ]);
    }
    let mut theirs = (Vec::new(), Vec::new());
    // It passes over what stands before the first time, the row included.
    words.rotate_left(1);
    words.pop();
    words.insert(2, y(0));
    evt3::Evt3Decoder::new().decode_buffer(&words, &mut theirs.0, &mut theirs.1);
    let theirs: Vec<u64> = theirs.0.iter().map(|e| e.timestamp).collect();
    assert_eq!(evt3_times(&words), theirs);
    assert!(theirs[3999] > 9 * EVT3_RANGE);

    // With the highs next to the edge missing, it does not see the wrap: then time goes back by 14.8 s.
    let words = [high(4000), low(0), y(0), on(0), high(300), low(0), on(0)];
    let mut theirs = (Vec::new(), Vec::new());
    evt3::Evt3Decoder::new().decode_buffer(&words, &mut theirs.0, &mut theirs.1);
    assert_eq!(theirs.0[1].timestamp, 300 * 4096);
    assert_eq!(evt3_times(&words)[1], EVT3_RANGE + 300 * 4096);
}
