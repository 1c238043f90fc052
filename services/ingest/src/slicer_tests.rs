//! The slicer against a plain computation of every segment, and its rules one by one.

use crate::testing::{KeptPort, Segment, Sent};
use crate::{MAX_GAP_TICKS, RawEvent, SliceTally, Slicer};
use evpr_core::message::{ChunkHeader, MemberSetting, TickKind};
use evpr_core::plan::{Align, Delivery, Origin, Pace, Plan, SliceMode, test_plan};
use evpr_core::stage::Settings;
use proptest::prelude::*;

const MS: u64 = 1_000_000;

fn plan(mode: SliceMode, tick: u64, windows: &[u64], align: Align) -> Plan {
    let mut plan = test_plan();
    plan.slicing.mode = mode;
    plan.slicing.tick = tick;
    plan.slicing.windows = windows.to_vec();
    plan.slicing.align = align;
    plan
}

fn at(t_ns: u64) -> RawEvent {
    RawEvent {
        t_ns,
        x: (t_ns % 6) as u16,
        y: (t_ns % 4) as u16,
        on: t_ns.is_multiple_of(3),
    }
}

fn slice(plan: &Plan, times: &[u64]) -> (Slicer, KeptPort) {
    let (mut slicer, mut port) = (Slicer::new(plan, 0, 1), KeptPort::default());
    let events: Vec<_> = times.iter().copied().map(at).collect();
    slicer.push(&events, &mut port).unwrap();
    (slicer, port)
}

/// (tick, segment, events, flags, closes) of each chunk.
fn chunks(port: &KeptPort) -> Vec<(u64, u32, usize, u32, u32)> {
    port.chunks()
        .map(|(h, e)| (h.tick, h.segment, e.len(), h.flags, h.closes))
        .collect()
}

const OPENS: u32 = ChunkHeader::OPENS_SEGMENT;
const CLOSES: u32 = ChunkHeader::CLOSES_SEGMENT;
use TickKind::{Close, End, Open};

#[test]
fn edges_are_half_open_and_unneeded_events_stay_behind() {
    let plan = plan(SliceMode::Time, 10 * MS, &[2 * MS, 5 * MS], Align::Start);
    let t0 = 1_000_000_123;
    let times = [
        t0,
        t0 + 2 * MS - 1,
        t0 + 2 * MS,
        t0 + 5 * MS,
        t0 + 10 * MS - 1,
        t0 + 10 * MS,
    ];
    let (mut slicer, mut port) = slice(&plan, &times);
    assert_eq!(slicer.finish(&mut port).unwrap(), 1);
    assert_eq!(
        chunks(&port),
        [
            (0, 0, 2, OPENS | CLOSES, 1),
            (0, 1, 1, OPENS | CLOSES, 2),
            (1, 0, 1, OPENS, 0)
        ]
    );
    assert_eq!(port.tick_numbers(), [(Open, 0), (Close, 0), (Open, 1), (End, 1)]);
    let first = port.ticks().next().unwrap().1;
    assert_eq!((first.start_us, first.end_us), (1_000_000, 1_010_000));
    assert_eq!(
        slicer.tally(),
        SliceTally {
            sent: 4,
            unneeded: 2,
            ..SliceTally::default()
        }
    );
    // Times count from the truncated start of the tick, truncated themselves.
    let (header, events) = port.chunks().next().unwrap();
    assert_eq!(
        (header.base_us, events[0].t_us, events[1].t_us),
        (1_000_000, 0, 2_000)
    );
}

#[test]
fn quiet_ticks_are_opened_closed_empty_and_closed() {
    let plan = plan(SliceMode::Time, 10 * MS, &[5 * MS, 10 * MS], Align::Start);
    let (_, port) = slice(&plan, &[0, 31 * MS]);
    let empty = |tick| [(tick, 0, 0, OPENS | CLOSES, 1), (tick, 1, 0, OPENS | CLOSES, 2)];
    let want: Vec<_> = [vec![(0, 0, 1, OPENS | CLOSES, 1), (0, 1, 0, OPENS | CLOSES, 2)]]
        .into_iter()
        .chain([1, 2].map(|k| empty(k).to_vec()))
        .flatten()
        .collect();
    assert_eq!(chunks(&port), want);
    let want = [
        (Open, 0),
        (Close, 0),
        (Open, 1),
        (Close, 1),
        (Open, 2),
        (Close, 2),
        (Open, 3),
    ];
    assert_eq!(port.tick_numbers(), want);
}

