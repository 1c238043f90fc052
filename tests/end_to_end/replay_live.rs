//! Runs that are recorded and replayed: the same answers, whatever happened in between, wherever nothing was dropped.

use super::live::{as_text, config, events, of_ticks, send_next, serve};
use super::support::{Bench, Running, Said, TICKS, read_answers, reasons, run_args, text, timeless};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// The tape in the folder of a kept run.
const EVENTS: &str = "events.aedat4";

/// Starts a live run over TCP in lossless delivery that is kept, with its events.
fn start_kept(bench: &Bench, address: &str, kept: &Path) -> Running {
    let config = config(bench, &format!("kind = \"tcp\"\n{address}"));
    let map = bench.path("map");
    let args = [
        "run",
        "-q",
        "-c",
        text(&config),
        "-m",
        text(&map),
        "--delivery",
        "lossless",
        "--keep",
        text(kept),
        "--record-events",
        "-o",
        "/dev/stdout",
    ];
    Running::start(bench, &args)
}

fn interrupt(running: Running) -> Vec<Value> {
    Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    answers
}

/// Replays a run and compares; what it says.
fn check(bench: &Bench, run: &Path) -> Said {
    bench.run(&["replay", "-q", "--check", text(run)])
}

/// Lines without their times.
fn timeless_lines(path: &Path) -> Vec<Value> {
    read_answers(path).iter().map(timeless).collect()
}

/// Replays, and gives the answers without their times.
fn replayed(bench: &Bench, run: &Path) -> Vec<Value> {
    let out = bench.path("replayed.jsonl");
    let said = bench.run(&["replay", "-q", text(run), "-o", text(&out)]);
    assert_eq!((said.code(), said.stderr.as_str()), (0, ""));
    timeless_lines(&out)
}

