//! The demonstration, on a short street.

use super::support::{Bench, text};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Kinds of ensembles, and how many there are of each of 3 reconstructions, 4 windows and 3 extractors.
const KINDS: [(&str, usize); 5] = [
    ("single", 36),
    ("temporal", 9),
    ("reconstruction", 12),
    ("extractor", 12),
    ("combined", 1),
];

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn assert_recall(results: &Value, ticks: u64) {
    let recall = results["recall"].as_array().unwrap();
    assert_eq!(
        recall.len(),
        KINDS.len() * 4,
        "two drives, two lengths of sequences"
    );
    for entry in recall {
        let ensembles = entry["ensembles"].as_array().unwrap();
        let expected = KINDS.iter().find(|(kind, _)| entry["kind"] == *kind).unwrap().1;
        assert_eq!(ensembles.len(), expected, "{}", entry["kind"]);
        let all = entry["ticks"].as_u64().unwrap();
        assert!(all >= ticks, "a drive with a stop is longer than one without");
        let mut sum = 0.0;
        for pair in ensembles.windows(2) {
            assert!(
                number(&pair[0]["recall_at_1"]) >= number(&pair[1]["recall_at_1"]),
                "best first"
            );
        }
        for ensemble in ensembles {
            let (right, share) = (number(&ensemble["right"]), number(&ensemble["recall_at_1"]));
            assert!((0.0..=1.0).contains(&share) && (share - right / all as f64).abs() < 1e-12);
            sum += share;
        }
        assert!((number(&entry["mean"]) - sum / expected as f64).abs() < 1e-12);
    }
    // A street that is seen again by day is no riddle.
    let by_day = recall
        .iter()
        .find(|r| r["kind"] == "combined" && r["pass"] == "day2" && r["length"] == 1);
    let by_day = number(&by_day.unwrap()["mean"]);
    assert!(by_day > 0.5, "{by_day}");
}

fn assert_latency(latency: &Value) {
    let stages = latency["stages"].as_array().unwrap();
    let names: Vec<&str> = stages.iter().map(|s| s["stage"].as_str().unwrap()).collect();
    assert_eq!(names, ["reconstruct", "extract", "fuse", "total"]);
    let ticks = latency["ticks"].as_u64().unwrap() + latency["left_out"].as_u64().unwrap();
    assert_eq!(ticks, 4);
    for stage in stages {
        let (median, slowest) = (number(&stage["median_us"]), number(&stage["slowest_us"]));
        assert!(median > 0.0 && slowest >= median, "{stage}");
    }
}

/// Every picture that the page shows is there, is a PNG, and is not of one colour.
fn assert_page(report: &Path) {
    let page = fs::read_to_string(report.join("index.html")).unwrap();
    assert!(!page.contains("{{"), "something was not filled in");
    assert!(!page.contains("http"), "the page asks for something outside");
    let pictures: Vec<&str> = page
        .split("src=\"")
        .skip(1)
        .map(|rest| rest.split('"').next().unwrap())
        .collect();
    assert_eq!(
        pictures,
        [
            "recall.png",
            "similarity_day.png",
            "similarity_night.png",
            "frames.png",
            "latency.png"
        ]
    );
    for picture in pictures {
        let bytes = fs::read(report.join(picture)).unwrap();
        assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"), "{picture}");
        assert!(bytes.len() > 10_000, "{picture} has {} bytes", bytes.len());
    }
}

#[test]
fn a_short_street_is_shown_with_everything_that_was_measured() {
    let bench = Bench::new();
    let said = bench.run(&["demo", "--quick", "--quiet", "--json", "--seed", "3"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(said.stderr, "");
    let report = bench.path("demo-report");
    let results: Value = serde_json::from_str(&said.stdout).unwrap();
    let written: Value =
        serde_json::from_str(&fs::read_to_string(report.join("results.json")).unwrap()).unwrap();
    assert_eq!(results, written);
    assert_eq!(results["scene"]["seed"], 3);
    assert!(results["scene"]["shared_memory_bytes"].as_u64().unwrap() <= 64 << 20);

    let passes = results["passes"].as_array().unwrap();
    let names: Vec<&str> = passes.iter().map(|p| p["pass"].as_str().unwrap()).collect();
    assert_eq!(names, ["day", "day2", "night"]);
    for pass in passes {
        assert!(pass["events"].as_u64().unwrap() > 0);
        let name = pass["pass"].as_str().unwrap();
        let said = bench.run(&["map", "verify", text(&report.join("traverses").join(name))]);
        assert_eq!(said.code(), 0, "{}", said.stderr);
    }
    for query in &passes[1..] {
        assert_eq!(
            query["equal_answers"], query["ticks"],
            "the graph and the evaluation agree"
        );
        let matches = report
            .join("matches")
            .join(format!("{}.jsonl", query["pass"].as_str().unwrap()));
        let lines = super::support::read_answers(&matches).len() as u64;
        assert_eq!(query["ticks"].as_u64().unwrap(), lines);
    }
    assert_recall(&results, passes[0]["ticks"].as_u64().unwrap());
    assert_latency(&results["latency"]);
    assert_page(&report);
    // What it leaves can be used with the other commands.
    let config = report.join("demo.toml");
    let said = bench.run(&["validate", "-c", text(&config)]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(fs::read_to_string(&config).unwrap().contains("seed = 3\n"));
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_folder_that_holds_something_else_is_left_alone() {
    let bench = Bench::new();
    fs::create_dir(bench.path("photos")).unwrap();
    bench.file("photos/index.html", "mine");
    let said = bench.run(&["demo", "--quick", "--out", "photos"]);
    assert_eq!(said.code(), 1);
    assert_eq!(said.errors().len(), 1, "{}", said.stderr);
    assert!(
        said.errors()[0].contains("photos") && said.errors()[0].contains("--out"),
        "{}",
        said.stderr
    );
    let names: Vec<_> = fs::read_dir(bench.path("photos"))
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    assert_eq!(names, ["index.html"]);
    assert_eq!(
        fs::read_to_string(bench.path("photos/index.html")).unwrap(),
        "mine"
    );
}
