//! Similarity and sequence matching against the golden arrays of scripts/make_fuse_golden.py.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::plan::{SequenceMethod, Similarity};
use evpr_fuse::{SequenceMatcher, sequence_match, similarity::similarity};
use ndarray::{Array1, Array2, Array3, Axis, s};
use support::{assert_close, golden};

fn read<T: ndarray_npy::ReadableElement, D: ndarray::Dimension>(name: &str) -> ndarray::Array<T, D> {
    ndarray_npy::read_npy(golden(name)).unwrap()
}

#[test]
fn similarity_of_four_kinds() {
    let (q, r): (Array2<f32>, Array2<f32>) = (read("q"), read("r"));
    for (kind, name) in [
        (Similarity::L2, "l2"),
        (Similarity::L2Squared, "l2_squared"),
        (Similarity::Cosine, "cosine"),
        (Similarity::Sad, "sad"),
    ] {
        let want: Array2<f64> = read(&format!("similarity_{name}"));
        for (query, want) in q.rows().into_iter().zip(want.rows()) {
            let mut got = vec![0.0; want.len()];
            let valid = vec![true; want.len()];
            similarity(
                kind,
                query.as_slice().unwrap(),
                r.as_slice().unwrap(),
                &valid,
                &mut got,
            );
            for (g, w) in got.iter().zip(want) {
                assert!((g - w).abs() <= 1e-5 * w.abs(), "{name}: {g} instead of {w}");
            }
        }
    }
}

#[test]
fn sequences_of_any_length_and_map() {
    for references in [1, 2, 7, 100] {
        let s: Array2<f64> = read(&format!("seq_{references}_s"));
        let want: Array3<f64> = read(&format!("seq_{references}"));
        for (k, length) in [2, 10, 30].into_iter().enumerate() {
            let got = sequence_match(s.view(), length, SequenceMethod::Paper);
            let what = format!("R = {references}, L = {length}");
            assert_close(
                &got.into_dyn(),
                &want.index_axis(Axis(0), k).to_owned().into_dyn(),
                &what,
            );
        }
        assert_eq!(sequence_match(s.view(), 1, SequenceMethod::Paper), s);
        assert_eq!(sequence_match(s.view(), 10, SequenceMethod::None), s);
    }
}

#[test]
fn the_first_tick_alone_scores_zero() {
    let s: Array2<f64> = read("seq_7_s");
    let got = sequence_match(s.view(), 10, SequenceMethod::Paper);
    assert!(got.slice(s![0, ..]).iter().all(|v| *v == 0.0));
    assert!(got.slice(s![1, ..]).iter().any(|v| *v != 0.0));
}

#[test]
fn holes_in_queries_and_map() {
    for (references, lengths) in [(7, vec![1, 2, 10, 30]), (100, vec![1, 10])] {
        let s: Array2<f64> = read(&format!("seq_{references}_s"));
        let present: Array1<bool> = read(&format!("masked_{references}_present"));
        let valid: Array1<bool> = read(&format!("masked_{references}_valid"));
        let want: Array3<f64> = read(&format!("masked_{references}"));
        assert!(
            present.iter().any(|p| !p) && valid.iter().any(|v| !v),
            "there are holes to see"
        );
        for (k, length) in lengths.into_iter().enumerate() {
            let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, length, valid.as_slice().unwrap());
            let mut got = Array2::zeros(s.dim());
            for (t, row) in s.rows().into_iter().enumerate() {
                matcher.push(present[t].then(|| row.as_slice().unwrap()));
                let out = got.row_mut(t).into_slice().unwrap();
                assert_eq!(matcher.score(out), present[t]);
            }
            let what = format!("with holes, R = {references}, L = {length}");
            assert_close(
                &got.into_dyn(),
                &want.index_axis(Axis(0), k).to_owned().into_dyn(),
                &what,
            );
        }
    }
}
