//! Evaluation and choice on real recordings: an indoor route that was walked twice.

use crate::support::{Bench, read_answers, run_args, shared_data, text};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Ticks of 0.5 s that are whole in the second pass.
const QUERIES: usize = 299;

const ONE_WINDOW: &str = "[\"500ms\"]";
const TWO_WINDOWS: &str = "[\"250ms\", \"500ms\"]";

/// A bench with the traverses `map` and `query`, their configuration `cor.toml` and `truth.csv`; and the second pass's
/// events.
fn recorded(test: &str, windows: &str) -> Option<(Bench, PathBuf)> {
    let data = shared_data(test, "data/corridor")?;
    let bench = Bench::new();
    let config = bench.file(
        "cor.toml",
        &format!(
            "[slicing]\ntick = \"500ms\"\nwindows = {windows}\n[[reconstruction]]\nid = \"event_count_no_polarity\"\n\
             [[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n[[extractor]]\nid = \"hog\"\n"
        ),
    );
    for (name, events) in [("map", "reference_events.h5"), ("query", "query_events.h5")] {
        let said = bench.build_map(&config, &data.join(events), Path::new(name));
        assert_eq!(said.code(), 0, "{}", said.stderr);
    }
    // The file knows the last tick too, which is not whole.
    let pairs = fs::read_to_string(data.join("ground_truth.csv")).unwrap();
    let whole = |line: &&str| {
        line.split(',')
            .next()
            .unwrap()
            .parse()
            .map_or(true, |q: usize| q < QUERIES)
    };
    let pairs: Vec<&str> = pairs.lines().filter(whole).collect();
    bench.file("truth.csv", &(pairs.join("\n") + "\n"));
    Some((bench, data.join("query_events.h5")))
}

fn evaluate(bench: &Bench, more: &[&str]) {
    let pair = [
        "evaluate",
        "--quiet",
        "-r",
        "map",
        "-q",
        "query",
        "-g",
        "truth.csv",
        "-o",
        "out",
    ];
    let said = bench.run(&[&pair[..], more].concat());
    assert_eq!(said.code(), 0, "{}", said.stderr);
}

#[test]
fn every_method_and_rule_is_as_numpy_has_it() {
    const TEST: &str = "every_method_and_rule_is_as_numpy_has_it";
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let numpy = Command::new(&python).args(["-c", "import numpy"]).output();
    if !numpy.is_ok_and(|o| o.status.success()) {
        println!("skipped: {TEST}: {python} has no module numpy");
        return;
    }
    let Some((bench, _)) = recorded(TEST, ONE_WINDOW) else {
        return;
    };
    let methods = "paper,rows,filter,none,seqslam,seqslam:window=12:velocities=0.5..1.5:velocity_steps=5,\
                   filter:beta=0.8:transition=0.1/0.8/0.1:restart=0.05";
    let rules = "sum,median,product,trimmed_mean:trim=0.3";
    let sets = [
        "--subsets",
        "single,combined",
        "--method",
        methods,
        "--rule",
        rules,
        "-l",
        "5",
    ];
    evaluate(&bench, &sets);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scripts/check_evaluate.py");
    let said = Command::new(&python)
        .arg(script)
        .args(["map", "query", "truth.csv", "out/results.json"].map(|name| bench.path(name)))
        .output()
        .unwrap();
    let found = String::from_utf8_lossy(&said.stdout);
    assert!(
        said.status.success(),
        "{found}{}",
        String::from_utf8_lossy(&said.stderr)
    );
    // Seven methods, four rules, four members and all of them.
    assert!(found.contains("140 rows, 0 wrong"), "{found}");
}

/// Answers of a run, and how many of them are given and right.
fn run(bench: &Bench, config: &Path, events: &Path) -> (Vec<Value>, usize, usize) {
    let out = bench.path("matches.jsonl");
    let said = bench.run(&run_args(config, events, &bench.path("map"), &["-o", text(&out)]));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let answers = read_answers(&out);
    fs::remove_file(out).unwrap();
    let pairs = fs::read_to_string(bench.path("truth.csv")).unwrap();
    let right = |(tick, answer): (usize, &Value)| {
        let reference = answer["reference"].as_u64()?;
        Some(pairs.lines().any(|line| line == format!("{tick},{reference}")))
    };
    let given: Vec<bool> = answers.iter().enumerate().filter_map(right).collect();
    let count = given.iter().filter(|r| **r).count();
    (answers, given.len(), count)
}

