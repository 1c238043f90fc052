//! Recordings that cannot be read, or not to their end.

use super::{assert_begins, assert_fails, fails, repository};
use crate::support::{Bench, Said, TICK_MS, TICKS, assert_ticks, read_answers, text, timeless};
use evpr_store::Traverse;
use std::fs;
use std::path::PathBuf;

/// Events of the synthetic recording per tick.
const PER_TICK: usize = 250;
/// The bad event is in the middle of this tick, so that the ticks before it are whole.
const BAD_TICK: u64 = 40;
/// Its number in the recording; its line has one more for counting from 1 and one more for the header.
const BAD_EVENT: usize = BAD_TICK as usize * PER_TICK + 100;

/// A file of the recordings that the reader is tested with.
fn fixture(name: &str) -> PathBuf {
    repository("shared/events/tests/fixtures").join(name)
}

/// Every command that reads a recording refuses this one with these words, and makes nothing.
fn refused_by_all(bench: &Bench, input: &str, words: &[&str]) {
    let graph = ["-q", "-c", "ensemble.toml", "-i", input];
    fails(
        bench,
        &[&["run", "-m", "map", "-r", "recorded"], &graph[..]].concat(),
        1,
        words,
    );
    fails(
        bench,
        &[&["map", "build", "-o", "recorded"], &graph[..]].concat(),
        1,
        words,
    );
    fails(bench, &["events", "info", input], 1, words);
    let frames = [
        "-m",
        "event_count",
        "-w",
        "50ms",
        "-t",
        "100ms",
        "--sensor",
        "48x64",
        "-o",
        "frames.npy",
    ];
    fails(
        bench,
        &[&["events", "reconstruct", input], &frames[..]].concat(),
        1,
        words,
    );
    for made in ["recorded", "recorded.partial", "frames.npy"] {
        assert!(!bench.path(made).exists(), "{made} is there after {input}");
    }
}

#[test]
fn recordings_that_cannot_be_opened_are_refused_before_anything_starts() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    bench.map(&config);
    fs::create_dir(bench.path("folder")).unwrap();
    bench.file("empty.txt", "");
    bench.file("empty.h5", "");
    bench.file("header.txt", "t x y p\n");
    bench.file("prose.txt", "It was a dark and stormy night.\n");
    bench.file("nan.txt", "t x y p\nNaN 1 2 1\n0.1 1 2 1\n");
    bench.file("not_hdf5.h5", "0.1 1 2 1\n");
    fs::write(bench.path("binary"), [0, 1, 2, 3]).unwrap();
    let cases: [(&str, &[&str]); 11] = [
        ("none.h5", &["none.h5", "there is no such file", "check the path"]),
        ("none.txt", &["none.txt", "there is no such file"]),
        ("folder", &["folder", "is a directory"]),
        ("empty.txt", &["empty.txt", "is empty"]),
        ("empty.h5", &["empty.h5", "is empty"]),
        ("header.txt", &["header.txt", "holds no events"]),
        ("prose.txt", &["prose.txt", "line 1"]),
        (
            "nan.txt",
            &["nan.txt", "line 2", "the time \"NaN\" is not a decimal number"],
        ),
        ("not_hdf5.h5", &["not_hdf5.h5", "not its signature"]),
        ("binary", &["binary", "no known format"]),
        ("/dev/null", &["/dev/null", "not a regular file"]),
    ];
    for (input, words) in cases {
        refused_by_all(&bench, input, words);
    }
}

#[test]
fn hdf5_recordings_that_are_not_whole_are_refused() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let cases: [(&str, &[&str]); 6] = [
        ("truncated.h5", &["cannot be read", "truncated"]),
        ("no_events_group.h5", &["no group /events"]),
        ("missing_dataset.h5", &["no dataset /events/timestamps"]),
        ("wrong_type.h5", &["/events/timestamps has type string"]),
        ("unequal_lengths.h5", &["300 entries", "295"]),
        ("zero_events.h5", &["holds no events"]),
    ];
    for (name, words) in cases {
        let path = fixture(name);
        refused_by_all(&bench, text(&path), &[&[name], words].concat());
    }
}

