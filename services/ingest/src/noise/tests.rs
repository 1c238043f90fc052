//! The filters against what they say they do, event by event; and whole runs with noise taken out.

use super::*;
use crate::testing::{KeptPort, Sent};
use crate::{Ingest, IngestSummary};
use crossbeam::channel::bounded;
use evpr_core::message::TickKind;
use evpr_core::plan::{Filters, HotPixelRule, Pace, Pixel, Sensor, SliceMode, Source, Street, test_plan};
use evpr_core::stage::StageError;
use proptest::prelude::*;
use std::fmt::Write;
use std::path::{Path, PathBuf};

const MS: u64 = 1_000_000;
const S: u64 = 1_000 * MS;

fn event(t_ns: u64, x: u16, y: u16) -> RawEvent {
    RawEvent { t_ns, x, y, on: true }
}

fn pixels(list: &[(u16, u16)]) -> Vec<Pixel> {
    list.iter().copied().map(Pixel::from).collect()
}

/// The test plan of 4×6 pixels with a mask and filters, ns.
fn noisy(mask: &[(u16, u16)], refractory_ns: Option<u64>, background_activity_ns: Option<u64>) -> Plan {
    let mut plan = test_plan();
    plan.source.hot_pixels = Some(HotPixels {
        from: HotPixelsFrom::File(PathBuf::from("hot.txt")),
        masked_by: MaskedBy::Ingest,
        pixels: Some(pixels(mask)),
    });
    plan.source.filters = Filters {
        refractory_ns,
        background_activity_ns,
    };
    plan
}

/// What is kept, one event after the other, looking back over all that came.
fn slowly(plan: &Plan, events: &[RawEvent]) -> (Vec<RawEvent>, NoiseTally) {
    let mask = plan.source.hot_pixels.as_ref().unwrap().pixels.clone().unwrap();
    let Filters {
        refractory_ns,
        background_activity_ns,
    } = plan.source.filters;
    let (mut seen, mut kept, mut tally) = (Vec::<RawEvent>::new(), Vec::new(), NoiseTally::default());
    for e in events {
        if mask.contains(&Pixel { x: e.x, y: e.y }) {
            tally.hot_pixels += 1;
            continue;
        }
        let soon = |s: &&RawEvent| (s.x, s.y) == (e.x, e.y) && Some(e.t_ns - s.t_ns) < refractory_ns;
        if refractory_ns.is_some() && seen.iter().any(|s| soon(&s)) {
            tally.refractory += 1;
            continue;
        }
        let near = |s: &RawEvent| {
            let apart = (s.x.abs_diff(e.x), s.y.abs_diff(e.y));
            apart != (0, 0) && apart.0 <= 1 && apart.1 <= 1 && Some(e.t_ns - s.t_ns) <= background_activity_ns
        };
        let lone = background_activity_ns.is_some() && !seen.iter().any(near);
        seen.push(*e);
        if lone {
            tally.background_activity += 1;
        } else {
            kept.push(*e);
        }
    }
    (kept, tally)
}

fn applied(plan: &Plan, events: &[RawEvent], cut: usize) -> (Vec<RawEvent>, NoiseTally) {
    let mut noise = Noise::new(plan).unwrap();
    let (left, right) = events.split_at(cut.min(events.len()));
    let (mut left, mut right) = (left.to_vec(), right.to_vec());
    noise.apply(&mut left);
    noise.apply(&mut right);
    left.extend(right);
    (left, noise.tally())
}

#[test]
fn each_filter_keeps_its_limit_exactly() {
    // Refractory: again after exactly its length; what it leaves out does not prolong it.
    let plan = noisy(&[], Some(10), None);
    let events = [0, 4, 9, 10, 19, 20].map(|t| event(t, 2, 2));
    let (kept, tally) = applied(&plan, &events, 3);
    assert_eq!(kept.iter().map(|e| e.t_ns).collect::<Vec<_>>(), [0, 10, 20]);
    assert_eq!(tally.refractory, 3);
    // Background activity: a neighbour exactly so long before, the diagonal and the corners included; the pixel itself
    // is none, nor is one two away.
    let plan = noisy(&[], None, Some(10));
    let events = [
        event(0, 0, 0),
        event(1, 0, 0),
        event(11, 1, 1),
        event(22, 0, 0),
        event(23, 5, 3),
        event(24, 4, 2),
        event(25, 2, 2),
        event(26, 3, 3),
    ];
    let (kept, tally) = applied(&plan, &events, 0);
    assert_eq!(kept.iter().map(|e| e.t_ns).collect::<Vec<_>>(), [11, 24, 26]);
    assert_eq!(tally.background_activity, 5);
    // The first event has no neighbours before it, however early it is.
    assert!(
        applied(&noisy(&[], Some(S), Some(S)), &[event(0, 0, 0)], 0)
            .0
            .is_empty()
    );
    assert_eq!(
        applied(&noisy(&[], Some(S), None), &[event(0, 0, 0)], 0).0.len(),
        1
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]
    #[test]
    fn it_is_what_it_says_however_it_is_split(
        raw in proptest::collection::vec((0u64..6, 0u16..6, 0u16..4), 0..80),
        mask in proptest::collection::vec((0u16..6, 0u16..4), 0..3),
        refractory in proptest::option::of(1u64..12),
        background in proptest::option::of(1u64..12),
        start in prop_oneof![Just(0u64), Just(crate::MAX_TIME_NS - 1000)],
        cut in 0usize..80,
    ) {
        let mut t = start;
        let events: Vec<_> = raw.into_iter().map(|(step, x, y)| { t += step; event(t, x, y) }).collect();
        let plan = noisy(&mask, refractory, background);
        let wanted = slowly(&plan, &events);
        prop_assert_eq!(&applied(&plan, &events, cut), &wanted);
        prop_assert_eq!(wanted.0.len() as u64 + wanted.1.dropped(), events.len() as u64);
    }
}

