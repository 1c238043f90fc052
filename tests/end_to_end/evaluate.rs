//! `evpr evaluate` and `evpr choose` over traverses that were recorded by real processes.

use crate::support::{Bench, Said, read_answers, run_args, text};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Ticks of a made-up drive.
const TICKS: u64 = 60;

fn succeeds(bench: &Bench, args: &[&str]) -> Said {
    let said = bench.run(args);
    assert_eq!(said.code(), 0, "evpr {}: {}", args.join(" "), said.stderr);
    said
}

/// Refused in one line that has these words.
pub(crate) fn refused(bench: &Bench, args: &[&str], code: i32, words: &str) {
    let said = bench.run(args);
    let line = said.errors().join("\n");
    assert_eq!(said.code(), code, "evpr {}: {}", args.join(" "), said.stderr);
    assert!(
        line.contains(words) && line.lines().count() == 1,
        "evpr {}: {line}",
        args.join(" ")
    );
}

/// `evpr evaluate` of the traverses `map` and `query` of the bench.
pub(crate) fn evaluate<'a>(more: &[&'a str]) -> Vec<&'a str> {
    let pair = ["evaluate", "--quiet", "-r", "map", "-q", "query"];
    [&pair[..], more].concat()
}

/// Each line of a CSV file by the names of its columns.
fn table(path: &Path) -> Vec<BTreeMap<String, String>> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let row = |line: &str| {
        let fields = line.split(',').map(str::to_owned);
        names.iter().map(|n| (*n).to_owned()).zip(fields).collect()
    };
    lines.map(row).collect()
}

/// A drive past frames, in the order of their names: a bit of the pattern per pixel, and metres to the east.
fn drive(bench: &Bench, name: &str, frames: &[(u16, u32)]) {
    fs::create_dir(bench.path(name)).unwrap();
    for (at, (pattern, east)) in frames.iter().enumerate() {
        let pixels: Vec<u8> = (0..16).map(|bit| 200 * (pattern >> bit & 1) as u8).collect();
        let file = bench.path(name).join(format!("@{east}@0@{at}@.png"));
        let mut encoder = png::Encoder::new(fs::File::create(file).unwrap(), 4, 4);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    }
    succeeds(
        bench,
        &[
            "map",
            "build",
            "-q",
            "-c",
            "frames.toml",
            "-i",
            name,
            "-o",
            &format!("{name}-rows"),
        ],
    );
}

/// Five patterns of which any two differ in half of their pixels, each of them half bright: all rows are √2 apart.
const PATTERNS: [u16; 5] = [0x00ff, 0x0f0f, 0x3333, 0x5555, 0x6969];

#[test]
fn a_case_that_can_be_computed_by_hand() {
    let bench = Bench::new();
    bench.file(
        "frames.toml",
        "source.kind = \"frames\"\n[slicing]\ntick = \"1s\"\n[[reconstruction]]\nid = \"frames\"\n[[extractor]]\n\
         id = \"raw_pixels\"\nparams = { height = 4, width = 4 }\n",
    );
    let [a, b, c, d, unknown] = PATTERNS;
    drive(&bench, "there", &[(a, 0), (b, 10), (c, 20), (d, 30)]);
    // The second stands at the third place and looks like the second; the fourth looks like all places alike, and gets
    // the first; the last is nowhere.
    drive(
        &bench,
        "again",
        &[(a, 0), (b, 20), (d, 30), (unknown, 30), (c, 1000)],
    );
    #[rustfmt::skip]
    let args = [
        "evaluate", "--quiet", "-r", "there-rows", "-q", "again-rows", "-g", "positions", "--tolerance-m", "5", "--method",
        "none", "--exclusion", "0", "--subsets", "single,combined", "--wanted-precision", "0.5", "-o", "out",
    ];
    succeeds(&bench, &args);
    let rows = table(&bench.path("out/results.csv"));
    assert_eq!(rows.len(), 2);
    for row in &rows {
        let number = |name: &str| row[name].parse::<f64>().unwrap();
        for (name, right) in [
            ("queries", 5.0),
            ("matchable", 4.0),
            ("answered", 5.0),
            ("right", 2.0),
            ("recall_at_1_of_all", 0.4),
            ("recall_at_1_of_matchable", 0.5),
            ("recall_at_5_of_all", 0.8),
            ("recall_at_20_of_matchable", 1.0),
            ("recall_at_1_optimistic_of_all", 0.6),
            ("recall_at_1_pessimistic_of_all", 0.4),
            // Four answers of confidence 1, two of them right, and one of 0: 2/4 · 2/4, and nothing more after that.
            ("precision_recall_area", 0.25),
            ("recall_at_full_precision", 0.0),
            // 0, 10, 0, 30 and 980 m.
            ("error_median_m", 10.0),
            ("error_mean_m", 204.0),
            ("first_right_ticks", 1.0),
            ("first_right_s", 1.0),
            ("recall_within_5m_of_all", 0.4),
            ("recall_within_10m_of_all", 0.6),
            ("recall_within_30m_of_all", 0.8),
            ("recall_within_30m_of_matchable", 1.0),
            ("recall_within_1_frames_of_all", 0.6),
        ] {
            assert!(
                (number(name) - right).abs() < 1e-12,
                "{name} is {}, not {right}",
                row[name]
            );
        }
    }
    let thresholds = table(&bench.path("out/thresholds.csv"));
    assert_eq!(
        (
            thresholds[0]["threshold"].as_str(),
            thresholds[0]["precision"].as_str()
        ),
        ("1", "0.5")
    );
    let json: Value = serde_json::from_slice(&fs::read(bench.path("out/results.json")).unwrap()).unwrap();
    let measures = &json["rows"][0]["measures"];
    assert_eq!(measures["recall_at"][0]["of_all"], 0.4);
    assert_eq!(
        json["rows"][0]["key"],
        "there-rows-again-rows|l2|none|1|sum|equal|single|frames@1s/raw_pixels"
    );
}

