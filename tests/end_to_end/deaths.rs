//! kill -9 of each kind of process in the middle of a run, in lossless and in latest delivery.

use super::support::{
    Bench, Running, Said, TICKS, assert_ticks, read_answers, reasons, run_args, text, timeless,
};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::path::Path;
use std::time::{Duration, Instant};

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
    let mut args = run_args(&config, &query, &map, &["--pace", PACE, "--delivery", delivery]);
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
    let said = bench.run(&run_args(&config, &query, &map, &["-o", text(&out)]));
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
    let (bench, after) = kill_one("fuse", "latest", &[]);
    assert!(after.stderr.contains("fuse died"), "{}", after.stderr);
    assert!(complete(after.answers.last().unwrap()));
    // Wherever all inputs were there, the answers are those of an undisturbed run.
    let wanted = undisturbed(&bench, &bench.path("ensemble.toml"), &bench.path("map"));
    let whole = |a: &Value| a["complete"].as_bool().unwrap();
    assert!(wanted.iter().all(whole));
    let mut since = 0;
    for (a, b) in after.answers.iter().zip(&wanted) {
        since = if complete(a) { since + 1 } else { 0 };
        let tick = a["tick"].as_u64().unwrap();
        // L = 5.
        assert_eq!(whole(a), since >= 5.min(tick + 1), "{a}");
        if whole(a) {
            assert_eq!(timeless(a), timeless(b), "{}", after.stderr);
        }
    }
    assert!(whole(after.answers.last().unwrap()), "{}", after.stderr);
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
    let args = run_args(&config, &query, &map, &[]);
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
    let args = run_args(&config, &query, &map, &["--pace", "1"]);
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(5));
    let orphans: Vec<i32> = ["ingest", "reconstruct", "extract", "fuse"]
        .iter()
        .flat_map(|k| running.services(k))
        .collect();
    assert_eq!(orphans.len(), 6);
    // One of them cannot even hear that its supervisor has gone.
    Running::signal(orphans[3], Signal::SIGSTOP);
    wait_for(|| all_stopped(orphans[3]));
    Running::signal(running.pid(), Signal::SIGKILL);
    let _ = running.finish();
    wait_for(|| orphans.iter().all(|pid| has_ended(*pid)));
    let out = bench.path("again.jsonl");
    let again = bench.run(&run_args(&config, &query, &map, &["-o", text(&out)]));
    assert_eq!(again.code(), 0, "{}", again.stderr);
    assert!(again.stderr.contains("earlier run"), "{}", again.stderr);
    assert_ticks(&super::support::read_answers(&out), TICKS);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

fn wait_for(it: impl Fn() -> bool) {
    let started = Instant::now();
    while !it() {
        assert!(started.elapsed() < Duration::from_secs(60), "it does not come");
        std::thread::yield_now();
    }
}

/// Every thread of it stands still.
fn all_stopped(pid: i32) -> bool {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    threads.flatten().all(|thread| {
        let stat = std::fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
        stat.rsplit_once(") ")
            .is_some_and(|(_, state)| state.starts_with('T'))
    })
}

/// It is gone, or a zombie that nobody reaps.
fn has_ended(pid: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(") ")
        .is_none_or(|(_, state)| state.starts_with('Z'))
}

