//! What cannot be evaluated is refused in one line that says what to do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::Plan;
use evpr_core::config::SEQUENCE_METHODS;
use evpr_core::plan::Sensor;
use evpr_evaluate::{Pair, PairSpec, PairsFile, Results, Spec, Truth, evaluate};
use std::path::Path;
use support::*;

fn refused(spec: &PairSpec, members: &[&str]) -> String {
    let members: Vec<String> = members.iter().map(|m| (*m).to_owned()).collect();
    let error = Pair::open(spec, &members).unwrap_err().to_string();
    assert_eq!(error.lines().count(), 1, "{error}");
    error
}

/// A good pair whose query is written anew by another plan.
fn with_query(folder: &Path, change: impl Fn(&mut Plan)) -> PairSpec {
    let mut pair = pair_in(folder);
    let mut plan = plan();
    change(&mut plan);
    pair.query = folder.join("other");
    write(&plan, &pair.query, QUERIES, query_row, |t| Some([t as f64, 0.0]));
    pair
}

#[test]
fn ground_truth_that_does_not_fit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.csv");
    let mut pair = pair_in(folder.path());
    pair.truth = Truth::File {
        path: path.clone(),
        tolerance_frames: 0,
        orientation: None,
    };
    let error = refused(&pair, &[]);
    assert!(
        error.contains("truth.csv") && error.contains("cannot open"),
        "{error}"
    );
    for (text, words) in [
        (
            "query_id,reference_id\n0,23\n",
            "query 0 and reference 23 are not in the traverses",
        ),
        ("query_id,reference_id\nx,1\n", "line 2 is no pair"),
        ("query_id,reference_id\n", "no query has a right answer"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = refused(&pair, &[]);
        assert!(error.contains(words), "{error}");
    }
    std::fs::write(&path, "0,3\n").unwrap();
    assert_eq!(Pair::open(&pair, &[]).unwrap().truth().matches(0), [3]);
    pair.truth = Truth::File {
        path,
        tolerance_frames: 2,
        orientation: None,
    };
    assert_eq!(
        Pair::open(&pair, &[]).unwrap().truth().matches(0),
        [1, 2, 3, 4, 5]
    );
}

#[test]
fn no_labelled_queries() {
    let folder = tempfile::tempdir().unwrap();
    let mut pair = pair_in(folder.path());
    pair.truth = Truth::Positions { tolerance_m: 0.01 };
    let error = refused(&pair, &[]);
    assert!(error.contains("no query has a right answer"), "{error}");
    pair.truth = Truth::Positions { tolerance_m: -1.0 };
    assert!(refused(&pair, &[]).contains("is not a distance"));
}

#[test]
fn no_positions() {
    let folder = tempfile::tempdir().unwrap();
    let mut pair = pair_in(folder.path());
    pair.query = folder.path().join("lost");
    write(&plan(), &pair.query, QUERIES, query_row, |_| None);
    let error = refused(&pair, &[]);
    assert!(
        error.contains("the query") && error.contains("has no positions"),
        "{error}"
    );
}

#[test]
fn members_missing_in_one_of_the_traverses() {
    let folder = tempfile::tempdir().unwrap();
    let pair = with_query(folder.path(), |plan| {
        plan.members.pop();
    });
    let error = refused(&pair, &[]);
    assert!(
        error.contains("the query has no rows of b@1ms/y, which the reference has"),
        "{error}"
    );
    let swapped = PairSpec {
        reference: pair.query.clone(),
        query: pair.reference.clone(),
        ..pair.clone()
    };
    let error = refused(&swapped, &[]);
    assert!(
        error.contains("the reference has no rows of b@1ms/y, which the query has"),
        "{error}"
    );
    assert!(refused(&pair, &["*/y"]).contains("b@1ms/y"));
    let members = ["a@1ms/*".to_owned(), "b@1ms/x".to_owned()];
    assert_eq!(Pair::open(&pair, &members).unwrap().members().len(), 3);
    let error = refused(&pair, &["c@1ms/x"]);
    assert!(
        error.contains("no member is c@1ms/x; there are a@1ms/x"),
        "{error}"
    );
}

