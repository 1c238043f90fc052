//! Hot pixels and noise filters over real processes.

use super::support::{Bench, Running, Said, assert_ticks, read_answers, shared_data, text, timeless};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::path::PathBuf;

const REFERENCE: &str = "data/corridor/reference_events.h5";
const QUERY: &str = "data/corridor/query_events.h5";
const QUERY_TICKS: u64 = 299;
/// Ticks of 500 ms take 20 ms on the wall.
const PACE: &str = "25";

/// A configuration for the corridor with this about noise.
fn config(noise: &str) -> String {
    format!(
        "{noise}\n[slicing]\ntick = \"500ms\"\nwindows = [\"250ms\", \"500ms\"]\n\
         [[reconstruction]]\nid = \"event_count_no_polarity\"\n[[reconstruction]]\nid = \"time_surface\"\n\
         [[extractor]]\nid = \"patch_norm\"\n[fuse]\nsequence = {{ method = \"paper\", length = 5 }}\n"
    )
}

const LEARN: &str = "[source]\nhot_pixels = { learn = \"20s\" }\n\
                     filters = { refractory = \"2ms\", background_activity = \"20ms\" }";

fn corridor(test: &str) -> Option<(Bench, PathBuf, PathBuf)> {
    let (reference, query) = (shared_data(test, REFERENCE)?, shared_data(test, QUERY)?);
    Some((Bench::new(), reference, query))
}

fn succeeds(bench: &Bench, args: &[&str]) -> Said {
    println!("evpr {}", args.join(" "));
    let said = bench.run(args);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
    said
}

/// The number after `key=` in the line of the log that has these words.
fn logged(said: &Said, words: &str, key: &str) -> u64 {
    let plain: String = strip_colours(&said.stderr);
    let line = plain.lines().find(|l| l.contains(words));
    let line = line.unwrap_or_else(|| panic!("\"{words}\" is not in the log:\n{plain}"));
    let (_, rest) = line.split_once(&format!("{key}=")).unwrap();
    let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap()
}

fn strip_colours(text: &str) -> String {
    let mut plain = String::new();
    let mut escaped = false;
    for c in text.chars() {
        match (escaped, c) {
            (false, '\u{1b}') => escaped = true,
            (false, c) => plain.push(c),
            (true, 'm') => escaped = false,
            (true, _) => {}
        }
    }
    plain
}

