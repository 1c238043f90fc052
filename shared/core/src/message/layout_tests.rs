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
    layout!(Stamp, 32, run_id: 0, seq: 8, sent_ns: 16, service: 24, incarnation: 28);
    layout!(Life, 40, closed_ns: 0, reconstruct_started_ns: 8, reconstructed_ns: 16, extract_started_ns: 24, extracted_ns: 32);
    layout!(ChunkHeader, 104, stamp: 0, tick: 32, base_us: 40, closed_ns: 48, epoch: 56, segment: 60, flags: 64, closes: 68, members: 72);
    layout!(FrameHeader, 120, stamp: 0, tick: 32, events: 40, life: 48, epoch: 88, reconstruction: 92, window: 96,
        height: 100, width: 104, channel_order: 108, reason: 112, extractors: 116);
    layout!(DescriptorHeader, 104, stamp: 0, tick: 32, life: 40, epoch: 80, member: 84, reason: 88, dim: 92,
        reconstruct_service: 96, reconstruct_incarnation: 100);
    layout!(TickHeader, 112, stamp: 0, tick: 32, start_us: 40, end_us: 48, closed_ns: 56, control_version: 64,
        members: 72, epoch: 104, kind: 108);
    layout!(MemberSetting, 16, weight: 0, enabled: 8);
    layout!(ControlHeader, 40, stamp: 0, version: 32);
    layout!(ServiceState, 16, incarnation: 0, dead_through: 4, health: 8);
    layout!(LifecycleHeader, 40, stamp: 0, version: 32);
    layout!(Candidate, 16, score: 0, reference: 8);
    layout!(MatchHeader, 400, stamp: 0, tick: 32, start_us: 40, end_us: 48, reference: 56, score: 64, confidence: 72,
        east_m: 80, north_m: 88, reconstruct_ns: 96, extract_ns: 104, fuse_ns: 112, total_ns: 120, reason: 128,
        candidates: 132, control_version: 136, ends: 144);
    layout!(StatsHeader, 2776, stamp: 0, phase: 32, pid: 36, next_tick: 40, received: 48, emitted: 56, skipped: 64,
        dropped: 72, refused: 80, events: 88, progress_permille: 96, waiting: 104, processing: 1440);
}
