//! Losses, restarts, drops, switching members, and headers that make no sense.
#![allow(clippy::unwrap_used, clippy::panic)] // in the tests' helpers too

mod common;

use common::{Chunk, Frame, METHODS, Recorded, cut, direct, feed, plan, windows};
use evpr_core::message::{ChunkHeader, Event, Frames};
use evpr_core::plan::{Align, Plan, Sensor};
use evpr_core::stage::{Kept, Outlet, Stage, StageError};
use evpr_core::{MemberSet, Reason};
use evpr_reconstruct::{BuildError, Reconstruct, build};

const SENSOR: Sensor = Sensor { height: 3, width: 5 };
const TICK_NS: u64 = 1_000_000;
const IMAGE: u32 = 0;
const EMPTY: u32 = Reason::EmptyWindow as u32;
const INCOMPLETE: u32 = Reason::IncompleteWindow as u32;
const BEFORE_START: u32 = Reason::BeforeStart as u32;
const DROPPED: u32 = Reason::Dropped as u32;

/// Windows of 0.2, 0.5 and 1 ms at the start of the tick: segments 0, 1, 2.
fn nested() -> Plan {
    plan(
        SENSOR,
        &METHODS,
        TICK_NS,
        &[200_000, 500_000, TICK_NS],
        Align::Start,
        1,
    )
}

/// Windows of 0.3 and 2.3 ms at the end of the tick: segments of 0.7 and 0.3 ms; the long one has five.
fn reaching() -> Plan {
    plan(SENSOR, &METHODS, TICK_NS, &[300_000, 2_300_000], Align::End, 1)
}

/// An event every 10 µs.
fn events(ticks: u64) -> Vec<Recorded> {
    (0..ticks * 100)
        .map(|i| Recorded {
            t_ns: i * 10_000,
            x: (i % 5) as u16,
            y: (i / 7 % 3) as u16,
            on: i % 3 == 0,
        })
        .collect()
}

fn chunks_of(plan: &Plan, ticks: u64, pieces: usize) -> Vec<Chunk> {
    let enabled = plan.enabled_members();
    cut(plan, &events(ticks), ticks, &mut || pieces, &|_| enabled)
}

fn ends(frames: &[Frame]) -> Vec<(u64, u32, u32)> {
    frames.iter().map(|(h, _)| (h.tick, h.window, h.reason)).collect()
}

fn reasons(frames: &[Frame]) -> Vec<u32> {
    frames.iter().map(|(h, _)| h.reason).collect()
}

fn fresh(plan: &Plan) -> Reconstruct {
    build(plan, 0).unwrap()
}

fn process(stage: &mut Reconstruct, chunk: &Chunk) -> (Vec<Frame>, Result<(), StageError>) {
    let mut kept = Kept::<Frames>::default();
    let result = stage.process(&chunk.0, &chunk.1, &mut kept);
    (kept.messages, result)
}

#[test]
fn headers_say_what_the_frame_is() {
    let plan = nested();
    for (method, kind) in evpr_reconstruct::kinds().iter().enumerate() {
        let mut stage = build(&plan, method).unwrap();
        let frames = feed(&mut stage, &chunks_of(&plan, 2, 2));
        assert_eq!(frames.len(), 6);
        for (header, pixels) in frames {
            assert_eq!(header.reconstruction as usize, method);
            assert_eq!((header.height, header.width), (3, 5));
            assert_eq!(header.channel_order, kind.channel_order as u32);
            assert_eq!((header.epoch, header.extractors), (1, 1));
            assert_eq!(header.life.closed_ns, 1000 + header.tick);
            assert_eq!(pixels.len(), 15 * kind.channel_order.channels());
        }
    }
}