#[test]
fn with_a_learned_mask_and_filters_the_death_of_ingest_changes_no_answer() {
    const TEST: &str = "with_a_learned_mask_and_filters_the_death_of_ingest_changes_no_answer";
    let Some((bench, reference, query)) = corridor(TEST) else {
        return;
    };
    bench.file("noise.toml", &config(LEARN));
    let built = succeeds(
        &bench,
        &[
            "map",
            "build",
            "-c",
            "noise.toml",
            "-i",
            text(&reference),
            "-o",
            "map",
        ],
    );
    for key in ["hot_pixels", "refractory", "background_activity"] {
        assert!(logged(&built, "events left out as noise", key) > 0, "{key}");
    }
    let run = ["run", "-q", "-c", "noise.toml", "-i", text(&query), "-m", "map"];
    succeeds(&bench, &[&run[..], &["-o", "undisturbed.jsonl"]].concat());
    let wanted = read_answers(&bench.path("undisturbed.jsonl"));
    assert_ticks(&wanted, QUERY_TICKS);
    let mut running = Running::start(&bench, &[&run[..], &["--pace", PACE]].concat());
    for at in [40, 170] {
        assert!(running.read_to(at));
        for pid in running.services("ingest") {
            Running::signal(pid, Signal::SIGKILL);
        }
    }
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(said.stderr.matches("ingest died").count(), 2, "{}", said.stderr);
    assert_ticks(&answers, QUERY_TICKS);
    for (a, b) in answers.iter().zip(&wanted) {
        assert_eq!(timeless(a), timeless(b));
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_list_of_hot_pixels_is_made_read_and_applied() {
    const TEST: &str = "a_list_of_hot_pixels_is_made_read_and_applied";
    let Some((bench, reference, query)) = corridor(TEST) else {
        return;
    };
    let said = succeeds(
        &bench,
        &["events", "hot-pixels", text(&query), "-o", "hot.txt", "--json"],
    );
    let estimate: Value = serde_json::from_str(&said.stdout).unwrap();
    assert!(estimate["hot_pixels"].as_array().unwrap().len() >= 3);
    let listed = succeeds(&bench, &["events", "hot-pixels", text(&query)]).stdout;
    assert_eq!(listed, std::fs::read_to_string(bench.path("hot.txt")).unwrap());
    bench.file("list.toml", &config("[source.hot_pixels]\nfile = \"hot.txt\""));
    bench.file("learn.toml", &config("[source.hot_pixels]\nlearn = \"20s\""));
    bench.file("none.toml", &config(""));
    succeeds(
        &bench,
        &[
            "map",
            "build",
            "-q",
            "-c",
            "learn.toml",
            "-i",
            text(&reference),
            "-o",
            "map",
        ],
    );
    let run = |config: &'static str| {
        [
            "run",
            "-c",
            config,
            "-i",
            text(&query),
            "-m",
            "map",
            "-o",
            "out.jsonl",
        ]
    };
    // Another list of the same camera goes with this map, no mask at all does not.
    let masked = succeeds(&bench, &run("list.toml"));
    assert_eq!(
        logged(&masked, "events left out as noise", "hot_pixels"),
        estimate["hot_events"].as_u64().unwrap()
    );
    assert_ticks(&read_answers(&bench.path("out.jsonl")), QUERY_TICKS);
    let refused = bench.run(&run("none.toml"));
    assert_eq!(refused.code(), 1);
    assert!(
        refused
            .stderr
            .contains("hot_pixels is masked at ingest in the map and (none) in the"),
        "{}",
        refused.stderr
    );
}

#[test]
fn every_bad_line_of_a_list_is_told_before_anything_starts() {
    let bench = Bench::new();
    bench.file("hot.txt", "# mine\n1,2\nx,y\n64,0\n3;4\n");
    let stages = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n";
    bench.file(
        "noise.toml",
        &format!("[sensor]\nheight = 48\nwidth = 64\n[source.hot_pixels]\nfile = \"hot.txt\"\n{stages}"),
    );
    let query = bench.recording("query.txt", 3, 1);
    let said = bench.run(&["run", "-c", "noise.toml", "-i", text(&query), "-r", "recorded"]);
    assert_eq!(said.code(), 1);
    let errors = said.errors();
    assert_eq!(errors.len(), 3, "{}", said.stderr);
    for (error, line) in errors.iter().zip([3, 4, 5]) {
        assert!(
            error.starts_with(&format!("error: hot.txt: line {line}: ")),
            "{error}"
        );
    }
    assert!(!bench.path("recorded").exists());
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn info_reads_like_a_report() {
    let bench = Bench::new();
    let recording = bench.recording("query.txt", 20, 1);
    let said = succeeds(&bench, &["events", "info", text(&recording)]);
    for label in [
        "recording",
        "sensor",
        "events",
        "rate over time",
        "longest gaps",
        "backward times",
        "hot pixels",
    ] {
        assert!(
            said.stdout.lines().any(|l| l.starts_with(label)),
            "{label}:\n{}",
            said.stdout
        );
    }
    assert!(said.stdout.contains('█'), "{}", said.stdout);
    let said = succeeds(&bench, &["events", "info", "--json", text(&recording)]);
    let info: Value = serde_json::from_str(&said.stdout).unwrap();
    assert_eq!(info["rate"]["bin_ns"], 1_000_000_000);
    let rates = info["rate"]["events"].as_array().unwrap();
    assert_eq!(rates.len(), 3);
    assert_eq!(rates.iter().map(|n| n.as_u64().unwrap()).sum::<u64>(), 21 * 250);
    assert_eq!(info["gaps"].as_array().unwrap().len(), 5);
}