#[test]
fn other_ticks_sensor_or_parameters() {
    let folder = tempfile::tempdir().unwrap();
    type Case = (&'static str, fn(&mut Plan), &'static str);
    let cases: [Case; 3] = [
        (
            "ticks",
            |p| p.slicing.tick *= 2,
            "a tick is 1ms in the reference and 2ms in the query",
        ),
        (
            "sensor",
            |p| p.sensor = Sensor { height: 5, width: 6 },
            "the sensor is 4×6 (height × width) in the reference and 5×6",
        ),
        (
            "kind",
            |p| p.extractors[3].kind = "hog".into(),
            "extractor of member b@1ms/y is raw_pixels in the reference and hog in the query",
        ),
    ];
    for (name, change, words) in cases {
        let folder = folder.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        let error = refused(&with_query(&folder, change), &[]);
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn rows_that_are_not_finite_or_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let mut pair = pair_in(folder.path());
    let path = pair.query.join("rows/b@1ms/x.npy");
    let mut bytes = std::fs::read(&path).unwrap();
    let row = bytes.len() - (QUERIES - 9) * DIMS[2] * 4;
    bytes[row..row + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    let error = refused(&pair, &[]);
    assert!(
        error.contains("the query's row of member b@1ms/x at tick 9 is not finite"),
        "{error}"
    );
    assert!(
        Pair::open(&pair, &["a@*/*".to_owned()]).is_ok(),
        "others can be evaluated"
    );
    pair.query = folder.path().join("none");
    let row = |m: usize, t: usize| if m == 2 { None } else { query_row(m, t) };
    write(&plan(), &pair.query, QUERIES, row, |t| Some([t as f64, 0.0]));
    assert!(refused(&pair, &[]).contains("member b@1ms/x has no row in the query"));
    // The map is looked through too.
    std::mem::swap(&mut pair.reference, &mut pair.query);
    assert!(refused(&pair, &[]).contains("member b@1ms/x has no row in the reference"));
}

#[test]
fn no_traverse() {
    let folder = tempfile::tempdir().unwrap();
    let mut pair = pair_in(folder.path());
    pair.reference = folder.path().join("nowhere");
    assert!(refused(&pair, &[]).contains("there is no such traverse"));
}

#[test]
fn files_of_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pairs.toml");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        PairsFile::read(&path).map_err(|e| e.to_string())
    };
    let good = "[[pair]]\nreference = \"m\"\nquery = \"n\"\nground_truth = \"positions\"\n";
    let file = read(&format!("{good}[subsets]\nfast = [\"a@*/x\"]\n")).unwrap();
    assert_eq!(file.pairs[0].name, "m-n");
    assert_eq!(file.pairs[0].reference, folder.path().join("m"));
    assert_eq!(file.pairs[0].truth, Truth::Positions { tolerance_m: 25.0 });
    assert_eq!(file.subsets["fast"], ["a@*/x"]);
    let twice = format!("{good}{good}");
    let file_and_metres = good.replace("positions", "g.csv") + "tolerance_m = 3.0\n";
    for (text, words) in [
        ("", "it has no pair"),
        (twice.as_str(), "another pair has this name"),
        (file_and_metres.as_str(), "the tolerance is tolerance_frames"),
        ("[[pair]]\nreference = 3\n", "reference"),
        (&format!("{good}colour = 3\n"), "unknown field `colour`"),
        (&format!("{good}name = \"a|b\"\n"), "has no |"),
    ] {
        let error = read(text).unwrap_err();
        assert!(error.contains(words) && error.lines().count() == 1, "{error}");
    }
}

#[test]
fn a_map_that_is_too_short_for_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let pair = [open(&pair_in(folder.path()))];
    let spec = Spec {
        methods: vec![SEQUENCE_METHODS.parse("seqslam").unwrap()],
        lengths: vec![REFERENCES + 1],
        ..spec()
    };
    let mut results = Results::open(&folder.path().join("out"), &pair).unwrap();
    let error = evaluate(&pair, &spec, &mut results, &()).unwrap_err().to_string();
    assert!(
        error.contains("its map has 23 ticks, fewer than the 24 of"),
        "{error}"
    );
}
