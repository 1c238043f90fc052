//! kill -9 of each kind of process in the middle of a run, in lossless and in latest delivery.

use super::support::{Bench, Running, TICKS, assert_ticks, reasons, text};
use nix::sys::signal::Signal;
use serde_json::Value;

/// Ticks of 20 ms on the wall: time for a process to come back before the recording ends.
const PACE: &str = "5";
const KILL_AT: u64 = 40;

struct After {
    answers: Vec<Value>,
    stderr: String,
}

fn kill_one(kind: &str, delivery: &str, extra: &[&str]) -> (Bench, After) {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut args = vec![
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        text(&map),
        "--pace",
        PACE,
        "--delivery",
        delivery,
    ];
    args.extend_from_slice(extra);
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(KILL_AT));
    let victims = running.services(kind);
    Running::signal(victims[0], Signal::SIGKILL);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
    (
        bench,
        After {
            answers,
            stderr: said.stderr,
        },
    )
}

fn complete(answer: &Value) -> bool {
    answer["missing"].as_object().unwrap().is_empty()
}

/// A stage died: its members are missing for a while, with the reason, and come back.
fn check_members_return(after: &After, reason: &str) {
    assert!(after.stderr.contains("died"), "{}", after.stderr);
    let seen = reasons(&after.answers);
    assert!(seen.contains_key(reason), "{seen:?}\n{}", after.stderr);
    let last_missing = after.answers.iter().rposition(|a| !complete(a)).unwrap();
    assert!(
        last_missing + 1 < after.answers.len(),
        "the members did not return\n{}",
        after.stderr
    );
}

#[test]
fn lossless_reconstruction_dies() {
    let (_bench, after) = kill_one("reconstruct", "lossless", &[]);
    check_members_return(&after, "reconstruction down");
}

#[test]
fn lossless_extractor_dies() {
    let (_bench, after) = kill_one("extract", "lossless", &[]);
    check_members_return(&after, "extractor down");
}

#[test]
fn lossless_ingest_dies_and_nothing_is_lost() {
    let (_bench, after) = kill_one("ingest", "lossless", &[]);
    assert!(
        after.answers.iter().all(complete),
        "{:?}",
        reasons(&after.answers)
    );
    assert!(after.stderr.contains("ingest died"), "{}", after.stderr);
}

#[test]
fn lossless_fuser_dies_and_nothing_is_lost() {
    let (bench, after) = kill_one("fuse", "lossless", &[]);
    assert!(
        after.answers.iter().all(complete),
        "{:?}",
        reasons(&after.answers)
    );
    // History is rebuilt, so the answers are those of an undisturbed run.
    let out = bench.path("undisturbed.jsonl");
    let (config, query, map) = (
        bench.path("ensemble.toml"),
        bench.path("query.txt"),
        bench.path("map"),
    );
    let said = bench.run(&[
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        text(&map),
        "-o",
        text(&out),
    ]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    for (a, b) in super::support::read_answers(&out).iter().zip(&after.answers) {
        assert_eq!(super::support::timeless(a), super::support::timeless(b));
    }
}

#[test]
fn lossless_recorder_dies_and_nothing_is_lost() {
    let record = tempfile::tempdir().unwrap();
    let recorded = record.path().join("recorded");
    let (bench, after) = kill_one("record", "lossless", &["--record", text(&recorded)]);
    assert!(
        after.answers.iter().all(complete),
        "{:?}",
        reasons(&after.answers)
    );
    let said = bench.run(&["map", "info", "--json", text(&recorded)]);
    let manifest: Value = serde_json::from_str(&said.stdout).unwrap();
    for member in manifest["members"].as_array().unwrap() {
        assert_eq!(member["present"], TICKS, "{member}");
    }
    assert_eq!(bench.run(&["map", "verify", text(&recorded)]).code(), 0);
}

#[test]
fn latest_reconstruction_dies() {
    let (_bench, after) = kill_one("reconstruct", "latest", &[]);
    check_members_return(&after, "reconstruction down");
}

#[test]
fn latest_extractor_dies() {
    let (_bench, after) = kill_one("extract", "latest", &[]);
    check_members_return(&after, "extractor down");
}

#[test]
fn latest_ingest_dies() {
    let (_bench, after) = kill_one("ingest", "latest", &[]);
    assert!(after.stderr.contains("ingest died"), "{}", after.stderr);
    assert!(complete(after.answers.last().unwrap()));
}

#[test]
fn latest_fuser_dies() {
    let (_bench, after) = kill_one("fuse", "latest", &[]);
    assert!(after.stderr.contains("fuse died"), "{}", after.stderr);
    assert!(complete(after.answers.last().unwrap()));
}

#[test]
fn latest_recorder_dies() {
    let record = tempfile::tempdir().unwrap();
    let recorded = record.path().join("recorded");
    let (bench, _after) = kill_one("record", "latest", &["--record", text(&recorded)]);
    assert_eq!(bench.run(&["map", "verify", text(&recorded)]).code(), 0);
}

#[test]
fn unpaced_replay_survives_every_kind_of_death_in_a_row() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 3000, 2);
    let args = [
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        text(&map),
    ];
    let mut running = Running::start(&bench, &args);
    for (at, kind) in [
        (100, "reconstruct"),
        (400, "extract"),
        (700, "fuse"),
        (1000, "ingest"),
        (1300, "fuse"),
    ] {
        assert!(running.read_to(at));
        for pid in running.services(kind) {
            Running::signal(pid, Signal::SIGKILL);
        }
    }
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, 3000);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_killed_supervisor_leaves_no_process_and_the_next_start_cleans_up() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let args = [
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        text(&map),
        "--pace",
        "1",
    ];
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(5));
    let orphans: Vec<i32> = ["ingest", "reconstruct", "extract", "fuse"]
        .iter()
        .flat_map(|k| running.services(k))
        .collect();
    assert_eq!(orphans.len(), 6);
    Running::signal(running.pid(), Signal::SIGKILL);
    let _ = running.finish();
    let out = bench.path("again.jsonl");
    let again = bench.run(&[
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        text(&map),
        "-o",
        text(&out),
    ]);
    assert_eq!(again.code(), 0, "{}", again.stderr);
    assert!(again.stderr.contains("earlier run"), "{}", again.stderr);
    assert_ticks(&super::support::read_answers(&out), TICKS);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}
