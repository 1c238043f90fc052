//! The driver with a stream in memory and a clock that only waiting moves.

use super::*;
use crate::testing::{KeptPort, Sent};
use evpr_core::message::{ChunkHeader, TickKind};
use evpr_core::plan::{Delivery, LiveSource, Source, test_plan};
use evpr_core::stage::OpenedTick;
use proptest::prelude::*;
use std::collections::{BTreeMap, VecDeque};

const MS: u64 = 1_000_000;
/// The host's clock when the sensor's is 0.
const HOST0: u64 = 1_000 * MS;
const TICK: u64 = 100 * MS;
const SLACK: u64 = 20 * MS;

/// Items at host times, and then nothing until the run is stopped.
struct Script {
    items: VecDeque<(u64, Item)>,
    stop_ns: u64,
}

impl Arrivals for Script {
    fn next(&mut self, deadline_ns: u64, port: &mut dyn IngestPort) -> Next {
        let due = deadline_ns.min(self.stop_ns);
        if self.items.front().is_some_and(|(at, _)| *at <= due)
            && let Some((at, item)) = self.items.pop_front()
        {
            port.wait_until(at).unwrap();
            return Next::Item(item);
        }
        port.wait_until(due).unwrap();
        if due == self.stop_ns {
            Next::Stopped
        } else {
            Next::Due
        }
    }
}

fn plan(delivery: Delivery) -> Plan {
    let mut plan = test_plan();
    plan.source = Source::live(
        "tcp",
        LiveSource {
            address: Some("camera:1".to_owned()),
            serial: None,
            slack_ns: SLACK,
        },
    );
    plan.source.on_backward_time = evpr_core::plan::OnBadEvent::Drop;
    plan.source.on_outside_sensor = evpr_core::plan::OnBadEvent::Drop;
    plan.slicing.tick = TICK;
    plan.slicing.windows = vec![TICK];
    plan.delivery = delivery;
    plan
}

fn event(t_ns: u64) -> RawEvent {
    RawEvent {
        t_ns,
        x: 1,
        y: 1,
        on: true,
    }
}

fn connected() -> Item {
    Item::Connected(evpr_events::SourceInfo {
        format: "text",
        path: "camera:1".into(),
        time_unit: "s",
        time_unit_from: "decimal point",
        events: None,
    })
}

/// Events at these sensor times in ms that arrive `way_ms` after the last of them.
fn events(host0_ns: u64, way_ms: u64, times_ms: &[u64]) -> (u64, Item) {
    let arrival_ns = host0_ns + (times_ms.last().unwrap() + way_ms) * MS;
    let events = times_ms.iter().map(|t| event(t * MS)).collect();
    (arrival_ns, Item::Events { arrival_ns, events })
}

fn run_with(
    port: &mut KeptPort,
    plan: &Plan,
    first: u64,
    items: Vec<(u64, Item)>,
    stop_ms: u64,
) -> LiveSummary {
    let mut driver = Driver::new(plan, first, 1).unwrap();
    let mut script = Script {
        items: items.into(),
        stop_ns: HOST0 + stop_ms * MS,
    };
    let outcome = driver.run(&mut script, port);
    driver.end(outcome, port).unwrap()
}

fn run(items: Vec<(u64, Item)>, stop_ms: u64) -> (KeptPort, LiveSummary) {
    let mut port = KeptPort {
        now_ns: HOST0,
        ..KeptPort::default()
    };
    let summary = run_with(&mut port, &plan(Delivery::Latest), 0, items, stop_ms);
    (port, summary)
}

/// Per tick: its events, and why it is not whole.
fn ticks(port: &KeptPort) -> BTreeMap<u64, (usize, Option<Reason>)> {
    let mut ticks = BTreeMap::new();
    for (header, events) in port.chunks() {
        let (count, loss): &mut (usize, Option<Reason>) = ticks.entry(header.tick).or_default();
        *count += events.len();
        *loss = loss.or(header.loss());
    }
    ticks
}

fn closed(port: &KeptPort) -> Vec<u64> {
    let of_kind = |(kind, tick)| (kind == TickKind::Close).then_some(tick);
    port.tick_numbers().into_iter().filter_map(of_kind).collect()
}

/// When tick `tick` closed, host ms after [`HOST0`].
fn closed_at(port: &KeptPort, tick: u64) -> u64 {
    let mut sent = port.sent.iter().zip(&port.sent_ns);
    let closes =
        |s: &Sent| matches!(s, Sent::Tick(h, _) if h.tick == tick && h.kind == TickKind::Close as u32);
    let (_, ns) = sent.find(|(s, _)| closes(s)).unwrap();
    (ns - HOST0) / MS
}