#[test]
fn a_watermark_closes_what_is_over() {
    let plan = plan(SliceMode::Time, 10 * MS, &[5 * MS], Align::Start);
    let (mut slicer, mut port) = slice(&plan, &[0]);
    assert_eq!(slicer.next_edge_ns(), Some(5 * MS));
    slicer.watermark(5 * MS - 1, &mut port).unwrap();
    assert_eq!(chunks(&port), []);
    port.now_ns = 77;
    slicer.watermark(5 * MS, &mut port).unwrap();
    assert_eq!(chunks(&port), [(0, 0, 1, OPENS | CLOSES, 1)]);
    assert_eq!(port.chunks().next().unwrap().0.closed_ns, 77);
    assert_eq!(port.tick_numbers(), [(Open, 0)]);
    port.now_ns = 99;
    slicer.watermark(10 * MS, &mut port).unwrap();
    let (kind, header) = port.ticks().last().unwrap();
    assert_eq!((kind, header.closed_ns), (Close, 77));
    assert_eq!(slicer.finish(&mut port).unwrap(), 1);
}

#[test]
fn latest_answers_a_tick_with_its_last_window() {
    let mut plan = plan(SliceMode::Time, 10 * MS, &[2 * MS, 5 * MS], Align::Start);
    plan.delivery = Delivery::Latest;
    let (mut slicer, mut port) = slice(&plan, &[0, 6 * MS]);
    assert_eq!(port.tick_numbers(), [(Open, 0), (Close, 0)]);
    assert_eq!(slicer.finish(&mut port).unwrap(), 1);
    let (mut slicer, mut port) = slice(&plan, &[0, 4 * MS]);
    assert_eq!(slicer.finish(&mut port).unwrap(), 0);
}

#[test]
fn counted_ticks_close_with_their_last_event() {
    let plan = plan(SliceMode::Count, 5, &[2, 3], Align::Start);
    let (mut slicer, mut port) = slice(&plan, &[1000, 2000, 3000, 9000, 9000, 9000, 12_000]);
    assert_eq!(
        chunks(&port),
        [
            (0, 0, 2, OPENS | CLOSES, 1),
            (0, 1, 1, OPENS | CLOSES, 2),
            (1, 0, 2, OPENS | CLOSES, 1)
        ]
    );
    assert_eq!(port.tick_numbers(), [(Open, 0), (Close, 0), (Open, 1)]);
    let spans: Vec<_> = port.ticks().map(|(_, h)| (h.start_us, h.end_us)).collect();
    assert_eq!(spans, [(1, 1), (1, 9), (9, 9)]);
    assert_eq!(slicer.finish(&mut port).unwrap(), 1);
    assert_eq!((slicer.tally().sent, slicer.tally().unneeded), (5, 2));
}

#[test]
fn windows_at_the_end_close_together() {
    let plan = plan(SliceMode::Time, 10 * MS, &[2 * MS, 25 * MS], Align::End);
    let (_, port) = slice(&plan, &[0, 9 * MS, 10 * MS]);
    // Segments [0, 5), [5, 8), [8, 10): the long window needs all of them.
    assert_eq!(
        chunks(&port),
        [
            (0, 0, 1, OPENS | CLOSES, 0),
            (0, 1, 0, OPENS | CLOSES, 0),
            (0, 2, 1, OPENS | CLOSES, 0b11)
        ]
    );
}

