//! The fuser as the end of the graph: reasons, holes, restarts, latencies, and what must not matter.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::message::{MatchHeader, ServiceHealth, ServiceState, TickKind};
use evpr_core::plan::{Delivery, SequenceMethod};
use evpr_core::stage::{Kept, Sink, StageError};
use evpr_core::{MemberSet, Plan, Reason};
use evpr_fuse::{FuseError, Fuser, Map, MapMember};
use proptest::prelude::*;
use std::sync::{Arc, Mutex};
use support::*;

/// The map's own row of each member at this reference: a query that is certainly there.
fn there(map: &Map, reference: usize) -> Vec<Option<Vec<f32>>> {
    map.members
        .iter()
        .map(|m| m.row(reference).map(<[f32]>::to_vec))
        .collect()
}

fn reason(header: &MatchHeader) -> Option<Reason> {
    Reason::from_code(header.reason)
}

fn skipped(result: Result<(), StageError>) -> String {
    match result {
        Err(StageError::Skip(text)) => text,
        other => panic!("expected a message to be skipped, got {other:?}"),
    }
}

#[test]
fn names_the_place_with_its_position_and_candidates() {
    let mut plan = plan(&[5, 3], 1);
    plan.fuse.top = 3;
    let map = map(&plan, 12, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    feed(&mut fuser, 0, all(&plan), &[1.0, 2.0], &there(&map, 7));
    let kept = settle(&mut fuser);
    let [(header, candidates)] = kept.messages.as_slice() else {
        panic!("one answer")
    };
    assert_eq!((header.reference, header.score, header.reason), (7, 0.0, 0));
    assert_eq!((header.east_m, header.north_m), (7.0, -7.0));
    assert_eq!(
        (
            header.tick,
            header.start_us,
            header.end_us,
            header.control_version
        ),
        (0, 0, 1000, 3)
    );
    assert_eq!(
        (header.candidates, candidates.len(), candidates[0].reference),
        (3, 3, 7)
    );
    assert!(candidates[0].score > candidates[1].score && candidates[1].score >= candidates[2].score);
    assert!(header.confidence > 0.0 && header.confidence <= 1.0);
    assert_eq!(&header.ends[..3], [1, 1, 0]);
    assert_eq!((fuser.next_tick(), fuser.finished()), (1, false));
    fuser
        .tick(&tick_header(1, MemberSet::default(), TickKind::End), &[])
        .unwrap();
    assert!(fuser.finished());
    fuser.close().unwrap();
}

#[test]
fn says_where_the_time_went() {
    let plan = plan(&[3], 1);
    let map = map(&plan, 4, |_, _| true);
    let header_of = |rows: &[Option<Vec<f32>>]| {
        let mut fuser = fuser(&plan, map.clone(), 0, 0);
        feed(&mut fuser, 0, all(&plan), &[1.0], rows);
        settle(&mut fuser).messages[0].0
    };
    let times = |h: MatchHeader| (h.reconstruct_ns, h.extract_ns, h.fuse_ns, h.total_ns);
    // Closed at 1,000, frame at 2,000, row at 3,000; the clock stands at 5,000 after the matching.
    assert_eq!(times(header_of(&there(&map, 0))), (1_000, 1_000, 2_000, 4_000));
    assert_eq!(times(header_of(&[None])), (0, 0, 4_000, 4_000));
}

#[test]
fn an_unknown_closing_is_taken_from_the_rows() {
    let mut plan = plan(&[3], 1);
    plan.delivery = Delivery::Latest;
    let map = map(&plan, 4, |_, _| true);
    for (closed_ns, want) in [(1_500, (500, 1_000, 2_000, 3_500)), (0, (0, 1_000, 2_000, 0))] {
        let mut fuser = fuser(&plan, map.clone(), 0, 0);
        open(&mut fuser, 0, all(&plan), &[1.0]).unwrap();
        let mut header = row_header(0, 0);
        header.life.closed_ns = closed_ns;
        fuser.descriptor(&header, map.members[0].row(1).unwrap()).unwrap();
        let h = settle(&mut fuser).messages[0].0;
        assert_eq!((h.reconstruct_ns, h.extract_ns, h.fuse_ns, h.total_ns), want);
    }
}

#[test]
fn without_members_rows_or_history_there_is_no_answer() {
    let plan = plan(&[3, 3], 4);
    let map = map(&plan, 6, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    let none = MemberSet::default();
    feed(&mut fuser, 0, none, &[1.0, 1.0], &there(&map, 0));
    feed(&mut fuser, 1, all(&plan), &[1.0, 1.0], &[None, None]);
    feed(&mut fuser, 2, all(&plan), &[1.0, 1.0], &there(&map, 2));
    feed(&mut fuser, 3, all(&plan), &[0.0, 0.0], &there(&map, 3));
    feed(&mut fuser, 4, all(&plan), &[1.0, 1.0], &there(&map, 4));
    let kept = settle(&mut fuser);
    let reasons: Vec<_> = kept.messages.iter().map(|(h, _)| reason(h)).collect();
    use Reason::{NoHistory, NoMembers, NoRows};
    assert_eq!(
        reasons,
        [
            Some(NoMembers),
            Some(NoRows),
            Some(NoHistory),
            Some(NoMembers),
            None
        ]
    );
    for (header, payload) in &kept.messages[..4] {
        assert_eq!(
            (
                header.reference,
                header.score,
                header.confidence,
                header.candidates
            ),
            (-1, 0.0, 0.0, 0)
        );
        assert!(header.east_m.is_nan() && header.north_m.is_nan());
        assert_eq!(
            (payload.len(), payload[0].score, payload[0].reference),
            (1, 0.0, 0)
        );
    }
    let ends: Vec<_> = kept
        .messages
        .iter()
        .map(|(h, _)| [h.ends[0], h.ends[1]])
        .collect();
    let empty = Reason::EmptyWindow as u8;
    assert_eq!(ends, [[0, 0], [empty, empty], [1, 1], [1, 1], [1, 1]]);
}

#[test]
fn method_none_answers_the_first_tick() {
    let mut plan = plan(&[3], 4);
    plan.fuse.sequence = SequenceMethod::None;
    let map = map(&plan, 6, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    feed(&mut fuser, 0, all(&plan), &[1.0], &there(&map, 3));
    assert_eq!(settle(&mut fuser).messages[0].0.reference, 3);
}

#[test]
fn a_lost_tick_is_answered_as_lost() {
    let mut plan = plan(&[3], 1);
    plan.delivery = Delivery::Latest;
    let map = map(&plan, 6, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    feed(&mut fuser, 1, all(&plan), &[1.0], &there(&map, 5));
    let kept = settle(&mut fuser);
    assert_eq!(reason(&kept.messages[0].0), Some(Reason::Lost));
    assert_eq!(
        (kept.messages[0].0.tick, kept.messages[0].0.ends[0]),
        (0, Reason::Lost as u8)
    );
    assert_eq!((kept.messages[1].0.tick, kept.messages[1].0.reference), (1, 5));
}

#[test]
fn latest_answers_at_the_deadline_with_what_has_come() {
    let mut plan = plan(&[3, 3], 1);
    plan.delivery = Delivery::Latest;
    plan.deadline_ns = 100;
    let map = map(&plan, 6, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    open(&mut fuser, 0, all(&plan), &[1.0, 1.0]).unwrap();
    fuser
        .descriptor(&row_header(0, 1), map.members[1].row(2).unwrap())
        .unwrap();
    close(&mut fuser, 0, all(&plan));
    assert_eq!(fuser.deadline_ns(), Some(1_100));
    let mut kept = Kept::default();
    fuser.settle(1_099, &mut kept).unwrap();
    assert!(kept.messages.is_empty());
    fuser.settle(1_100, &mut kept).unwrap();
    let (header, _) = kept.messages[0];
    assert_eq!(
        (header.reference, header.ends[0], header.ends[1]),
        (2, Reason::Late as u8, 1)
    );
}

#[test]
fn a_row_that_cannot_be_used_is_named_and_not_waited_for() {
    let plan = plan(&[3, 3], 1);
    let map = map(&plan, 6, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    let mut unknown = row_header(3, 0);
    unknown.reason = 77;
    for (tick, header, row, problem) in [
        (
            0,
            row_header(0, 0),
            vec![1.0; 4],
            "it has 4 values, the map's rows have 3",
        ),
        (1, row_header(1, 0), vec![0.0, f32::NAN, 0.0], "value 1 is NaN"),
        (
            2,
            row_header(2, 0),
            vec![0.0, 0.0, f32::INFINITY],
            "value 2 is inf",
        ),
        (3, unknown, vec![], "no such reason: 77"),
    ] {
        open(&mut fuser, tick, all(&plan), &[1.0, 1.0]).unwrap();
        let text = skipped(fuser.descriptor(&header, &row));
        assert!(text.contains("a@1ms/x0") && text.contains(problem), "{text}");
        fuser
            .descriptor(&row_header(tick, 1), map.members[1].row(4).unwrap())
            .unwrap();
        close(&mut fuser, tick, all(&plan));
        let (header, _) = settle(&mut fuser).messages[0];
        assert_eq!((header.reference, header.ends[0]), (4, Reason::Failed as u8));
    }
}

#[test]
fn nonsense_is_refused_and_repeats_are_passed_over() {
    let plan = plan(&[3], 1);
    let map = map(&plan, 6, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    let row = map.members[0].row(1).unwrap();
    assert!(skipped(fuser.descriptor(&row_header(0, 9), row)).contains("no such member"));
    assert!(skipped(fuser.descriptor(&row_header(u64::MAX, 0), row)).contains("out of reach"));
    let mut header = tick_header(0, all(&plan), TickKind::Open);
    header.kind = 9;
    assert!(skipped(fuser.tick(&header, &[1.0])).contains("ignored"));
    feed(&mut fuser, 0, all(&plan), &[1.0], &there(&map, 1));
    fuser
        .descriptor(&row_header(0, 0), map.members[0].row(2).unwrap())
        .unwrap();
    assert_eq!(
        settle(&mut fuser).messages[0].0.reference,
        1,
        "the first row counts"
    );
    fuser.descriptor(&row_header(0, 0), row).unwrap();
    assert!(settle(&mut fuser).messages.is_empty());
}

#[test]
fn weights_that_cannot_be_right_are_those_of_the_plan() {
    let mut plan = plan(&[3, 3], 1);
    plan.members[0].weight = 0.0;
    let map = map(&plan, 6, |_, _| true);
    for weights in [vec![f64::NAN, 1.0], vec![1.0]] {
        let mut fuser = fuser(&plan, map.clone(), 0, 0);
        let text = skipped(open(&mut fuser, 0, all(&plan), &weights));
        assert!(
            text.contains("tick 0") && text.contains("the plan's are used"),
            "{text}"
        );
        fuser
            .descriptor(&row_header(0, 0), map.members[0].row(1).unwrap())
            .unwrap();
        fuser
            .descriptor(&row_header(0, 1), map.members[1].row(4).unwrap())
            .unwrap();
        close(&mut fuser, 0, all(&plan));
        assert_eq!(settle(&mut fuser).messages[0].0.reference, 4);
    }
}

#[test]
fn a_late_row_of_a_new_life_lifts_the_tombstone() {
    let plan = plan(&[3, 3], 1);
    let map = map(&plan, 6, |_, _| true);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    let mut states = vec![ServiceState::default(); plan.services().len()];
    states[plan.extract_service(0)].dead_through = 1;
    states[plan.extract_service(0)].health = ServiceHealth::Restarting as u32;
    fuser.lifecycle(&states);
    for tick in 0..2 {
        open(&mut fuser, tick, all(&plan), &[1.0, 1.0]).unwrap();
        fuser
            .descriptor(&row_header(tick, 1), map.members[1].row(2).unwrap())
            .unwrap();
        close(&mut fuser, tick, all(&plan));
        if tick == 0 {
            let (header, _) = settle(&mut fuser).messages[0];
            assert_eq!((header.reference, header.ends[0]), (2, Reason::ExtractDown as u8));
            let mut reborn = row_header(0, 0);
            reborn.stamp.incarnation = 2;
            fuser.descriptor(&reborn, map.members[0].row(2).unwrap()).unwrap();
        }
    }
    assert!(
        settle(&mut fuser).messages.is_empty(),
        "tick 1 waits for the member that is back"
    );
}

#[test]
fn a_place_that_only_an_absent_member_knows_is_never_the_answer() {
    let plan = plan(&[3, 3], 1);
    let map = map(&plan, 6, |m, j| m == 1 || j % 2 == 0);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    feed(
        &mut fuser,
        0,
        [0].into_iter().collect(),
        &[1.0, 1.0],
        &there(&map, 2),
    );
    feed(&mut fuser, 1, all(&plan), &[1.0, 0.0], &there(&map, 4));
    let kept = settle(&mut fuser);
    for (header, candidates) in &kept.messages {
        assert_eq!(header.candidates, 3, "weight 0 makes no place eligible");
        assert!(candidates.iter().all(|c| c.reference % 2 == 0));
    }
}

#[test]
fn a_restarted_fuser_goes_on_as_if_it_had_never_been_away() {
    let plan = plan(&[4, 3], 5);
    let map = map(&plan, 20, |m, j| (j + m) % 7 != 0);
    let rows: Vec<Vec<Option<Vec<f32>>>> = (0..14)
        .map(|t| {
            vec![
                (t % 4 != 1).then(|| noise(t, 4)),
                (t % 5 != 2).then(|| noise(50 + t, 3)),
            ]
        })
        .collect();
    let run = |first: u64, answer_from: u64| {
        let mut fuser = fuser(&plan, map.clone(), first, answer_from);
        for (tick, rows) in rows.iter().enumerate().skip(first as usize) {
            feed(&mut fuser, tick as u64, all(&plan), &[1.0, 0.5], rows);
        }
        settle(&mut fuser).messages
    };
    let (whole, resumed) = (run(0, 0), run(4, 8));
    assert_eq!((whole.len(), resumed.len(), resumed[0].0.tick), (14, 6, 8));
    let text = |answers: &[_]| format!("{answers:?}");
    assert_eq!(text(&whole[8..]), text(&resumed));
    assert_ne!(text(&whole[8..]), text(&run(8, 8)), "history matters here");
}

#[test]
fn map_and_plan_must_fit() {
    let plan = plan(&[3, 2], 1);
    let good = map(&plan, 6, |_, _| true);
    let refusal = |map: Map| {
        Fuser::new(&plan, map, 0, 0, Box::new(|| 0))
            .map(|_| ())
            .unwrap_err()
    };
    let swapped = Map {
        members: good.members.iter().rev().cloned().collect(),
        ..good.clone()
    };
    assert!(matches!(
        refusal(swapped),
        FuseError::Dimension { map: 2, plan: 3, .. }
    ));
    let short = Map {
        references: 5,
        ..good.clone()
    };
    assert!(matches!(refusal(short), FuseError::Shape { .. }));
    let fewer = Map {
        members: good.members[..1].to_vec(),
        ..good.clone()
    };
    assert!(matches!(refusal(fewer), FuseError::Members { map: 1, plan: 2 }));
    assert!(matches!(
        refusal(Map {
            references: 0,
            ..good.clone()
        }),
        FuseError::EmptyMap
    ));
    let blank = map(&plan, 6, |m, _| m == 0);
    let error = refusal(blank);
    assert!(matches!(&error, FuseError::NoRows { member } if member == "a@1ms/x1"));
    assert!(!error.to_string().contains('\n'));
}

#[test]
fn a_map_row_that_is_not_finite_is_refused_and_named() {
    let plan = plan(&[2], 1);
    for (value, there, refused) in [
        (f32::NAN, true, true),
        (f32::NEG_INFINITY, true, true),
        (f32::NAN, false, false),
        (f32::MAX, true, false),
    ] {
        let map = Map {
            references: 3,
            positions: vec![],
            members: vec![MapMember::new(
                vec![0.0, 1.0, value, 0.0, 1.0, 1.0],
                2,
                vec![true, there, true],
            )],
        };
        let result = Fuser::new(&plan, map, 0, 0, Box::new(|| 0));
        assert_eq!(result.is_err(), refused, "{value}, there: {there}");
        if let Err(error) = result {
            assert!(matches!(&error, FuseError::NotFinite { member, reference: 1 } if member == "a@1ms/x0"));
        }
    }
}

/// E, S̃ and the answers of a few ticks, computed by so many threads.
fn by_threads(threads: usize, plan: &Plan, map: &Map) -> (Vec<Vec<u64>>, Vec<i64>) {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| {
        let mut fuser = fuser(plan, map.clone(), 0, 0);
        let seen = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&seen);
        let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        fuser.observe(Box::new(move |tick| {
            let mut seen = sink.lock().unwrap();
            seen.push(bits(tick.fused));
            seen.extend(tick.members.iter().map(|m| bits(m.scores)));
        }));
        for tick in 0..8 {
            let row = |m: usize| Some(noise(tick * 2 + m, map.members[m].dim));
            feed(&mut fuser, tick as u64, all(plan), &[1.0, 0.5], &[row(0), row(1)]);
        }
        let answers = settle(&mut fuser)
            .messages
            .iter()
            .map(|(h, _)| h.reference)
            .collect();
        (std::mem::take(&mut *seen.lock().unwrap()), answers)
    })
}

#[test]
fn the_number_of_threads_changes_not_a_bit() {
    // Large enough for similarity and matching to be shared out.
    let plan = plan(&[64, 5], 6);
    let map = map(&plan, 6000, |m, j| (j + m) % 9 != 4);
    let alone = by_threads(1, &plan, &map);
    assert_eq!((alone.0.len(), alone.1.len()), (24, 8));
    for threads in [2, 3, 5] {
        assert_eq!(by_threads(threads, &plan, &map), alone, "{threads} threads");
    }
}

/// Who is on, weights, rows.
type Tick = (MemberSet, Vec<f64>, Vec<Option<Vec<f32>>>);

type Seen = Arc<Mutex<Vec<(u64, Vec<f64>)>>>;

/// E of every tick.
fn fused(plan: &Plan, map: &Map, ticks: &[Tick]) -> (Vec<(u64, Vec<f64>)>, Vec<i64>) {
    let mut fuser = fuser(plan, map.clone(), 0, 0);
    let seen = Seen::default();
    let sink = Arc::clone(&seen);
    fuser.observe(Box::new(move |tick| {
        sink.lock().unwrap().push((tick.tick, tick.fused.to_vec()))
    }));
    for (tick, (enabled, weights, rows)) in ticks.iter().enumerate() {
        feed(&mut fuser, tick as u64, *enabled, weights, rows);
    }
    let answers = settle(&mut fuser)
        .messages
        .iter()
        .map(|(h, _)| h.reference)
        .collect();
    (seen.lock().unwrap().clone(), answers)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn off_absent_and_weight_zero_are_the_same_and_order_does_not_matter(
        off in prop::collection::vec(prop::collection::vec(any::<bool>(), 3), 1..16),
        length in 1usize..6, references in 1usize..30,
    ) {
        let plan = plan(&[4, 2, 3], length);
        let map = map(&plan, references, |m, j| j == 0 || (j + m) % 5 != 0);
        let dims = [4, 2, 3];
        let rows: Vec<Vec<Option<Vec<f32>>>> = (0..off.len())
            .map(|t| (0..3).map(|m| Some(noise(t * 3 + m, dims[m]))).collect())
            .collect();
        let ticks = |make: &dyn Fn(usize) -> Tick| -> Vec<_> {
            (0..off.len()).map(make).collect()
        };
        let on = |t: usize| (0..3).filter(|m| !off[t][*m]).collect::<MemberSet>();
        let switched = ticks(&|t| (on(t), vec![1.0; 3], rows[t].clone()));
        let absent = ticks(&|t| {
            let rows = rows[t].iter().zip(&off[t]).map(|(r, off)| r.clone().filter(|_| !off)).collect();
            (all(&plan), vec![1.0; 3], rows)
        });
        let (want, answers) = fused(&plan, &map, &switched);
        prop_assert_eq!(&(want.clone(), answers.clone()), &fused(&plan, &map, &absent));

        // A member that is off for good equals one of weight 0.
        let gone = ticks(&|t| ([0, 1].into_iter().collect(), vec![1.0; 3], rows[t].clone()));
        let weightless = ticks(&|t| (all(&plan), vec![1.0, 1.0, 0.0], rows[t].clone()));
        prop_assert_eq!(fused(&plan, &map, &gone), fused(&plan, &map, &weightless));

        // The same members in reverse order.
        let mut reversed_plan = plan.clone();
        reversed_plan.members.reverse();
        let reversed_map = Map { members: map.members.iter().rev().cloned().collect(), ..map.clone() };
        let reversed = ticks(&|t| {
            let on = (0..3).filter(|m| !off[t][2 - *m]).collect();
            (on, vec![1.0; 3], rows[t].iter().rev().cloned().collect())
        });
        let (got, _) = fused(&reversed_plan, &reversed_map, &reversed);
        for ((_, a), (_, b)) in want.iter().zip(&got) {
            for (a, b) in a.iter().zip(b) {
                prop_assert!((a - b).abs() <= 1e-9);
            }
        }
    }
}
