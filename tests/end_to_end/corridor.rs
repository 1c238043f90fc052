//! Real recordings: an indoor route that was walked twice. The figures are those of an independent implementation.

use crate::members::{assert_as_offline, switch};
use crate::support::{Bench, Running, assert_ticks, read_answers, shared_data, text};
use evpr_core::config::{self, Overrides};
use evpr_core::message::FuseSettings;
use evpr_core::plan::{Catalog, Models, Sensor};
use evpr_core::{MemberSet, Plan};
use evpr_fuse::{Map, offline};
use evpr_store::{GroundTruth, Traverse};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const REFERENCE: &str = "data/corridor/reference_events.h5";
const QUERY: &str = "data/corridor/query_events.h5";
/// Whole ticks of 0.5 s in the query, which is 149.9998 s long.
const QUERY_TICKS: u64 = 299;

/// The method that the known figures are of.
const METHOD: &str = "event_count_no_polarity";

/// A configuration for the corridor, with the paper's matching.
fn config(windows: &str, methods: &[&str], members: &str, length: usize) -> String {
    let sequence = format!("sequence = {{ method = \"paper\", length = {length} }}");
    config_with(windows, methods, members, &sequence)
}

/// A configuration for the corridor; `fuse` is what stands in that section.
fn config_with(windows: &str, methods: &[&str], members: &str, fuse: &str) -> String {
    let methods: String = methods
        .iter()
        .map(|id| format!("[[reconstruction]]\nid = \"{id}\"\n"))
        .collect();
    format!(
        "[slicing]\ntick = \"500ms\"\nwindows = {windows}\n{methods}\
         [[extractor]]\nid = \"patch_norm\"\n[[extractor]]\nid = \"raw_pixels\"\n\
         [ensemble]\nmembers = {members}\n\
         [fuse]\n{fuse}\n"
    )
}

fn succeeds(bench: &Bench, args: &[&str]) -> String {
    println!("evpr {}", args.join(" "));
    let said = bench.run(args);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
    said.stdout
}

/// A bench with `all.toml` and the map `map` made by it, and the path of the query.
fn mapped(test: &str, all: &str) -> Option<(Bench, PathBuf)> {
    let (reference, query) = (shared_data(test, REFERENCE)?, shared_data(test, QUERY)?);
    let bench = Bench::new();
    bench.file("all.toml", all);
    succeeds(
        &bench,
        &[
            "map",
            "build",
            "-q",
            "-c",
            "all.toml",
            "-i",
            text(&reference),
            "-o",
            "map",
        ],
    );
    Some((bench, query))
}

/// The map's tick that each of these answers names.
fn references(answers: &[Value]) -> Vec<Option<usize>> {
    let reference = |answer: &Value| answer["reference"].as_u64().map(|reference| reference as usize);
    answers.iter().map(reference).collect()
}

#[test]
fn the_route_is_recognised_as_often_as_by_the_reference_implementation() {
    const TEST: &str = "the_route_is_recognised_as_often_as_by_the_reference_implementation";
    let Some(truth) = shared_data(TEST, "data/corridor/ground_truth.csv") else {
        return;
    };
    let Some((bench, query)) = mapped(TEST, &config("[\"500ms\"]", &[METHOD], "\"all\"", 10)) else {
        return;
    };
    let map = Traverse::open(&bench.path("map")).unwrap();
    // It knows the last tick too, which is not whole.
    let truth = GroundTruth::from_pairs(&truth, QUERY_TICKS as usize + 1, map.len()).unwrap();
    let paper = |length: usize| format!("{{ method = \"paper\", length = {length} }}");
    let rows = |length: usize| format!("{{ method = \"rows\", length = {length} }}");
    let filter = "{ method = \"filter\" }".to_owned();
    for (extractor, sequence, known) in [
        ("patch_norm", paper(1), 0.903),
        ("patch_norm", paper(10), 0.490),
        ("patch_norm", paper(20), 0.663),
        ("patch_norm", rows(5), 0.937),
        ("patch_norm", rows(10), 0.873),
        ("patch_norm", rows(20), 0.760),
        ("patch_norm", rows(30), 0.677),
        ("patch_norm", filter.clone(), 0.917),
        ("raw_pixels", paper(1), 0.870),
        ("raw_pixels", paper(10), 0.520),
        ("raw_pixels", paper(20), 0.620),
        ("raw_pixels", rows(5), 0.897),
        ("raw_pixels", rows(30), 0.687),
        ("raw_pixels", filter, 0.890),
    ] {
        let member = format!("{METHOD}@500ms/{extractor}");
        let fuse = format!("sequence = {sequence}");
        bench.file(
            "one.toml",
            &config_with("[\"500ms\"]", &[METHOD], &format!("[\"{member}\"]"), &fuse),
        );
        let run = [
            "run",
            "-q",
            "-c",
            "one.toml",
            "-i",
            text(&query),
            "-m",
            "map",
            "-o",
            "answers.jsonl",
        ];
        succeeds(&bench, &run);
        let answers = read_answers(&bench.path("answers.jsonl"));
        assert_ticks(&answers, QUERY_TICKS);
        assert!(
            answers
                .iter()
                .all(|a| a["members"] == serde_json::json!([member]))
        );
        let recall = truth.recall(&references(&answers)).right as f64 / QUERY_TICKS as f64;
        println!("{extractor}, {sequence}: R@1 {recall:.4}, known {known}");
        assert!(
            (recall - known).abs() <= 0.01,
            "{extractor}, {sequence}: R@1 {recall}, known {known}"
        );
    }
}

