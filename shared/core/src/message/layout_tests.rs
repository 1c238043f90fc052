//! Pins the layout of everything that crosses process borders. When one of these fails, give the type a new
//! version number in its `type_name` and then the test its new numbers.

use super::*;
use std::mem::{offset_of, size_of};

macro_rules! layout {
    ($type:ty, $size:expr, $($field:ident: $offset:expr),+ $(,)?) => {
        assert_eq!(size_of::<$type>(), $size, concat!("size of ", stringify!($type)));
        $(assert_eq!(offset_of!($type, $field), $offset, concat!(stringify!($type), ".", stringify!($field)));)+
    };
}

#[test]
fn layouts_are_as_published() {
    layout!(Event, 8, t_us: 0, x: 4, y_polarity: 6);
    layout!(Stamp, 40, run_id: 0, seq: 8, sent_ns: 16, service: 24, incarnation: 28, items: 32);
    layout!(Life, 40, closed_ns: 0, reconstruct_started_ns: 8, reconstructed_ns: 16, extract_started_ns: 24, extracted_ns: 32);
    layout!(ChunkHeader, 112,  stamp: 0, tick: 40, base_us: 48, closed_ns: 56, epoch: 64, segment: 68, flags: 72, closes: 76, members: 80);
    layout!(FrameHeader, 128,  stamp: 0, tick: 40, events: 48, life: 56, epoch: 96, reconstruction: 100, window: 104,
        height: 108, width: 112, channel_order: 116, reason: 120, extractors: 124);
    layout!(DescriptorHeader, 120,  stamp: 0, tick: 40, life: 48, epoch: 88, member: 92, reason: 96, dim: 100,
        reconstruct_service: 104, reconstruct_incarnation: 108, together: 112);
    layout!(TickHeader, 176,  stamp: 0, tick: 40, start_us: 48, end_us: 56, closed_ns: 64, east_m: 72, north_m: 80,
        control_version: 88, members: 96, fuse: 128, epoch: 168, kind: 172);
    layout!(FuseSettings, 40, length: 0, rule: 4, trim: 8, deadline_ns: 16, min_confidence: 24, sets_min_confidence: 32);
    layout!(MemberSetting, 16, weight: 0, enabled: 8, unload: 12);
    layout!(ControlHeader, 88,  stamp: 0, version: 40, fuse: 48);
    layout!(ServiceState, 16, incarnation: 0, dead_through: 4, health: 8);
    layout!(LifecycleHeader, 48,  stamp: 0, version: 40);
    layout!(Candidate, 16, score: 0, reference: 8);
    layout!(MatchHeader, 416,  stamp: 0, tick: 40, start_us: 48, end_us: 56, reference: 64, score: 72, confidence: 80,
        east_m: 88, north_m: 96, reconstruct_ns: 104, extract_ns: 112, fuse_ns: 120, total_ns: 128, reason: 136,
        candidates: 140, control_version: 144, complete: 152, ends: 160);
    layout!(LiveStats, 88, is_live: 0, connected: 4, dropped_ticks: 8, missed_ticks: 16, lost_events: 24, late_events: 32,
        disconnects: 40, jumps: 48, offset_ns: 56, drift_ppb: 64, delay_p50_ns: 72, delay_p99_ns: 80);
    layout!(StatsHeader, 5560,  stamp: 0, phase: 40, pid: 44, next_tick: 48, received: 56, emitted: 64, skipped: 72,
        dropped: 80, refused: 88, events: 96, progress_permille: 104, live: 112, doing: 200, progress_ns: 208, waiting: 216,
        processing: 1552, sending: 2888, age: 4224);
    layout!(MemberCost, 24, rows: 0, reconstruct_ns: 8, extract_ns: 16);
    layout!(Span, 48, sent_ns: 0, start_ns: 8, end_ns: 16, tick: 24, closed_ns: 32, kind: 40, part: 44);
    layout!(SpansHeader, 40, stamp: 0);
    layout!(ScoresHeader, 64, stamp: 0, tick: 40, references: 48, columns: 56);
}

#[test]
fn a_position_is_unknown_unless_both_numbers_are_there() {
    let at = |east_m, north_m| TickHeader {
        east_m,
        north_m,
        ..TickHeader::default()
    };
    assert_eq!(TickHeader::default().position(), None);
    assert_eq!(at(1.0, f64::NAN).position(), None);
    assert_eq!(at(f64::INFINITY, 0.0).position(), None);
    assert_eq!(at(1.0, -2.0).position(), Some([1.0, -2.0]));
}
