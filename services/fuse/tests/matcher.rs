//! Properties of the sequence matcher, against a plain transcription of the formula.
#![allow(clippy::unwrap_used, clippy::panic)]

use evpr_core::plan::SequenceMethod;
use evpr_fuse::{SequenceMatcher, sequence_match};
use ndarray::Array2;
use proptest::prelude::*;

/// One score row by the definition, one number at a time.
fn by_definition(
    s: &[Vec<f64>],
    present: &[bool],
    valid: &[bool],
    length: usize,
    q: usize,
) -> Option<Vec<f64>> {
    if !present[q] || !valid.contains(&true) {
        return None;
    }
    let columns: Vec<usize> = (0..valid.len()).filter(|j| valid[*j]).collect();
    if length == 1 {
        let mean = columns.iter().map(|j| s[q][*j]).sum::<f64>() / columns.len() as f64;
        return Some(
            (0..valid.len())
                .map(|j| if valid[j] { s[q][j] } else { mean })
                .collect(),
        );
    }
    let ticks: Vec<usize> = (q.saturating_sub(length - 1)..=q)
        .filter(|t| present[*t])
        .collect();
    let mean_and_sigma = |v: &[f64]| {
        let mean = v.iter().sum::<f64>() / v.len() as f64;
        let variance = v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / v.len() as f64;
        (mean, variance.sqrt() + 1e-8)
    };
    let mut z: Vec<Vec<f64>> = ticks
        .iter()
        .map(|t| columns.iter().map(|j| s[*t][*j]).collect())
        .collect();
    for k in 0..columns.len() {
        let (mean, sigma) = mean_and_sigma(&z.iter().map(|row| row[k]).collect::<Vec<_>>());
        let sigma = if sigma < 1e-4 { 1.0 } else { sigma };
        z.iter_mut().for_each(|row| row[k] = (row[k] - mean) / sigma);
    }
    let mut out = vec![0.0; valid.len()];
    for (t, row) in ticks.iter().zip(&z) {
        let (mean, sigma) = mean_and_sigma(row);
        for (k, j) in columns.iter().enumerate() {
            if let Some(score) = out.get_mut(j + q - t) {
                *score += (row[k] - mean) / sigma;
            }
        }
    }
    out.iter_mut()
        .zip(valid)
        .filter(|(_, v)| !**v)
        .for_each(|(o, _)| *o = 0.0);
    Some(out)
}

fn matrix(ticks: usize, references: usize, seed: usize) -> Vec<Vec<f64>> {
    let value = |i: usize| (((i * 7919 + seed * 104_729) as f64).sin() * 43_758.545_3).fract();
    (0..ticks)
        .map(|t| (0..references).map(|j| value(t * references + j)).collect())
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn follows_the_definition_through_any_holes(
        references in 1usize..300, length in 1usize..12, seed in 0usize..1000,
        present in prop::collection::vec(prop::bool::weighted(0.7), 1..25),
        hole in 2usize..9,
    ) {
        let s = matrix(present.len(), references, seed);
        let valid: Vec<bool> = (0..references).map(|j| (j * 31 + seed) % hole != 0).collect();
        let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, length, &valid);
        let mut out = vec![0.0; references];
        for q in 0..present.len() {
            matcher.push(present[q].then_some(s[q].as_slice()));
            let scored = matcher.score(&mut out);
            let in_window = present[q.saturating_sub(length - 1)..=q].iter().filter(|p| **p).count();
            prop_assert_eq!(matcher.history(), in_window);
            match by_definition(&s, &present, &valid, length, q) {
                None => prop_assert!(!scored && out.iter().all(|v| v.is_nan())),
                Some(want) => for (j, (g, w)) in out.iter().zip(&want).enumerate() {
                    // Two rows that differ alike at all places leave only rounding errors, scaled by 1e-8.
                    let degenerate = in_window == 2 && length > 1 && references < 20;
                    let tolerance = if degenerate { 1e-6 } else { 1e-9 };
                    prop_assert!((g - w).abs() <= tolerance * w.abs().max(1.0), "q {} j {}: {} {}", q, j, g, w);
                },
            }
        }
    }

    #[test]
    fn streaming_equals_batch(references in 1usize..60, ticks in 1usize..40, length in 0usize..12) {
        let s = matrix(ticks, references, length);
        let whole = Array2::from_shape_fn((ticks, references), |(t, j)| s[t][j]);
        let batch = sequence_match(whole.view(), length, SequenceMethod::Paper);
        let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, length, &vec![true; references]);
        let mut out = vec![0.0; references];
        for (row, want) in s.iter().zip(batch.rows()) {
            matcher.push(Some(row));
            prop_assert!(matcher.score(&mut out));
            prop_assert_eq!(&out[..], want.as_slice().unwrap());
        }
    }

    #[test]
    fn what_lies_outside_the_window_is_forgotten(length in 1usize..8, references in 2usize..200) {
        let s = matrix(30, references, references);
        let valid = vec![true; references];
        let mut old = SequenceMatcher::new(SequenceMethod::Paper, length, &valid);
        let mut fresh = old_window(&s, length, &valid);
        s.iter().for_each(|row| old.push(Some(row)));
        let (mut a, mut b) = (vec![0.0; references], vec![0.0; references]);
        old.score(&mut a);
        fresh.score(&mut b);
        prop_assert_eq!(a, b);
    }
}

fn old_window(s: &[Vec<f64>], length: usize, valid: &[bool]) -> SequenceMatcher {
    let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, length, valid);
    s[s.len() - length..]
        .iter()
        .for_each(|row| matcher.push(Some(row)));
    matcher
}

#[test]
fn transposed_and_empty_matrices_are_taken() {
    let s = Array2::from_shape_fn((5, 4), |(t, j)| ((t * 3 + j * 5) % 7) as f64);
    let columns_first = s.t().as_standard_layout().into_owned();
    let a = sequence_match(s.view(), 3, SequenceMethod::Paper);
    assert_eq!(a, sequence_match(columns_first.t(), 3, SequenceMethod::Paper));
    for shape in [(0, 3), (3, 0), (0, 0)] {
        assert_eq!(
            sequence_match(Array2::zeros(shape).view(), 3, SequenceMethod::Paper).dim(),
            shape
        );
    }
}

#[test]
fn a_map_without_any_row_is_sat_out() {
    let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, 3, &[false, false]);
    let mut out = [0.0; 2];
    matcher.push(Some(&[f64::NAN, f64::NAN]));
    assert!(!matcher.score(&mut out));
    assert!(out.iter().all(|v| v.is_nan()));
}