#[test]
fn how_the_stream_is_cut_into_chunks_changes_no_row() {
    const TEST: &str = "how_the_stream_is_cut_into_chunks_changes_no_row";
    let Some(query) = shared_data(TEST, QUERY) else {
        return;
    };
    let bench = Bench::new();
    let methods = [METHOD, "event_count", "time_surface"];
    bench.file(
        "all.toml",
        &config("[\"100ms\", \"250ms\", \"500ms\"]", &methods, "\"all\"", 10),
    );
    let record = ["run", "-q", "-c", "all.toml", "-i", text(&query), "-r"];
    // Paced, a chunk holds at most 10 ms of wall time: 0.4 s of the recording.
    for (pace, name) in [("unpaced", "whole"), ("40", "cut")] {
        succeeds(&bench, &[&record[..], &[name, "--pace", pace]].concat());
        succeeds(&bench, &["map", "verify", name]);
    }
    assert_eq!(
        fs::read(bench.path("whole/ticks.csv")).unwrap(),
        fs::read(bench.path("cut/ticks.csv")).unwrap()
    );
    let traverse = Traverse::open(&bench.path("whole")).unwrap();
    assert_eq!(traverse.len() as u64, QUERY_TICKS);
    assert_eq!(traverse.manifest().members.len(), 18);
    for member in &traverse.manifest().members {
        for ending in ["npy", "present.npy"] {
            let file =
                |name: &str| fs::read(bench.path(&format!("{name}/rows/{}.{ending}", member.name))).unwrap();
            assert!(file("whole") == file("cut"), "{}.{ending}", member.name);
        }
        assert_eq!(member.present, QUERY_TICKS, "{}", member.name);
    }
}

fn plan(bench: &Bench, map: &Path) -> Plan {
    let catalog = Catalog {
        reconstructions: &evpr_reconstruct::KINDS,
        extractors: &evpr_extract::KINDS,
        models: Models::NONE,
        cores: 2,
    };
    let text = fs::read_to_string(bench.path("all.toml")).unwrap();
    let config = config::parse(&text, "all.toml", &catalog).unwrap();
    let input = Some(PathBuf::from("query.h5"));
    let overrides = Overrides {
        input,
        map: Some(map.to_owned()),
        ..Overrides::default()
    };
    config
        .resolve(
            Sensor {
                height: 128,
                width: 128,
            },
            &overrides,
        )
        .unwrap()
}