#[test]
fn origins() {
    let mut plan = plan(SliceMode::Time, 10 * MS, &[10 * MS], Align::Start);
    plan.slicing.origin = Origin::Grid(4 * MS);
    let (slicer, _) = slice(&plan, &[13 * MS]);
    assert_eq!(slicer.start_ns(), Some(12 * MS));
    plan.slicing.origin = Origin::At(12 * MS);
    let (slicer, port) = slice(&plan, &[3 * MS, 11 * MS, 12 * MS, 40 * MS]);
    assert_eq!(
        (
            slicer.tally().before_origin,
            port.chunks().next().unwrap().1.len()
        ),
        (2, 1)
    );
    let (_, port) = slice(&plan, &[33 * MS]);
    assert_eq!(
        port.tick_numbers(),
        [(Open, 0), (Close, 0), (Open, 1), (Close, 1), (Open, 2)]
    );
    plan.slicing.mode = SliceMode::Count;
    (plan.slicing.tick, plan.slicing.windows) = (2, vec![2]);
    let (slicer, port) = slice(&plan, &[3 * MS, 12 * MS, 13 * MS]);
    assert_eq!(
        (slicer.tally().before_origin, port.tick_numbers()),
        (1, vec![(Open, 0), (Close, 0)])
    );
}

#[test]
fn a_jump_ahead_is_an_error_that_names_both_times() {
    let plan = plan(SliceMode::Time, MS, &[MS], Align::Start);
    let (mut slicer, mut port) = slice(&plan, &[5]);
    let far = 5 + MS * (MAX_GAP_TICKS + 1);
    let error = slicer.push(&[at(6), at(far)], &mut port).unwrap_err().to_string();
    assert!(
        error.starts_with("time jumps ahead by 100.000 s: event 2 "),
        "{error}"
    );
    assert!(
        error.contains("100.001000005 s") && error.contains("0.000000006 s"),
        "{error}"
    );
    assert_eq!(slicer.finish(&mut port).unwrap(), 0);
    assert_eq!(port.segments()[0].2.len(), 2);
    let (mut slicer, mut port) = slice(&plan, &[5]);
    slicer.push(&[at(far - MS)], &mut port).unwrap();
    assert_eq!(slicer.finish(&mut port).unwrap(), MAX_GAP_TICKS);
    assert!(slicer.push(&[at(u64::MAX)], &mut port).is_err());
}

#[test]
fn long_ticks_take_newer_bases() {
    let hour = 3_600_000_000_000;
    let plan = plan(SliceMode::Time, 3 * hour, &[3 * hour], Align::Start);
    let (mut slicer, mut port) = slice(&plan, &[0, 1000, hour, 2 * hour, 2 * hour + 5000]);
    slicer.finish(&mut port).unwrap();
    let bases: Vec<_> = port
        .chunks()
        .map(|(h, e)| (h.base_us, e.len(), h.flags))
        .collect();
    assert_eq!(bases, [(0, 3, OPENS), (7_200_000_000, 2, 0)]);
    let times: Vec<_> = port.segments()[0].2.iter().map(|e| e.0).collect();
    assert_eq!(times, [0, 1, 3_600_000_000, 7_200_000_000, 7_200_000_005]);
}

#[test]
fn chunks_are_filled_and_no_larger() {
    let mut plan = plan(SliceMode::Time, 1000 * MS, &[1000 * MS], Align::Start);
    plan.source.pace = Pace::Factor(1.0);
    let most = plan.chunk_events();
    let times: Vec<u64> = (0..2 * most as u64).collect();
    let (mut slicer, mut port) = slice(&plan, &times);
    slicer.watermark(1000 * MS, &mut port).unwrap();
    assert_eq!(chunks(&port), [(0, 0, most, OPENS, 0), (0, 0, most, CLOSES, 1)]);
}

#[test]
fn members_change_at_an_opening() {
    let plan = plan(SliceMode::Time, 10 * MS, &[5 * MS], Align::Start);
    let (mut slicer, mut port) = (Slicer::new(&plan, 0, 3), KeptPort::default());
    let setting = |enabled, weight| MemberSetting {
        weight,
        enabled,
        unload: 0,
    };
    let settings = Settings {
        version: 7,
        members: vec![setting(0, 0.5), setting(1, 2.0)],
        ..Settings::default()
    };
    port.control = [None, Some(settings), None].into();
    slicer
        .push(&[at(0), at(12 * MS), at(30 * MS)], &mut port)
        .unwrap();
    let opened: Vec<_> = port
        .sent
        .iter()
        .filter_map(|s| match s {
            Sent::Tick(h, w) if h.kind == Open as u32 => Some((
                h.tick,
                h.control_version,
                h.members.iter().collect::<Vec<_>>(),
                w.clone(),
            )),
            _ => None,
        })
        .collect();
    assert_eq!(opened[0], (0, 0, vec![0, 1], vec![1.0, 1.0]));
    assert_eq!(opened[1], (1, 7, vec![1], vec![0.5, 2.0]));
    assert_eq!(opened[2], (2, 7, vec![1], vec![0.5, 2.0]));
    for (h, _) in port.chunks() {
        assert_eq!((h.members.contains(0), h.epoch), (h.tick == 0, 3));
    }
}

