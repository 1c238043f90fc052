//! What must hold for any events, any slicing and any splitting into chunks.
#![allow(clippy::unwrap_used, clippy::panic)] // in the tests' helpers too

mod common;

use common::{METHODS, Recorded, cut, direct, feed, plan, set_tau, windows};
use evpr_core::plan::{Align, Plan, Sensor};
use evpr_core::stage::Stage;
use evpr_core::{MemberSet, Reason};
use evpr_reconstruct::build;
use proptest::prelude::*;

const SENSOR: Sensor = Sensor { height: 3, width: 5 };
const TICKS: u64 = 4;
const TICK_NS: u64 = 1_000_000;
const TAU_NS: i64 = 300_000;

fn config() -> ProptestConfig {
    ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(48)
    }
}

/// Events in the order of their times, over a little more than the ticks; the first at a time that is not round.
fn events() -> impl Strategy<Value = Vec<Recorded>> {
    let event = (0..=TICKS * TICK_NS + 999, 0..5u16, 0..3u16, any::<bool>());
    proptest::collection::vec(event, 1..300).prop_map(|raw| {
        let mut events: Vec<Recorded> = raw
            .into_iter()
            .map(|(t, x, y, on)| Recorded {
                t_ns: 987_654_321 + t,
                x,
                y,
                on,
            })
            .collect();
        events.sort_by_key(|e| e.t_ns);
        events
    })
}

/// Windows in units of 0.1 ms: start-aligned up to the tick, end-aligned up to two and a half.
fn slicing() -> impl Strategy<Value = (Align, Vec<u64>)> {
    let lengths = |longest| proptest::collection::btree_set(1u64..=longest, 1..4);
    let ns = |set: std::collections::BTreeSet<u64>| set.into_iter().map(|w| w * 100_000).collect();
    prop_oneof![
        lengths(10).prop_map(move |set| (Align::Start, ns(set))),
        lengths(25).prop_map(move |set| (Align::End, ns(set))),
    ]
}

fn plan_of(align: Align, lengths: &[u64]) -> Plan {
    let mut plan = plan(SENSOR, &METHODS, TICK_NS, lengths, align, 2);
    set_tau(&mut plan, 2, TAU_NS);
    plan
}

/// A cheap source of numbers of pieces.
fn pieces(seed: u64) -> impl FnMut() -> usize {
    let mut random = common::SplitMix(seed);
    move || (random.draw() % 6) as usize
}

proptest! {
    #![proptest_config(config())]

    /// Segments put together equal the window's own events put through the formulas, for every method, alignment and
    /// splitting; and every window of every tick is answered once, in order.
    #[test]
    fn frames_equal_the_direct_computation(events in events(), (align, lengths) in slicing(), seed in any::<u64>()) {
        let plan = plan_of(align, &lengths);
        let enabled = plan.enabled_members();
        for (method, kind) in METHODS.iter().enumerate() {
            let chunks = cut(&plan, &events, TICKS, &mut pieces(seed), &|_| enabled);
            let mut stage = build(&plan, method).unwrap();
            let frames = feed(&mut stage, &chunks);
            // Windows that close with one segment come in the order of their indices; others by their last segment.
            let mut expected = windows(&plan, &events, TICKS);
            let span = plan.slicing.segments();
            expected.sort_by_key(|(tick, window, _)| (*tick, span.windows[*window].last, *window));
            prop_assert_eq!(frames.len(), expected.len());
            for ((header, pixels), (tick, window, inside)) in frames.iter().zip(expected) {
                prop_assert_eq!((header.tick, header.window as usize), (tick, window));
                prop_assert_eq!(header.extractors, 0b11);
                let reason = match inside {
                    None => Reason::BeforeStart.code(),
                    Some([]) => Reason::EmptyWindow.code(),
                    Some(_) => 0,
                };
                prop_assert_eq!(header.reason, reason);
                if let (0, Some(inside)) = (reason, inside) {
                    prop_assert_eq!(header.events, inside.len() as u64);
                    let image = direct(kind, SENSOR, TAU_NS as f64 / 1e3, inside);
                    prop_assert_eq!(pixels, &image, "{} tick {} window {}", kind, tick, window);
                } else {
                    prop_assert!(pixels.is_empty() && header.events == 0);
                }
            }
        }
    }

    #[test]
    fn splitting_chunks_anywhere_changes_nothing(events in events(), (align, lengths) in slicing(), seed in any::<u64>()) {
        let plan = plan_of(align, &lengths);
        let enabled = plan.enabled_members();
        for method in 0..METHODS.len() {
            let run = |pieces: &mut dyn FnMut() -> usize| {
                let mut stage = build(&plan, method).unwrap();
                let chunks = cut(&plan, &events, TICKS, pieces, &|_| enabled);
                (feed(&mut stage, &chunks), stage.events())
            };
            prop_assert_eq!(run(&mut || 1), run(&mut pieces(seed)));
        }
    }

    /// Windows of one whole tick lose and double nothing.
    #[test]
    fn events_are_conserved(events in events(), align in prop_oneof![Just(Align::Start), Just(Align::End)], seed in any::<u64>()) {
        let plan = plan_of(align, &[TICK_NS]);
        let enabled = plan.enabled_members();
        let end = events[0].t_ns + TICKS * TICK_NS;
        let inside = events.iter().filter(|e| e.t_ns < end).count() as u64;
        for method in 0..METHODS.len() {
            let mut stage = build(&plan, method).unwrap();
            let frames = feed(&mut stage, &cut(&plan, &events, TICKS, &mut pieces(seed), &|_| enabled));
            prop_assert_eq!(frames.iter().map(|(h, _)| h.events).sum::<u64>(), inside);
            prop_assert_eq!((stage.events(), stage.outside_sensor()), (inside, 0));
        }
    }

    /// Disabled members leave the frames of the others as they are in a plan that does not have them.
    #[test]
    fn a_disabled_member_equals_an_absent_one(events in events(), (align, lengths) in slicing(), mask in any::<u32>()) {
        let whole = plan_of(align, &lengths);
        let enabled: MemberSet = (0..whole.members.len()).filter(|m| mask >> m & 1 == 1).collect();
        let mut lean = whole.clone();
        lean.members = enabled.iter().map(|m| whole.members[m].clone()).collect();
        for method in 0..METHODS.len() {
            let run = |plan: &Plan, enabled: MemberSet| {
                let mut stage = build(plan, method).unwrap();
                (feed(&mut stage, &cut(plan, &events, TICKS, &mut || 2, &|_| enabled)), stage.events())
            };
            prop_assert_eq!(run(&whole, enabled), run(&lean, lean.enabled_members()));
        }
    }
}