#[test]
fn hdf5_recordings_that_fail_in_their_middle_keep_what_came_before() {
    let bench = Bench::new();
    let config = bench.file(
        "small.toml",
        "[slicing]\ntick = \"20ms\"\n[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"raw_pixels\"\n",
    );
    // Events come every millisecond; ticks begin with the first.
    let cases: [(&str, usize, &[&str]); 4] = [
        (
            "backward_time.h5",
            7,
            &["event 150", "goes back in time", "on_backward_time"],
        ),
        ("bad_polarity.h5", 9, &["event 200", "has polarity 7"]),
        (
            "outside_sensor.h5",
            12,
            &[
                "event 250",
                "x 32",
                "outside the sensor of 24×32",
                "on_outside_sensor",
            ],
        ),
        ("damaged_chunk.h5", 0, &["cannot be read", "damaged"]),
    ];
    for (name, ticks, words) in cases {
        let (input, map) = (fixture(name), bench.path("map"));
        let said = bench.run(&[
            "map",
            "build",
            "-q",
            "-c",
            text(&config),
            "-i",
            text(&input),
            "-o",
            text(&map),
        ]);
        assert_fails(&bench, &said, 1, &[&[name], words].concat());
        let found = Traverse::open(&map).map(|t| t.len()).ok();
        assert!(found.is_none() || ticks > 0, "{name}: {found:?}");
        if ticks > 0 {
            assert_eq!(found, Some(ticks), "{name}");
            fs::remove_dir_all(&map).unwrap();
        }
        assert!(!bench.path("map.partial").exists());
    }
}

/// The recording of [`Bench::recording`] with one event replaced.
fn spoilt(bench: &Bench, name: &str, event: usize, replacement: &str) -> PathBuf {
    let good = fs::read_to_string(bench.path("query.txt")).unwrap();
    let mut lines: Vec<&str> = good.lines().collect();
    lines[1 + event] = replacement;
    bench.file(name, &(lines.join("\n") + "\n"))
}