/// A bench with `map` and `query`, traverses of eight members of a made-up drive, its configuration and `truth.csv`.
pub(crate) fn recorded() -> (Bench, PathBuf) {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    for (name, seed) in [("map", 1), ("query", 2)] {
        let events = bench.recording(&format!("{name}.txt"), TICKS, seed);
        let said = bench.build_map(&config, &events, Path::new(name));
        assert_eq!(said.code(), 0, "{}", said.stderr);
    }
    let pairs: String = (0..TICKS).map(|t| format!("{t},{t}\n")).collect();
    bench.file("truth.csv", &format!("query_id,reference_id\n{pairs}"));
    (bench, config)
}

#[test]
fn an_evaluation_goes_on_by_key() {
    let (bench, _) = recorded();
    let args = [
        "-g",
        "truth.csv",
        "--subsets",
        "single,temporal,combined",
        "-l",
        "2,5",
        "-o",
        "out",
    ];
    succeeds(&bench, &evaluate(&args));
    let read = |name: &str| fs::read_to_string(bench.path("out").join(name)).unwrap();
    let (all, csv) = (read("rows.jsonl"), read("results.csv"));
    // A line that says of which pairs they are; 8 members, 4 temporal ensembles and the combined one; two lengths.
    assert_eq!((all.lines().count(), csv.lines().count()), (1 + 26, 1 + 26));
    // Whatever is computed again is added at the end.
    let again = bench.run(&[&["evaluate", "-r", "map", "-q", "query"], &args[..]].concat());
    assert!(
        again.stderr.contains("26 configurations, 0 of them new"),
        "{}",
        again.stderr
    );
    assert_eq!(read("rows.jsonl"), all);
    // Killed while it wrote the sixth row.
    let five: usize = all.split_inclusive('\n').take(6).map(str::len).sum();
    fs::write(bench.path("out/rows.jsonl"), &all[..five + 30]).unwrap();
    succeeds(&bench, &evaluate(&args));
    assert_eq!(
        (read("results.csv"), read("rows.jsonl").lines().count()),
        (csv, 27)
    );
    // Two lists of one name are two configurations.
    for members in ["*/raw_pixels", "*/patch_norm"] {
        let subset = format!("mine={members}");
        let args = [
            "-g",
            "truth.csv",
            "--subsets",
            "none",
            "--subset",
            &subset,
            "-l",
            "2",
            "-o",
            "lists",
        ];
        succeeds(&bench, &evaluate(&args));
    }
    let lists = table(&bench.path("lists/results.csv"));
    assert_eq!((lists.len(), lists[0]["subset"].as_str()), (2, "mine"));
    // Other parameters are other configurations, and say which they are.
    let other = [
        "--method",
        "rows,seqslam:window=8,seqslam",
        "--rule",
        "trimmed_mean:trim=0.4",
    ];
    succeeds(&bench, &evaluate(&[&args[..], &other].concat()));
    let rows = table(&bench.path("out/results.csv"));
    assert_eq!(rows.len(), 26 + 3 * 26);
    let count = |method: &str| rows.iter().filter(|r| r["method"] == method).count();
    assert_eq!((count("seqslam:window=8"), count("seqslam")), (26, 26));
    assert_eq!(
        rows.iter()
            .filter(|r| r["rule"] == "trimmed_mean:trim=0.4")
            .count(),
        78
    );
}

