//! A stored traverse gives the answers that the running fuser gave.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::message::MatchHeader;
use evpr_core::{MemberSet, Reason};
use evpr_fuse::offline::{Query, QueryTick, answers};
use evpr_fuse::{FuseError, MapMember};
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
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn equals_the_running_fuser_with_the_same_holes(
        holes in prop::collection::vec((any::<bool>(), any::<bool>(), prop::bool::weighted(0.2)), 2..25),
        length in 1usize..7,
    ) {
        let plan = plan(&DIMS, length);
        let map = map(&plan, 15, |m, j| (j + m) % 6 != 1);
        let enabled = |t: u64| (0..2usize).filter(|m| *m == 1 || !holes[t as usize].2).collect::<MemberSet>();
        let present = |t: u64, m: usize| if m == 0 { holes[t as usize].0 } else { holes[t as usize].1 };
        let ticks: Vec<u64> = (0..holes.len() as u64).collect();
        let stored = query(&ticks, present);
        let mut fuser = fuser(&plan, map.clone(), 0, 0);
        for t in &ticks {
            let rows: Vec<_> =
                (0..2).map(|m| stored.members[m].row(*t as usize).map(<[f32]>::to_vec)).collect();
            feed(&mut fuser, *t, enabled(*t), &[1.0, 1.0], &rows);
        }
        let live = settle(&mut fuser).messages;
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
    let plan = plan(&DIMS, 4);
    let map = map(&plan, 10, |_, _| true);
    let on = |_: u64| (0..2).collect::<MemberSet>();
    let text = |answers: Vec<_>| format!("{answers:?}");
    let gap = |t: u64| !(5..=7).contains(&t);
    let ticks: Vec<u64> = (3..12).collect();
    let kept: Vec<u64> = ticks.iter().copied().filter(|t| gap(*t)).collect();
    let short = answers(&plan, map.clone(), &query(&kept, |_, _| true), on).unwrap();
    let mut long = answers(&plan, map.clone(), &query(&ticks, |t, _| gap(t)), on).unwrap();
    long.retain(|(h, _)| gap(h.tick));
    assert_eq!(text(short.clone()), text(long));
    let far = [3, 4, 1 << 40];
    let last = answers(&plan, map, &query(&far, |_, _| true), on)
        .unwrap()
        .pop()
        .unwrap();
    assert_eq!(Reason::from_code(last.0.reason), Some(Reason::NoHistory));
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
