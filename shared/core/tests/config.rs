//! The configurations of the repository: those that are good resolve, those that are not say why, word for word.
//!
//! `UPDATE_SNAPSHOTS=1 cargo test -p evpr-core` rewrites the expected messages in `tests/config/invalid`.
#![allow(clippy::panic, clippy::unwrap_used)] // helpers of tests are tests

use evpr_core::Plan;
use evpr_core::config::{Overrides, parse, registry_path, test_catalog};
use evpr_core::plan::{
    Crop, Filter, Inference, Network, PositionClock, PositionCompat, PositionKind, Positions, Provider, Rule,
    Sensor, SeqSlam, SequenceMethod, Transition, UtmZone,
};
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The TOML files of a folder, by name.
fn configurations(folder: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join(folder)).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|e| e.unwrap().path()).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "toml"));
    // Its networks are not in the catalog for tests; `evpr graph` takes it in the end-to-end tests.
    paths.retain(|p| p.file_name().is_none_or(|name| name != "paper.toml"));
    paths.sort();
    assert!(!paths.is_empty(), "no configurations in {folder}");
    paths
}

fn plan(path: &Path) -> Plan {
    let text = std::fs::read_to_string(path).unwrap();
    let config = parse(&text, &path.display().to_string(), &test_catalog()).unwrap_or_else(|e| panic!("{e}"));
    let recording = config
        .source(&Overrides::default())
        .is_none_or(|source| source.street.is_none() && source.live.is_none());
    let overrides = Overrides {
        input: recording.then(|| PathBuf::from("input.h5")),
        positions: recording.then(|| PathBuf::from("input.nmea")),
        ..Overrides::default()
    };
    let sensor = config.sensor().unwrap_or(Sensor {
        height: 260,
        width: 346,
    });
    config
        .resolve(sensor, &overrides)
        .unwrap_or_else(|e| panic!("{e}"))
}

fn named(file: &str) -> Plan {
    plan(&root().join(file))
}

fn names(plan: &Plan) -> Vec<&str> {
    plan.members.iter().map(|m| m.name.as_str()).collect()
}

#[test]
fn good_configurations_resolve() {
    for path in configurations("config")
        .iter()
        .chain(&configurations("tests/config/valid"))
    {
        let plan = plan(path);
        assert!(!plan.members.is_empty());
        assert!(plan.slicing.segments().per_tick() > 0);
    }
}

#[test]
fn minimal_has_the_defaults() {
    let plan = named("config/minimal.toml");
    assert_eq!(names(&plan), ["event_count@1s/patch_norm"]);
    assert_eq!(
        (plan.slicing.tick, plan.slicing.windows.as_slice()),
        (1_000_000_000, [1_000_000_000].as_slice())
    );
    assert_eq!(
        (plan.reconstructions[0].channels, plan.extractors[0].dim),
        (3, 1024)
    );
    assert_eq!(plan.extractors[0].params.integer("patch"), 8);
}

#[test]
fn ensemble_states_the_defaults() {
    let (minimal, ensemble) = (named("config/minimal.toml"), named("config/ensemble.toml"));
    assert_eq!(ensemble.name, minimal.name);
    assert_eq!(ensemble.source, minimal.source);
    assert_eq!(ensemble.fuse, minimal.fuse);
    assert_eq!(ensemble.extractors[0], minimal.extractors[0]);
    assert_eq!(
        (ensemble.delivery, ensemble.deadline_ns),
        (minimal.delivery, minimal.deadline_ns)
    );
    assert_eq!(
        (ensemble.slicing.align, ensemble.slicing.origin),
        (minimal.slicing.align, minimal.slicing.origin)
    );
    assert_eq!(ensemble.members.len(), 36);
    assert_eq!(ensemble.enabled_members().len(), 35);
    assert_eq!(
        &names(&ensemble)[..3],
        [
            "event_count@100ms/patch_norm",
            "event_count@100ms/raw_pixels",
            "event_count@100ms/hog",
        ]
    );
}

#[test]
fn corridor_is_the_setting_of_the_figures() {
    let plan = named("config/corridor.toml");
    assert_eq!(names(&plan), ["event_count_no_polarity@500ms/patch_norm"]);
    assert_eq!((plan.slicing.tick_id().as_str(), plan.fuse.length), ("500ms", 10));
}