#[test]
fn a_replay_of_a_live_run_gives_its_answers_the_missing_ones_included() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 60, 2);
    let events = events(&recording);
    let (listener, address) = serve();
    let kept = bench.path("kept");
    let mut running = start_kept(&bench, &address, &kept);
    let peer = send_next(&listener, &as_text(of_ticks(&events, 0..21)));
    assert!(running.read_to(9));
    let said = bench.run(&["member", "disable", "event_count@50ms/raw_pixels"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(running.read_to(19));
    drop(peer);
    let peer = send_next(&listener, &as_text(of_ticks(&events, 25..61)));
    assert!(running.read_to(59));
    let answers = interrupt(running);
    drop(peer);
    assert!(reasons(&answers).contains_key("the camera was disconnected"));
    let members = |a: &Value| a["members"].as_array().unwrap().len();
    assert!(answers.iter().any(|a| members(a) == 8) && answers.iter().any(|a| members(a) == 7));
    let said = check(&bench, &kept);
    assert_eq!((said.code(), said.stderr.as_str()), (0, ""));
    assert_eq!(
        said.stdout,
        format!("the same answers in {} ticks\n", answers.len())
    );
    // Line by line, from the folder and from the tape alone.
    let live = timeless_lines(&kept.join("matches.jsonl"));
    assert_eq!(live, answers.iter().map(timeless).collect::<Vec<_>>());
    assert_eq!(replayed(&bench, &kept), live);
    assert_eq!(replayed(&bench, &kept.join(EVENTS)), live);
    let stats: Value = serde_json::from_str(&fs::read_to_string(kept.join("stats.json")).unwrap()).unwrap();
    assert_eq!(stats["ticks"], answers.len());
    let about: Value = serde_json::from_str(&fs::read_to_string(kept.join("run.json")).unwrap()).unwrap();
    assert_eq!(about["ended"]["outcome"], "interrupted");
    assert_eq!(about["inputs"][0]["what"], "map");
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_tape_goes_on_when_ingest_died() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 40, 2);
    let events = events(&recording);
    let (listener, address) = serve();
    let kept = bench.path("kept");
    let mut running = start_kept(&bench, &address, &kept);
    let peer = send_next(&listener, &as_text(of_ticks(&events, 0..10)));
    assert!(running.read_to(8));
    for pid in running.services("ingest") {
        Running::signal(pid, Signal::SIGKILL);
    }
    let again = send_next(&listener, &as_text(of_ticks(&events, 20..41)));
    assert!(running.read_to(39));
    let answers = interrupt(running);
    drop((peer, again));
    assert!(reasons(&answers).contains_key("lost on the way"));
    // Of the tick that it died in, the tape may have less than was sent.
    let said = check(&bench, &kept);
    assert_eq!((said.code(), said.stderr.as_str()), (0, ""));
    let replay = replayed(&bench, &kept);
    assert_eq!(replay.len(), answers.len());
    for (tick, (live, again)) in answers.iter().zip(&replay).enumerate() {
        if !(8..16).contains(&tick) {
            assert_eq!(timeless(live), *again, "tick {tick}");
        }
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_run_in_latest_delivery_is_replayed_without_loss() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 40, 2);
    // Nothing is late, however busy the machine is.
    let patient = fs::read_to_string(&config).unwrap().replace("300ms", "50s");
    let config = bench.file("patient.toml", &patient);
    let (kept, tape) = (bench.path("kept"), bench.path("tape.aedat4"));
    let more = [
        "--delivery",
        "latest",
        "--pace",
        "4",
        "--keep",
        text(&kept),
        "--record-events",
        text(&tape),
    ];
    let said = bench.run(&run_args(&config, &query, &map, &more));
    assert_eq!((said.code(), said.stdout.as_str()), (0, ""), "{}", said.stderr);
    let said = check(&bench, &kept);
    assert_eq!((said.code(), said.stderr.as_str()), (0, ""));
    assert!(said.stdout.starts_with("the same answers in "), "{}", said.stdout);
    assert_eq!(replayed(&bench, &tape).len(), 40);
    // As a recording like any other.
    let said = bench.run(&["events", "info", "--json", text(&tape)]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let info: Value = serde_json::from_str(&said.stdout).unwrap();
    assert_eq!(info["events"], 41 * 250);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_flood_is_replayed_with_the_ticks_that_ingest_dropped() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", TICKS, 2);
    let (listener, address) = serve();
    let kept = bench.path("kept");
    let mut running = start_kept(&bench, &address, &kept);
    let events = as_text(&events(&recording));
    let peer = send_next(&listener, &events);
    assert!(running.read_to(TICKS - 1));
    let answers = interrupt(running);
    drop(peer);
    let said = check(&bench, &kept);
    assert_eq!((said.code(), said.stderr.as_str()), (0, ""));
    assert_eq!(
        said.stdout,
        format!("the same answers in {} ticks\n", answers.len())
    );
}

#[test]
fn a_kept_run_of_a_recording_needs_no_tape() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 30, 2);
    let kept = bench.path("kept");
    let said = bench.run(&run_args(&config, &query, &map, &["--keep", text(&kept)]));
    assert_eq!((said.code(), said.stdout.as_str()), (0, ""), "{}", said.stderr);
    let said = check(&bench, &kept);
    assert_eq!(
        (said.code(), said.stdout.as_str()),
        (0, "the same answers in 30 ticks\n")
    );
    // The first answer that differs is named.
    let matches = kept.join("matches.jsonl");
    let mut lines: Vec<Value> = read_answers(&matches);
    lines[7]["reference"] = Value::from(9_999);
    let right = read_answers(&matches)[7]["reference"].clone();
    let other: String = lines.iter().map(|l| format!("{l}\n")).collect();
    let other = bench.file("other.jsonl", &other);
    let said = bench.run(&["replay", "-q", text(&kept), &format!("--check={}", text(&other))]);
    assert_eq!(said.code(), 1);
    let line = format!("error: tick 7 differs: reference {right}, in the run 9999");
    assert_eq!(said.errors(), [line]);
    // What was read is read again, or nothing is.
    fs::write(&query, "t x y p\n0.0 1 1 1\n").unwrap();
    let said = check(&bench, &kept);
    assert_eq!(said.code(), 1);
    assert!(said.stderr.contains("the recording ") && said.stderr.contains("has changed since the run"));
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_full_disk_costs_the_rest_of_the_tape_and_nothing_else() {
    const TEST: &str = "a_full_disk_costs_the_rest_of_the_tape_and_nothing_else";
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    fs::create_dir(bench.path("small")).unwrap();
    let mount = "mount -t tmpfs -o size=256k tmpfs small";
    let script = format!(
        "$EVPR run -q -c {} -i {} -m {} -o matches.jsonl --record-events small/tape.aedat4 && cp small/tape* .",
        text(&config),
        text(&query),
        text(&map)
    );
    let Some(said) = bench.run_with_mounts(TEST, mount, &script) else {
        return;
    };
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let about_tape: Vec<&str> = said
        .stderr
        .lines()
        .filter(|l| l.contains("tape.aedat4"))
        .collect();
    assert_eq!(about_tape.len(), 1, "{}", said.stderr);
    assert!(about_tape[0].contains("events are no longer recorded"));
    let answers = timeless_lines(&bench.path("matches.jsonl"));
    assert_eq!(answers.len() as u64, TICKS);
    let again = replayed(&bench, &bench.path("tape.aedat4"));
    assert!(
        !again.is_empty() && again.len() < answers.len(),
        "{}",
        again.len()
    );
    assert_eq!(again[..], answers[..again.len()]);
}

