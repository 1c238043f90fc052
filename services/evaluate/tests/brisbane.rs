//! Recall on real rows: Brisbane-Event-VPR at 7×7 pixels has the figures of the method's reference.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::plan::SequenceMethod;
use evpr_evaluate::{Pair, PairSpec, Results, Spec, Truth, evaluate};
use ndarray::{Array3, Axis};
use std::path::Path;
use support::*;

/// Rows of `raw_pixels` 7×7 with `log1p`: mean 0, standard deviation 1, L2-normalised.
fn rows(path: &Path) -> Vec<Vec<f32>> {
    let images: Array3<u8> = ndarray_npy::read_npy(path).unwrap();
    let row = |image: ndarray::ArrayView2<'_, u8>| {
        let v: Vec<f64> = image.iter().map(|p| f64::from(*p).ln_1p()).collect();
        let mean = v.iter().sum::<f64>() / 49.0;
        let sigma = (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 49.0).sqrt() + 1e-6;
        let z: Vec<f64> = v.iter().map(|x| (x - mean) / sigma).collect();
        let norm = z.iter().map(|x| x * x).sum::<f64>().sqrt();
        // An image of one level has a row of zeros.
        z.iter().map(|z| (z / norm.max(1e-12)) as f32).collect()
    };
    images.axis_iter(Axis(0)).map(row).collect()
}

#[test]
fn recall_is_as_published() {
    let Some(data) = shared("recall_is_as_published", "data/brisbane_7x7") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut plan = plan();
    plan.members.truncate(1);
    plan.extractors.truncate(1);
    plan.extractors[0].dim = 49;
    for (name, file) in [("map", "reference_sunset2.npy"), ("query", "query_sunset1.npy")] {
        let rows = rows(&data.join(file));
        write(
            &plan,
            &folder.path().join(name),
            rows.len(),
            |_, t| Some(rows[t].clone()),
            |_| None,
        );
    }
    let truth = Truth::File {
        path: data.join("ground_truth.csv"),
        tolerance_frames: 0,
        orientation: None,
    };
    let pair = PairSpec::new(folder.path().join("map"), folder.path().join("query"), truth);
    let pairs = [Pair::open(&pair, &[]).unwrap()];
    let spec = Spec {
        methods: vec![SequenceMethod::None, SequenceMethod::Paper],
        lengths: vec![5, 10, 20, 30],
        subsets: vec![evpr_evaluate::SubsetChoice::Kind(
            evpr_evaluate::SubsetKind::Single,
        )],
        ..spec()
    };
    let mut results = Results::open(&folder.path().join("out"), &pairs).unwrap();
    evaluate(&pairs, &spec, &mut results, &()).unwrap();
    // Exactly, and within three places.
    for (method, length, exact, three) in [
        ("none", 1, 0.185, 0.332),
        ("paper", 5, 0.312, 0.425),
        ("paper", 10, 0.558, 0.789),
        ("paper", 20, 0.571, 0.843),
        ("paper", 30, 0.561, 0.833),
    ] {
        let row = results
            .rows()
            .iter()
            .find(|r| r.method == method && r.length == length)
            .unwrap();
        let (at, near) = (
            row.measures.recall_at[0].of_matchable,
            row.measures.by_frames[3].of_matchable,
        );
        assert!(
            (at - exact).abs() < 0.003,
            "{method} {length}: {at} instead of {exact}"
        );
        assert!(
            (near - three).abs() < 0.003,
            "{method} {length}: {near} instead of {three}"
        );
        assert_eq!((row.measures.queries, row.measures.matchable), (724, 720));
    }
}
