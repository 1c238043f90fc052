//! Headers go in as the runtime would hand them over; traverses come out.

use super::*;
use evpr_core::member::MemberSet;
use evpr_core::message::{Stamp, TickKind};
use evpr_core::plan::{Delivery, test_plan};
use evpr_core::stage::Kept;
use evpr_store::Traverse;

/// Services of the test plan: 0 ingest, 1 and 2 the reconstructions, 3 the extractor.
const EXTRACT: usize = 3;

struct Bench {
    dir: tempfile::TempDir,
    plan: Plan,
}

impl Bench {
    fn new(delivery: Delivery) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut plan = test_plan();
        plan.map = None;
        plan.record = Some(dir.path().join("map"));
        plan.delivery = delivery;
        plan.deadline_ns = 100;
        Self { dir, plan }
    }

    fn start(&self, resume: bool) -> Recorder {
        Recorder::new(&self.plan, resume).unwrap()
    }

    fn traverse(&self) -> Traverse {
        Traverse::open(&self.dir.path().join("map")).unwrap()
    }
}

fn tick_of(r: &mut Recorder, tick: u64, kind: TickKind, members: &[usize]) {
    let header = TickHeader {
        tick,
        start_us: tick * 1000,
        end_us: tick * 1000 + 1000,
        closed_ns: 1000 * (tick + 1),
        members: members.iter().copied().collect::<MemberSet>(),
        // The camera's position is not known at tick 1.
        east_m: if tick == 1 { f64::NAN } else { tick as f64 + 0.5 },
        north_m: -1.0,
        kind: kind as u32,
        ..TickHeader::default()
    };
    r.tick(&header, &[1.0, 1.0]).unwrap();
}

/// A tick that is opened and closed, with both members enabled.
fn tick(r: &mut Recorder, tick: u64) {
    tick_of(r, tick, TickKind::Open, &[0, 1]);
    tick_of(r, tick, TickKind::Close, &[0, 1]);
}

fn header(tick: u64, member: u32) -> DescriptorHeader {
    DescriptorHeader {
        stamp: Stamp {
            service: EXTRACT as u32,
            incarnation: 1,
            ..Stamp::default()
        },
        tick,
        member,
        dim: 3,
        reconstruct_service: 1 + member,
        reconstruct_incarnation: 1,
        ..DescriptorHeader::default()
    }
}

fn values(tick: u64, member: u32) -> [f32; 3] {
    [1.0 + tick as f32, member as f32, 0.5]
}

fn row(r: &mut Recorder, tick: u64, member: u32) {
    r.descriptor(&header(tick, member), &values(tick, member))
        .unwrap();
}

fn no_row(r: &mut Recorder, tick: u64, member: u32) {
    let header = DescriptorHeader {
        reason: Reason::EmptyWindow.code(),
        dim: 0,
        ..header(tick, member)
    };
    r.descriptor(&header, &[]).unwrap();
}

fn settle(r: &mut Recorder, now_ns: u64) {
    let mut outlet = Kept::default();
    r.settle(now_ns, &mut outlet).unwrap();
    assert!(outlet.messages.is_empty(), "a recorder gives no answers");
}

fn present(t: &Traverse, member: &str) -> Vec<bool> {
    let rows = t.member(member).unwrap();
    let number = u32::from(member.starts_with('b'));
    for (tick, present) in rows.present().iter().enumerate() {
        let expected = if *present {
            values(tick as u64, number)
        } else {
            [0.0; 3]
        };
        assert_eq!(rows.row(tick), expected);
    }
    rows.present().to_vec()
}