#[test]
fn weights_are_given_or_learnt() {
    let (bench, _) = recorded();
    bench.file(
        "mine.toml",
        "\"event_count@50ms/raw_pixels\" = 3\n\"time_surface@50ms/raw_pixels\" = 0.0\n",
    );
    let args = [
        "-g",
        "truth.csv",
        "--subsets",
        "single,combined",
        "--weights",
        "mine.toml",
        "--learn-weights",
        "map-query",
        "-o",
        "out",
    ];
    succeeds(&bench, &evaluate(&args));
    let rows = table(&bench.path("out/results.csv"));
    let of = |weights: &str| rows.iter().filter(|r| r["weights"].starts_with(weights)).count();
    assert_eq!(
        (rows.len(), of("equal"), of("mine#"), of("learnt:map-query")),
        (27, 9, 9, 9)
    );
    let learnt = table(&bench.path("out/weights.csv"));
    let sum: f64 = learnt.iter().map(|l| l["weight"].parse::<f64>().unwrap()).sum();
    assert!(learnt.len() == 8 && (sum - 8.0).abs() < 1e-9, "{learnt:?}");
    // A member of weight 0 is left out, so alone it answers nothing.
    let off = |r: &&BTreeMap<String, String>| {
        r["weights"].starts_with("mine#") && r["subset"] == "time_surface@50ms/raw_pixels"
    };
    assert_eq!(rows.iter().find(off).unwrap()["answered"], "0");
    for (content, words) in [
        (
            "\"event_count@9s/hog\" = 1\n",
            "no pair has a member event_count@9s/hog",
        ),
        (
            "\"event_count@50ms/raw_pixels\" = -1\n",
            "the weight -1 of event_count@50ms/raw_pixels",
        ),
        ("weights", "mine.toml"),
    ] {
        bench.file("mine.toml", content);
        refused(&bench, &evaluate(&args), 1, words);
    }
}

/// The share of these answers, as the map's ticks, that is right, by a file of pairs.
fn share_right(answers: &[Value], truth: &Path) -> (usize, usize) {
    let pairs = fs::read_to_string(truth).unwrap();
    let right = |(tick, answer): (usize, &Value)| {
        let reference = answer["reference"].as_u64()?;
        Some(pairs.lines().any(|line| line == format!("{tick},{reference}")))
    };
    let given: Vec<bool> = answers.iter().enumerate().filter_map(right).collect();
    (given.iter().filter(|r| **r).count(), given.len())
}

#[test]
fn what_is_chosen_is_run() {
    let (bench, config) = recorded();
    bench.file(
        "costs.toml",
        "member_ms = 0.1\n[reconstruction]\nevent_count = 2.0\ntime_surface = 5.0\n[extractor]\npatch_norm = 1.0\n\
         raw_pixels = { batch_ms = 0.5, frame_ms = 0.25 }\n",
    );
    let config = text(&config);
    for (method, rule, length) in [
        ("paper", "sum", "5"),
        ("filter:beta=0.7:restart=0.1", "trimmed_mean:trim=0.3", "1"),
    ] {
        let _ = fs::remove_file(bench.path("chosen.toml"));
        #[rustfmt::skip]
        let args = [
            "choose", "--quiet", "--json", "-r", "map", "-q", "query", "-g", "truth.csv", "--costs", "costs.toml", "--budget",
            "6ms", "--method", method, "--rule", rule, "-l", length, "--config", config, "--out", "chosen.toml",
        ];
        let said = succeeds(&bench, &args);
        let chosen: Value = serde_json::from_str(&said.stdout).unwrap();
        let members = &chosen["choice"]["members"];
        assert!(chosen["choice"]["cost_ms"].as_f64().unwrap() <= 6.0, "{chosen}");
        assert!(
            chosen["cross_validated"].as_f64().is_some() && !chosen["folds"].as_array().unwrap().is_empty()
        );
        // Within 6 ms there is no time surface beside its extractor and the counts, so some members are left out.
        assert!((1..8).contains(&members.as_array().unwrap().len()), "{members}");
        // The map has all members; those that were chosen answer.
        let (chosen_toml, query, map) = (
            bench.path("chosen.toml"),
            bench.path("query.txt"),
            bench.path("map"),
        );
        let out = bench.path("matches.jsonl");
        succeeds(&bench, &run_args(&chosen_toml, &query, &map, &["-o", text(&out)]));
        let answers = read_answers(&out);
        assert_eq!(answers.len() as u64, TICKS);
        for answer in &answers {
            assert_eq!(&answer["members"], members, "{answer}");
        }
        let (right, _) = share_right(&answers, &bench.path("truth.csv"));
        assert_eq!(
            right as f64 / TICKS as f64,
            chosen["choice"]["recall"].as_f64().unwrap()
        );
        fs::remove_file(out).unwrap();
        assert_eq!(bench.left_behind(), Vec::<String>::new());
    }
}