#[test]
fn a_live_mask_holds_from_the_end_of_its_period_on() {
    let mut plan = test_plan();
    plan.source.hot_pixels = Some(HotPixels {
        from: HotPixelsFrom::Learn {
            period_ns: S,
            rule: HotPixelRule::default(),
        },
        masked_by: MaskedBy::Ingest,
        pixels: None,
    });
    // 100 events per second at one pixel, one now and then elsewhere.
    let events: Vec<_> = (0..300)
        .map(|i| event(7 + i * 10 * MS, if i % 10 == 9 { 5 } else { 2 }, 1))
        .collect();
    let of = |kept: &[RawEvent], x: u16| kept.iter().filter(|e| e.x == x).count();
    for cut in [0, 1, 99, 100, 101, 250] {
        let (kept, tally) = applied(&plan, &events, cut);
        assert_eq!((of(&kept, 2), of(&kept, 5)), (90, 30), "{cut}");
        assert_eq!(tally.hot_pixels, 180);
        assert_eq!(kept.iter().rfind(|e| e.x == 2).unwrap().t_ns, 7 + 980 * MS);
    }
    assert_eq!(Noise::new(&plan).unwrap().memory(), Memory::All);
}

#[test]
fn a_mask_of_a_file_must_be_in_the_plan() {
    let mut plan = noisy(&[], None, None);
    plan.source.hot_pixels.as_mut().unwrap().pixels = None;
    let error = Noise::new(&plan).unwrap_err().to_string();
    assert!(error.contains("hot.txt are not in the plan"), "{error}");
    // Where reconstructions mask, ingest does nothing.
    plan.source.hot_pixels.as_mut().unwrap().masked_by = MaskedBy::Reconstruction;
    assert!(Noise::new(&plan).is_ok());
}

/// A recording of three seconds: something moves along the row 2; the pixel (5, 0) is hot, and fires first and last.
fn recording(folder: &Path) -> PathBuf {
    let mut lines = String::new();
    for ms in 0..3_000u64 {
        let _ = writeln!(lines, "{} 5 0 1", ms * 1_000);
        if (1..2_990).contains(&ms) {
            let x = ms / 3 % 6;
            let _ = writeln!(lines, "{} {x} 2 1", ms * 1_000 + 100);
            let _ = writeln!(lines, "{} {x} 3 {}", ms * 1_000 + 100 + ms % 800, ms % 2);
        }
    }
    let path = folder.join("events.txt");
    std::fs::write(&path, lines).unwrap();
    path
}

/// 4×6 pixels, ticks of 100 ms with windows of 20 and 100 ms.
fn plan_of(path: PathBuf) -> Plan {
    let mut plan = test_plan();
    plan.source.path = path;
    plan.source.time_unit = evpr_core::plan::TimeUnit::Us;
    (plan.slicing.tick, plan.slicing.windows) = (100 * MS, vec![20 * MS, 100 * MS]);
    plan
}

fn ran(plan: &Plan, resume_tick: u64) -> Result<(IngestSummary, KeptPort), StageError> {
    let mut port = KeptPort::default();
    let (_keep, stop) = bounded(0);
    let summary = Ingest::new(plan, resume_tick, 1, stop).unwrap().run(&mut port)?;
    Ok((summary, port))
}

fn learning(plan: &Plan) -> Plan {
    let mut plan = plan.clone();
    plan.source.hot_pixels = Some(HotPixels {
        from: HotPixelsFrom::Learn {
            period_ns: S,
            rule: HotPixelRule::default(),
        },
        masked_by: MaskedBy::Ingest,
        pixels: None,
    });
    plan
}

