//! The whole job on synthetic data.

use super::support::{Bench, TICKS, assert_ticks, read_answers, reasons, run_args, text, timeless};
use nix::sys::signal::Signal;

/// Sequence length of the ensemble configuration.
const SEQUENCE: usize = 5;

fn matches(bench: &Bench, out: &str, extra: &[&str]) -> Vec<serde_json::Value> {
    let config = bench.ensemble_config();
    let query = bench.path("query.txt");
    let out = bench.path(out);
    let map = bench.path("map");
    let mut args = run_args(&config, &query, &map, &["-o", text(&out)]);
    args.extend_from_slice(extra);
    let said = bench.run(&args);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(said.stderr, "");
    read_answers(&out)
}

#[test]
fn a_route_seen_again_is_recognised_and_two_replays_agree() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    bench.recording("query.txt", TICKS, 2);
    let first = matches(&bench, "first.jsonl", &[]);
    assert_ticks(&first, TICKS);
    assert!(reasons(&first).is_empty());
    assert_eq!(first[0]["reason"], "no history");
    assert_eq!(first[10]["members"].as_array().unwrap().len(), 8);
    let right = first.iter().filter(|a| a["reference"] == a["tick"]).count() as u64;
    assert!(right >= TICKS * 9 / 10, "{right} of {TICKS} right");
    let second = matches(
        &bench,
        "second.jsonl",
        &["--record", text(&bench.path("recorded"))],
    );
    for (a, b) in first.iter().zip(&second) {
        assert_eq!(timeless(a), timeless(b));
    }
    let info = bench.run(&["map", "verify", text(&bench.path("recorded"))]);
    assert_eq!(info.code(), 0, "{}", info.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn paced_latest_delivery_gives_the_same_answers_when_nothing_is_late() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    bench.recording("query.txt", 60, 2);
    let lossless = matches(&bench, "lossless.jsonl", &[]);
    let latest = matches(&bench, "latest.jsonl", &["--delivery", "latest", "--pace", "2"]);
    assert_ticks(&lossless, 60);
    assert_ticks(&latest, 60);
    // Whatever the load of the machine: where nothing is missing within the sequence, the answers are the same.
    let whole = |window: &[serde_json::Value]| {
        window
            .iter()
            .all(|a| a["missing"].as_object().unwrap().is_empty())
    };
    let mut compared = 0;
    for end in SEQUENCE..=latest.len() {
        if whole(&latest[end - SEQUENCE..end]) {
            assert_eq!(timeless(&lossless[end - 1]), timeless(&latest[end - 1]));
            compared += 1;
        }
    }
    assert!(compared > 0, "{:?}", reasons(&latest));
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn ctrl_c_ends_in_an_orderly_way_with_130() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let args = run_args(&config, &query, &map, &["--pace", "2"]);
    let mut running = super::support::Running::start(&bench, &args);
    assert!(running.read_to(10));
    super::support::Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
    assert!((answers.len() as u64) < TICKS);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn overload_in_latest_delivery_drops_ticks_but_answers_each_once() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    bench.recording("query.txt", TICKS, 2);
    // Ticks of 50 µs: no machine keeps up.
    let answers = matches(&bench, "flood.jsonl", &["--delivery", "latest", "--pace", "2000"]);
    assert_ticks(&answers, TICKS);
    let missing = reasons(&answers);
    assert!(!missing.is_empty(), "nothing was dropped");
    let known = ["late", "dropped", "incomplete", "lost"];
    assert!(
        missing.keys().all(|r| known.iter().any(|k| r.starts_with(k))),
        "{missing:?}"
    );
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}