#[test]
fn two_instances_side_by_side_never_touch_each_other() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 200, 2);
    let wanted = undisturbed(&bench, &config, &map);
    let start = |name| {
        Running::start(
            &bench,
            &run_args(&config, &query, &map, &["--name", name, "--pace", PACE]),
        )
    };
    let (mut left, mut right) = (start("left"), start("right"));
    assert!(left.read_to(20) && right.read_to(20));
    let third = bench.run(&run_args(&config, &query, &map, &["--name", "left"]));
    assert!(third.stderr.contains("is running already"), "{}", third.stderr);
    // All of one dies; what the next start sweeps away is its own.
    Running::signal(left.pid(), Signal::SIGKILL);
    let _ = left.finish();
    let (answers, said) = start("left").finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(said.stderr.contains("earlier run"), "{}", said.stderr);
    let (others, said) = right.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(!said.stderr.contains("died"), "{}", said.stderr);
    for answers in [&answers, &others] {
        assert_ticks(answers, 200);
        for (a, b) in answers.iter().zip(&wanted) {
            assert_eq!(timeless(a), timeless(b));
        }
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

/// Windows that reach back over the ticks before, in a recording of the same kind.
fn long_window_config(bench: &Bench, sequence: &str) -> std::path::PathBuf {
    let stages = "[sensor]\nheight = 48\nwidth = 64\n\
         [slicing]\ntick = \"100ms\"\nwindows = [\"100ms\", \"350ms\"]\nalign = \"end\"\norigin = 0\n\
         [[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n\
         [[extractor]]\nid = \"raw_pixels\"\n";
    bench.file("long.toml", &format!("{stages}[fuse]\nsequence = {sequence}\n"))
}

/// Runs `config` over the query, disturbed while it runs, and gives the answers.
fn disturbed(
    bench: &Bench,
    config: &Path,
    map: &Path,
    pace: &str,
    disturb: impl FnOnce(&mut Running),
) -> (Vec<Value>, Said) {
    let query = bench.path("query.txt");
    let args = run_args(config, &query, map, &["--pace", pace]);
    let mut running = Running::start(bench, &args);
    disturb(&mut running);
    let (answers, said) = running.finish();
    assert_eq!(bench.left_behind(), Vec::<String>::new());
    (answers, said)
}

fn undisturbed(bench: &Bench, config: &Path, map: &Path) -> Vec<Value> {
    let out = bench.path("undisturbed.jsonl");
    let query = bench.path("query.txt");
    let said = bench.run(&run_args(config, &query, map, &["-o", text(&out)]));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    read_answers(&out)
}

fn kill(running: &Running, kind: &str) {
    for pid in running.services(kind) {
        Running::signal(pid, Signal::SIGKILL);
    }
}

#[test]
fn windows_that_reach_back_survive_the_death_of_ingest_and_of_the_fuser() {
    ingest_and_fuser_die("{ method = \"paper\", length = 5 }");
}

#[test]
fn a_filter_survives_the_death_of_ingest_and_of_the_fuser() {
    // Its history reaches back to the first tick.
    ingest_and_fuser_die("{ method = \"filter\" }");
}

fn ingest_and_fuser_die(sequence: &str) {
    let bench = Bench::new();
    let config = long_window_config(&bench, sequence);
    let map = bench.map(&config);
    bench.recording("query.txt", 150, 2);
    let (answers, said) = disturbed(&bench, &config, &map, PACE, |running| {
        for (at, kind) in [(40, "ingest"), (80, "fuse")] {
            assert!(running.read_to(at));
            kill(running, kind);
        }
    });
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let wanted = undisturbed(&bench, &config, &map);
    assert_eq!(answers.len(), wanted.len());
    for (a, b) in answers.iter().zip(&wanted) {
        assert_eq!(timeless(a), timeless(b));
    }
}

#[test]
fn a_fuser_that_dies_after_a_stage_died_answers_as_if_nothing_had_been() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    bench.recording("query.txt", 200, 2);
    let (answers, said) = disturbed(&bench, &config, &map, PACE, |running| {
        for (at, kind) in [(20, "extract"), (110, "fuse"), (140, "fuse")] {
            assert!(running.read_to(at));
            kill(running, kind);
        }
    });
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let wanted = undisturbed(&bench, &config, &map);
    let last_missing = answers.iter().rposition(|a| !complete(a)).unwrap();
    assert!(
        last_missing < 100,
        "the extractors came back too late to tell: {last_missing}"
    );
    for (a, b) in answers.iter().zip(&wanted).skip(last_missing + 5) {
        assert_eq!(timeless(a), timeless(b));
    }
}

#[test]
fn a_member_switched_off_while_ingest_is_away_holds_up_nobody() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    bench.recording("query.txt", 200, 2);
    let member = "event_count@50ms/patch_norm";
    let mut from = 0;
    let (answers, said) = disturbed(&bench, &config, &map, PACE, |running| {
        assert!(running.read_to(40));
        // Twice, so that it is in back-off when the member goes.
        for _ in 0..2 {
            while running.services("ingest").is_empty() {
                std::thread::yield_now();
            }
            kill(running, "ingest");
        }
        let said = bench.run(&["member", "disable", "--json", member]);
        let reply: Value = serde_json::from_str(&said.stdout).unwrap();
        from = reply["from_tick"].as_u64().unwrap();
    });
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, 200);
    for answer in &answers {
        let used = answer["members"].as_array().unwrap().iter().any(|m| m == member);
        assert_eq!(
            used,
            answer["tick"].as_u64().unwrap() < from,
            "from {from}: {answer}"
        );
        assert!(complete(answer), "{answer}");
    }
}

#[test]
fn an_ingest_that_somebody_else_stops_fails_the_run() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    bench.recording("query.txt", TICKS, 2);
    let (answers, said) = disturbed(&bench, &config, &map, PACE, |running| {
        assert!(running.read_to(20));
        Running::signal(running.services("ingest")[0], Signal::SIGTERM);
    });
    assert_eq!(said.code(), 1);
    assert_eq!(said.errors().len(), 1, "{}", said.stderr);
    assert!(said.stderr.contains("by somebody else"), "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
}

#[test]
fn ctrl_c_while_the_fuser_is_away_still_answers_what_was_under_way() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    bench.recording("query.txt", TICKS, 2);
    let (answers, said) = disturbed(&bench, &config, &map, PACE, |running| {
        assert!(running.read_to(40));
        kill(running, "fuse");
        Running::signal(running.pid(), Signal::SIGINT);
    });
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_eq!(said.errors(), Vec::<&str>::new());
    assert_ticks(&answers, answers.len() as u64);
    assert!(answers.iter().all(complete));
}