#[test]
fn a_quiet_sensor_closes_its_windows_a_slack_after_they_are_over() {
    let (port, summary) = run(vec![events(HOST0, 3, &[0, 50])], 350);
    assert_eq!(closed(&port), [0, 1, 2]);
    // 3 ms on the way, the end of the tick, and the slack.
    let at: Vec<u64> = (0..3).map(|t| closed_at(&port, t)).collect();
    assert_eq!(at, [123, 223, 323]);
    assert_eq!((summary.end_tick, summary.stopped), (3, true));
    assert_eq!(ticks(&port)[&0], (2, None));
}

#[test]
fn the_next_event_closes_a_window_at_once() {
    let (port, _) = run(
        vec![events(HOST0, 1, &[0, 50]), events(HOST0, 1, &[90, 105])],
        110,
    );
    assert_eq!(closed_at(&port, 0), 106);
    assert_eq!(ticks(&port)[&0], (3, None));
}

#[test]
fn events_that_come_after_their_window_is_closed_are_left_out_and_counted() {
    let late = (
        HOST0 + 140 * MS,
        Item::Events {
            arrival_ns: HOST0 + 140 * MS,
            events: vec![event(95 * MS), event(110 * MS)],
        },
    );
    let (port, summary) = run(vec![events(HOST0, 0, &[0, 50]), late], 240);
    assert_eq!(summary.live.late_events, 1);
    assert_eq!((ticks(&port)[&0], ticks(&port)[&1]), ((2, None), (1, None)));
}

#[test]
fn overload_costs_the_whole_ticks_that_it_touches() {
    let items = vec![
        events(HOST0, 0, &[0, 50, 150, 199]),
        (HOST0 + 200 * MS, Item::Lost(7)),
        events(HOST0, 0, &[330, 340]),
        events(HOST0, 0, &[410, 501]),
    ];
    let (port, summary) = run(items, 502);
    let dropped = Some(Reason::Dropped);
    let whole: Vec<_> = ticks(&port)
        .into_iter()
        .map(|(tick, (_, loss))| (tick, loss))
        .collect();
    assert_eq!(
        whole,
        [
            (0, None),
            (1, dropped),
            (2, dropped),
            (3, dropped),
            (4, None),
            (5, None)
        ]
    );
    assert_eq!(closed(&port), [0, 1, 2, 3, 4]);
    assert_eq!(summary.live.dropped_ticks, 3);
    // 7 in the queue, 2 in tick 1 that were kept back, 2 in tick 3.
    assert_eq!(summary.live.lost_events, 11);
}

#[test]
fn a_disconnection_costs_only_the_ticks_in_between_which_go_on_by_the_hosts_clock() {
    let items = vec![
        events(HOST0, 0, &[0, 99, 120]),
        (HOST0 + 125 * MS, Item::Disconnected("gone".to_owned())),
        (HOST0 + 160 * MS, Item::Unreachable("no".to_owned())),
        (HOST0 + 470 * MS, connected()),
        events(HOST0, 0, &[480]),
        events(HOST0, 0, &[520]),
        events(HOST0, 0, &[601]),
    ];
    let (port, summary) = run(items, 602);
    let away = Some(Reason::Disconnected);
    let got = ticks(&port);
    assert_eq!(got[&0], (2, None));
    for tick in 1..5 {
        assert_eq!(got[&tick], (0, away), "tick {tick}");
    }
    assert_eq!(got[&5], (1, None));
    assert_eq!(closed_at(&port, 2), 320, "nobody waits for the camera");
    assert_eq!((summary.live.missed_ticks, summary.live.disconnects), (4, 1));
    assert_eq!(summary.live.jumps, 0);
}

#[test]
fn a_camera_that_starts_anew_goes_on_by_the_hosts_clock() {
    let items = vec![
        events(HOST0, 0, &[5_000, 5_099, 5_120]),
        (HOST0 + 5_150 * MS, Item::Disconnected("gone".to_owned())),
        (HOST0 + 5_470 * MS, connected()),
    ];
    // Its time begins at 0 again, at the host's 5480 ms.
    let anew = (0..=10).map(|ms| events(HOST0 + 5_480 * MS, 0, &[ms]));
    let items = items.into_iter().chain(anew);
    let items = items.chain([events(HOST0 + 5_480 * MS, 0, &[40, 130])]).collect();
    let (port, summary) = run(items, 5_615);
    assert_eq!(closed(&port), [0, 1, 2, 3, 4, 5]);
    // Tick 0 began at 5000; so 5480 + 40 is in tick 5, and 5480 + 130 in tick 6.
    assert_eq!(ticks(&port)[&5], (1, None));
    assert_eq!(ticks(&port)[&4].1, Some(Reason::Disconnected));
    assert_eq!((summary.live.missed_ticks, summary.live.jumps), (4, 1));
}

