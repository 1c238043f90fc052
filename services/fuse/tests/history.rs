//! A fuser that is started again goes on as if it had never been away, by the file that the last one left.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::Plan;
use evpr_core::message::{Candidate, MatchHeader};
use evpr_core::plan::{Delivery, Filter, SeqSlam, SequenceMethod};
use evpr_core::stage::{Kept, Sink, StageError};
use evpr_fuse::{Fuser, History, Map};
use std::path::Path;
use support::*;

const REFERENCES: usize = 40;
const RUN: u64 = 9;

fn latest(method: SequenceMethod) -> Plan {
    let mut plan = plan(&[4, 3], 6);
    plan.delivery = Delivery::Latest;
    plan.fuse.sequence = method;
    plan
}

fn remembering(plan: &Plan, map: &Map, from: u64, path: &Path) -> Fuser {
    let history = History::open(path, plan, REFERENCES, RUN).unwrap();
    fuser(plan, map.clone(), from, from).with_history(plan, history)
}

/// The rows of a tick: the second member has none now and then.
fn rows(tick: u64) -> Vec<Option<Vec<f32>>> {
    let second = (tick % 9 != 4).then(|| noise(7 * tick as usize + 1, 3));
    vec![Some(noise(7 * tick as usize, 4)), second]
}

fn step(fuser: &mut Fuser, plan: &Plan, tick: u64) -> Vec<(MatchHeader, Vec<Candidate>)> {
    feed(fuser, tick, all(plan), &[1.0, 2.0], &rows(tick));
    settle(fuser).messages
}

/// Without what depends on when it was answered.
fn timeless(answers: &[(MatchHeader, Vec<Candidate>)]) -> Vec<(MatchHeader, Vec<Candidate>)> {
    let header = |h: &MatchHeader| MatchHeader {
        reconstruct_ns: 0,
        extract_ns: 0,
        fuse_ns: 0,
        total_ns: 0,
        ..*h
    };
    answers.iter().map(|(h, c)| (header(h), c.clone())).collect()
}

const METHODS: [SequenceMethod; 5] = [
    SequenceMethod::Paper,
    SequenceMethod::Rows,
    SequenceMethod::SeqSlam(SeqSlam::AUTHORS),
    SequenceMethod::Filter(Filter::DEFAULT),
    SequenceMethod::None,
];

#[test]
fn it_goes_on_as_if_it_had_never_been_away() {
    for method in METHODS {
        let plan = latest(method);
        let map = map(&plan, REFERENCES, |_, reference| reference != 3);
        let mut whole = fuser(&plan, map.clone(), 0, 0);
        let wanted: Vec<_> = (0..40).flat_map(|tick| step(&mut whole, &plan, tick)).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fuse");
        let mut got = Vec::new();
        // It dies early, soon again, and late.
        for life in [0..3, 3..5, 5..23, 23..40] {
            let mut fuser = remembering(&plan, &map, life.start, &path);
            got.extend(life.flat_map(|tick| step(&mut fuser, &plan, tick)));
        }
        assert_eq!(
            format!("{:?}", timeless(&got)),
            format!("{:?}", timeless(&wanted)),
            "{method:?}"
        );
        assert!(wanted.iter().any(|(h, _)| h.complete == 1) && wanted.iter().any(|(h, _)| h.complete == 0));
    }
}

#[test]
fn what_was_settled_and_not_sent_is_sent_once() {
    for method in METHODS {
        let plan = latest(method);
        let map = map(&plan, REFERENCES, |_, _| true);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fuse");
        let mut first = remembering(&plan, &map, 0, &path);
        let wanted: Vec<_> = (0..12).flat_map(|tick| step(&mut first, &plan, tick)).collect();
        // The answer of tick 11 never left.
        let mut second = remembering(&plan, &map, 11, &path);
        assert_eq!(second.next_tick(), 12);
        let sent = settle(&mut second).messages;
        assert_eq!(
            format!("{:?}", timeless(&sent)),
            format!("{:?}", timeless(&wanted[11..])),
            "{method:?}"
        );
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for tick in 12..20 {
            a.extend(step(&mut first, &plan, tick));
            b.extend(step(&mut second, &plan, tick));
        }
        assert_eq!(
            format!("{:?}", timeless(&a)),
            format!("{:?}", timeless(&b)),
            "{method:?}"
        );
    }
}

#[test]
fn ticks_that_passed_in_between_are_missing_from_the_history() {
    let plan = latest(SequenceMethod::Paper);
    let map = map(&plan, REFERENCES, |_, _| true);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fuse");
    let mut first = remembering(&plan, &map, 0, &path);
    (0..12).for_each(|tick| {
        step(&mut first, &plan, tick);
    });
    // Nobody answered ticks 12 and 13, and none was opened for this fuser: it begins with 14.
    let mut second = remembering(&plan, &map, 14, &path);
    let complete = |tick: u64, fuser: &mut Fuser| step(fuser, &plan, tick)[0].0.complete;
    let flags: Vec<u32> = (14..32).map(|tick| complete(tick, &mut second)).collect();
    // L = 6; the second member has no row at ticks 22 and 31.
    let wanted = (14..32).map(|tick| u32::from((19..22).contains(&tick) || (28..31).contains(&tick)));
    assert_eq!(flags, wanted.collect::<Vec<_>>());
}

#[test]
fn a_history_that_cannot_be_kept_is_said_once_and_costs_no_answer() {
    let plan = latest(SequenceMethod::Paper);
    let map = map(&plan, REFERENCES, |_, _| true);
    // Every write to it fails.
    let full = Path::new("/dev/full");
    if !full.exists() {
        println!("skipped: /dev/full is absent");
        return;
    }
    assert!(History::open(full, &plan, REFERENCES, RUN).is_err());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fuse");
    let mut fuser = remembering(&plan, &map, 0, &path);
    // A sequence that becomes longer needs a longer file, for which there is no place any more.
    std::fs::remove_dir_all(folder.path()).unwrap();
    let mut header = tick_header(0, all(&plan), evpr_core::message::TickKind::Open);
    header.fuse.length = 30;
    fuser.tick(&header, &[1.0, 1.0]).unwrap();
    for (member, row) in rows(0).into_iter().enumerate() {
        fuser.descriptor(&row_header(0, member), &row.unwrap()).unwrap();
    }
    let mut kept = Kept::default();
    match fuser.settle(4_000, &mut kept) {
        Err(StageError::Skip(line)) => assert!(line.contains("the history cannot be kept"), "{line}"),
        other => panic!("{other:?}"),
    }
    assert_eq!(kept.messages.len(), 1);
    assert_eq!(step(&mut fuser, &plan, 1).len(), 1, "and it is said once");
}
