//! Whole runs over recordings on disk.

use crate::testing::{KeptPort, Sent};
use crate::{Ingest, IngestSummary};
use crossbeam::channel::bounded;
use evpr_core::message::TickKind;
use evpr_core::plan::{
    Crop, OnBadEvent, Origin, Pace, Plan, PositionClock, Positions, Sensor, SliceMode, test_plan,
};
use evpr_core::stage::StageError;
use std::path::{Path, PathBuf};

const MS: u64 = 1_000_000;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../shared/events/tests/fixtures")
        .join(name)
}

/// Ticks of 50 ms with windows of 10 and 50 ms: `valid.h5` has 300 events, one per ms.
fn plan(path: PathBuf) -> Plan {
    let mut plan = test_plan();
    plan.source.path = path;
    plan.sensor = Sensor {
        height: 24,
        width: 32,
    };
    (plan.slicing.tick, plan.slicing.windows) = (50 * MS, vec![10 * MS, 50 * MS]);
    plan
}

fn run(plan: &Plan, resume_tick: u64, port: &mut KeptPort) -> Result<IngestSummary, StageError> {
    let (_keep, stop) = bounded(0);
    Ingest::new(plan, resume_tick, 1, stop).unwrap().run(port)
}

fn ran(plan: &Plan, resume_tick: u64) -> (IngestSummary, KeptPort) {
    let mut port = KeptPort::default();
    let summary = run(plan, resume_tick, &mut port).unwrap();
    (summary, port)
}

fn end_tick(port: &KeptPort) -> u64 {
    let (kind, header) = port.ticks().last().unwrap();
    assert_eq!(kind, TickKind::End);
    assert!(matches!(port.sent.last(), Some(Sent::Tick(..))));
    header.tick
}

#[test]
fn a_recording_is_sent_whole() {
    let (summary, port) = ran(&plan(fixture("valid.h5")), 0);
    // The last event is 299 ms after the first: ticks 0 to 4 are whole, tick 5 is not.
    assert_eq!(
        (summary.end_tick, end_tick(&port), summary.sliced.sent),
        (5, 5, 300)
    );
    assert!(!summary.stopped);
    assert_eq!(port.progress, (1000, 6, 300, 0));
    let events: usize = port.chunks().map(|(_, e)| e.len()).sum();
    assert_eq!(events, 300);
}

#[test]
fn text_and_hdf5_of_the_same_events_give_the_same_stream() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    let lines: String = (0..300u64)
        .map(|i| {
            format!(
                "{} {} {} {}\n",
                1_000_000_000 + MS * i + i % 7,
                7 * i % 32,
                3 * i % 24,
                i % 2
            )
        })
        .collect();
    std::fs::write(&path, lines).unwrap();
    let mut text = plan(path);
    text.source.time_unit = evpr_core::plan::TimeUnit::Ns;
    assert_eq!(ran(&text, 0).1.sent, ran(&plan(fixture("valid.h5")), 0).1.sent);
}

/// Positions of `valid.h5`, whose first event is at 1 s: 1 m east per ms from 1.1 s to 1.25 s.
fn positions(dir: &Path, shift_ms: u64) -> Positions {
    let path = dir.join("positions.csv");
    let lines = (100..=250u64)
        .step_by(10)
        .map(|ms| format!("{},{ms},7\n", 1_000 + shift_ms + ms));
    std::fs::write(
        &path,
        format!("t_ms,east_m,north_m\n{}", lines.collect::<String>()),
    )
    .unwrap();
    Positions::file(path)
}

fn opened(port: &KeptPort) -> Vec<(u64, Option<[f64; 2]>)> {
    let open = port.ticks().filter(|(kind, _)| *kind == TickKind::Open);
    open.map(|(_, header)| (header.start_us, header.position()))
        .collect()
}