#[test]
fn members_are_in_the_order_of_the_plan() {
    let plan = named("tests/config/valid/members.toml");
    assert_eq!(
        names(&plan),
        [
            "event_count@250ms/patch_norm",
            "event_count@1s/patch_norm",
            "time_surface@1s/raw_pixels",
        ]
    );
    let starts: Vec<(bool, f64)> = plan.members.iter().map(|m| (m.enabled, m.weight)).collect();
    assert_eq!(starts, [(true, 1.0), (false, 1.0), (true, 0.0)]);
    let at = |m: usize| {
        (
            plan.members[m].reconstruction,
            plan.members[m].window,
            plan.members[m].extractor,
        )
    };
    assert_eq!((at(0), at(1), at(2)), ((0, 0, 0), (0, 1, 0), (1, 1, 1)));
    assert_eq!(
        names(&named("tests/config/valid/count.toml")),
        [
            "event_count@100000ev/patch_norm",
            "event_count@1000000ev/patch_norm",
        ]
    );
}

#[test]
fn live_windows_ascend_and_parameters_arrive() {
    let plan = named("tests/config/valid/live.toml");
    assert_eq!(plan.slicing.windows, [10_000_000, 100_000_000]);
    assert_eq!(plan.reconstructions[1].params.integer("tau"), 300_000_000);
    assert_eq!(plan.extractors[0].dim, 49);
    assert_eq!((plan.deadline_ns, plan.fuse.length), (50_000_000, 1));
    assert_eq!(plan.name, "live-1");
}

#[test]
fn sequence_methods_and_rules_have_their_parameters() {
    let seqslam = named("tests/config/valid/seqslam.toml").fuse;
    let expected = SeqSlam {
        window: 30,
        velocities: [0.0, 2.0],
        velocity_steps: 3,
    };
    assert_eq!(
        (seqslam.sequence, seqslam.length, seqslam.rule),
        (
            SequenceMethod::SeqSlam(expected),
            5,
            Rule::TrimmedMean { trim: 0.1 }
        )
    );
    let filter = named("tests/config/valid/filter.toml").fuse;
    let expected = Filter {
        beta: 2.0,
        transition: Transition::new(&[0.4, 0.6]).unwrap(),
        restart: 0.1,
    };
    assert_eq!(
        (filter.sequence, filter.length, filter.rule),
        (SequenceMethod::Filter(expected), 1, Rule::Mean)
    );
    let stages = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n";
    let fuse = |keys: &str| {
        let text = format!("{stages}[fuse]\n{keys}\n");
        let config = parse(&text, "x.toml", &test_catalog()).unwrap_or_else(|e| panic!("{e}"));
        let fuse = config.fuse();
        (fuse.sequence, fuse.length, fuse.rule)
    };
    for (keys, expected) in [
        (
            "sequence.method = \"rows\"",
            (SequenceMethod::Rows, 10, Rule::Sum),
        ),
        (
            "sequence.method = \"seqslam\"",
            (SequenceMethod::SeqSlam(SeqSlam::AUTHORS), 10, Rule::Sum),
        ),
        (
            "sequence.method = \"filter\"\nrule = \"sum\"",
            (SequenceMethod::Filter(Filter::DEFAULT), 1, Rule::Sum),
        ),
        ("rule = \"median\"", (SequenceMethod::Paper, 10, Rule::Median)),
        (
            "rule = \"trimmed_mean\"",
            (SequenceMethod::Paper, 10, Rule::TrimmedMean { trim: 0.25 }),
        ),
    ] {
        assert_eq!(fuse(keys), expected, "{keys}");
    }
}

#[test]
fn networks_are_entries_of_the_registry_and_share_the_cores() {
    let plan = named("tests/config/valid/networks.toml");
    let [carry, reset] = plan.reconstructions.as_slice() else {
        panic!("{:?}", plan.reconstructions);
    };
    assert_eq!(
        (carry.kind.as_str(), carry.params.text("state")),
        ("e2vid", "carry")
    );
    assert_eq!(
        (reset.kind.as_str(), reset.params.text("state")),
        ("e2vid", "reset")
    );
    assert_eq!((carry.optional, reset.optional), (false, true));
    assert_eq!((carry.channels, carry.masks_hot_pixels), (1, true));
    // Three cores for three networks.
    let threads = |network: &Option<Network>| network.as_ref().map(|n| (n.threads, n.batch));
    assert_eq!(threads(&carry.network), Some((1, None)));
    assert_eq!(threads(&plan.extractors[0].network), Some((4, Some(8))));
    assert_eq!(
        (plan.extractors[0].dim, &plan.extractors[1].network),
        (4096, &None)
    );
    let expected = Inference {
        library: Some(PathBuf::from("/opt/libonnxruntime.so")),
        providers: vec![Provider::Cuda, Provider::Cpu],
        fallback: true,
        spinning: true,
    };
    assert_eq!(plan.inference, expected);
    // What the network is belongs to what its rows are.
    let print = plan.fingerprint(0);
    let sha256 = plan.extractors[0].network.as_ref().map(|n| &n.model.sha256);
    assert_eq!(print.get("extractor.network.sha256"), sha256);
    assert_eq!(
        print.get("extractor.network.mean").map(String::as_str),
        Some("0.485,0.456,0.406")
    );
    assert_eq!(
        print.get("reconstruction.state").map(String::as_str),
        Some("carry")
    );
    assert!(print.contains_key("reconstruction.network.sha256"), "{print:?}");
}