#[test]
fn a_mask_is_learned_before_the_first_event_and_moves_no_tick() {
    let dir = tempfile::tempdir().unwrap();
    let plain = plan_of(recording(dir.path()));
    let mut plan = learning(&plain);
    find_hot_pixels(&mut plan).unwrap();
    assert_eq!(
        plan.source.hot_pixels.as_ref().unwrap().pixels,
        Some(pixels(&[(5, 0)]))
    );
    let (summary, port) = ran(&plan, 0).unwrap();
    let (all, whole) = ran(&plain, 0).unwrap();
    assert_eq!(summary.noise.hot_pixels, 3_000);
    assert_eq!(summary.sliced.sent + 3_000, all.sliced.sent);
    // Though the first event and the last ones are masked.
    assert_eq!((summary.end_tick, all.end_tick), (29, 29));
    let openings = |port: &KeptPort| -> Vec<(TickKind, u64, u64)> {
        port.ticks().map(|(kind, h)| (kind, h.tick, h.start_us)).collect()
    };
    assert_eq!(openings(&port), openings(&whole));
    let mut wanted = whole.segments();
    for (_, _, events) in &mut wanted {
        events.retain(|e| (e.1, e.2) != (5, 0));
    }
    assert_eq!(port.segments(), wanted);
    assert_eq!(port.progress.3, 3_000);
}

/// What is sent for this tick and later ones.
fn from_tick(port: &KeptPort, tick: u64) -> Vec<Sent> {
    let later = |s: &&Sent| match s {
        Sent::Chunk(h, _) => h.tick >= tick,
        Sent::Tick(h, _) => h.tick >= tick,
    };
    port.sent.iter().filter(later).cloned().collect()
}

#[test]
fn a_resumed_run_with_noise_taken_out_is_the_rest_of_the_whole_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = recording(dir.path());
    for (r, b) in [
        (Some(3 * MS), None),
        (None, Some(MS / 2)),
        (Some(3 * MS), Some(MS / 2)),
    ] {
        for mode in [SliceMode::Time, SliceMode::Count] {
            let base = plan_of(path.clone());
            let mut plan = learning(&base);
            plan.source.filters = Filters {
                refractory_ns: r,
                background_activity_ns: b,
            };
            find_hot_pixels(&mut plan).unwrap();
            if mode == SliceMode::Count {
                plan.slicing.mode = mode;
                (plan.slicing.tick, plan.slicing.windows) = (40, vec![10, 40]);
            }
            let (summary, whole) = ran(&plan, 0).unwrap();
            assert!(summary.noise.dropped() > 0 && summary.sliced.sent > 40);
            assert_eq!(
                (
                    summary.noise.refractory > 0,
                    summary.noise.background_activity > 0
                ),
                (r.is_some(), b.is_some())
            );
            assert!(summary.end_tick > 1);
            for tick in [1, 2, 4].into_iter().filter(|tick| *tick < summary.end_tick) {
                let (_, rest) = ran(&plan, tick).unwrap();
                assert_eq!(rest.sent, from_tick(&whole, tick), "{r:?} {b:?} {mode:?} {tick}");
            }
        }
    }
}

/// A recording that can be searched by time: the filter of background activity sees again what it remembers.
#[test]
fn a_resumed_search_of_the_corridor_gives_the_rest_of_the_whole_run() {
    let name = "a_resumed_search_of_the_corridor_gives_the_rest_of_the_whole_run";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/corridor/query_events.h5");
    if !path.exists() {
        println!("skipped: {name}: {} is absent", path.display());
        return;
    }
    let mut plan = noisy(&[(112, 4), (51, 18)], None, Some(20 * MS));
    plan.source.path = path;
    plan.sensor = Sensor {
        height: 128,
        width: 128,
    };
    (plan.slicing.tick, plan.slicing.windows) = (500 * MS, vec![100 * MS, 500 * MS]);
    assert_eq!(Noise::new(&plan).unwrap().memory(), Memory::Ns(20 * MS));
    let (summary, whole) = ran(&plan, 0).unwrap();
    assert!(summary.noise.background_activity > 100_000 && summary.noise.hot_pixels > 3_000);
    assert_eq!(summary.end_tick, 299);
    for tick in [200, 290] {
        let (part, rest) = ran(&plan, tick).unwrap();
        assert!(
            rest.sent == from_tick(&whole, tick),
            "resumed at {tick} it differs"
        );
        // It was searched, and not read from its start.
        assert!(part.noise.background_activity < summary.noise.background_activity / 2);
    }
}