#[test]
fn windows_without_events_and_windows_before_the_start_say_so() {
    let plan = reaching();
    let one = [Recorded {
        t_ns: 800_000,
        x: 0,
        y: 0,
        on: true,
    }];
    let enabled = plan.enabled_members();
    // Tick 0 begins with the event; only the windows that hold it have an image.
    let frames = feed(&mut fresh(&plan), &cut(&plan, &one, 4, &mut || 1, &|_| enabled));
    let expected = [
        EMPTY,
        BEFORE_START,
        EMPTY,
        BEFORE_START,
        EMPTY,
        EMPTY,
        EMPTY,
        EMPTY,
    ];
    assert_eq!(reasons(&frames), expected);
}

#[test]
fn a_lost_chunk_makes_exactly_its_windows_incomplete() {
    let plan = nested();
    let chunks = chunks_of(&plan, 3, 3);
    // Tick 1 has chunks 9..18, three per segment.
    for (lost, expected) in [
        (9, [INCOMPLETE, INCOMPLETE, INCOMPLETE]),
        (10, [INCOMPLETE, INCOMPLETE, INCOMPLETE]),
        (12, [IMAGE, INCOMPLETE, INCOMPLETE]),
        (16, [IMAGE, IMAGE, INCOMPLETE]),
    ] {
        let mut chunks = chunks.clone();
        chunks.remove(lost);
        let frames = feed(&mut fresh(&plan), &chunks);
        let all = [[IMAGE; 3], expected, [IMAGE; 3]].concat();
        assert_eq!(reasons(&frames), all, "chunk {lost} lost");
    }
}

#[test]
fn a_lost_closing_chunk_gives_no_frame_for_what_it_closed() {
    let plan = nested();
    let mut chunks = chunks_of(&plan, 2, 3);
    chunks.remove(5);
    let frames = feed(&mut fresh(&plan), &chunks);
    let tick_0 = [(0, 0, IMAGE), (0, 2, INCOMPLETE)];
    let tick_1 = [(1, 0, IMAGE), (1, 1, IMAGE), (1, 2, IMAGE)];
    assert_eq!(ends(&frames), [tick_0.as_slice(), &tick_1].concat());
}

#[test]
fn a_lost_segment_spoils_every_window_that_reaches_back_to_it() {
    let plan = reaching();
    let mut chunks = chunks_of(&plan, 8, 1);
    // Tick 3 is segments 6 and 7; the first is lost. The long window ends with its tick, which is two segments.
    chunks.remove(6);
    let long = |frames: &[Frame]| -> Vec<(u64, u32)> {
        let long = frames.iter().filter(|(h, _)| h.window == 1);
        long.map(|(h, _)| (h.tick, h.reason)).collect()
    };
    let spans = plan.slicing.segments();
    assert_eq!((spans.per_tick(), spans.windows[1].len), (2, 5));
    let frames = feed(&mut fresh(&plan), &chunks);
    let expected: Vec<(u64, u32)> = (0..8)
        .map(|tick| match tick {
            0 | 1 => (tick, BEFORE_START),
            3 | 4 => (tick, INCOMPLETE),
            _ => (tick, IMAGE),
        })
        .collect();
    assert_eq!(long(&frames), expected);
}

#[test]
fn joining_in_the_middle_starts_with_the_next_whole_window() {
    let plan = nested();
    let chunks = chunks_of(&plan, 2, 2);
    // The second chunk of the first segment is the first that is seen.
    let frames = feed(&mut fresh(&plan), &chunks[1..]);
    assert_eq!(
        reasons(&frames),
        [INCOMPLETE, INCOMPLETE, INCOMPLETE, IMAGE, IMAGE, IMAGE]
    );
}

