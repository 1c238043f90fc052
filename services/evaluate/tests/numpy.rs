//! Every method and rule has the recalls that `scripts/check_evaluate.py` finds by itself.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod support;

use evpr_core::config::{RULES, SEQUENCE_METHODS, SIMILARITIES};
use evpr_evaluate::{Pair, PairSpec, Results, Spec, SubsetChoice, SubsetKind, Truth, evaluate};
use std::path::Path;
use std::process::Command;
use support::*;

/// The interpreter, where it has NumPy.
fn python(test: &str) -> Option<String> {
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = Command::new(&python).args(["-c", "import numpy"]).output();
    if !has.is_ok_and(|o| o.status.success()) {
        println!("skipped: {test}: {python} has no module numpy");
        return None;
    }
    Some(python)
}

fn everything(lengths: &[usize]) -> Spec {
    let words = SEQUENCE_METHODS.all();
    Spec {
        similarities: SIMILARITIES
            .all()
            .iter()
            .map(|w| SIMILARITIES.parse(w).unwrap())
            .collect(),
        methods: words.iter().map(|w| SEQUENCE_METHODS.parse(w).unwrap()).collect(),
        rules: RULES.all().iter().map(|w| RULES.parse(w).unwrap()).collect(),
        lengths: lengths.into(),
        ..spec()
    }
}

/// Evaluates a pair and has it recomputed.
fn agrees(python: &str, pair: &PairSpec, truth: &str, spec: &Spec, out: &Path) -> String {
    let pairs = [Pair::open(pair, &[]).unwrap()];
    let mut results = Results::open(out, &pairs).unwrap();
    evaluate(&pairs, spec, &mut results, &()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scripts/check_evaluate.py");
    let said = Command::new(python)
        .arg(script)
        .args([&pair.reference, &pair.query])
        .arg(truth)
        .arg(out.join("results.json"))
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&said.stdout).into_owned();
    let errors = String::from_utf8_lossy(&said.stderr);
    assert!(said.status.success(), "{text}{errors}");
    text
}

#[test]
fn noise_with_holes_is_as_numpy_has_it() {
    let Some(python) = python("noise_with_holes_is_as_numpy_has_it") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let pair = pair_in(folder.path());
    let spec = Spec {
        subsets: vec![
            SubsetChoice::Kind(SubsetKind::Single),
            SubsetChoice::Kind(SubsetKind::Combined),
        ],
        ..everything(&[4])
    };
    let text = agrees(&python, &pair, "positions:1.1", &spec, &folder.path().join("out"));
    // 4 similarities × 5 methods × 6 rules × 5 subsets.
    assert!(text.contains("600 rows, 0 wrong"), "{text}");
}

#[test]
fn brisbane_is_as_numpy_has_it() {
    const TEST: &str = "brisbane_is_as_numpy_has_it";
    let (Some(data), Some(python)) = (shared(TEST, "data/brisbane_7x7"), python(TEST)) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let truth = data.join("ground_truth.csv");
    let pair = brisbane(&data, folder.path());
    let spec = Spec {
        similarities: vec![SIMILARITIES.parse("l2").unwrap()],
        rules: vec![RULES.parse("sum").unwrap(), RULES.parse("mean").unwrap()],
        subsets: vec![SubsetChoice::Kind(SubsetKind::Single)],
        ..everything(&[5, 10, 20])
    };
    let text = agrees(
        &python,
        &pair,
        truth.to_str().unwrap(),
        &spec,
        &folder.path().join("out"),
    );
    assert!(text.contains("22 rows, 0 wrong"), "{text}");
    assert!(matches!(pair.truth, Truth::File { .. }));
}