#[test]
fn ticks_carry_the_position_of_their_start() {
    let dir = tempfile::tempdir().unwrap();
    let mut plan = plan(fixture("valid.h5"));
    plan.source.positions = Some(positions(dir.path(), 0));
    let (_, port) = ran(&plan, 0);
    let known = |start_us| (start_us, Some([start_us as f64 / 1e3 - 1e3, 7.0]));
    let (before, after) = ((1_050_000, None), (1_000_000, None));
    assert_eq!(opened(&port)[..2], [after, before]);
    assert_eq!(
        opened(&port)[2..5],
        [known(1_100_000), known(1_150_000), known(1_200_000)]
    );
    let resumed = ran(&plan, 3).1;
    assert_eq!(opened(&resumed)[0], known(1_150_000));
}

#[test]
fn cropped_to_its_positions_a_recording_begins_and_ends_with_them() {
    let dir = tempfile::tempdir().unwrap();
    let mut plan = plan(fixture("valid.h5"));
    plan.source.positions = Some(Positions {
        crop: Crop::Track,
        ..positions(dir.path(), 5)
    });
    let (summary, port) = ran(&plan, 0);
    // The first event inside is number 105, at 1.105 s exactly; the last, number 255, at 1.255000003 s, is not inside.
    assert_eq!(summary.sliced.sent, 150);
    let begun = opened(&port);
    assert_eq!(
        begun.iter().map(|(start, _)| *start).collect::<Vec<_>>(),
        [1_105_000, 1_155_000, 1_205_000]
    );
    assert!(begun.iter().all(|(_, position)| position.is_some()));
    assert_eq!((summary.end_tick, port.progress.0), (2, 1000));
    let resumed = ran(&plan, 1).1;
    assert_eq!(end_tick(&resumed), 2);
    assert_eq!(opened(&resumed)[..], begun[1..]);
}

#[test]
fn positions_of_another_time_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut plan = plan(fixture("valid.h5"));
    let fails = |plan: &Plan| run(plan, 0, &mut KeptPort::default()).unwrap_err().to_string();
    for crop in [Crop::None, Crop::Track] {
        let late = positions(dir.path(), 1_000);
        plan.source.positions = Some(Positions { crop, ..late.clone() });
        let error = fails(&plan);
        assert!(
            error.contains("its events end before its positions begin at 2.1"),
            "{error}"
        );
        let clock = PositionClock::Offset(-1_500 * MS as i64);
        plan.source.positions = Some(Positions { crop, clock, ..late });
        let error = fails(&plan);
        assert!(error.contains("its positions end at 0.75"), "{error}");
    }
    plan.source.positions = Some(Positions::file(dir.path().join("none.csv")));
    let (_keep, stop) = bounded(0);
    let error = Ingest::new(&plan, 0, 1, stop).unwrap_err().to_string();
    assert!(error.contains("none.csv: there is no such file"), "{error}");
}

#[test]
fn a_resumed_run_is_the_rest_of_the_whole_one() {
    for mode in [SliceMode::Time, SliceMode::Count] {
        for on_backward_time in [OnBadEvent::Error, OnBadEvent::Drop] {
            let mut plan = plan(fixture("valid.h5"));
            plan.source.on_backward_time = on_backward_time;
            if mode == SliceMode::Count {
                plan.slicing.mode = mode;
                (plan.slicing.tick, plan.slicing.windows) = (50, vec![10, 50]);
            }
            let (_, whole) = ran(&plan, 0);
            for resume in [1, 3, 4] {
                let (summary, rest) = ran(&plan, resume);
                let later = |s: &&Sent| match s {
                    Sent::Chunk(h, _) => h.tick >= resume,
                    Sent::Tick(h, _) => h.tick >= resume,
                };
                assert_eq!(
                    rest.sent.iter().collect::<Vec<_>>(),
                    whole.sent.iter().filter(later).collect::<Vec<_>>()
                );
                assert_eq!(summary.end_tick, if mode == SliceMode::Count { 6 } else { 5 });
            }
            let (summary, rest) = ran(&plan, 40);
            assert_eq!((summary.end_tick, rest.sent.len()), (40, 1));
        }
    }
}