#[test]
fn a_new_epoch_throws_half_windows_away_and_goes_back() {
    for plan in [nested(), reaching()] {
        let whole = feed(&mut fresh(&plan), &chunks_of(&plan, 5, 2));
        let again = |resume: u64| {
            let mut chunks = chunks_of(&plan, 5, 2);
            chunks.retain(|(h, _)| h.tick >= resume);
            for (seq, (header, _)) in chunks.iter_mut().enumerate() {
                header.epoch = 2;
                header.stamp.seq = seq as u64;
            }
            chunks
        };
        // Ingest dies after 15 chunks, in the middle of a segment; its sequence numbers start again.
        let mut chunks = chunks_of(&plan, 5, 2);
        chunks.truncate(15);
        let before = feed(&mut fresh(&plan), &chunks).len();
        chunks.extend(again(1));
        let frames = feed(&mut fresh(&plan), &chunks);
        assert_eq!(frames[..before], whole[..before]);
        // From the tick it resumes with all is answered again, under the new epoch, out of its own events alone.
        let alone = feed(&mut fresh(&plan), &again(1));
        assert_eq!(frames[before..], alone);
        assert!(alone.iter().all(|(h, _)| h.epoch == 2));
        // What is whole within the epoch is as in the undisturbed run.
        for (header, pixels) in alone.iter().filter(|(h, _)| h.reason == IMAGE) {
            let same = |(h, _): &&Frame| (h.tick, h.window) == (header.tick, header.window);
            assert_eq!(whole.iter().find(same).map(|(_, p)| p), Some(pixels));
        }
    }
}

#[test]
fn an_epoch_in_the_middle_of_a_segment_is_not_mixed_even_if_numbers_fit() {
    let plan = nested();
    let mut chunks = chunks_of(&plan, 1, 2);
    for (header, _) in chunks.iter_mut().skip(3) {
        header.epoch = 2;
    }
    assert_eq!(
        reasons(&feed(&mut fresh(&plan), &chunks)),
        [IMAGE, INCOMPLETE, INCOMPLETE]
    );
}

#[test]
fn a_chunk_of_an_older_epoch_is_told_and_changes_nothing() {
    let plan = nested();
    let mut chunks = chunks_of(&plan, 1, 2);
    chunks.iter_mut().for_each(|(h, _)| h.epoch = 2);
    let mut stage = fresh(&plan);
    let mut frames = Vec::new();
    for chunk in &chunks {
        frames.extend(process(&mut stage, chunk).0);
        let mut old = chunk.clone();
        old.0.epoch = 1;
        let (none, result) = process(&mut stage, &old);
        assert!(none.is_empty() && matches!(result, Err(StageError::Skip(_))));
    }
    assert_eq!(reasons(&frames), [IMAGE; 3]);
}

#[test]
fn a_dropped_tick_says_so_and_spoils_what_reaches_back_to_it() {
    let plan = reaching();
    let mut stage = fresh(&plan);
    let mut kept = Kept::<Frames>::default();
    for (header, events) in chunks_of(&plan, 7, 2) {
        let result = if header.tick == 3 {
            stage.skip_dropped(&header, &mut kept)
        } else {
            stage.process(&header, &events, &mut kept)
        };
        result.unwrap();
    }
    let of = |window: u32| -> Vec<u32> {
        let frames = kept.messages.iter().filter(|(h, _)| h.window == window);
        frames.map(|(h, _)| h.reason).collect()
    };
    assert_eq!(of(0), [IMAGE, IMAGE, IMAGE, DROPPED, IMAGE, IMAGE, IMAGE]);
    let long = [
        BEFORE_START,
        BEFORE_START,
        IMAGE,
        DROPPED,
        INCOMPLETE,
        INCOMPLETE,
        IMAGE,
    ];
    assert_eq!(of(1), long);
    assert!(
        kept.messages
            .iter()
            .all(|(h, p)| (h.reason == IMAGE) != p.is_empty())
    );
}

#[test]
fn a_dropped_tick_emits_only_what_is_enabled() {
    let plan = nested();
    let only = MemberSet::from_iter([1]);
    let mut kept = Kept::<Frames>::default();
    let mut stage = fresh(&plan);
    for (header, _) in cut(&plan, &events(1), 1, &mut || 2, &|_| only) {
        stage.skip_dropped(&header, &mut kept).unwrap();
    }
    assert_eq!(ends(&kept.messages), [(0, 1, DROPPED)]);
}

