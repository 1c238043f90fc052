//! What `evpr evaluate` and `evpr choose` refuse: one line, and the exit code.

use crate::evaluate::{evaluate, recorded, refused};
use crate::support::{Bench, text};
use std::fs;
use std::path::Path;

/// Evaluates the traverses of the bench, with these options in place of the ones that are right.
fn bad(bench: &Bench, more: &[&str], code: i32, words: &str) {
    let truth: &[&str] = if more.contains(&"-g") {
        &[]
    } else {
        &["-g", "truth.csv"]
    };
    refused(
        bench,
        &evaluate(&[truth, more, &["-o", "out"]].concat()),
        code,
        words,
    );
    assert!(!bench.path("out").exists(), "nothing is written: {words}");
}

#[test]
fn ground_truth_that_does_not_fit() {
    let (bench, _) = recorded();
    for (name, content, words) in [
        (
            "far.csv",
            "query_id,reference_id\n0,60\n",
            "query 0 and reference 60 are not in the traverses",
        ),
        ("words.csv", "query_id,reference_id\nx,1\n", "line 2 is no pair"),
        // No query is labelled.
        (
            "none.csv",
            "query_id,reference_id\n",
            "no query has a right answer",
        ),
        ("empty.npy", "", "empty.npy"),
    ] {
        bench.file(name, content);
        bad(&bench, &["-g", name], 1, words);
    }
    bad(&bench, &["-g", "nowhere.csv"], 1, "nowhere.csv: cannot open");
    bad(
        &bench,
        &["-g", "positions"],
        1,
        "has no positions; give a file of right pairs instead",
    );
    refused(
        &bench,
        &["evaluate", "-r", "map", "-q", "query", "-o", "out"],
        2,
        "--ground-truth",
    );
}

#[test]
fn traverses_that_do_not_fit() {
    let (bench, config) = recorded();
    let events = bench.path("query.txt");
    let config = fs::read_to_string(config).unwrap();
    let record = |name: &str, change: (&str, &str)| {
        assert!(config.contains(change.0), "{}", change.0);
        let file = bench.file(&format!("{name}.toml"), &config.replace(change.0, change.1));
        let said = bench.build_map(&file, &events, Path::new(name));
        assert_eq!(said.code(), 0, "{}", said.stderr);
    };
    record("fewer", ("[[extractor]]\nid = \"patch_norm\"\n", ""));
    record("longer", ("tick = \"100ms\"", "tick = \"200ms\""));
    record(
        "other",
        (
            "id = \"patch_norm\"",
            "id = \"patch_norm\"\nparams = { side = 16 }",
        ),
    );
    for (query, words) in [
        ("fewer", "the query has no rows of event_count@50ms/patch_norm"),
        (
            "longer",
            "a tick is 100ms in the reference and 200ms in the query",
        ),
        ("other", "of member event_count@50ms/patch_norm is"),
        ("nowhere", "there is no such traverse"),
    ] {
        let args = [
            "evaluate",
            "-r",
            "map",
            "-q",
            query,
            "-g",
            "truth.csv",
            "-o",
            "out",
        ];
        refused(&bench, &args, 1, words);
        // Costs and choices stand on the same pairs.
        bench.file("costs.toml", "");
        #[rustfmt::skip]
        let args = [
            "choose", "-r", "map", "-q", query, "-g", "truth.csv", "--costs", "costs.toml", "--budget", "9ms",
        ];
        refused(&bench, &args, 1, words);
    }
    // A number that is none.
    let path = bench.path("query/rows/time_surface@100ms/raw_pixels.npy");
    let mut bytes = fs::read(&path).unwrap();
    let last = bytes.len() - 4;
    bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let words = "the query's row of member time_surface@100ms/raw_pixels at tick 59 is not finite";
    bad(&bench, &[], 1, words);
}

