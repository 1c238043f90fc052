//! Tests over pairs, intervals, thresholds and likeness of members, from evaluations as they are written.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_evaluate::statistics::{comparisons, members};
use evpr_evaluate::{Pair, Results, Spec, evaluate, learnt_weights, thresholds};
use std::path::Path;
use support::*;

/// Three pairs of one map whose queries have more noise from pair to pair.
fn pairs(folder: &Path) -> Vec<Pair> {
    let one = |i: usize| {
        let mut spec = pair_in(&{
            let folder = folder.join(i.to_string());
            std::fs::create_dir(&folder).unwrap();
            folder
        });
        spec.name = format!("pair{i}");
        spec.query = folder.join(format!("query{i}"));
        let row = |m: usize, t: usize| {
            let own = noise(99_000 + 100 * i + 7 * m + t, DIMS[m]);
            query_row(m, t).map(|row| row.iter().zip(own).map(|(r, o)| r + 0.4 * i as f32 * o).collect())
        };
        write(&plan(), &spec.query, QUERIES, row, |t| {
            Some([place(t) as f64, 0.0])
        });
        open(&spec)
    };
    (0..3).map(one).collect()
}

#[test]
fn comparisons_are_over_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let pairs = pairs(folder.path());
    let mut results = Results::open(&folder.path().join("out"), &pairs).unwrap();
    evaluate(&pairs, &spec(), &mut results, &()).unwrap();
    let all = comparisons(results.rows());
    let found = all
        .iter()
        .find(|c| (c.a.as_str(), c.b.as_str()) == ("single", "combined"));
    let found = found
        .or_else(|| {
            all.iter()
                .find(|c| (c.a.as_str(), c.b.as_str()) == ("combined", "single"))
        })
        .unwrap();
    assert_eq!(found.pairs, 3);
    assert_eq!(
        found.recalls,
        [9, 36],
        "three sequences, one and four subsets, three pairs"
    );
    let mean = |kind: &str| {
        let recalls: Vec<f64> = results
            .rows()
            .iter()
            .filter(|r| r.kind.name() == kind)
            .map(|r| r.measures.recall_at[0].of_all)
            .collect();
        recalls.iter().sum::<f64>() / recalls.len() as f64
    };
    assert!((found.mean_a - mean("combined")).abs() < 1e-12 && (found.mean_b - mean("single")).abs() < 1e-12);
    // With three pairs, Wilcoxon's p is at least 1/4.
    assert!(
        found.wilcoxon_p.unwrap() >= 0.25 && found.paired_t_p.is_some() && found.welch_of_all_p.is_some()
    );
    // One pair alone says nothing.
    let one: Vec<_> = results
        .rows()
        .iter()
        .filter(|r| r.pair == "pair0")
        .cloned()
        .collect();
    let alone = comparisons(&one);
    assert!(
        alone
            .iter()
            .all(|c| c.wilcoxon_p.is_none() && c.paired_t_p.is_none() && c.welch_p.is_none())
    );
    results.write_statistics(&all).unwrap();
    let csv = std::fs::read_to_string(folder.path().join("out/comparisons.csv")).unwrap();
    assert_eq!(csv.lines().count(), all.len() + 1);
}

#[test]
fn intervals_hold_the_recall_and_thresholds_the_precision() {
    let folder = tempfile::tempdir().unwrap();
    let pairs = pairs(folder.path());
    let mut results = Results::open(&folder.path().join("out"), &pairs).unwrap();
    evaluate(&pairs, &spec(), &mut results, &()).unwrap();
    for row in results.rows() {
        let (m, i) = (&row.measures, row.measures.interval_95);
        assert!(
            i.of_all_low <= m.recall_at[0].of_all && m.recall_at[0].of_all <= i.of_all_high,
            "{}",
            row.key
        );
        let answers: u32 = m.confidence.iter().map(|b| b.answers).sum();
        assert_eq!(answers as usize, m.answered);
        assert_eq!(row.trust(0.0).answers as usize, m.answered);
        let table: u32 = row.calibration().iter().map(|b| b.right).sum();
        assert_eq!(table as usize, m.right);
    }
    let learnt = thresholds(results.rows(), 0.9);
    assert!(!learnt.is_empty());
    for one in &learnt {
        assert!(one.fitted.precision >= 0.9 && one.fitted.answers > 0);
        assert_eq!(one.elsewhere.len(), 2);
        let lower = one
            .from
            .measures
            .confidence
            .iter()
            .filter(|b| f64::from(b.from) / 1000.0 < one.fitted.confidence);
        assert!(
            lower
                .into_iter()
                .all(|b| one.from.trust(f64::from(b.from) / 1000.0).precision < 0.9)
        );
    }
    results.write_thresholds(0.9).unwrap();
    let csv = std::fs::read_to_string(folder.path().join("out/thresholds.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 3 * learnt.len());
}

#[test]
fn members_are_most_like_themselves() {
    let folder = tempfile::tempdir().unwrap();
    let pair = open(&pair_in(folder.path()));
    let found = members(&pair, &spec()).unwrap();
    for a in 0..4 {
        assert!((found.similarity_correlation[a][a].unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(found.error_overlap[a][a], 1.0);
        for b in 0..4 {
            assert_eq!(
                found.similarity_correlation[a][b],
                found.similarity_correlation[b][a]
            );
            assert!(a == b || found.similarity_correlation[a][b].unwrap() < 0.9);
        }
    }
    assert!(
        found.recall[0] > found.recall[3],
        "the last member has the most noise"
    );
}

#[test]
fn learnt_weights_favour_what_is_right_more_often() {
    let folder = tempfile::tempdir().unwrap();
    let pairs = pairs(folder.path());
    let mut results = Results::open(&folder.path().join("out"), &pairs).unwrap();
    evaluate(&pairs, &spec(), &mut results, &()).unwrap();
    let like = results.rows()[0].clone();
    let weights = learnt_weights(&pairs[0], results.rows(), &like).unwrap();
    assert!((weights.values().sum::<f64>() / 4.0 - 1.0).abs() < 1e-12);
    let right = |member: &str| {
        let row = results.rows().iter().find(|r| {
            r.pair == "pair0" && r.subset == member && (&r.method, r.length) == (&like.method, like.length)
        });
        row.unwrap().measures.right
    };
    for (a, weight_a) in &weights {
        for (b, weight_b) in &weights {
            assert!(right(a) <= right(b) || weight_a >= weight_b, "{a} {b}");
        }
    }
    let weighted = Spec {
        weights: Some(("learnt:pair0".to_owned(), weights)),
        ..spec()
    };
    let before = results.rows().len();
    evaluate(&pairs, &weighted, &mut results, &()).unwrap();
    assert_eq!(results.rows().len(), 2 * before);
    // A single member is what it is, whatever its weight, unless that is 0.
    for row in results
        .rows()
        .iter()
        .filter(|r| r.members == 1 && r.weights != "equal" && r.measures.answered > 0)
    {
        let equal = results
            .rows()
            .iter()
            .find(|r| r.key == row.key.replace("learnt:pair0", "equal"))
            .unwrap();
        assert_eq!(row.measures.right, equal.measures.right, "{}", row.key);
    }
    let few: Vec<_> = results.rows().iter().filter(|r| r.members > 1).cloned().collect();
    let error = learnt_weights(&pairs[0], &few, &like).unwrap_err().to_string();
    assert!(error.contains("was not evaluated alone"), "{error}");
}