#[test]
fn what_no_enabled_member_wants_costs_nothing() {
    let plan = nested();
    let run = |member: &[usize]| {
        let enabled: MemberSet = member.iter().copied().collect();
        let mut stage = fresh(&plan);
        let frames = feed(&mut stage, &cut(&plan, &events(2), 2, &mut || 2, &|_| enabled));
        (ends(&frames), stage.events())
    };
    // 100 events per tick; members 0, 1, 2 are the windows of this reconstruction, 3 is another's.
    assert_eq!(run(&[]), (vec![], 0));
    assert_eq!(run(&[3, 4, 5]), (vec![], 0));
    assert_eq!(run(&[0]), (vec![(0, 0, IMAGE), (1, 0, IMAGE)], 40));
    assert_eq!(run(&[1]), (vec![(0, 1, IMAGE), (1, 1, IMAGE)], 100));
    assert_eq!(run(&[0, 2]).1, 200);
}

#[test]
fn members_switched_off_and_on_again_come_back_with_whole_windows() {
    let plan = reaching();
    let (short, long) = (MemberSet::from_iter([0]), MemberSet::from_iter([1]));
    let enabled = |tick: u64| match tick {
        3 => MemberSet::default(),
        4 | 8 => short,
        _ => [short, long].iter().flat_map(|s| s.iter()).collect(),
    };
    let events = events(11);
    let frames = feed(&mut fresh(&plan), &cut(&plan, &events, 11, &mut || 2, &enabled));
    let of = |window: u32| -> Vec<(u64, u32)> {
        let frames = frames.iter().filter(|(h, _)| h.window == window);
        frames.map(|(h, _)| (h.tick, h.reason)).collect()
    };
    let short: Vec<_> = (0..11).filter(|t| *t != 3).map(|tick| (tick, IMAGE)).collect();
    assert_eq!(of(0), short);
    // At tick 5 the long one lacks tick 3; at tick 9 the first segment of tick 8, which the short one does not cover.
    let long = [
        (0, BEFORE_START),
        (1, BEFORE_START),
        (2, IMAGE),
        (5, INCOMPLETE),
        (6, IMAGE),
        (7, IMAGE),
        (9, INCOMPLETE),
        (10, IMAGE),
    ];
    assert_eq!(of(1), long);
    // What has an image has the right one.
    for (tick, window, inside) in windows(&plan, &events, 11) {
        let same = |(h, _): &&Frame| (h.tick, h.window as usize, h.reason) == (tick, window, IMAGE);
        if let (Some((_, pixels)), Some(inside)) = (frames.iter().find(same), inside) {
            assert_eq!(*pixels, direct(METHODS[0], SENSOR, 0.0, inside));
        }
    }
}

#[test]
fn extractors_that_are_not_enabled_have_no_bit() {
    let plan = plan(SENSOR, &METHODS, TICK_NS, &[TICK_NS], Align::Start, 3);
    for (members, bits) in [(vec![0, 2], 0b101), (vec![1], 0b010), (vec![0, 1, 2, 5], 0b111)] {
        let enabled: MemberSet = members.into_iter().collect();
        let frames = feed(
            &mut fresh(&plan),
            &cut(&plan, &events(1), 1, &mut || 1, &|_| enabled),
        );
        assert_eq!(frames[0].0.extractors, bits);
    }
}