/// The study of the paper, with `changes` to it.
fn paper(bench: &Bench, changes: &[(&str, &str)]) -> PathBuf {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/paper.toml");
    let text = changes
        .iter()
        .fold(fs::read_to_string(file).unwrap(), |text, (from, to)| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        });
    bench.file("paper.toml", &text)
}

#[test]
fn the_study_of_the_paper_is_one_file() {
    let bench = Bench::new();
    paper(
        &bench,
        &[("[slicing]", "[sensor]\nheight = 48\nwidth = 64\n[slicing]")],
    );
    let evaluate = ["evaluate", "--pairs", "paper.toml", "-o", "out"];
    refused(
        &bench,
        &evaluate,
        1,
        "no pair of the study can be evaluated, as its traverses are missing: brisbane:sunset1",
    );
    // A network in the place of all of them: 64 members.
    fs::create_dir(bench.path("models")).unwrap();
    let tiny = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/models");
    let registry = fs::read_to_string(tiny.join("models.toml")).unwrap();
    let stanzas: Vec<&str> = registry.split("[[model]]").skip(1).collect();
    let of = |id: &str| {
        *stanzas
            .iter()
            .find(|s| s.contains(&format!("id = \"{id}\"")))
            .unwrap()
    };
    let named =
        |id: &str, tiny: &str| of(tiny).replace(&format!("id = \"{tiny}\""), &format!("id = \"{id}\""));
    let mut models = format!("[[model]]{}", named("e2vid", "tiny_e2vid"));
    for id in ["netvlad", "cosplace", "mixvpr", "megaloc"] {
        models += &format!("[[model]]{}", named(id, "tiny_extractor"));
    }
    bench.file("models/models.toml", &models);
    let events = bench.recording("events.txt", 3, 1);
    let graph = succeeds(
        &bench,
        &["graph", "--json", "-c", "paper.toml", "-i", text(&events)],
    );
    let graph: Value = serde_json::from_str(&graph.stdout).unwrap();
    assert_eq!(graph["members"].as_array().unwrap().len(), 64);
    // One pair is there.
    let [a, b, c, ..] = PATTERNS;
    bench.file(
        "frames.toml",
        "source.kind = \"frames\"\n[slicing]\ntick = \"1s\"\n[[reconstruction]]\nid = \"frames\"\n[[extractor]]\n\
         id = \"raw_pixels\"\nparams = { height = 4, width = 4 }\n",
    );
    fs::create_dir_all(bench.path("traverses/brisbane")).unwrap();
    for name in ["sunset1", "night"] {
        let places: Vec<(u16, u32)> = (0..40)
            .map(|t| ([a, b, c][t as usize % 3].rotate_left(t / 3), 30 * t))
            .collect();
        drive(&bench, name, &places);
        fs::rename(
            bench.path(&format!("{name}-rows")),
            bench.path("traverses/brisbane").join(name),
        )
        .unwrap();
    }
    let said = succeeds(&bench, &evaluate);
    assert_eq!(said.stderr.matches("left out: ").count(), 9, "{}", said.stderr);
    assert!(
        said.stderr
            .contains("left out: brisbane:sunset1-sunrise (traverses/brisbane/sunrise is not there)")
    );
    let rows = table(&bench.path("out/results.csv"));
    // Two methods, three lengths, one member in five kinds of ensembles.
    assert_eq!(rows.len(), 2 * 3 * 5);
    assert!(
        rows.iter()
            .all(|r| r["pair"] == "brisbane:sunset1-night" && r["queries"] == "40")
    );
    succeeds(
        &bench,
        &[&evaluate[..], &["--method", "none", "--subsets", "single"]].concat(),
    );
    assert_eq!(table(&bench.path("out/results.csv")).len(), 31);
    for (from, to, words) in [
        ("\"nsavp\"", "\"kitti\"", "--preset kitti is neither a preset"),
        (
            "tolerance_m = 25.0",
            "tolerance = 25.0",
            "[study]: unknown field `tolerance`",
        ),
        ("\"seqslam\"", "\"seqslm\"", "--method seqslm: "),
    ] {
        paper(&bench, &[(from, to)]);
        let said = bench.run(&evaluate);
        assert!(
            said.code() != 0 && said.errors().len() == 1 && said.stderr.contains(words),
            "{}",
            said.stderr
        );
    }
}
