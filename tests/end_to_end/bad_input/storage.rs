//! Maps that cannot be used, places that cannot be written, and too little room.

use super::{assert_begins, assert_fails, fails};
use crate::support::{Bench, TICKS, text};
use std::fs;
use std::path::Path;

const RUN: [&str; 8] = [
    "run",
    "-q",
    "-c",
    "ensemble.toml",
    "-i",
    "query.txt",
    "-o",
    "answers.jsonl",
];

fn bench_with_map() -> Bench {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    bench.map(&config);
    bench.recording("query.txt", TICKS, 2);
    bench
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// A copy of the map, for spoiling.
fn copy_of_map(bench: &Bench, name: &str) -> std::path::PathBuf {
    copy_folder(&bench.path("map"), &bench.path(name));
    bench.path(name)
}

#[test]
fn maps_that_are_none() {
    let bench = bench_with_map();
    copy_of_map(&bench, "crashed.partial");
    fs::create_dir(bench.path("folder")).unwrap();
    let cases: [(&str, &[&str]); 5] = [
        ("none", &["none", "no such traverse", "evpr map build"]),
        (
            "crashed",
            &[
                "crashed.partial is an unfinished recording",
                "evpr map repair crashed",
            ],
        ),
        (
            "crashed.partial",
            &[
                "crashed.partial is an unfinished recording",
                "evpr map repair crashed",
            ],
        ),
        ("folder", &["folder is not a traverse", "traverse.json"]),
        ("query.txt", &["query.txt is not a traverse", "it is a file"]),
    ];
    for (map, words) in cases {
        fails(&bench, &[&RUN[..], &["-m", map]].concat(), 1, words);
        fails(&bench, &["map", "info", map], 1, words);
        fails(&bench, &["map", "verify", map], 1, words);
    }
    fails(
        &bench,
        &["map", "repair", "none"],
        1,
        &["none", "no such traverse"],
    );
    fails(
        &bench,
        &["map", "repair", "map"],
        1,
        &["map is finished already", "evpr map verify"],
    );
    assert!(
        !bench.path("answers.jsonl").exists(),
        "nothing is written before the map is known to be good"
    );
}

#[test]
fn maps_that_are_damaged() {
    let bench = bench_with_map();
    let rows = "rows/event_count@100ms/patch_norm.npy";
    let spoil = |name: &str, spoil: &dyn Fn(&Path)| spoil(&copy_of_map(&bench, name));
    let cut = |file: &Path| {
        let bytes = fs::read(file).unwrap();
        fs::write(file, &bytes[..bytes.len() - 100]).unwrap();
    };
    spoil("rows_cut", &|map| cut(&map.join(rows)));
    spoil("rows_gone", &|map| fs::remove_file(map.join(rows)).unwrap());
    spoil("ticks_cut", &|map| {
        let lines = fs::read_to_string(map.join("ticks.csv")).unwrap();
        let kept: Vec<&str> = lines.lines().take(100).collect();
        fs::write(map.join("ticks.csv"), kept.join("\n") + "\n").unwrap();
    });
    spoil("manifest_cut", &|map| cut(&map.join("traverse.json")));
    for (map, file) in [
        ("rows_cut", rows),
        ("rows_gone", rows),
        ("ticks_cut", "ticks.csv"),
        ("manifest_cut", "traverse.json"),
    ] {
        let words = [&format!("{map}/{file}")[..]];
        fails(&bench, &[&RUN[..], &["-m", map]].concat(), 1, &words);
        let verified = bench.run(&["map", "verify", map]);
        assert_eq!(verified.code(), 1, "{map}");
        assert!(
            !verified.errors().is_empty() && verified.stderr.contains(file),
            "{}",
            verified.stderr
        );
    }
}

#[test]
fn a_map_of_other_parameters_is_refused_with_the_differences() {
    let bench = bench_with_map();
    let config = fs::read_to_string(bench.path("ensemble.toml")).unwrap();
    let cases = [
        (
            "tick = \"100ms\"",
            "tick = \"200ms\"",
            &["tick is 100ms in the map and 200ms in the configuration"][..],
        ),
        (
            "origin = 0",
            "origin = 0\nalign = \"end\"",
            &["align is start in the map and end in the configuration"],
        ),
        (
            "id = \"patch_norm\"",
            "id = \"patch_norm\"\nparams = { side = 16 }",
            &["side is 32 in the map and 16 in the configuration", "patch_norm"],
        ),
        (
            "id = \"time_surface\"",
            "id = \"event_count_no_polarity\"",
            &["the map has no members event_count_no_polarity@50ms/patch_norm"],
        ),
        (
            "height = 48\nwidth = 64",
            "height = 50\nwidth = 64",
            &["sensor is 48x64 in the map and 50x64"],
        ),
    ];
    for (old, new, words) in cases {
        let changed = config.replace(old, new);
        assert_ne!(changed, config);
        bench.file("changed.toml", &changed);
        let run = ["run", "-q", "-c", "changed.toml", "-i", "query.txt", "-m", "map"];
        fails(
            &bench,
            &run,
            1,
            &[&["map map does not fit the configuration"], words].concat(),
        );
    }
}

#[test]
fn nothing_is_overwritten() {
    let bench = bench_with_map();
    copy_of_map(&bench, "crashed.partial");
    let manifest = || fs::read(bench.path("map/traverse.json")).unwrap();
    let before = manifest();
    let build = [
        "map",
        "build",
        "-q",
        "-c",
        "ensemble.toml",
        "-i",
        "query.txt",
        "-o",
    ];
    let record = [&RUN[..], &["-m", "map", "-r"]].concat();
    for command in [&build[..], &record] {
        fails(&bench, &[command, &["map"]].concat(), 1, &["map exists already"]);
        fails(
            &bench,
            &[command, &["crashed"]].concat(),
            1,
            &["crashed.partial was left", "evpr map repair crashed"],
        );
    }
    assert_eq!(manifest(), before);
    assert_eq!(bench.run(&["map", "verify", "map"]).code(), 0);
}

#[test]
fn places_that_cannot_be_written() {
    let bench = bench_with_map();
    let matching = [
        "run",
        "-q",
        "-c",
        "ensemble.toml",
        "-i",
        "query.txt",
        "-m",
        "map",
        "-o",
    ];
    fails(
        &bench,
        &[&matching[..], &["none/answers.jsonl"]].concat(),
        1,
        &["cannot write none/answers.jsonl"],
    );
    fails(
        &bench,
        &[&matching[..], &["map"]].concat(),
        1,
        &["cannot write map", "directory"],
    );
    fails(
        &bench,
        &[&matching[..], &["/dev/full"]].concat(),
        1,
        &["/dev/full", "No space left on device"],
    );
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
    ];
    let reconstruct = [&["events", "reconstruct", "query.txt"], &frames[..]].concat();
    fails(
        &bench,
        &[&reconstruct[..], &["none/frames.npy"]].concat(),
        1,
        &["cannot write none/frames.npy"],
    );
    fails(
        &bench,
        &[&reconstruct[..], &["/dev/full"]].concat(),
        1,
        &["cannot write /dev/full", "No space left"],
    );
    let build = [
        "map",
        "build",
        "-q",
        "-c",
        "ensemble.toml",
        "-i",
        "query.txt",
        "-o",
    ];
    fails(
        &bench,
        &[&build[..], &["query.txt/map"]].concat(),
        1,
        &["query.txt"],
    );
    // Folders above a map are made.
    let said = bench.run(&[&build[..], &["new/folder/map"]].concat());
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(bench.run(&["map", "verify", "new/folder/map"]).code(), 0);
}