#[test]
fn an_error_in_the_middle_comes_after_everything_before_it() {
    for (name, sent, whole_ticks, wanted) in [
        ("bad_polarity.h5", 200, 3, "event 200 (from 0) has polarity 7"),
        (
            "backward_time.h5",
            150,
            2,
            "event 150 (from 0) at 1.100000000 s (x 26, y 18) goes back in time",
        ),
        ("outside_sensor.h5", 250, 4, "event 250 (from 0)"),
    ] {
        let mut port = KeptPort::default();
        let error = run(&plan(fixture(name)), 0, &mut port).unwrap_err();
        assert!(matches!(error, StageError::Fatal(_)));
        assert!(error.to_string().contains(wanted), "{error}");
        assert_eq!(
            (
                port.chunks().map(|(_, e)| e.len()).sum::<usize>(),
                end_tick(&port)
            ),
            (sent, whole_ticks),
            "{name}"
        );
    }
}

#[test]
fn policies_let_the_run_go_on_and_are_counted() {
    let mut dropping = plan(fixture("outside_sensor.h5"));
    dropping.source.on_outside_sensor = OnBadEvent::Drop;
    let (summary, port) = ran(&dropping, 0);
    assert_eq!(
        (summary.sliced.sent, summary.screened.outside, port.progress.3),
        (299, 1, 1)
    );
    let mut clamping = plan(fixture("backward_time.h5"));
    clamping.source.on_backward_time = OnBadEvent::Clamp;
    let (summary, _) = ran(&clamping, 0);
    assert_eq!((summary.sliced.sent, summary.screened.backward_clamped), (300, 1));
}

#[test]
fn an_origin_after_the_recording_is_an_error() {
    let mut plan = plan(fixture("valid.h5"));
    plan.slicing.origin = Origin::At(5_000_000_000);
    let mut port = KeptPort::default();
    let error = run(&plan, 0, &mut port).unwrap_err().to_string();
    assert!(
        error.contains("all 300 events are earlier than slicing.origin at 5.000000000 s"),
        "{error}"
    );
    assert_eq!(end_tick(&port), 0);
}

#[test]
fn a_request_to_stop_ends_the_stream_at_the_tick_under_way() {
    let plan = plan(fixture("valid.h5"));
    let (keep, stop) = bounded(0);
    drop(keep);
    let mut port = KeptPort::default();
    let summary = Ingest::new(&plan, 0, 1, stop).unwrap().run(&mut port).unwrap();
    assert!(summary.stopped);
    assert_eq!((end_tick(&port), port.sent.len()), (0, 1));
    // While it waits for its time.
    let mut paced = plan.clone();
    paced.source.pace = Pace::Factor(1.0);
    let mut port = KeptPort {
        waits_left: Some(13),
        ..KeptPort::default()
    };
    let summary = run(&paced, 0, &mut port).unwrap();
    assert!(summary.stopped && summary.end_tick == end_tick(&port));
    assert_eq!(summary.end_tick, 2);
    // While it waits for room, and nobody takes the end either.
    let mut port = KeptPort {
        room: Some(4),
        ..KeptPort::default()
    };
    assert!(run(&plan, 0, &mut port).unwrap().stopped);
}

#[test]
fn a_full_channel_does_not_outshout_the_request_to_stop() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    let lines: String = (0..400_000u64).map(|i| format!("{} 0 0 1\n", i * 100)).collect();
    std::fs::write(&path, lines).unwrap();
    let plan = plan(path);
    let (keep, stop) = bounded(0);
    let mut port = KeptPort {
        stop_after: Some((30, keep)),
        ..KeptPort::default()
    };
    let summary = Ingest::new(&plan, 0, 1, stop).unwrap().run(&mut port).unwrap();
    assert!(summary.stopped && summary.sliced.sent < 400_000);
    assert_eq!(summary.end_tick, end_tick(&port));
}