#[test]
fn a_threshold_for_a_wanted_precision_has_it_in_a_run() {
    const TEST: &str = "a_threshold_for_a_wanted_precision_has_it_in_a_run";
    let Some((bench, events)) = recorded(TEST, TWO_WINDOWS) else {
        return;
    };
    evaluate(
        &bench,
        &[
            "--subsets",
            "combined",
            "--method",
            "rows",
            "-l",
            "5",
            "--wanted-precision",
            "0.98",
        ],
    );
    let table = fs::read_to_string(bench.path("out/thresholds.csv")).unwrap();
    let mut lines = table.lines().map(|line| line.split(','));
    let learnt: BTreeMap<&str, &str> = lines.next().unwrap().zip(lines.next().unwrap()).collect();
    let config = fs::read_to_string(bench.path("cor.toml")).unwrap();
    let fuse = |more: &str| format!("{config}[fuse]\nsequence = {{ method = \"rows\", length = 5 }}\n{more}");
    let all = run(&bench, &bench.file("all.toml", &fuse("")), &events);
    let sure = format!("min_confidence = {}\n", learnt["threshold"]);
    let (answers, given, right) = run(&bench, &bench.file("sure.toml", &fuse(&sure)), &events);
    assert_eq!(answers.len(), QUERIES);
    assert_eq!(given.to_string(), learnt["answers"]);
    let precision = right as f64 / given as f64;
    assert_eq!(precision.to_string(), learnt["precision"]);
    assert!(
        precision >= 0.98 && (all.2 as f64) < 0.98 * all.1 as f64,
        "{precision}, without {} of {}",
        all.2,
        all.1
    );
    // It keeps what it can: far more than half of the answers.
    assert!(given > QUERIES / 2, "{given}");
    let unknown = answers.iter().filter(|a| a["reference"].is_null());
    assert!(unknown.clone().all(|a| a["reason"] == "low confidence"));
    assert_eq!(unknown.count(), QUERIES - given);
}

#[test]
fn members_are_chosen_that_beat_all_of_them_per_millisecond() {
    const TEST: &str = "members_are_chosen_that_beat_all_of_them_per_millisecond";
    let Some((bench, events)) = recorded(TEST, TWO_WINDOWS) else {
        return;
    };
    bench.file(
        "costs.toml",
        "[reconstruction]\nevent_count_no_polarity = 0.5\nevent_count = 0.8\n[extractor]\npatch_norm = 0.2\nhog = 0.6\n",
    );
    #[rustfmt::skip]
    let args = [
        "choose", "--quiet", "--json", "-r", "map", "-q", "query", "-g", "truth.csv", "--costs", "costs.toml", "--budget",
        "1500us", "--method", "rows", "-l", "5", "--config", "cor.toml", "--out", "chosen.toml",
    ];
    let said = bench.run(&args);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let chosen: Value = serde_json::from_str(&said.stdout).unwrap();
    let number = |choice: &Value, key: &str| choice[key].as_f64().unwrap();
    let (choice, all) = (&chosen["choice"], &chosen["all"]);
    let per_ms = |recall: f64, choice: &Value| recall / number(choice, "cost_ms");
    // Also by the recall on blocks of queries that it was not chosen by.
    let cross_validated = number(&chosen, "cross_validated");
    assert!(
        per_ms(cross_validated, choice) > 2.0 * per_ms(number(all, "recall"), all),
        "{chosen}"
    );
    assert!(
        number(choice, "recall") >= cross_validated && cross_validated > 0.9,
        "{chosen}"
    );
    let (answers, _, right) = run(&bench, &bench.path("chosen.toml"), &events);
    assert!(
        answers.iter().all(|a| a["members"] == choice["members"]),
        "{choice}"
    );
    assert_eq!(right as f64 / QUERIES as f64, number(choice, "recall"));
}