#[test]
fn headers_that_make_no_sense_are_told_and_the_stage_goes_on() {
    let plan = nested();
    let chunks = chunks_of(&plan, 2, 2);
    let good = chunks[1].0;
    let bad = [
        ChunkHeader { segment: 3, ..good },
        ChunkHeader {
            segment: u32::MAX,
            ..good
        },
        ChunkHeader {
            closes: 0b1001,
            ..good
        },
        ChunkHeader {
            closes: 0b010,
            ..good
        },
        ChunkHeader {
            tick: u64::MAX / 2,
            ..good
        },
    ];
    for header in bad {
        let mut stage = fresh(&plan);
        feed(&mut stage, &chunks[..1]);
        let (frames, result) = process(&mut stage, &(header, chunks[1].1.clone()));
        assert!(frames.is_empty());
        assert!(
            matches!(result, Err(StageError::Skip(text)) if text.contains("reconstruction \"event_count\""))
        );
        // Its segment is spoilt, the next tick is not.
        let frames = feed(&mut stage, &chunks[1..]);
        assert_eq!(reasons(&frames)[..3], [INCOMPLETE; 3]);
        assert_eq!(reasons(&frames)[3..], [IMAGE; 3]);
    }
}

#[test]
fn events_outside_the_sensor_are_counted_and_left_out() {
    for (method, kind) in METHODS.iter().enumerate() {
        let plan = plan(SENSOR, &METHODS, TICK_NS, &[TICK_NS], Align::Start, 1);
        let mut chunks = chunks_of(&plan, 2, 1);
        let far = [
            Event::new(5, 5, 0, true),
            Event::new(5, 0, 3, false),
            Event::new(u32::MAX, u16::MAX, Event::Y_MAX, true),
        ];
        chunks[0].1.extend(far);
        chunks[1].1 = far.to_vec();
        let mut stage = build(&plan, method).unwrap();
        let frames = feed(&mut stage, &chunks);
        let image = direct(kind, SENSOR, 100_000.0, &events(1));
        assert_eq!((frames[0].0.events, &frames[0].1), (100, &image), "{kind}");
        assert_eq!(frames[1].0.reason, EMPTY, "{kind}");
        assert_eq!((stage.events(), stage.outside_sensor()), (100, 6), "{kind}");
    }
}

#[test]
fn a_closed_outlet_stops_the_stage() {
    struct Closed;
    impl Outlet<Frames> for Closed {
        fn emit(
            &mut self,
            _: evpr_core::message::FrameHeader,
            _: usize,
            _: &mut dyn FnMut(&mut [u8]),
        ) -> Result<(), StageError> {
            Err(StageError::Stopped)
        }
    }
    let plan = nested();
    let (header, events) = &chunks_of(&plan, 1, 1)[0];
    let result = fresh(&plan).process(header, events, &mut Closed);
    assert!(matches!(result, Err(StageError::Stopped)));
}

#[test]
fn plans_that_cannot_be_are_refused() {
    let refused = |index: usize, change: fn(&mut Plan)| {
        let mut plan = nested();
        change(&mut plan);
        build(&plan, index).unwrap_err().to_string()
    };
    assert!(matches!(
        build(&nested(), 3),
        Err(BuildError::NoSuchReconstruction { index: 3, count: 3 })
    ));
    let unknown = refused(0, |p| p.reconstructions[0].kind = "e2vid".to_owned());
    for kind in METHODS {
        assert!(unknown.contains(kind), "{unknown}");
    }
    assert!(refused(0, |p| p.reconstructions[0].channels = 1).contains("makes 3 channels, not 1"));
    assert!(refused(2, |p| p.reconstructions[2].params.0.clear()).contains("\"tau\" is missing"));
    assert!(refused(2, |p| common::set_tau(p, 2, 0)).contains("\"tau\" is 0"));
    assert!(refused(2, |p| common::set_tau(p, 2, i64::MAX)).contains("above 100s"));
    assert!(refused(0, |p| p.sensor.width = 0).contains("sensor"));
    assert!(refused(0, |p| p.sensor.height = 40_000).contains("sensor"));
    assert!(refused(0, |p| p.slicing.windows = (1..=33).collect()).contains("33 windows"));
}

#[test]
fn a_reconstruction_without_members_takes_everything_and_gives_nothing() {
    let mut plan = nested();
    plan.members.clear();
    assert!(feed(&mut fresh(&plan), &chunks_of(&plan, 2, 2)).is_empty());
}