#[test]
fn words_and_numbers_that_are_not_known() {
    let (bench, _) = recorded();
    for (args, code, words) in [
        (
            &["--method", "papr"][..],
            2,
            "--method papr: \"papr\" is not known here; did you mean \"paper\"?",
        ),
        (
            &["--method", "seqslam:window=1"],
            2,
            "window=1: give a number from 2 to 10000",
        ),
        (&["--method", "paper:beta=2"], 2, "paper has no parameter beta"),
        (
            &["--rule", "average"],
            2,
            "--rule average: \"average\" is not known here",
        ),
        (&["--similarity", "l3"], 2, "--similarity l3"),
        (
            &["--subsets", "temporl"],
            2,
            "--subsets temporl: give some of single, temporal",
        ),
        (&["--subsets", "none"], 2, "nothing to evaluate"),
        (
            &["--subset", "mine"],
            2,
            "--subset mine: write NAME=MEMBER,MEMBER",
        ),
        (
            &["--subset", "mine=a@1s/b"],
            1,
            "subset mine: no member is a@1s/b; there are event_count@50ms/patch_norm",
        ),
        (&["--members", "a@1s/b"], 1, "no member is a@1s/b"),
        (&["-l", "0"], 2, "a sequence has 1 to 1000 ticks"),
        (
            &["--method", "seqslam", "-l", "61"],
            1,
            "its map has 60 ticks, fewer than the 61 of the sequence",
        ),
        (
            &["--learn-weights", "map"],
            2,
            "no pair is named so; there are map-query",
        ),
        (
            &["--wanted-precision", "1.5"],
            2,
            "give a number above 0, up to 1",
        ),
    ] {
        let truth = ["-g", "truth.csv", "-o", "out"];
        refused(&bench, &evaluate(&[&truth, args].concat()), code, words);
    }
    assert!(!bench.path("out/results.csv").exists());
    // Results of another pair of the same name are not taken for these.
    bench.file("other.csv", "query_id,reference_id\n0,1\n");
    let evaluated = |truth| evaluate(&["-g", truth, "--subsets", "combined", "-o", "out"]);
    assert_eq!(bench.run(&evaluated("truth.csv")).code(), 0);
    refused(
        &bench,
        &evaluated("other.csv"),
        1,
        "it holds results of another pair map-query",
    );
    // Nor what is left when some members are.
    let fewer = [&evaluated("truth.csv")[..], &["--members", "*/raw_pixels"]].concat();
    refused(&bench, &fewer, 1, "map-query: members was 8");
    let other = [&evaluated("truth.csv")[..], &["--exclusion", "0"]].concat();
    refused(&bench, &other, 1, "it holds results with exclusion 5, not 0");
}

#[test]
fn choices_that_cannot_be_made() {
    let (bench, config) = recorded();
    let good = "[reconstruction]\nevent_count = 2.0\ntime_surface = 5.0\n[extractor]\npatch_norm = 1.0\nraw_pixels = 1.0\n";
    bench.file("costs.toml", good);
    bench.file("some.toml", &good.replace("raw_pixels = 1.0\n", ""));
    bench.file("minus.toml", &good.replace("5.0", "-5.0"));
    bench.file("stats.json", "{}");
    let choose = |costs: &'static str, budget: &'static str| {
        let pair = ["choose", "--quiet", "-r", "map", "-q", "query", "-g", "truth.csv"];
        [&pair[..], &["--costs", costs, "--budget", budget]].concat()
    };
    for (args, code, words) in [
        (choose("costs.toml", "80"), 2, "--budget"),
        (choose("costs.toml", "0ms"), 1, "no member fits 0 ms"),
        (choose("costs.toml", "1ms"), 1, "no member fits"),
        (
            choose("some.toml", "9ms"),
            1,
            "the costs have no raw_pixels in [extractor]",
        ),
        (
            choose("minus.toml", "9ms"),
            1,
            "the cost -5 ms of time_surface makes no sense",
        ),
        (choose("stats.json", "9ms"), 1, "these are no statistics of a run"),
        (choose("nowhere.toml", "9ms"), 1, "nowhere.toml: cannot open"),
        (
            [&choose("costs.toml", "9ms")[..], &["--method", "best"]].concat(),
            2,
            "--method: \"best\" is not known here",
        ),
        (
            [&choose("costs.toml", "9ms")[..], &["--out", "x.toml"]].concat(),
            2,
            "give both or neither",
        ),
        (
            [
                &choose("costs.toml", "9ms")[..],
                &["--out", "costs.toml", "--config", text(&config)],
            ]
            .concat(),
            1,
            "costs.toml exists already",
        ),
    ] {
        refused(&bench, &args, code, words);
    }
    // A configuration that the traverses are not of.
    bench.file(
        "strange.toml",
        "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"hog\"\n",
    );
    let strange = ["--config", "strange.toml", "--out", "chosen.toml"];
    refused(
        &bench,
        &[&choose("costs.toml", "9ms")[..], &strange].concat(),
        1,
        "strange.toml",
    );
    assert!(!bench.path("chosen.toml").exists());
}