#[test]
fn events_that_no_enabled_member_wants_are_not_sent() {
    let plan = plan(SliceMode::Time, 10 * MS, &[5 * MS], Align::Start);
    let (mut slicer, mut port) = (Slicer::new(&plan, 0, 3), KeptPort::default());
    let settings = |version, enabled| Settings {
        version,
        members: vec![
            MemberSetting {
                enabled,
                ..MemberSetting::default()
            };
            2
        ],
        ..Settings::default()
    };
    port.control = [None, Some(settings(1, 0)), Some(settings(2, 1))].into();
    slicer
        .push(&[at(0), at(12 * MS), at(22 * MS), at(40 * MS)], &mut port)
        .unwrap();
    let sent: Vec<_> = port.chunks().map(|(h, events)| (h.tick, events.len())).collect();
    assert_eq!(sent, [(0, 1), (2, 1), (3, 0)]);
    let closed = port
        .tick_numbers()
        .into_iter()
        .filter(|(kind, _)| *kind == TickKind::Close);
    assert_eq!(
        closed.map(|(_, tick)| tick).collect::<Vec<_>>(),
        [0, 1, 2, 3],
        "ticks go on"
    );
    assert_eq!(slicer.tally().unneeded, 1);
}

#[test]
fn a_resumed_stream_is_the_rest_of_the_whole_one() {
    for mode in [SliceMode::Time, SliceMode::Count] {
        let plan = plan(mode, 100, &[30, 70], Align::Start);
        let events: Vec<_> = (0..1000).map(|i| at(5 + i)).collect();
        let (mut whole, mut whole_port) = (Slicer::new(&plan, 0, 1), KeptPort::default());
        whole.push(&events, &mut whole_port).unwrap();
        let (mut rest, mut rest_port) = (Slicer::new(&plan, 4, 1), KeptPort::default());
        rest.push(&events, &mut rest_port).unwrap();
        let later = |s: &&Sent| match s {
            Sent::Chunk(h, _) => h.tick >= 4,
            Sent::Tick(h, _) => h.tick >= 4,
        };
        let want: Vec<_> = whole_port.sent.iter().filter(later).collect();
        assert!(want.len() > 10);
        assert_eq!(rest_port.sent.iter().collect::<Vec<_>>(), want);
        assert_eq!(rest.tally().before_resume, 400);
    }
}

/// What each needed segment holds, computed one event at a time.
fn naive(plan: &Plan, events: &[RawEvent]) -> Vec<Segment> {
    let segments = plan.slicing.segments();
    let t0 = events[0].t_ns;
    let offsets: Vec<u64> = match plan.slicing.mode {
        SliceMode::Time => events.iter().map(|e| e.t_ns - t0).collect(),
        SliceMode::Count => (0..events.len() as u64).collect(),
    };
    let tick = plan.slicing.tick;
    let mut all = Vec::new();
    // One beyond the last event: in count mode the last edge may have been reached.
    let end = offsets.last().unwrap() + u64::from(plan.slicing.mode == SliceMode::Count);
    for k in 0..=end / tick {
        for (s, edge) in segments.edges.windows(2).enumerate() {
            let range = k * tick + edge[0]..k * tick + edge[1];
            let inside = offsets.iter().zip(events).filter(|(o, _)| range.contains(o));
            let found: Vec<_> = inside.map(|(_, e)| (e.t_ns / 1000, e.x, e.y, e.on)).collect();
            // A segment is heard of when it has closed, or when it has events.
            if segments.needed[s] && (range.end <= end || !found.is_empty()) {
                all.push((k, s as u32, found));
            }
        }
    }
    all
}