#[test]
fn quiet_ticks_of_noise_alone_are_closed_when_they_are_due() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    // Nothing but the hot pixel.
    let lines: String = (0..1_000u64)
        .map(|ms| format!("{} 5 0 1\n", ms * 1_000))
        .collect();
    std::fs::write(&path, lines).unwrap();
    for pace in [Pace::Unpaced, Pace::Factor(2.0)] {
        let mut plan = learning(&plan_of(path.clone()));
        plan.source.pace = pace;
        find_hot_pixels(&mut plan).unwrap();
        let (summary, port) = ran(&plan, 0).unwrap();
        assert_eq!((summary.end_tick, summary.sliced.sent), (9, 0));
        for ((kind, h), now) in port.ticks().zip(
            port.sent
                .iter()
                .zip(&port.sent_ns)
                .filter(|(s, _)| matches!(s, Sent::Tick(..)))
                .map(|(_, now)| *now),
        ) {
            if pace != Pace::Unpaced && kind == TickKind::Close {
                assert_eq!(now, (h.tick + 1) * 50 * MS);
            }
        }
    }
}

#[test]
fn a_recording_that_goes_bad_while_it_is_learned_from_fails_in_the_replay() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    let mut lines: String = (0..500u64).map(|ms| format!("{} 5 0 1\n", ms * 1_000)).collect();
    lines += "499000 40 0 1\n";
    std::fs::write(&path, lines).unwrap();
    let mut plan = learning(&plan_of(path));
    find_hot_pixels(&mut plan).unwrap();
    assert_eq!(
        plan.source.hot_pixels.as_ref().unwrap().pixels,
        Some(pixels(&[(5, 0)]))
    );
    let mut port = KeptPort::default();
    let (_keep, stop) = bounded(0);
    let error = Ingest::new(&plan, 0, 1, stop)
        .unwrap()
        .run(&mut port)
        .unwrap_err();
    assert!(error.to_string().contains("event 500 (from 0)"), "{error}");
    assert_eq!(port.ticks().last().unwrap().1.tick, 4);
}

#[test]
fn bad_lists_and_live_streams_say_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let list = dir.path().join("hot.txt");
    std::fs::write(&list, "1,1\n9,9\n").unwrap();
    let mut plan = noisy(&[], None, None);
    let hot = plan.source.hot_pixels.as_mut().unwrap();
    (hot.from, hot.pixels) = (HotPixelsFrom::File(list.clone()), None);
    let error = find_hot_pixels(&mut plan.clone()).unwrap_err().to_string();
    assert!(error.contains("line 2: pixel 9,9 lies outside"), "{error}");
    std::fs::write(&list, "3,1\n1,1\n").unwrap();
    find_hot_pixels(&mut plan).unwrap();
    assert_eq!(
        plan.source.hot_pixels.as_ref().unwrap().pixels,
        Some(pixels(&[(1, 1), (3, 1)]))
    );
    // Once they are known they stay.
    std::fs::remove_file(&list).unwrap();
    find_hot_pixels(&mut plan).unwrap();
    let mut live = learning(&plan);
    live.source.kind = "a camera".to_owned();
    find_hot_pixels(&mut live).unwrap();
    assert_eq!(live.source.hot_pixels.as_ref().unwrap().pixels, None);
    live.source.hot_pixels.as_mut().unwrap().masked_by = MaskedBy::Reconstruction;
    let error = find_hot_pixels(&mut live).unwrap_err().to_string();
    assert!(error.contains("evpr events hot-pixels"), "{error}");
}

/// The street's camera has a hot pixel in 2000; the first second of the drive shows which.
#[test]
fn the_hot_pixels_of_the_street_are_found() {
    let mut plan = test_plan();
    plan.source = Source::street(Street {
        length_m: 25.0,
        ..Street::default()
    });
    plan.sensor = plan.source.street.as_ref().unwrap().sensor;
    let mut plan = learning(&plan);
    plan.source.hot_pixels.as_mut().unwrap().from = HotPixelsFrom::Learn {
        period_ns: 4 * S,
        rule: HotPixelRule::default(),
    };
    find_hot_pixels(&mut plan).unwrap();
    let found = plan.source.hot_pixels.as_ref().unwrap().pixels.clone().unwrap();
    let hot = crate::source::street_hot_pixels(plan.source.street.as_ref().unwrap());
    let right = found.iter().filter(|p| hot.contains(p)).count();
    println!(
        "{} of {} hot pixels, and {} others",
        right,
        hot.len(),
        found.len() - right
    );
    assert!(
        hot.len() >= 5 && right * 10 >= hot.len() * 8,
        "{found:?} of {hot:?}"
    );
    assert!(
        found.len() - right <= plan.sensor.pixels() / 2_000,
        "{found:?} of {hot:?}"
    );
}
