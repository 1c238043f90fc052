//! Whatever is wrong: one line that begins with `error: ` per mistake, exit code 1 (2 for usage), nothing left in
//! shared memory, and nothing lost that had been answered or recorded before.

mod recordings;
mod storage;

use crate::support::{Bench, Running, Said, TICKS, assert_ticks, run_args, text};
use evpr_store::Traverse;
use nix::sys::signal::Signal;
use std::fs;
use std::path::Path;

/// The command failed with this code and one line that has all these words, and left nothing in shared memory.
fn assert_fails(bench: &Bench, said: &Said, code: i32, words: &[&str]) {
    assert_eq!(said.code(), code, "{}", said.stderr);
    let errors = said.errors();
    assert_eq!(errors.len(), 1, "{}", said.stderr);
    for word in words {
        assert!(errors[0].contains(word), "\"{word}\" is not in: {}", errors[0]);
    }
    assert!(!said.stderr.contains("panicked"), "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

fn fails(bench: &Bench, args: &[&str], code: i32, words: &[&str]) {
    println!("evpr {}", args.join(" "));
    assert_fails(bench, &bench.run(args), code, words);
}

/// A file of this repository.
fn repository(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

/// The traverse holds exactly the first ticks of the other one.
fn assert_begins(part: &Path, whole: &Path, ticks: usize) {
    let (part, whole) = (Traverse::open(part).unwrap(), Traverse::open(whole).unwrap());
    assert_eq!(part.len(), ticks);
    assert_eq!(part.ticks(), &whole.ticks()[..ticks]);
    for entry in &part.manifest().members {
        let (a, b) = (
            part.member(&entry.name).unwrap(),
            whole.member(&entry.name).unwrap(),
        );
        assert_eq!(a.present(), &b.present()[..ticks]);
        assert_eq!(a.rows(), &b.rows()[..ticks * b.dim()], "{}", entry.name);
    }
}

#[test]
fn usage_errors_exit_with_2() {
    let bench = Bench::new();
    bench.ensemble_config();
    let run = ["run", "-c", "ensemble.toml", "-i", "query.txt"];
    let with = |extra: &[&'static str]| [&run[..], extra].concat();
    fails(&bench, &with(&["--map", "map", "--fast"]), 2, &["--fast"]);
    fails(&bench, &["run"], 2, &["required arguments"]);
    fails(
        &bench,
        &["map", "build", "-c", "ensemble.toml"],
        2,
        &["required arguments"],
    );
    fails(
        &bench,
        &with(&["--map", "map", "--pace", "0"]),
        2,
        &["--pace", "out of range", "0.001"],
    );
    fails(&bench, &with(&["--map", "map", "--pace", "fast"]), 2, &["--pace"]);
    fails(
        &bench,
        &with(&["--map", "map", "--delivery", "soon"]),
        2,
        &["--delivery"],
    );
    fails(&bench, &run, 2, &["nothing to do", "--map DIR", "--record DIR"]);
    fails(&bench, &["fly"], 2, &["fly"]);
    let reconstruct = [
        "events",
        "reconstruct",
        "query.txt",
        "-t",
        "1s",
        "-o",
        "f.npy",
        "-m",
    ];
    let with = |extra: &[&'static str]| [&reconstruct[..], extra].concat();
    let query = bench.recording("query.txt", 20, 2);
    fails(
        &bench,
        &with(&["event_count", "-w", "fast"]),
        2,
        &["--window", "duration"],
    );
    fails(
        &bench,
        &with(&["event_count", "-w", "1s", "--sensor", "48"]),
        2,
        &["--sensor 48", "260x346"],
    );
    fails(
        &bench,
        &with(&["event_cont", "-w", "1s", "--sensor", "48x64"]),
        2,
        &["did you mean \"event_count\"?"],
    );
    fails(
        &bench,
        &with(&["event_count", "-w", "2s", "--sensor", "48x64"]),
        2,
        &["longer than the tick"],
    );
    fails(
        &bench,
        &with(&["time_surface", "-w", "1s", "--sensor", "48x64", "-p", "tua=5ms"]),
        2,
        &["`tua`", "did you mean `tau`?"],
    );
    fails(
        &bench,
        &with(&["event_count", "-w", "1s"]),
        1,
        &[text(&query).rsplit('/').next().unwrap(), "--sensor"],
    );
}

#[test]
fn all_five_mistakes_of_a_configuration_are_reported() {
    let bench = Bench::new();
    let config = repository("tests/config/invalid/five_mistakes.toml");
    bench.recording("query.txt", 20, 2);
    let config = text(&config);
    for args in [
        &["validate", "-c", config][..],
        &["graph", "-c", config],
        &["run", "-c", config, "-i", "query.txt", "-r", "recorded"],
        &["map", "build", "-c", config, "-i", "query.txt", "-o", "recorded"],
    ] {
        let said = bench.run(args);
        assert_eq!(said.code(), 1, "{}", said.stderr);
        let wanted = [
            ":2: slicing.tick: \"1 day\" is not a duration",
            ":3: slicing.windws: unknown key `windws`; did you mean `windows`?",
            ":10: extractor[0].params.side: 1000 is out of range",
            ":13: ensemble.disabled[0]: no such reconstruction: \"event_cont\"",
            ":16: runtime.deadline: is a number; write a duration",
        ];
        let errors = said.errors();
        assert_eq!(errors.len(), wanted.len(), "{}", said.stderr);
        assert_eq!(said.stderr.lines().count(), wanted.len(), "{}", said.stderr);
        for (error, words) in errors.iter().zip(wanted) {
            assert!(error.starts_with(&format!("error: {config}{words}")), "{error}");
        }
        assert!(!bench.path("recorded").exists() && !bench.path("recorded.partial").exists());
        assert_eq!(bench.left_behind(), Vec::<String>::new());
    }
}

#[test]
fn configurations_that_cannot_be_read() {
    let bench = Bench::new();
    bench.recording("query.txt", 20, 2);
    fs::create_dir(bench.path("folder")).unwrap();
    fs::write(bench.path("binary.toml"), b"\xff\xfe\x00 = 1").unwrap();
    bench.file("syntax.toml", "[slicing]\ntick = \"1s\n");
    for (config, words) in [
        (
            "none.toml",
            &["cannot read the configuration none.toml", "No such file"][..],
        ),
        ("folder", &["cannot read the configuration folder", "directory"]),
        (
            "binary.toml",
            &["cannot read the configuration binary.toml", "UTF-8"],
        ),
        ("syntax.toml", &["syntax.toml:2: not valid TOML"]),
    ] {
        fails(
            &bench,
            &["run", "-c", config, "-i", "query.txt", "-m", "map"],
            1,
            words,
        );
        fails(&bench, &["validate", "-c", config], 1, words);
    }
    // A recording is no configuration in any of its lines; that it is none at all can be said in fewer.
    let said = bench.run(&["validate", "-c", "query.txt"]);
    assert_eq!(said.code(), 1);
    assert!((2..100).contains(&said.errors().len()), "{}", said.stderr);
    assert!(
        said.errors().last().unwrap().ends_with(" more"),
        "{}",
        said.stderr
    );
}

#[test]
fn no_instance_and_a_second_instance_of_the_same_name() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    fails(
        &bench,
        &["member", "list"],
        1,
        &["no instance named \"evpr\" is running"],
    );
    fails(
        &bench,
        &["member", "disable", "--name", "other", "all"],
        1,
        &["no instance named \"other\""],
    );
    let query = bench.recording("query.txt", TICKS, 2);
    let args = run_args(&config, &query, &map, &[]);
    let mut running = Running::start(&bench, &[&args[..], &["--pace", "1"]].concat());
    assert!(running.read_to(5));
    let second = bench.run(&[&args[..], &["-o", "second.jsonl"]].concat());
    assert_eq!(second.code(), 1, "{}", second.stderr);
    assert_eq!(second.errors().len(), 1, "{}", second.stderr);
    assert!(
        second
            .stderr
            .contains("an instance named \"evpr\" is running already"),
        "{}",
        second.stderr
    );
    assert!(second.stderr.contains("--name"), "{}", second.stderr);
    // Another name is free, and the first one is none the worse.
    let third = bench.run(&[&args[..], &["-o", "third.jsonl", "--name", "third"]].concat());
    assert_eq!(third.code(), 0, "{}", third.stderr);
    let heard = running.answers.len() as u64;
    assert!(running.read_to(heard + 5));
    Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn stopping_before_the_first_tick_leaves_no_map() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let query = bench.recording("query.txt", TICKS, 2);
    // A tick takes 100 s.
    let slow = ["-q", "-c", text(&config), "-i", text(&query), "--pace", "0.001"];
    let running = Running::start(&bench, &[&["map", "build", "-o", "stopped"], &slow[..]].concat());
    let listening = (0..1000).any(|_| bench.run(&["member", "list"]).code() == 0);
    assert!(listening, "the instance never answered");
    Running::signal(running.pid(), Signal::SIGINT);
    let (_, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert!(said.errors().is_empty(), "{}", said.stderr);
    assert!(said.stderr.contains("no map"), "{}", said.stderr);
    assert!(!bench.path("stopped").exists() && !bench.path("stopped.partial").exists());
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_run_that_fails_at_its_start_touches_no_older_answers_and_prints_no_table() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 20, 2);
    bench.file("bad.txt", "t x y p\n0.000001 1 1 1\n0.000002 x 1 1\n");
    let older = bench.file("answers.jsonl", "older\n");
    let run = |config: &str, input: &str, map: &str, out: &str| {
        bench.run(&["run", "-c", config, "-i", input, "-m", map, "-o", out])
    };
    let (config, map, query) = (text(&config), text(&map), text(&query));
    for (config, input, map, words) in [
        (config, "bad.txt", map, "line 3"),
        (config, "none.txt", map, "no such file"),
        (config, query, "none", "none"),
        ("none.toml", query, map, "none.toml"),
    ] {
        for out in ["answers.jsonl", "new.jsonl"] {
            let said = run(config, input, map, out);
            assert_fails(&bench, &said, 1, &[words]);
            assert!(!said.stderr.contains("p50 ms"), "{}", said.stderr);
        }
        assert_eq!(fs::read(&older).unwrap(), b"older\n", "{words}");
        assert!(!bench.path("new.jsonl").exists(), "{words}");
    }
    // Where nothing can be written is said before anything starts.
    for (out, words) in [
        ("none/answers.jsonl", "cannot write none/answers.jsonl"),
        ("map", "cannot write map"),
        (".", "cannot write ."),
    ] {
        let said = run(config, query, map, out);
        assert_fails(&bench, &said, 1, &[words]);
        assert_eq!(said.stderr.lines().count(), 1, "{}", said.stderr);
    }
    // Once there are answers they replace the older ones.
    let said = run(config, query, map, "answers.jsonl");
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(said.stderr.contains("p50 ms"), "{}", said.stderr);
    assert_ticks(&crate::support::read_answers(&older), 20);
}

/// A `.npy` of f64 with this shape.
fn npy(path: &Path, shape: &str, values: &[f64]) {
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}").bytes());
    bytes.resize(127, b' ');
    bytes.push(b'\n');
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    fs::write(path, bytes).unwrap();
}

#[test]
fn matrices_that_cannot_be_matched() {
    let bench = Bench::new();
    npy(&bench.path("good.npy"), "(2, 3)", &[0.0, 1.0, 2.0, 3.0, 4.0, 6.0]);
    npy(&bench.path("flat.npy"), "(3,)", &[0.0, 1.0, 2.0]);
    npy(&bench.path("nan.npy"), "(2, 2)", &[0.0, 1.0, f64::NAN, 2.0]);
    npy(&bench.path("cut.npy"), "(2, 3)", &[0.0]);
    bench.file("text.npy", "0 1 2\n3 4 5\n");
    let matching = |similarity: &str, length: &str, out: &str, code: i32, words: &[&str]| {
        fails(
            &bench,
            &["sequence-match", "-s", similarity, "-l", length, "-o", out],
            code,
            words,
        );
        assert!(!bench.path(out).is_file());
    };
    matching("flat.npy", "2", "t.npy", 1, &["flat.npy", "queries × references"]);
    matching("text.npy", "2", "t.npy", 1, &["text.npy", ".npy array"]);
    matching("cut.npy", "2", "t.npy", 1, &["cut.npy"]);
    matching("none.npy", "2", "t.npy", 1, &["none.npy", "No such file"]);
    matching(
        "nan.npy",
        "2",
        "t.npy",
        1,
        &["nan.npy", "query 1 and reference 0 is NaN"],
    );
    matching("good.npy", "2", "none/t.npy", 1, &["cannot write none/t.npy"]);
    matching("good.npy", "0", "t.npy", 2, &["--length 0"]);
    matching("good.npy", "-1", "t.npy", 2, &["-1"]);
    matching("good.npy", "two", "t.npy", 2, &["two"]);
    let methods: [(&[&str], &str); 7] = [
        (&["-m", "rows"], "needs a sequence length"),
        (
            &["-l", "2", "--beta", "1"],
            "--beta has no effect with --method paper",
        ),
        (
            &["-m", "filter", "--window", "9"],
            "--window has no effect with --method filter",
        ),
        (&["-m", "filter", "--restart", "2"], "--restart 2 is out of range"),
        (&["-m", "filter", "--transition", "0.5,0.4"], "add up to 0.9"),
        (
            &["-m", "seqslam", "-l", "2", "--velocities", "1.2,0.8"],
            "velocities are the least and the greatest",
        ),
        (
            &["-m", "seqslam", "-l", "2", "--window", "1"],
            "--window 1 is out of range",
        ),
    ];
    for (options, words) in methods {
        let args = [&["sequence-match", "-s", "good.npy", "-o", "t.npy"], options].concat();
        fails(&bench, &args, 2, &[words]);
    }
    let said = bench.run(&["sequence-match", "-s", "good.npy", "-l", "2", "-o", "t.npy"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(fs::metadata(bench.path("t.npy")).unwrap().len(), 128 + 6 * 8);
}