#[test]
fn recorded_rows_matched_offline_give_the_answers_of_the_running_graph() {
    const TEST: &str = "recorded_rows_matched_offline_give_the_answers_of_the_running_graph";
    let weights = format!(
        "[ensemble.weights]\n\"{METHOD}@500ms/patch_norm\" = 2.5\n\"time_surface@100ms/raw_pixels\" = 0.25\n"
    );
    let all = |fuse: &str| {
        config_with(
            "[\"100ms\", \"500ms\"]",
            &[METHOD, "time_surface"],
            "\"all\"",
            fuse,
        ) + &weights
    };
    let fuses = [
        "sequence = { method = \"paper\", length = 10 }",
        "sequence = { method = \"filter\" }",
        "sequence = { method = \"seqslam\", length = 8 }\nrule = \"trimmed_mean\"",
        "sequence = { method = \"rows\", length = 5 }\nrule = \"product\"",
        "sequence = { method = \"none\" }\nrule = \"median\"",
    ];
    let Some((bench, query)) = mapped(TEST, &all(fuses[0])) else {
        return;
    };
    for fuse in fuses {
        bench.file("all.toml", &all(fuse));
        recorded_rows_give_the_answers(&bench, &query);
        fs::remove_dir_all(bench.path("recorded")).unwrap();
    }
}

/// Runs `all.toml` with the map, and compares its answers with those of the rows it recorded.
fn recorded_rows_give_the_answers(bench: &Bench, query: &Path) {
    let run = [
        "run",
        "-q",
        "-c",
        "all.toml",
        "-i",
        text(query),
        "-m",
        "map",
        "-r",
        "recorded",
        "-o",
        "answers.jsonl",
    ];
    succeeds(bench, &run);
    let answers = read_answers(&bench.path("answers.jsonl"));
    assert_ticks(&answers, QUERY_TICKS);
    let plan = plan(bench, &bench.path("map"));
    let query = offline::Query::open(&plan, &bench.path("recorded")).unwrap();
    let everyone = |_| (0..plan.members.len()).collect();
    let expected = offline::answers(&plan, Map::open(&plan).unwrap(), &query, everyone).unwrap();
    assert_eq!(expected.len(), answers.len());
    let close = |value: &Value, wanted: f64| {
        (value.as_f64().unwrap() - wanted).abs() <= 1e-12 * wanted.abs().max(1.0)
    };
    for ((header, candidates), answer) in expected.iter().zip(&answers) {
        assert_eq!(answer["members"].as_array().unwrap().len(), 8, "{answer}");
        let reference = u64::try_from(header.reference).ok();
        assert_eq!(answer["reference"].as_u64(), reference, "{answer}");
        let Some(_) = reference else { continue };
        assert!(
            close(&answer["score"], header.score),
            "{} against {answer}",
            header.score
        );
        assert!(
            close(&answer["confidence"], header.confidence),
            "{} against {answer}",
            header.confidence
        );
        let top = answer["top"].as_array().unwrap();
        assert_eq!(top.len(), candidates.len());
        for (place, candidate) in top.iter().zip(candidates) {
            assert_eq!(place["reference"], candidate.reference);
            assert!(close(&place["score"], candidate.score));
        }
    }
    assert!(answers.iter().filter(|a| a["reference"].is_u64()).count() as u64 >= QUERY_TICKS - 7);
}

/// Runs a script of the oracle's, in the bench's folder, and gives what it prints. None, with a note that names the
/// test, without the oracle or without Python and what it imports.
fn oracle(test: &str, bench: &Bench, script: &str, args: &[&str]) -> Option<String> {
    let path = shared_data(test, "oracle/oracle.py")?;
    let python = || {
        let mut command = Command::new("python3");
        command
            .env("PYTHONPATH", path.parent().unwrap())
            .env("PYTHONDONTWRITEBYTECODE", "1");
        command.current_dir(bench.folder.path());
        command
    };
    let imports = python().args(["-c", "import numpy, h5py"]).output();
    if !imports.is_ok_and(|output| output.status.success()) {
        println!("skipped: {test}: python3 with numpy and h5py is absent");
        return None;
    }
    let output = python()
        .args(["-c", &format!("import numpy as np, h5py, oracle, sys\n{script}")])
        .args(args)
        .output();
    let output = output.unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    Some(String::from_utf8(output.stdout).unwrap())
}