/// Each needed segment opens once and closes once, in order; only the last one may stay open.
fn check_flags(plan: &Plan, port: &KeptPort) {
    let segments = plan.slicing.segments();
    let mut open: Option<(u64, u32)> = None;
    let mut opened_tick = None;
    let mut base = 0;
    for sent in &port.sent {
        match sent {
            Sent::Chunk(h, events) => {
                assert_eq!(Some(h.tick), opened_tick, "its tick is announced first");
                assert_eq!(h.opens_segment(), open.is_none());
                assert!(open.is_none_or(|o| o == (h.tick, h.segment)));
                assert!(segments.needed[h.segment as usize] && events.len() <= plan.chunk_events());
                let closes = if h.closes_segment() {
                    segments.closes(h.segment as usize)
                } else {
                    0
                };
                assert_eq!(h.closes, closes);
                assert!(h.base_us >= base);
                base = h.base_us;
                open = (!h.closes_segment()).then_some((h.tick, h.segment));
            }
            Sent::Tick(h, weights) => match TickKind::from_code(h.kind).unwrap() {
                Open => {
                    assert_eq!(h.tick, opened_tick.map_or(0, |t| t + 1));
                    assert_eq!((open, weights.len()), (None, plan.members.len()));
                    opened_tick = Some(h.tick);
                }
                Close => assert_eq!((Some(h.tick), open), (opened_tick, None)),
                End => assert!(weights.is_empty()),
            },
        }
    }
}

fn any_plan() -> impl Strategy<Value = Plan> {
    let windows = proptest::collection::btree_set(1u64..60, 1..4);
    (10u64..60, windows, any::<bool>(), any::<bool>(), any::<bool>()).prop_map(
        |(tick, windows, count, end, latest)| {
            let mode = if count { SliceMode::Count } else { SliceMode::Time };
            let align = if end { Align::End } else { Align::Start };
            let windows: Vec<u64> = match align {
                Align::Start => windows.into_iter().map(|w| w.min(tick)).collect(),
                Align::End => windows.into_iter().collect(),
            };
            let mut plan = plan(mode, tick, &windows, align);
            plan.slicing.windows.dedup();
            plan.delivery = if latest {
                Delivery::Latest
            } else {
                Delivery::Lossless
            };
            plan
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn equals_the_plain_computation_however_it_is_split(
        plan in any_plan(),
        steps in proptest::collection::vec(prop_oneof![4 => 0u64..5, 1 => 0u64..150], 1..120),
        cuts in proptest::collection::vec(1usize..20, 0..40),
        flush: bool,
    ) {
        let mut t = 1_000_000_007;
        let events: Vec<_> = steps.iter().map(|s| { t += s; at(t) }).collect();
        let (mut whole, mut whole_port) = (Slicer::new(&plan, 0, 1), KeptPort::default());
        whole.push(&events, &mut whole_port).unwrap();
        let end = whole.finish(&mut whole_port).unwrap();
        let (mut split, mut split_port) = (Slicer::new(&plan, 0, 1), KeptPort::default());
        let mut rest = events.as_slice();
        for cut in cuts {
            let (part, after) = rest.split_at(cut.min(rest.len()));
            split.push(part, &mut split_port).unwrap();
            if flush {
                split.flush(&mut split_port).unwrap();
            }
            rest = after;
        }
        split.push(rest, &mut split_port).unwrap();
        prop_assert_eq!(split.finish(&mut split_port).unwrap(), end);
        check_flags(&plan, &whole_port);
        check_flags(&plan, &split_port);
        prop_assert_eq!(whole_port.segments(), naive(&plan, &events));
        prop_assert_eq!(split_port.segments(), whole_port.segments());
        prop_assert_eq!(split_port.tick_numbers(), whole_port.tick_numbers());
        if !flush {
            prop_assert_eq!(&split_port.sent, &whole_port.sent);
        }
        let tally = whole.tally();
        prop_assert_eq!(tally, split.tally());
        prop_assert_eq!(tally.sent + tally.skipped(), events.len() as u64);
        if plan.delivery == Delivery::Lossless {
            let length = match plan.slicing.mode {
                SliceMode::Time => t - events[0].t_ns,
                SliceMode::Count => events.len() as u64,
            };
            prop_assert_eq!(end, length / plan.slicing.tick);
        }
        let closed = whole_port.ticks().filter(|(kind, _)| *kind == Close).count() as u64;
        prop_assert_eq!(closed, end);
    }
}