/// Bad events by name: what stands in the recording instead, and what must be said.
fn bad_events(event: usize) -> [(&'static str, String, Vec<String>); 5] {
    let t_us = event as u64 * TICK_MS * 1_000 / PER_TICK as u64;
    let seconds = |t_us: u64| format!("{}.{:06}", t_us / 1_000_000, t_us % 1_000_000);
    let (now, before) = (seconds(t_us), seconds(t_us - 1_000));
    let (number, line) = (format!("event {event} (from 0)"), format!("line {}", event + 2));
    let words = |words: &[&str]| words.iter().map(|w| (*w).to_owned()).collect::<Vec<_>>();
    [
        (
            "right.txt",
            format!("{now} 64 3 1"),
            words(&[&number, "x 64", "outside the sensor of 48×64", "\"drop\""]),
        ),
        (
            "below.txt",
            format!("{now} 3 48 1"),
            words(&[&number, "y 48", "outside the sensor of 48×64", "\"drop\""]),
        ),
        (
            "back.txt",
            format!("{before} 3 3 1"),
            words(&[&number, "goes back in time", &before, "\"clamp\""]),
        ),
        (
            "nan.txt",
            "NaN 3 3 1".to_owned(),
            words(&[&line, "the time \"NaN\"", "correct the line"]),
        ),
        (
            "cut.txt",
            format!("{now} 3"),
            words(&[&line, "has 2 columns instead of 4"]),
        ),
    ]
}

fn all_words<'a>(file: &'a str, words: &'a [String]) -> Vec<&'a str> {
    std::iter::once(file)
        .chain(words.iter().map(String::as_str))
        .collect()
}

/// A bench with a map, a good query, and what a run over it records and answers.
fn undisturbed() -> (Bench, Vec<serde_json::Value>) {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    bench.map(&config);
    bench.recording("query.txt", TICKS, 2);
    let said = run(&bench, "query.txt", "whole", &[]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let answers = read_answers(&bench.path("whole.jsonl"));
    assert_ticks(&answers, TICKS);
    (bench, answers)
}

/// Matches a recording, into `<out>.jsonl` and the traverse `out`.
fn run(bench: &Bench, input: &str, out: &str, extra: &[&str]) -> Said {
    let answers = format!("{out}.jsonl");
    let args = [
        "run",
        "-q",
        "-c",
        "ensemble.toml",
        "-i",
        input,
        "-m",
        "map",
        "-r",
        out,
        "-o",
        &answers,
    ];
    bench.run(&[&args[..], extra].concat())
}

#[test]
fn a_bad_event_ends_a_run_and_every_whole_tick_before_it_is_answered_and_recorded() {
    let (bench, whole) = undisturbed();
    for (file, replacement, words) in bad_events(BAD_EVENT) {
        spoilt(&bench, file, BAD_EVENT, &replacement);
        let out = format!("part_of_{file}");
        let said = run(&bench, file, &out, &[]);
        assert_fails(&bench, &said, 1, &all_words(file, &words));
        assert!(
            said.stderr
                .contains(&format!("the {BAD_TICK} ticks before the failure are kept")),
            "{}",
            said.stderr
        );
        let answers = read_answers(&bench.path(&format!("{out}.jsonl")));
        assert_ticks(&answers, BAD_TICK);
        for (answer, expected) in answers.iter().zip(&whole) {
            assert_eq!(timeless(answer), timeless(expected));
        }
        assert_begins(&bench.path(&out), &bench.path("whole"), BAD_TICK as usize);
        assert_eq!(bench.run(&["map", "verify", &out]).code(), 0);
        assert!(!bench.path(&format!("{out}.partial")).exists());
    }
}

#[test]
fn a_bad_event_ends_map_build_and_the_map_of_the_ticks_before_it_is_finished() {
    let (bench, _) = undisturbed();
    for (file, replacement, words) in bad_events(BAD_EVENT) {
        spoilt(&bench, file, BAD_EVENT, &replacement);
        let out = format!("map_of_{file}");
        let said = bench.run(&[
            "map",
            "build",
            "-q",
            "-c",
            "ensemble.toml",
            "-i",
            file,
            "-o",
            &out,
        ]);
        assert_fails(&bench, &said, 1, &all_words(file, &words));
        assert_begins(&bench.path(&out), &bench.path("whole"), BAD_TICK as usize);
        assert_eq!(bench.run(&["map", "verify", &out]).code(), 0);
    }
}

#[test]
fn a_bad_event_in_the_first_tick_is_the_only_thing_reported() {
    let (bench, _) = undisturbed();
    const EARLY: usize = 100;
    for (file, replacement, words) in bad_events(EARLY) {
        spoilt(&bench, file, EARLY, &replacement);
        let said = run(&bench, file, "none", &[]);
        assert_fails(&bench, &said, 1, &all_words(file, &words));
        assert!(!bench.path("none.jsonl").exists());
        assert!(!bench.path("none").exists() && !bench.path("none.partial").exists());
    }
}

#[test]
fn a_bad_event_ends_a_live_run_after_the_ticks_before_it() {
    let (bench, _) = undisturbed();
    let (file, replacement, words) = bad_events(BAD_EVENT).into_iter().next().unwrap();
    spoilt(&bench, file, BAD_EVENT, &replacement);
    let said = run(&bench, file, "live", &["--delivery", "latest", "--pace", "20"]);
    assert_fails(&bench, &said, 1, &all_words(file, &words));
    let answers = read_answers(&bench.path("live.jsonl"));
    // In latest delivery a tick is over with its last window, so the one with the bad event may be answered too.
    assert!(
        (BAD_TICK..=BAD_TICK + 1).contains(&(answers.len() as u64)),
        "{} answers",
        answers.len()
    );
    assert_ticks(&answers, answers.len() as u64);
    assert_eq!(bench.run(&["map", "verify", "live"]).code(), 0);
}

#[test]
fn bad_events_can_be_left_out_instead() {
    let (bench, _) = undisturbed();
    let strict = fs::read_to_string(bench.path("ensemble.toml")).unwrap();
    let lenient = strict.replace(
        "on_outside_sensor = \"error\"",
        "on_outside_sensor = \"drop\"\non_backward_time = \"drop\"",
    );
    assert_ne!(strict, lenient);
    bench.file("ensemble.toml", &lenient);
    for (file, replacement, _) in bad_events(BAD_EVENT).into_iter().take(3) {
        spoilt(&bench, file, BAD_EVENT, &replacement);
        let said = run(&bench, file, file.trim_end_matches(".txt"), &[]);
        assert_eq!(said.code(), 0, "{}", said.stderr);
        assert!(
            said.stderr.contains("events left out or moved"),
            "{}",
            said.stderr
        );
        assert_ticks(&read_answers(&bench.path(&file.replace(".txt", ".jsonl"))), TICKS);
    }
}

#[test]
fn frames_of_the_ticks_before_a_bad_event_are_kept() {
    let bench = Bench::new();
    bench.recording("query.txt", TICKS, 2);
    let frames = |input: &str, out: &str| {
        let args = [
            "--method",
            "event_count",
            "-w",
            "50ms",
            "-t",
            "100ms",
            "--sensor",
            "48x64",
            "-o",
            out,
        ];
        bench.run(&[&["events", "reconstruct", input], &args[..]].concat())
    };
    assert_eq!(frames("query.txt", "whole.npy").code(), 0);
    let whole = fs::read(bench.path("whole.npy")).unwrap();
    const HEADER_BYTES: usize = 128;
    const FRAME_BYTES: usize = 48 * 64 * 3;
    assert_eq!(whole.len(), HEADER_BYTES + TICKS as usize * FRAME_BYTES);
    for (file, replacement, words) in bad_events(BAD_EVENT) {
        spoilt(&bench, file, BAD_EVENT, &replacement);
        assert_fails(&bench, &frames(file, "part.npy"), 1, &all_words(file, &words));
        let part = fs::read(bench.path("part.npy")).unwrap();
        let header = String::from_utf8_lossy(&part[..HEADER_BYTES]).into_owned();
        assert!(header.contains(&format!("({BAD_TICK}, 48, 64, 3)")), "{header}");
        assert_eq!(
            part[HEADER_BYTES..],
            whole[HEADER_BYTES..HEADER_BYTES + BAD_TICK as usize * FRAME_BYTES]
        );
    }
}

#[test]
fn a_recording_shorter_than_a_tick_is_refused() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    bench.map(&config);
    let whole = fs::read_to_string(bench.recording("query.txt", 1, 2)).unwrap();
    let lines: Vec<&str> = whole.lines().take(1 + PER_TICK / 2).collect();
    bench.file("short.txt", &lines.join("\n"));
    let words = ["short.txt", "100ms", "nothing to"];
    let graph = ["-q", "-c", "ensemble.toml", "-i", "short.txt"];
    fails(&bench, &[&["run", "-m", "map"], &graph[..]].concat(), 1, &words);
    fails(
        &bench,
        &[&["run", "-m", "map", "-r", "recorded"], &graph[..]].concat(),
        1,
        &words,
    );
    fails(
        &bench,
        &[&["run", "-r", "recorded"], &graph[..]].concat(),
        1,
        &words,
    );
    fails(
        &bench,
        &[&["map", "build", "-o", "recorded"], &graph[..]].concat(),
        1,
        &words,
    );
    assert!(!bench.path("recorded").exists() && !bench.path("recorded.partial").exists());
    let frames = [
        "-m",
        "event_count",
        "-w",
        "50ms",
        "-t",
        "100ms",
        "--sensor",
        "48x64",
        "-o",
        "frames.npy",
    ];
    let reconstruct = ["events", "reconstruct", "short.txt"];
    fails(
        &bench,
        &[&reconstruct, &frames[..]].concat(),
        1,
        &["short.txt", "shorter than one tick"],
    );
}