#[test]
fn paced_chunks_leave_when_their_last_event_is_due() {
    let mut plan = plan(fixture("valid.h5"));
    for factor in [1.0, 2.0, 0.5] {
        plan.source.pace = Pace::Factor(factor);
        let mut port = KeptPort {
            now_ns: 7_000,
            ..KeptPort::default()
        };
        let summary = run(&plan, 0, &mut port).unwrap();
        assert_eq!((summary.sliced.sent, summary.end_tick), (300, 5));
        let wall = |t_ns: u64| 7_000 + ((t_ns - 1_000_000_000) as f64 / factor) as u64;
        for (sent, now) in port.sent.iter().zip(&port.sent_ns) {
            let Sent::Chunk(h, events) = sent else { continue };
            if let (Some(first), Some(last)) = (events.first(), events.last()) {
                assert!(*now >= wall((h.base_us + u64::from(last.t_us)) * 1000));
                assert!(f64::from(last.t_us - first.t_us) <= 10_000.0 * factor);
            }
            if h.closes_segment() {
                let offset = if h.segment == 0 { 10 } else { 50 };
                assert_eq!(*now, wall(1_000_000_000 + (h.tick * 50 + offset) * MS));
                assert!(h.closed_ns == *now);
            }
        }
        // Chunk borders aside, a paced run sends what an unpaced one does.
        let mut unpaced = plan.clone();
        unpaced.source.pace = Pace::Unpaced;
        let (_, all) = ran(&unpaced, 0);
        assert_eq!(port.segments(), all.segments());
        assert_eq!(port.tick_numbers(), all.tick_numbers());
    }
}

#[test]
fn a_resumed_pace_begins_at_once() {
    let mut plan = plan(fixture("valid.h5"));
    plan.source.pace = Pace::Factor(1.0);
    let mut port = KeptPort {
        now_ns: 1,
        ..KeptPort::default()
    };
    run(&plan, 4, &mut port).unwrap();
    assert!(port.sent_ns[0] <= 1 + 10 * MS);
    assert_eq!(port.sent_ns.last(), Some(&(1 + 99 * MS + 5)));
}

#[test]
fn counted_ticks_are_paced_too() {
    let mut plan = plan(fixture("valid.h5"));
    plan.source.pace = Pace::Factor(1.0);
    plan.slicing.mode = SliceMode::Count;
    (plan.slicing.tick, plan.slicing.windows) = (100, vec![50]);
    let (summary, port) = ran(&plan, 0);
    assert_eq!(
        (summary.end_tick, summary.sliced.sent, summary.sliced.unneeded),
        (3, 150, 150)
    );
    assert_eq!(port.sent_ns.last(), Some(&(299 * MS + 5)));
}

#[test]
fn quiet_windows_close_when_they_are_due() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    std::fs::write(&path, "0.0 0 0 1\n0.2 1 1 1\n").unwrap();
    let mut plan = plan(path);
    plan.source.pace = Pace::Factor(1.0);
    let (_, port) = ran(&plan, 0);
    let closings: Vec<_> = port
        .sent
        .iter()
        .zip(&port.sent_ns)
        .filter(|(s, _)| matches!(s, Sent::Chunk(h, _) if h.closes_segment()))
        .map(|(_, now)| now / MS)
        .collect();
    assert_eq!(closings, [10, 50, 60, 100, 110, 150, 160, 200]);
}

#[test]
fn two_runs_over_the_corridor_are_alike_and_whole() {
    let name = "two_runs_over_the_corridor_are_alike_and_whole";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/corridor/query_events.h5");
    if !path.exists() {
        println!("skipped: {name}: {} is absent", path.display());
        return;
    }
    let mut plan = plan(path);
    plan.sensor = Sensor {
        height: 128,
        width: 128,
    };
    (plan.slicing.tick, plan.slicing.windows) = (500 * MS, vec![100 * MS, 500 * MS]);
    let (summary, a) = ran(&plan, 0);
    let (_, b) = ran(&plan, 0);
    assert_eq!((summary.sliced.sent, summary.end_tick), (3_585_918, 299));
    assert!(a.sent == b.sent, "two runs differ");
    let (_, rest) = ran(&plan, 290);
    let tail = a.sent.iter().filter(|s| match s {
        Sent::Chunk(h, _) => h.tick >= 290,
        Sent::Tick(h, _) => h.tick >= 290,
    });
    assert!(rest.sent.iter().eq(tail), "the resumed run differs");
}
