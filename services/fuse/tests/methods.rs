//! The methods beside the paper's, and the rules beside the sum, against the golden arrays of
//! scripts/make_fuse_golden.py.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::plan::{Filter, Rule, SeqSlam, SequenceMethod, Transition};
use evpr_fuse::ensemble::{Ensemble, Part};
use evpr_fuse::{SequenceMatcher, sequence_match};
use ndarray::{Array1, Array2, Array3, Axis};
use support::{assert_close, golden};

fn read<T: ndarray_npy::ReadableElement, D: ndarray::Dimension>(name: &str) -> ndarray::Array<T, D> {
    ndarray_npy::read_npy(golden(name)).unwrap()
}

/// Per golden array: its name, and the cases in it.
fn cases() -> [(&'static str, Vec<(SequenceMethod, usize)>); 3] {
    let rows = [1, 2, 10].map(|length| (SequenceMethod::Rows, length));
    let authors = SequenceMethod::SeqSlam(SeqSlam::AUTHORS);
    let slow = SequenceMethod::SeqSlam(SeqSlam {
        window: 6,
        velocities: [0.0, 2.0],
        velocity_steps: 3,
    });
    let filter = SequenceMethod::Filter(Filter {
        beta: 0.5,
        transition: Transition::new(&[0.0, 1.0]).unwrap(),
        restart: 0.2,
    });
    [
        ("rows", rows.to_vec()),
        (
            "seqslam",
            vec![(authors, 1), (authors, 5), (authors, 10), (slow, 4)],
        ),
        (
            "filter",
            vec![(SequenceMethod::Filter(Filter::DEFAULT), 1), (filter, 1)],
        ),
    ]
}

/// As [`assert_close`], where −∞ equals −∞.
fn assert_same(got: &Array2<f64>, want: &Array2<f64>, what: &str) {
    let finite = |a: &Array2<f64>| a.mapv(|v| if v == f64::NEG_INFINITY { -1e300 } else { v });
    assert_close(&finite(got).into_dyn(), &finite(want).into_dyn(), what);
}

#[test]
fn whole_matrices() {
    for references in [7, 100] {
        let s: Array2<f64> = read(&format!("seq_{references}_s"));
        for (name, cases) in cases() {
            let want: Array3<f64> = read(&format!("{name}_{references}"));
            assert_eq!(want.len_of(Axis(0)), cases.len());
            for ((method, length), want) in cases.into_iter().zip(want.outer_iter()) {
                let got = sequence_match(s.view(), length, method);
                let what = format!("{method:?}, R = {references}, L = {length}");
                assert_same(&got, &want.to_owned(), &what);
            }
        }
    }
}

#[test]
fn holes_in_queries_and_map() {
    for references in [7, 100] {
        let s: Array2<f64> = read(&format!("seq_{references}_s"));
        let present: Array1<bool> = read(&format!("masked_{references}_present"));
        let valid: Array1<bool> = read(&format!("masked_{references}_valid"));
        let valid = valid.to_vec();
        for (name, cases) in cases() {
            let want: Array3<f64> = read(&format!("masked_{name}_{references}"));
            for ((method, length), want) in cases.into_iter().zip(want.outer_iter()) {
                let mut matcher = SequenceMatcher::new(method, length, &valid);
                let mut ensemble = Ensemble::new(references, 1, 0);
                if let SequenceMethod::Filter(filter) = method {
                    ensemble = ensemble.with_filter(filter);
                }
                let mut got = Array2::zeros(s.dim());
                for (t, row) in s.rows().into_iter().enumerate() {
                    matcher.push(present[t].then(|| row.as_slice().unwrap()));
                    let mut scores = vec![0.0; references];
                    assert_eq!(matcher.score(&mut scores), present[t]);
                    if ensemble.remembers() {
                        let part = Part {
                            scores: &scores,
                            valid: &valid,
                            weight: 1.0,
                        };
                        ensemble.fuse(present[t].then_some(part).into_iter());
                        scores.copy_from_slice(ensemble.fused());
                    }
                    got.row_mut(t).assign(&Array1::from(scores));
                }
                let what = format!("{method:?} with holes, R = {references}, L = {length}");
                assert_same(&got, &want.to_owned(), &what);
            }
        }
    }
}

#[test]
fn histories_that_are_long_enough() {
    let authors = SequenceMethod::SeqSlam(SeqSlam::AUTHORS);
    let filter = SequenceMethod::Filter(Filter::DEFAULT);
    for (method, length, want) in [
        (SequenceMethod::Paper, 3, [false, false, true, false, false]),
        (SequenceMethod::Paper, 1, [true; 5]),
        (SequenceMethod::Rows, 3, [true; 5]),
        (authors, 3, [false, false, true, true, true]),
        (authors, 1, [true; 5]),
        (filter, 3, [true; 5]),
        (SequenceMethod::None, 3, [true; 5]),
    ] {
        let mut matcher = SequenceMatcher::new(method, length, &[true; 9]);
        let got = [true, false, true, false, false].map(|present| {
            matcher.push(present.then_some(&[0.5; 9][..]));
            matcher.has_history()
        });
        // Nothing is asked of a tick without a row.
        for tick in [0, 2] {
            assert_eq!(got[tick], want[tick], "{method:?} {length} at {tick}");
        }
    }
}

const RULES: [Rule; 5] = [
    Rule::Mean,
    Rule::Max,
    Rule::Median,
    Rule::Product,
    Rule::TrimmedMean { trim: 0.25 },
];

/// E of the golden scores.
fn fused(rule: Rule, weights: &[f64], valid: &Array2<bool>) -> Array1<f64> {
    let scores: Array2<f64> = read("rule_scores");
    let parts = scores
        .rows()
        .into_iter()
        .zip(valid.rows())
        .zip(weights)
        .map(|((scores, valid), weight)| Part {
            scores: scores.to_slice().unwrap(),
            valid: valid.to_slice().unwrap(),
            weight: *weight,
        });
    let mut ensemble = Ensemble::new(scores.ncols(), 3, 0).with_rule(rule);
    let best = ensemble.fuse(parts.collect::<Vec<_>>().into_iter()).unwrap();
    let fused = Array1::from(ensemble.fused().to_vec());
    let eligible = |j: usize| valid.column(j).iter().any(|v| *v);
    let highest = (0..fused.len())
        .filter(|j| eligible(*j))
        .fold(usize::MAX, |best, j| match best {
            usize::MAX => j,
            best if fused[j] > fused[best] => j,
            best => best,
        });
    assert_eq!(best.reference, highest, "{rule:?}");
    fused
}

#[test]
fn rules_with_equal_weights() {
    for rule in RULES {
        let want: Array1<f64> = read(&format!("rule_{}", rule.name()));
        let got = fused(rule, &[1.0; 6], &Array2::from_elem((6, want.len()), true));
        assert_close(&got.into_dyn(), &want.into_dyn(), rule.name());
    }
}

#[test]
fn rules_with_weights_and_holes() {
    let (valid, weights): (Array2<bool>, Array1<f64>) = (read("rule_valid"), read("rule_weights"));
    for rule in RULES {
        let want: Array1<f64> = read(&format!("masked_rule_{}", rule.name()));
        let got = fused(rule, weights.as_slice().unwrap(), &valid);
        assert_close(&got.into_dyn(), &want.into_dyn(), rule.name());
    }
}