#[test]
fn rows_and_holes_are_recorded_in_order() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    tick(&mut r, 0);
    row(&mut r, 1, 0);
    row(&mut r, 0, 1);
    settle(&mut r, 0);
    assert_eq!(r.next_tick(), 0, "member 0 is waited for");
    row(&mut r, 0, 0);
    tick(&mut r, 1);
    no_row(&mut r, 1, 1);
    tick_of(&mut r, 2, TickKind::Open, &[1]);
    row(&mut r, 2, 1);
    row(&mut r, 2, 0); // was disabled: does not count
    tick_of(&mut r, 2, TickKind::Close, &[1]);
    tick_of(&mut r, 3, TickKind::End, &[]);
    settle(&mut r, 0);
    assert!(r.finished());
    assert_eq!(r.next_tick(), 3);
    r.close().unwrap();
    let t = bench.traverse();
    assert_eq!(present(&t, "a@1ms/x"), [true, true, false]);
    assert_eq!(present(&t, "b@1ms/x"), [true, false, true]);
    let times: Vec<_> = t
        .ticks()
        .iter()
        .map(|t| (t.start_us, t.end_us, t.position))
        .collect();
    assert_eq!(
        times,
        [
            (0, 1000, Some([0.5, -1.0])),
            (1000, 2000, None),
            (2000, 3000, Some([2.5, -1.0]))
        ]
    );
    t.check_against(&bench.plan).unwrap();
    assert!(evpr_store::verify(t.path()).unwrap().problems.is_empty());
}

#[test]
fn ticks_that_come_again_are_recorded_once() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    for _ in 0..2 {
        tick(&mut r, 0);
        row(&mut r, 0, 0);
        row(&mut r, 0, 1);
        settle(&mut r, 0);
        tick(&mut r, 1);
        row(&mut r, 1, 0);
    }
    row(&mut r, 1, 1);
    settle(&mut r, 0);
    r.close().unwrap();
    assert_eq!(present(&bench.traverse(), "b@1ms/x"), [true, true]);
}

#[test]
fn a_dead_members_ticks_are_holes() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    for t in 0..3 {
        tick(&mut r, t);
        row(&mut r, t, 1);
    }
    row(&mut r, 0, 0);
    settle(&mut r, 0);
    assert_eq!(r.next_tick(), 1);
    let mut states = vec![ServiceState::default(); 5];
    states[1].dead_through = 1;
    states[1].health = evpr_core::message::ServiceHealth::Restarting as u32;
    r.lifecycle(&states);
    settle(&mut r, 0);
    assert_eq!(r.next_tick(), 3);
    r.close().unwrap();
    assert_eq!(present(&bench.traverse(), "a@1ms/x"), [true, false, false]);
}

#[test]
fn live_ticks_are_recorded_at_the_deadline_and_lost_ones_are_holes() {
    let bench = Bench::new(Delivery::Latest);
    let mut r = bench.start(false);
    tick(&mut r, 1);
    row(&mut r, 1, 0);
    settle(&mut r, 0);
    assert_eq!((r.next_tick(), r.deadline_ns()), (1, Some(2100)));
    settle(&mut r, 2100);
    row(&mut r, 1, 1); // too late
    r.close().unwrap();
    let t = bench.traverse();
    assert_eq!(present(&t, "a@1ms/x"), [false, true]);
    assert_eq!(present(&t, "b@1ms/x"), [false, false]);
}

#[test]
fn the_next_life_goes_on_where_the_last_one_died() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    for t in 0..3 {
        tick(&mut r, t);
        row(&mut r, t, 0);
        row(&mut r, t, 1);
    }
    settle(&mut r, 0);
    tick(&mut r, 3);
    row(&mut r, 3, 0);
    drop(r);
    let mut r = bench.start(true);
    assert_eq!(r.next_tick(), 3);
    // Ingest goes back further than it need.
    for t in 2..5 {
        tick(&mut r, t);
        row(&mut r, t, 0);
        no_row(&mut r, t, 1);
    }
    settle(&mut r, 0);
    r.close().unwrap();
    let t = bench.traverse();
    assert_eq!(present(&t, "a@1ms/x"), [true; 5]);
    assert_eq!(present(&t, "b@1ms/x"), [true, true, true, false, false]);
}