/// Frames of each tick's first 250 ms, counted straight from the columns of the file, against the array in `argv[3]`;
/// prints how many frames there are and how many pixels differ.
const COMPARE_FRAMES: &str = "
e = h5py.File(sys.argv[1])['events']; method = sys.argv[2]; mine = np.load(sys.argv[3])
t = e['timestamps'][:].astype(np.int64); x = e['x_coordinates'][:]; y = e['y_coordinates'][:]
p = (e['polarities'][:] > 0).astype(np.uint8); k = 0; differ = 0; tick = 500_000_000
while t[0]+(k+1)*tick <= t[-1]:
    a, b = np.searchsorted(t, [t[0]+k*tick, t[0]+k*tick+250_000_000]); s = slice(a, b)
    if method == 'event_count': f = oracle.event_count(x[s], y[s], p[s], 128, 128)
    elif method == 'time_surface':
        us = t[s]//1000; f = oracle.time_surface(x[s], y[s], (us-us[0])/1e6, p[s], 128, 128)
    else: f = oracle.event_count_no_polarity(x[s], y[s], 128, 128)
    differ += int((f != mine[k]).sum()); k += 1
assert mine.dtype == np.uint8 and len(mine) == k, (mine.shape, k)
print(k, differ)
";

/// Rows of the members with the array's frames against the recorded ones; prints the largest difference.
const COMPARE_ROWS: &str = "
mine = np.load(sys.argv[1]); worst = 0
for name, row in ('patch_norm', oracle.patch_norm), ('raw_pixels', oracle.raw_pixels):
    recorded = np.load(f'recorded/rows/{sys.argv[2]}@250ms/{name}.npy')
    assert len(recorded) == len(mine)
    worst = max(worst, *(np.abs(row(f)-r).max() for f, r in zip(mine, recorded)))
print(worst)
";

#[test]
fn members_go_off_and_on_in_a_paced_replay_of_the_corridor() {
    const TEST: &str = "members_go_off_and_on_in_a_paced_replay_of_the_corridor";
    let all = config("[\"250ms\", \"500ms\"]", &[METHOD, "time_surface"], "\"all\"", 10);
    let Some((bench, query)) = mapped(TEST, &all) else {
        return;
    };
    let record = [
        "run",
        "-q",
        "-c",
        "all.toml",
        "-i",
        text(&query),
        "-r",
        "recorded",
    ];
    succeeds(&bench, &record);
    let plan = plan(&bench, &bench.path("map"));
    let args = [
        "run",
        "-q",
        "-c",
        "all.toml",
        "-i",
        text(&query),
        "-m",
        "map",
        "--pace",
        "12",
    ];
    let mut running = Running::start(&bench, &args);
    let mut off = Vec::new();
    for (index, member) in plan.members.iter().enumerate() {
        assert!(running.read_to(20 * (index as u64 + 1)));
        let from = switch(&bench, "disable", &member.name);
        assert!(running.read_to(from + 4));
        off.push((index, from..switch(&bench, "enable", &member.name)));
    }
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, QUERY_TICKS);
    let enabled = |tick: u64| -> MemberSet {
        let is_off = |m: usize| {
            off.iter()
                .any(|(index, ticks)| *index == m && ticks.contains(&tick))
        };
        (0..plan.members.len()).filter(|m| !is_off(*m)).collect()
    };
    assert_as_offline(&plan, &bench.path("recorded"), &answers, &enabled, |_| {
        FuseSettings::default()
    });
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn frames_are_the_oracles_and_those_of_the_running_graph() {
    const TEST: &str = "frames_are_the_oracles_and_those_of_the_running_graph";
    let Some(query) = shared_data(TEST, QUERY) else {
        return;
    };
    let bench = Bench::new();
    let methods = [METHOD, "event_count", "time_surface"];
    bench.file("all.toml", &config("[\"250ms\"]", &methods, "\"all\"", 10));
    succeeds(
        &bench,
        &[
            "run",
            "-q",
            "-c",
            "all.toml",
            "-i",
            text(&query),
            "-r",
            "recorded",
        ],
    );
    for method in methods {
        let frames = ["-m", method, "-w", "250ms", "-t", "500ms", "-o", "frames.npy"];
        succeeds(
            &bench,
            &[&["events", "reconstruct", text(&query)], &frames[..]].concat(),
        );
        let args = [text(&query), method, "frames.npy"];
        let Some(printed) = oracle(TEST, &bench, COMPARE_FRAMES, &args) else {
            return;
        };
        assert_eq!(
            printed.trim(),
            format!("{QUERY_TICKS} 0"),
            "{method}: frames, pixels that differ"
        );
        let printed = oracle(TEST, &bench, COMPARE_ROWS, &["frames.npy", method]).unwrap();
        let worst: f64 = printed.trim().parse().unwrap();
        assert!(worst <= 1e-6, "{method}: a row differs by {worst}");
    }
}