#[test]
fn time_that_jumps_within_a_connection_costs_the_tick_and_not_the_grid() {
    let items = vec![
        events(HOST0, 0, &[5_000, 5_150]),
        (
            HOST0 + 5_160 * MS,
            Item::Events {
                arrival_ns: HOST0 + 5_160 * MS,
                events: vec![event(7), event(8)],
            },
        ),
    ];
    let anew = (1..=11).map(|ms| events(HOST0 + 5_160 * MS, 0, &[ms]));
    let items = items.into_iter().chain(anew);
    let items = items.chain([events(HOST0 + 5_160 * MS, 0, &[50, 150])]).collect();
    let (port, summary) = run(items, 5_311);
    assert_eq!(summary.live.jumps, 1);
    assert_eq!(ticks(&port)[&1].1, Some(Reason::Disconnected));
    assert_eq!(ticks(&port)[&2], (1, None));
    assert_eq!(summary.sliced.missed_ticks, 1);
}

#[test]
fn damaged_times_cost_their_events_and_no_tick() {
    let mut items: Vec<_> = (0..60).map(|i| events(HOST0, 0, &[i * 10, i * 10 + 5])).collect();
    // Ahead by half a tick, by many ticks and by an hour, back, and beyond all times.
    for (at, ms) in [
        (5, 105),
        (20, 30_000),
        (30, 3_600_000),
        (40, 0),
        (50, u64::MAX / MS),
    ] {
        let Item::Events { events, .. } = &mut items[at].1 else {
            unreachable!()
        };
        events.insert(1, event(ms * MS));
    }
    let (port, summary) = run(items, 600);
    let whole = (0..6).map(|tick| (tick, (20, None)));
    assert_eq!(ticks(&port), whole.collect());
    assert_eq!(closed(&port), [0, 1, 2, 3, 4]);
    // By less than a second back is the screen's.
    assert_eq!(
        (summary.screened.damaged_times, summary.screened.backward_dropped),
        (4, 1)
    );
    assert_eq!((summary.live.jumps, summary.live.missed_ticks), (0, 0));
}

#[test]
fn a_later_life_goes_on_with_the_grid_and_says_what_it_missed() {
    let mut port = KeptPort {
        now_ns: HOST0 + 5_450 * MS,
        opened_before: Some(OpenedTick {
            tick: 2,
            start_us: 5_200_000,
            sent_ns: HOST0 + 5_201 * MS,
        }),
        ..KeptPort::default()
    };
    let items = vec![
        events(HOST0, 1, &[5_520, 5_530]),
        events(HOST0, 1, &[5_610, 5_701]),
    ];
    let summary = run_with(&mut port, &plan(Delivery::Latest), 1, items, 5_703);
    assert_eq!(closed(&port), [1, 2, 3, 4, 5, 6]);
    let got = ticks(&port);
    for tick in 1..6 {
        assert_eq!(got[&tick], (0, Some(Reason::Lost)), "tick {tick}");
    }
    assert_eq!(got[&6], (1, None));
    let starts: Vec<u64> = port
        .ticks()
        .filter(|(kind, _)| *kind == TickKind::Open)
        .map(|(_, h)| h.start_us)
        .collect();
    assert_eq!(starts[..2], [5_100_000, 5_200_000]);
    assert_eq!(summary.live.missed_ticks, 5);
}

#[test]
fn standard_input_in_lossless_delivery_closes_nothing_by_the_hosts_clock() {
    let mut plan = plan(Delivery::Lossless);
    plan.source = Source::live(
        "stdin",
        LiveSource {
            address: None,
            serial: None,
            slack_ns: SLACK,
        },
    );
    let mut port = KeptPort {
        now_ns: HOST0,
        ..KeptPort::default()
    };
    let items = vec![
        events(HOST0, 0, &[0, 50]),
        (HOST0 + 900 * MS, events(HOST0, 0, &[90, 210]).1),
        (HOST0 + 901 * MS, Item::Ended),
    ];
    let summary = run_with(&mut port, &plan, 0, items, 2_000);
    assert_eq!(closed(&port), [0, 1]);
    assert_eq!(closed_at(&port, 0), 900);
    assert_eq!((ticks(&port)[&0], summary.stopped), ((3, None), false));
    assert_eq!(summary.end_tick, 2);
}

