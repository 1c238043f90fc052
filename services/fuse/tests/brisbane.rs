//! Recall on real rows: Brisbane-Event-VPR at 7×7 pixels, compared with the figures of the method's reference.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::plan::{Filter, SequenceMethod, Similarity};
use evpr_fuse::{sequence_match, similarity::similarity};
use evpr_store::GroundTruth;
use ndarray::{Array2, Array3, ArrayView1, Axis};

/// Rows of `raw_pixels` 7×7 with `log1p`: mean 0, standard deviation 1, L2-normalised.
fn rows(path: &std::path::Path) -> Array2<f32> {
    let images: Array3<u8> = ndarray_npy::read_npy(path).unwrap();
    let mut rows = Array2::zeros((images.len_of(Axis(0)), 49));
    for (image, mut row) in images.outer_iter().zip(rows.rows_mut()) {
        let v: Vec<f64> = image.iter().map(|p| f64::from(*p).ln_1p()).collect();
        let mean = v.iter().sum::<f64>() / 49.0;
        let sigma = (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 49.0).sqrt() + 1e-6;
        let z: Vec<f64> = v.iter().map(|x| (x - mean) / sigma).collect();
        // One image is all alike: its row is 0.
        let norm = z.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
        row.iter_mut().zip(z).for_each(|(r, z)| *r = (z / norm) as f32);
    }
    rows
}

#[test]
fn recall_at_1_is_as_published() {
    let Some(folder) = support::shared("recall_at_1_is_as_published", "data/brisbane_7x7") else {
        return;
    };
    let (query, reference) = (
        rows(&folder.join("query_sunset1.npy")),
        rows(&folder.join("reference_sunset2.npy")),
    );
    let pairs = folder.join("ground_truth.csv");
    let truth = GroundTruth::from_pairs(&pairs, query.nrows(), reference.nrows()).unwrap();
    let valid = vec![true; reference.nrows()];
    let mut s = Array2::zeros((query.nrows(), reference.nrows()));
    for (q, mut out) in query.rows().into_iter().zip(s.rows_mut()) {
        let (q, r) = (q.to_slice().unwrap(), reference.as_slice().unwrap());
        similarity(Similarity::L2, q, r, &valid, out.as_slice_mut().unwrap());
    }
    let mut figures = vec![(SequenceMethod::Filter(Filter::DEFAULT), 1, 0.546, 0.917)];
    let paper = [
        (1, 0.185, 0.332),
        (5, 0.312, 0.425),
        (10, 0.558, 0.789),
        (20, 0.571, 0.843),
        (30, 0.561, 0.833),
    ];
    let rows = [
        (5, 0.536, 0.789),
        (10, 0.608, 0.872),
        (20, 0.600, 0.876),
        (30, 0.569, 0.867),
    ];
    figures.extend(paper.map(|(length, exact, near)| (SequenceMethod::Paper, length, exact, near)));
    figures.extend(rows.map(|(length, exact, near)| (SequenceMethod::Rows, length, exact, near)));
    let near = truth.widened(3).unwrap();
    for (method, length, want, want_near) in figures {
        let scores = sequence_match(s.view(), length, method);
        let best = |row: ArrayView1<'_, f64>| {
            let first_best = |best: usize, (j, v): (usize, &f64)| if *v > row[best] { j } else { best };
            row.iter().enumerate().fold(0, first_best)
        };
        let answers: Vec<Option<usize>> = scores.rows().into_iter().map(|row| Some(best(row))).collect();
        for (truth, want) in [(&truth, want), (&near, want_near)] {
            let recall = truth.recall(&answers).of_matchable();
            assert!(
                (recall - want).abs() < 0.01,
                "R@1 of {} at L = {length}: {recall:.3} instead of {want}",
                method.name()
            );
        }
    }
}