/// Similarities with columns that are constant or nearly so, on both sides of the threshold.
const MAKE_SIMILARITIES: &str = "
for n, r in enumerate((1, 7, 5000)):
    s = -np.random.default_rng(n).gamma(3, .4, (45, r))
    if r > 1:
        s[:, ::5] = s[0, ::5]; s[:, 1] = -1; s[:, 3] = -1+2e-5*s[:, 3]; s[:, 4] = -1+1e-2*s[:, 4]
    np.save(f'similarity_{r}.npy', s); np.save(f'similarity_f32_{r}.npy', s.astype(np.float32))
";

/// Similarities that the oracle's loops can do; prints "made" where scipy is there.
const MAKE_SMALL_SIMILARITY: &str = "
import importlib.util
np.save('small.npy', -np.random.default_rng(5).gamma(3, .4, (30, 90)))
print('made' if importlib.util.find_spec('scipy') else 'no scipy')
";

/// Prints the largest difference between the oracle and each of the matched arrays.
const COMPARE_MATCHED: &str = "
for name in sys.argv[1:]:
    similarity, length = name.rsplit('-', 1); s = np.load(similarity+'.npy').astype(np.float64)
    mine = np.load(name+'.npy')
    if length.startswith('rows'): wanted = oracle.rows(s, int(length[4:]))
    elif length == 'filter': wanted = oracle.forward_filter(oracle.row_z(s))
    elif length == 'seqslam': wanted = oracle.seqslam(s, 5)
    else: wanted = oracle.seq_match(s, int(length))
    assert mine.dtype == np.float64 and mine.shape == wanted.shape, name
    assert (np.isneginf(mine) == np.isneginf(wanted)).all(), name
    print(name, np.abs(np.where(np.isneginf(wanted), 0, mine-wanted)).max())
";

#[test]
fn the_matcher_alone_is_the_oracles() {
    const TEST: &str = "the_matcher_alone_is_the_oracles";
    let bench = Bench::new();
    if oracle(TEST, &bench, MAKE_SIMILARITIES, &[]).is_none() {
        return;
    }
    let mut matched = Vec::new();
    for similarity in ["1", "f32_1", "7", "f32_7", "5000", "f32_5000"].map(|s| format!("similarity_{s}")) {
        for length in ["1", "2", "10", "30"] {
            let name = format!("{similarity}-{length}");
            let (from, to) = (format!("{similarity}.npy"), format!("{name}.npy"));
            succeeds(&bench, &["sequence-match", "-s", &from, "-l", length, "-o", &to]);
            matched.push(name);
        }
        for (method, length, name) in [
            ("rows", "1", "rows1"),
            ("rows", "10", "rows10"),
            ("filter", "1", "filter"),
        ] {
            let name = format!("{similarity}-{name}");
            let (from, to) = (format!("{similarity}.npy"), format!("{name}.npy"));
            let args = [
                "sequence-match",
                "-s",
                &from,
                "-m",
                method,
                "-l",
                length,
                "-o",
                &to,
            ];
            succeeds(&bench, &args);
            matched.push(name);
        }
    }
    // The oracle's seqslam takes scipy, and a map of at least four references.
    if oracle(TEST, &bench, MAKE_SMALL_SIMILARITY, &[]).unwrap().trim() == "made" {
        let args = ["-m", "seqslam", "-l", "5", "-o", "small-seqslam.npy"];
        succeeds(
            &bench,
            &[&["sequence-match", "-s", "small.npy"][..], &args].concat(),
        );
        matched.push("small-seqslam".to_owned());
    } else {
        println!("skipped: seqslam in {TEST}: scipy is absent");
    }
    let names: Vec<&str> = matched.iter().map(String::as_str).collect();
    let printed = oracle(TEST, &bench, COMPARE_MATCHED, &names).unwrap();
    assert_eq!(printed.lines().count(), names.len());
    println!("{printed}");
    for line in printed.lines() {
        let worst: f64 = line.rsplit(' ').next().unwrap().parse().unwrap();
        assert!(worst <= 1e-6, "{line}");
    }
}