#[test]
fn what_cannot_be_kept_or_replayed_says_so_in_one_line() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 20, 2);
    let one_line = |args: &[&str], code: i32, what: &str| {
        let said = bench.run(args);
        assert_eq!((said.code(), said.errors().len()), (code, 1), "{}", said.stderr);
        assert!(said.errors()[0].contains(what), "{}", said.stderr);
    };
    let run = |more: &[&str], code: i32, what: &str| {
        one_line(&run_args(&config, &query, &map, more), code, what);
    };
    let there = bench.file("there.aedat4", "mine");
    run(&["--record-events", text(&there)], 1, "exists already");
    assert_eq!(fs::read_to_string(&there).unwrap(), "mine");
    run(
        &["--record-events", "events.raw"],
        1,
        "a name that ends in .aedat4",
    );
    run(&["--record-events"], 2, "name the file");
    run(&["--keep", text(&map)], 1, "exists already");
    run(&["--keep", "no/such/folder"], 1, "cannot write no/such/folder");
    // A run that does not begin leaves nothing.
    run(
        &["--keep", "new", "--record-events", "-o", "no/such/file"],
        1,
        "cannot write no/such/file",
    );
    assert!(!bench.path("new").exists());
    one_line(&["replay", "nothing"], 1, "there is no such file or folder");
    one_line(&["replay", text(&query)], 1, "is no tape");
    one_line(&["replay", text(&map)], 1, "is no kept run");
    let kept = bench.path("kept");
    let said = bench.run(&run_args(
        &config,
        &query,
        &map,
        &["--keep", text(&kept), "--record-events"],
    ));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let tape = kept.join(EVENTS);
    one_line(
        &["replay", "--check", text(&tape)],
        2,
        "there are no answers of the run with it",
    );
    let spoil = |name: &str, from: &str, to: &str, what: &str| {
        let path = kept.join(name);
        let before = fs::read_to_string(&path).unwrap();
        assert!(before.contains(from), "{name}");
        fs::write(&path, before.replacen(from, to, 1)).unwrap();
        one_line(&["replay", "-q", "--check", text(&kept)], 1, what);
        fs::write(&path, before).unwrap();
    };
    spoil(
        "run.json",
        "\"kept_run\": 1",
        "\"kept_run\": 7",
        "a kept run of version 7",
    );
    spoil(
        "plan.json",
        "\"height\": 48",
        "\"height\": 47",
        "somebody edited it",
    );
    spoil(
        "events.aedat4.ticks",
        "\"tape\":1",
        "\"tape\":9",
        "a tape of version 9",
    );
    spoil(
        "events.aedat4.ticks",
        "\"height\":48",
        "\"height\":47",
        "somebody edited it",
    );
    spoil(
        "events.aedat4.ticks",
        "{\"close\":{\"tick\":5}}",
        "{\"close\":{\"tick\":3}}",
        "the tape is damaged",
    );
    let ticks = map.join("ticks.csv");
    fs::write(&ticks, fs::read_to_string(&ticks).unwrap() + "\n").unwrap();
    let said = check(&bench, &kept);
    assert_eq!((said.code(), said.errors().len()), (1, 1), "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}