#[test]
fn too_little_shared_memory_is_seen_before_anything_starts() {
    let bench = bench_with_map();
    let mount = "mount -t tmpfs -o size=2m tmpfs /dev/shm";
    let script = "$EVPR run -q -c ensemble.toml -i query.txt -m map -o answers.jsonl; code=$?; ls /dev/shm; exit $code";
    let Some(said) = bench.run_with_mounts("too_little_shared_memory", mount, script) else {
        return;
    };
    let words = [
        "too little shared memory",
        "2.0 MiB free",
        "--shm-size",
        "evpr graph",
    ];
    assert_fails(&bench, &said, 1, &words);
    assert_eq!(said.stdout, "", "left in the small /dev/shm");
    assert!(!bench.path("answers.jsonl").exists());
}

/// Records into a folder of this size, and copies what is there afterwards to `kept`.
fn record_into(bench: &Bench, size: &str) -> Option<crate::support::Said> {
    fs::create_dir(bench.path("small")).unwrap();
    let mount = format!("mount -t tmpfs -o size={size} tmpfs small");
    let script = "$EVPR map build -q -c ensemble.toml -i query.txt -o small/new\n\
                  code=$?; ls small; cp -r small kept; exit $code";
    bench.run_with_mounts("a_full_disk", &mount, script)
}

#[test]
fn a_full_disk_ends_the_recording_and_keeps_every_committed_tick() {
    let bench = bench_with_map();
    let said = bench.run(&[
        "map",
        "build",
        "-q",
        "-c",
        "ensemble.toml",
        "-i",
        "query.txt",
        "-o",
        "whole",
    ]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let Some(said) = record_into(&bench, "600k") else {
        return;
    };
    let words = [
        "No space left on device",
        "is kept in small/new.partial",
        "evpr map repair small/new",
    ];
    assert_fails(&bench, &said, 1, &words);
    assert_eq!(said.stdout, "new.partial\n");
    let (_, after) = said.errors()[0].split_once("up to tick ").unwrap();
    let last: usize = after.split_once(' ').unwrap().0.parse().unwrap();
    assert!((3..TICKS as usize - 1).contains(&last), "{last}");
    fails(
        &bench,
        &["map", "verify", "kept/new"],
        1,
        &["unfinished", "evpr map repair kept/new"],
    );
    let repaired = bench.run(&["map", "repair", "kept/new"]);
    assert_eq!(repaired.code(), 0, "{}", repaired.stderr);
    let verified = bench.run(&["map", "verify", "kept/new"]);
    assert_eq!(verified.code(), 0, "{}", verified.stderr);
    assert_begins(&bench.path("kept/new"), &bench.path("whole"), last + 1);
    // It is a map like any other.
    let said = bench.run(&[&RUN[..], &["-m", text(&bench.path("kept/new"))]].concat());
    assert_eq!(said.code(), 0, "{}", said.stderr);
}

#[test]
fn a_disk_too_full_to_begin_leaves_nothing() {
    let bench = bench_with_map();
    let Some(said) = record_into(&bench, "20k") else {
        return;
    };
    assert_fails(
        &bench,
        &said,
        1,
        &["small/new.partial", "No space left on device"],
    );
    assert_eq!(said.stdout, "");
}
