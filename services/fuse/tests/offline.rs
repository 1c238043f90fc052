//! A stored traverse gives the answers that the running fuser gave.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::config::{RULES, SEQUENCE_METHODS};
use evpr_core::message::MatchHeader;
use evpr_core::{MemberSet, Reason};
use evpr_fuse::offline::{Query, QueryTick, answers};
use evpr_fuse::{FuseError, Fuser, MapMember};
use proptest::prelude::*;
use support::*;

const DIMS: [usize; 2] = [4, 3];

fn query(ticks: &[u64], present: impl Fn(u64, usize) -> bool) -> Query {
    let member = |m: usize| {
        let values = ticks
            .iter()
            .flat_map(|t| noise(*t as usize * 2 + m, DIMS[m]))
            .collect();
        MapMember::new(values, DIMS[m], ticks.iter().map(|t| present(*t, m)).collect())
    };
    Query {
        ticks: ticks
            .iter()
            .map(|t| QueryTick {
                tick: *t,
                start_us: t * 1000,
                end_us: t * 1000 + 1000,
            })
            .collect(),
        members: vec![member(0), member(1)],
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn equals_the_running_fuser_with_the_same_holes_and_a_death(
        holes in prop::collection::vec((any::<bool>(), any::<bool>(), prop::bool::weighted(0.2)), 2..25),
        length in 1usize..7, method in 0usize..5, rule in 0usize..6, died_at in 0usize..30,
    ) {
        let mut plan = plan(&DIMS, length);
        plan.fuse.sequence = SEQUENCE_METHODS.parse(SEQUENCE_METHODS.all()[method]).unwrap();
        plan.fuse.rule = RULES.parse(RULES.all()[rule]).unwrap();
        let map = map(&plan, 15, |m, j| (j + m) % 6 != 1);
        let enabled = |t: u64| (0..2usize).filter(|m| *m == 1 || !holes[t as usize].2).collect::<MemberSet>();
        let present = |t: u64, m: usize| if m == 0 { holes[t as usize].0 } else { holes[t as usize].1 };
        let ticks: Vec<u64> = (0..holes.len() as u64).collect();
        let stored = query(&ticks, present);
        let run = |fuser: &mut Fuser, ticks: &[u64]| {
            for t in ticks {
                let rows: Vec<_> =
                    (0..2).map(|m| stored.members[m].row(*t as usize).map(<[f32]>::to_vec)).collect();
                feed(fuser, *t, enabled(*t), &[1.0, 1.0], &rows);
            }
            settle(fuser).messages
        };
        // A fuser that dies, and another one that goes back as far as the supervisor sends it.
        let died_at = died_at.min(ticks.len());
        let mut live = run(&mut fuser(&plan, map.clone(), 0, 0), &ticks[..died_at]);
        let history = plan.fuse.history_ticks().unwrap_or(u64::MAX);
        let first = (died_at as u64).saturating_sub(history);
        let mut second = fuser(&plan, map.clone(), first, died_at as u64);
        live.extend(run(&mut second, &ticks[first as usize..]));
        let offline = answers(&plan, map, &stored, enabled).unwrap();
        prop_assert_eq!(live.len(), offline.len());
        for ((live, live_candidates), (offline, offline_candidates)) in live.iter().zip(&offline) {
            let bare = |h: &MatchHeader| {
                let ends = [h.ends[0], h.ends[1]].map(|e| if e > 1 { Reason::Lost as u8 } else { e });
                (h.tick, h.start_us, h.end_us, h.reference, h.score, h.confidence, h.reason, h.candidates, ends)
            };
            prop_assert_eq!(bare(live), bare(offline));
            prop_assert_eq!(&live_candidates[..live.candidates as usize], &offline_candidates[..]);
        }
    }
}

#[test]
fn ticks_that_are_missing_count_as_holes() {
    for method in SEQUENCE_METHODS.all() {
        let mut plan = plan(&DIMS, 4);
        plan.fuse.sequence = SEQUENCE_METHODS.parse(method).unwrap();
        let map = map(&plan, 10, |_, _| true);
        let on = |_: u64| (0..2).collect::<MemberSet>();
        let text = |answers: Vec<_>| format!("{answers:?}");
        let gap = |t: u64| !(5..=7).contains(&t);
        let ticks: Vec<u64> = (3..12).collect();
        let kept: Vec<u64> = ticks.iter().copied().filter(|t| gap(*t)).collect();
        let short = answers(&plan, map.clone(), &query(&kept, |_, _| true), on).unwrap();
        let mut long = answers(&plan, map.clone(), &query(&ticks, |t, _| gap(t)), on).unwrap();
        long.retain(|(h, _)| gap(h.tick));
        assert_eq!(text(short.clone()), text(long), "{method}");
        // After a gap without end only what needs no second row has an answer, as if it were the first.
        let far = [3, 4, 1 << 40];
        let answer = |ticks: &[u64]| {
            let answers = answers(&plan, map.clone(), &query(ticks, |_, _| true), on);
            let (header, candidates) = answers.unwrap().pop().unwrap();
            (header.reference, header.score, header.reason, candidates)
        };
        let (last, alone) = (answer(&far), answer(&far[2..]));
        if method == "paper" {
            assert_eq!(Reason::from_code(last.2), Some(Reason::NoHistory));
        } else if method != "seqslam" {
            assert_eq!(last, alone, "{method}");
        }
    }
}

#[test]
fn seqslam_wants_a_map_as_long_as_its_lines() {
    let mut plan = plan(&DIMS, 4);
    plan.fuse.sequence = SEQUENCE_METHODS.parse("seqslam").unwrap();
    let on = |_: u64| (0..2).collect::<MemberSet>();
    let stored = query(&[0, 1, 2, 3, 4], |_, _| true);
    let refused = answers(&plan, map(&plan, 3, |_, _| true), &stored, on);
    assert!(matches!(
        refused,
        Err(FuseError::TooShort {
            references: 3,
            length: 4
        })
    ));
    let answered = answers(&plan, map(&plan, 4, |_, _| true), &stored, on).unwrap();
    let seen: Vec<_> = answered
        .iter()
        .map(|(h, _)| (h.reference, Reason::from_code(h.reason)))
        .collect();
    let none = (-1, Some(Reason::NoHistory));
    assert_eq!(seen, [none, none, none, (3, None), (3, None)]);
}

#[test]
fn what_does_not_fit_is_refused() {
    let plan = plan(&DIMS, 4);
    let map = map(&plan, 10, |_, _| true);
    let on = |_: u64| (0..9).collect::<MemberSet>();
    let good = query(&[0, 1], |_, _| true);
    assert_eq!(answers(&plan, map.clone(), &good, on).unwrap().len(), 2);
    let mut short = good.clone();
    short.ticks.pop();
    assert!(matches!(
        answers(&plan, map.clone(), &short, on),
        Err(FuseError::Shape { .. })
    ));
    let mut broken = good.clone();
    broken.members[1] = MapMember::new(vec![0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0], 3, vec![true, true]);
    assert!(matches!(
        answers(&plan, map, &broken, on),
        Err(FuseError::QueryNotFinite { tick: 1, .. })
    ));
}

#[test]
fn answers_of_little_confidence_are_none() {
    let mut plan = plan(&DIMS, 1);
    let map = map(&plan, 10, |_, _| true);
    let on = |_: u64| (0..2).collect::<MemberSet>();
    let query = query(&(0..12).collect::<Vec<_>>(), |_, _| true);
    let all = answers(&plan, map.clone(), &query, on).unwrap();
    let mut confidences: Vec<f64> = all.iter().map(|(header, _)| header.confidence).collect();
    confidences.sort_by(f64::total_cmp);
    plan.fuse.min_confidence = confidences[6];
    assert!(confidences[5] < confidences[6]);
    let sure = answers(&plan, map, &query, on).unwrap();
    for ((before, _), (after, candidates)) in all.iter().zip(&sure) {
        if before.confidence >= confidences[6] {
            assert_eq!((after.reference, after.reason), (before.reference, before.reason));
        } else {
            assert_eq!(Reason::from_code(after.reason), Some(Reason::LowConfidence));
            assert!(after.reference < 0 && candidates.is_empty());
        }
    }
    assert_eq!(sure.iter().filter(|(h, _)| h.reference >= 0).count(), 6);
}
