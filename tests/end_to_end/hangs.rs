//! Processes that neither work nor die: stopped, or stuck in one message; and slow ones, which are let be.

use super::support::{Bench, Running, TICKS, assert_ticks, read_answers, reasons, run_args, text, timeless};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::path::PathBuf;

const LIMITS: &str = "[supervision]\nhang = \"3s\"\n";
/// Ticks of 20 ms on the wall.
const PACE: &str = "5";

/// The bench's configuration with short limits.
fn config(bench: &Bench) -> PathBuf {
    let config = std::fs::read_to_string(bench.ensemble_config()).unwrap();
    bench.file("ensemble.toml", &(config + LIMITS))
}

fn complete(answer: &Value) -> bool {
    answer["complete"].as_bool().unwrap()
}

/// Stops a process of this kind in the middle of a run and gives the answers with what was logged.
fn stop_one(kind: &str, delivery: &str, ticks: u64) -> (Bench, Vec<Value>, String) {
    let bench = Bench::new();
    let config = config(&bench);
    let map = bench.map(&config);
    let query = bench.recording("query.txt", ticks, 2);
    let args = run_args(&config, &query, &map, &["--pace", PACE, "--delivery", delivery]);
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(30));
    Running::signal(running.services(kind)[0], Signal::SIGSTOP);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, ticks);
    assert!(
        said.stderr.contains("has said nothing for 3 s and is killed"),
        "{}",
        said.stderr
    );
    // Those who waited for it did not hang.
    assert_eq!(said.stderr.matches("is killed").count(), 1, "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
    (bench, answers, said.stderr)
}

fn assert_undisturbed(bench: &Bench, answers: &[Value]) {
    let out = bench.path("undisturbed.jsonl");
    let (config, query, map) = (
        bench.path("ensemble.toml"),
        bench.path("query.txt"),
        bench.path("map"),
    );
    let said = bench.run(&run_args(&config, &query, &map, &["-o", text(&out)]));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    for (a, b) in read_answers(&out).iter().zip(answers) {
        assert_eq!(timeless(a), timeless(b));
    }
}

#[test]
fn a_stopped_ingest_costs_nothing_in_lossless_delivery() {
    let (bench, answers, _) = stop_one("ingest", "lossless", 100);
    assert_undisturbed(&bench, &answers);
}

#[test]
fn a_stopped_fuser_costs_nothing_in_lossless_delivery() {
    let (bench, answers, _) = stop_one("fuse", "lossless", 100);
    assert_undisturbed(&bench, &answers);
}

#[test]
fn the_members_of_a_stopped_extractor_come_back() {
    let (_bench, answers, said) = stop_one("extract", "lossless", 600);
    assert!(reasons(&answers).contains_key("extractor down"), "{said}");
    assert!(complete(answers.last().unwrap()), "{said}");
}

#[test]
fn nobody_waits_for_a_stopped_reconstruction_in_latest_delivery() {
    let (_bench, answers, said) = stop_one("reconstruct", "latest", 600);
    assert!(complete(answers.last().unwrap()), "{said}");
}

#[test]
fn an_extractor_that_is_stuck_in_one_message_is_killed_and_a_slow_one_is_not() {
    let bench = Bench::new();
    let config = config(&bench);
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 20, 2);
    bench.delay("extract/patch_norm", 300);
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &[]));
    // Fourteen messages or more, slowly.
    assert!(running.read_to(2));
    bench.delay("extract/patch_norm", 3_600_000);
    assert!(running.logs("extract/patch_norm has been busy with one message for 3 s and is killed"));
    bench.delay("extract/patch_norm", 0);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, 20);
    // Its next incarnation may still have found the long delay; nobody else was killed.
    let killed = said.stderr.lines().filter(|l| l.contains("is killed"));
    assert!(
        killed.into_iter().all(|l| l.contains("extract/patch_norm")),
        "{}",
        said.stderr
    );
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_stage_that_dies_again_and_again_is_marked_down_and_the_rest_goes_on() {
    let bench = Bench::new();
    let config = std::fs::read_to_string(bench.ensemble_config()).unwrap();
    let config = bench.file("ensemble.toml", &(config + "[supervision]\ndeaths = 2\n"));
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let args = run_args(&config, &query, &map, &["--pace", "2"]);
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(20));
    let mut killed = Vec::new();
    while killed.len() < 3 {
        // Ingest, two reconstructions, and the first extractor come before it.
        let victim = running.service(4);
        if let Some(pid) = victim.filter(|pid| !killed.contains(pid)) {
            Running::signal(pid, Signal::SIGKILL);
            killed.push(pid);
        }
        std::thread::yield_now();
    }
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    assert!(
        said.stderr.contains("extract/raw_pixels died too often"),
        "{}",
        said.stderr
    );
    let last = answers.last().unwrap();
    assert_eq!(last["missing"]["event_count@50ms/raw_pixels"], "extractor down");
    assert!(last["reference"].is_u64(), "the rest goes on: {last}");
    assert!(!complete(last));
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}