#[test]
fn nothing_is_sent_while_nobody_was_ever_connected() {
    let (port, summary) = run(vec![(HOST0, Item::Unreachable("no".to_owned()))], 5_000);
    assert_eq!(port.tick_numbers(), [(TickKind::End, 0)]);
    assert!(summary.stopped && port.progress == (0, 0, 0, 0));
}

#[test]
fn a_life_that_is_to_end_before_it_begins_says_where_the_stream_ends() {
    let mut port = KeptPort::default();
    let summary = Live::end_at(&plan(Delivery::Latest), 7, 2, &mut port).unwrap();
    assert_eq!(port.tick_numbers(), [(TickKind::End, 7)]);
    assert_eq!((summary.end_tick, summary.stopped), (7, true));
}

#[test]
fn a_source_that_fails_ends_the_stream_and_says_why() {
    let mut port = KeptPort {
        now_ns: HOST0,
        ..KeptPort::default()
    };
    let mut driver = Driver::new(&plan(Delivery::Latest), 0, 1).unwrap();
    let items = [
        events(HOST0, 0, &[0, 110]),
        (HOST0 + 120 * MS, Item::Failed("why".to_owned())),
    ];
    let mut script = Script {
        items: items.into(),
        stop_ns: u64::MAX,
    };
    let outcome = driver.run(&mut script, &mut port);
    let error = driver.end(outcome, &mut port).unwrap_err();
    assert!(matches!(error, StageError::Fatal(why) if why == "why"));
    assert_eq!(port.tick_numbers().last(), Some(&(TickKind::End, 1)));
}

/// What can come, with the host time since the item before, ms.
fn any_item() -> impl Strategy<Value = (u64, u8, u64, u64)> {
    (0u64..180, 0u8..10, 0u64..400, 0u64..12)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn every_tick_is_opened_and_closed_once_and_in_order(
        raw in proptest::collection::vec(any_item(), 1..60),
        lossless: bool,
    ) {
        let mut host = HOST0;
        let mut sensor = 3_000 * MS;
        let mut items = Vec::new();
        for (wait_ms, what, jump_ms, count) in raw {
            host += wait_ms * MS;
            sensor += wait_ms * MS;
            items.push((host, match what {
                0 => Item::Lost(count),
                1 => Item::Disconnected(String::new()),
                2 => connected(),
                3 => Item::Unreachable(String::new()),
                _ => {
                    if what == 4 {
                        sensor = jump_ms * MS * 1_000;
                    }
                    let early = (jump_ms * MS / 4).min(sensor);
                    let times = (0..count).map(|i| event(sensor - early + i * early / 12));
                    Item::Events { arrival_ns: host, events: times.collect() }
                }
            }));
        }
        let delivery = if lossless { Delivery::Lossless } else { Delivery::Latest };
        let plan = plan(delivery);
        let mut port = KeptPort { now_ns: HOST0, ..KeptPort::default() };
        let stop_ms = (host - HOST0) / MS + 333;
        let summary = run_with(&mut port, &plan, 0, items.clone(), stop_ms);
        let mut expected: Vec<_> = (0..summary.end_tick)
            .flat_map(|t| [(TickKind::Open, t), (TickKind::Close, t)])
            .collect();
        let said = port.tick_numbers();
        if said.iter().any(|(kind, t)| *kind == TickKind::Open && *t == summary.end_tick) {
            expected.push((TickKind::Open, summary.end_tick));
        }
        expected.push((TickKind::End, summary.end_tick));
        prop_assert_eq!(said, expected);
        // Nothing is sent of a segment that is not whole, and every event is accounted for.
        let lost_chunks = |h: &ChunkHeader| h.loss().is_some();
        prop_assert!(port.chunks().all(|(h, events)| !lost_chunks(h) || events.is_empty()));
        let all: u64 = items.iter().map(|(_, item)| match item {
            Item::Events { events, .. } => events.len() as u64,
            Item::Lost(n) => *n,
            _ => 0,
        }).sum();
        let kept = summary.sliced.sent + summary.live.lost_events + summary.live.late_events
            + summary.screened.dropped() + summary.sliced.unneeded + summary.sliced.before_origin;
        prop_assert_eq!(kept, all);
    }
}