#[test]
fn a_life_that_left_nothing_is_begun_again() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(true);
    assert_eq!(r.next_tick(), 0);
    tick(&mut r, 0);
    row(&mut r, 0, 0);
    row(&mut r, 0, 1);
    settle(&mut r, 0);
    r.close().unwrap();
    assert_eq!(bench.traverse().len(), 1);
}

#[test]
fn without_resuming_nothing_of_an_earlier_run_is_touched() {
    let bench = Bench::new(Delivery::Lossless);
    drop(bench.start(false));
    let message = Recorder::new(&bench.plan, false).unwrap_err().to_string();
    assert!(message.contains("was left by an earlier recording"), "{message}");
    let mut plan = bench.plan.clone();
    plan.record = None;
    assert!(matches!(Recorder::new(&plan, false), Err(RecordError::NoPath)));
}

#[test]
fn a_recording_without_a_tick_leaves_nothing() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    tick_of(&mut r, 0, TickKind::Open, &[0, 1]);
    tick_of(&mut r, 0, TickKind::End, &[]);
    settle(&mut r, 0);
    assert!(r.finished());
    r.close().unwrap();
    assert_eq!(std::fs::read_dir(bench.dir.path()).unwrap().count(), 0);
    r.close().unwrap();
}

#[test]
fn rows_that_cannot_be_used_are_skipped_and_become_holes() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    tick(&mut r, 0);
    let mut skip = |h: &DescriptorHeader, row: &[f32]| match r.descriptor(h, row) {
        Err(StageError::Skip(message)) => message,
        other => panic!("{other:?}"),
    };
    let nan = [1.0, f32::NAN, 0.0];
    assert_eq!(
        skip(&header(0, 0), &nan),
        "member a@1ms/x, tick 0: the row has numbers that are not finite"
    );
    assert!(skip(&header(0, 1), &[1.0]).contains("has 1 numbers, it must have 3"));
    assert!(skip(&header(0, 9), &nan).contains("member 9, tick 0: there is no such member"));
    assert!(skip(&header(1 << 40, 0), &[1.0; 3]).contains("beyond reason"));
    let unknown = DescriptorHeader {
        reason: 77,
        ..header(1, 0)
    };
    assert!(skip(&unknown, &[]).contains("reason 77 is not known"));
    settle(&mut r, 0);
    assert_eq!(r.next_tick(), 1);
    r.close().unwrap();
    assert_eq!(present(&bench.traverse(), "a@1ms/x"), [false]);
}

#[test]
fn a_name_that_is_taken_meanwhile_is_fatal_and_the_recording_is_kept() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    tick(&mut r, 0);
    row(&mut r, 0, 0);
    row(&mut r, 0, 1);
    settle(&mut r, 0);
    let path = bench.dir.path().join("map");
    std::fs::write(&path, "taken").unwrap();
    let error = r.close().unwrap_err();
    assert!(
        matches!(&error, StageError::Fatal(m) if m.contains("is kept in") && m.contains("evpr map repair"))
    );
    std::fs::remove_file(&path).unwrap();
    assert_eq!(evpr_store::repair(&path).unwrap().ticks, 1);
}

#[test]
fn rows_are_kept_in_the_same_vectors() {
    let bench = Bench::new(Delivery::Lossless);
    let mut r = bench.start(false);
    for t in 0..50 {
        tick(&mut r, t);
        row(&mut r, t, 0);
        row(&mut r, t, 1);
        settle(&mut r, 0);
        assert_eq!(r.pool.len(), 2);
    }
    for t in 50..60 {
        tick(&mut r, t);
        row(&mut r, t, 0);
        row(&mut r, t, 1);
    }
    settle(&mut r, 0);
    assert_eq!(r.pool.len(), POOLED_TICKS * 2, "what a burst took is given back");
}