#[test]
fn the_registry_s_path_is_found_before_the_configuration_is_checked() {
    let text = std::fs::read_to_string(root().join("tests/config/valid/networks.toml")).unwrap();
    assert_eq!(registry_path(&text), PathBuf::from("elsewhere.toml"));
    for text in [
        "",
        "[inference]\n",
        "[inference]\nmodels = 3\n",
        "inference = 3",
        "[inference",
    ] {
        assert_eq!(registry_path(text), PathBuf::from("models/models.toml"), "{text}");
    }
}

#[test]
fn positions_are_read_as_written() {
    let plan = named("tests/config/valid/positions.toml");
    let expected = Positions {
        path: PathBuf::from("input.nmea"),
        kind: PositionKind::Nmea,
        clock: PositionClock::FirstAt(1_587_452_582_350_000_000),
        date: Some(18_373),
        zone: Some(UtmZone {
            number: 56,
            south: true,
        }),
        compat: PositionCompat::Paper,
        max_gap_ns: 2_000_000_000,
        crop: Crop::FirstLoop,
    };
    assert_eq!(plan.source.positions, Some(expected));
    let ensemble = named("config/ensemble.toml");
    assert_eq!(ensemble.source.positions, Some(Positions::file("input.nmea")));
    assert_eq!(named("tests/config/valid/street.toml").source.positions, None);
}

#[test]
fn a_plan_survives_being_handed_over() {
    for path in configurations("config")
        .iter()
        .chain(&configurations("tests/config/valid"))
    {
        let plan = plan(path);
        let text = serde_json::to_string(&plan).unwrap();
        assert_eq!(serde_json::from_str::<Plan>(&text).unwrap(), plan);
    }
}

/// The two texts, line by line: `-` expected, `+` found.
fn difference(expected: &str, found: &str) -> String {
    let (old, new): (Vec<&str>, Vec<&str>) = (expected.lines().collect(), found.lines().collect());
    let mut out = String::new();
    for line in &old {
        let mark = if new.contains(line) { ' ' } else { '-' };
        out += &format!("{mark} {line}\n");
    }
    for line in new.iter().filter(|line| !old.contains(line)) {
        out += &format!("+ {line}\n");
    }
    out
}

#[test]
fn bad_configurations_say_why() {
    let update = std::env::var_os("UPDATE_SNAPSHOTS").is_some_and(|v| v == "1");
    let mut failures = String::new();
    for path in configurations("tests/config/invalid") {
        let file = format!("config/{}", path.file_name().unwrap().to_string_lossy());
        let text = std::fs::read_to_string(&path).unwrap();
        let found = match parse(&text, &file, &test_catalog()) {
            Ok(_) => format!("{file}: accepted\n"),
            Err(errors) => format!("{errors}\n"),
        };
        let snapshot = path.with_extension("txt");
        if update {
            std::fs::write(&snapshot, &found).unwrap();
        }
        let expected = std::fs::read_to_string(&snapshot).unwrap_or_default();
        if expected != found || found.contains("accepted") {
            failures += &format!("{}:\n{}", snapshot.display(), difference(&expected, &found));
        }
    }
    assert!(
        failures.is_empty(),
        "if this is meant, run with UPDATE_SNAPSHOTS=1\n{failures}"
    );
}

#[test]
fn five_mistakes_of_different_kinds_are_all_reported() {
    let path = root().join("tests/config/invalid/five_mistakes.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let errors = parse(&text, "x.toml", &test_catalog()).unwrap_err();
    let found: Vec<(usize, &str)> = errors.errors.iter().map(|e| (e.line, e.key.as_str())).collect();
    assert_eq!(
        found,
        [
            (2, "slicing.tick"),
            (3, "slicing.windws"),
            (10, "extractor[0].params.side"),
            (13, "ensemble.disabled[0]"),
            (16, "runtime.deadline"),
        ]
    );
}
