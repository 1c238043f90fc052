//! The evaluation gives the answers of the running fuser, whatever is computed beside them.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::MemberSet;
use evpr_core::config::{RULES, SEQUENCE_METHODS};
use evpr_evaluate::{Configuration, Pair, Results, Row, Spec, SubsetChoice, SubsetKind, evaluate};
use evpr_fuse::Map;
use evpr_fuse::offline::{Query, answers};
use evpr_store::GroundTruth;
use std::path::Path;
use support::*;

fn rows(out: &Path, pairs: &[Pair], spec: &Spec) -> Vec<Row> {
    let mut results = Results::open(out, pairs).unwrap();
    evaluate(pairs, spec, &mut results, &()).unwrap();
    results.rows().to_vec()
}

/// Right answers by the chain that the demonstration and the running fuser use.
fn right(folder: &Path, c: &Configuration, truth: &GroundTruth) -> (usize, usize) {
    let mut plan = plan();
    plan.map = Some(folder.join("map"));
    (plan.fuse.length, plan.fuse.sequence, plan.fuse.rule) = (c.length, c.method, c.rule);
    plan.fuse.similarity = c.similarity;
    let query = Query::open(&plan, &folder.join("query")).unwrap();
    let on = |_: u64| c.subset.members.iter().collect::<MemberSet>();
    let answered: Vec<Option<usize>> = answers(&plan, Map::open(&plan).unwrap(), &query, on)
        .unwrap()
        .iter()
        .map(|(header, _)| usize::try_from(header.reference).ok())
        .collect();
    (truth.recall(&answered).right, answered.iter().flatten().count())
}

#[test]
fn every_configuration_has_the_recall_of_the_running_fuser() {
    have_the_recall_of_the_running_fuser(&spec(), 39);
}

#[test]
fn so_have_all_methods_and_rules() {
    let words = SEQUENCE_METHODS.all();
    let methods: Vec<_> = words.iter().map(|w| SEQUENCE_METHODS.parse(w).unwrap()).collect();
    let rules: Vec<_> = RULES.all().iter().map(|w| RULES.parse(w).unwrap()).collect();
    let spec = Spec {
        subsets: vec![SubsetChoice::Kind(SubsetKind::Combined)],
        lengths: vec![4],
        methods,
        rules,
        ..spec()
    };
    have_the_recall_of_the_running_fuser(&spec, 30);
}

/// All configurations of the made-up pair, of which there are `count`.
fn have_the_recall_of_the_running_fuser(spec: &Spec, count: usize) {
    let folder = tempfile::tempdir().unwrap();
    let pair = open(&pair_in(folder.path()));
    let configurations = spec.configurations(pair.members()).unwrap();
    let truth = pair.truth().clone();
    let found = rows(&folder.path().join("out"), &[pair], spec);
    assert_eq!((configurations.len(), found.len()), (count, count));
    let mut recalls = Vec::new();
    for c in &configurations {
        let row = found.iter().find(|r| r.key == c.key("map-query")).unwrap();
        let (right, answered) = right(folder.path(), c, &truth);
        assert_eq!(
            (row.measures.right, row.measures.answered),
            (right, answered),
            "{}",
            row.key
        );
        assert_eq!(row.measures.recall_at[0].of_all, right as f64 / QUERIES as f64);
        recalls.push(right);
    }
    recalls.sort_unstable();
    recalls.dedup();
    assert!(recalls.len() > 5, "the configurations must differ: {recalls:?}");
}

#[test]
fn a_small_memory_makes_several_passes_with_the_same_results() {
    let folder = tempfile::tempdir().unwrap();
    let pair = [open(&pair_in(folder.path()))];
    let plenty = rows(&folder.path().join("plenty"), &pair, &spec());
    let one = evpr_evaluate::bytes_needed(&pair[0], &[(6, 13)]);
    let tight = Spec {
        memory_bytes: one,
        ..spec()
    };
    assert_eq!(rows(&folder.path().join("tight"), &pair, &tight), plenty);
    let too_tight = Spec {
        memory_bytes: one - 1,
        ..spec()
    };
    let mut results = Results::open(&folder.path().join("none"), &pair).unwrap();
    let error = evaluate(&pair, &too_tight, &mut results, &())
        .unwrap_err()
        .to_string();
    assert!(error.contains("for sequences of 6 ticks, more than"), "{error}");
}

#[test]
fn an_interrupted_run_goes_on_by_key() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let spec_of_pair = pair_in(folder.path());
    let pair = [open(&spec_of_pair)];
    let all = rows(&out, &pair, &spec());
    let csv = std::fs::read_to_string(out.join("results.csv")).unwrap();
    // Killed in the middle of its twelfth row.
    let text = std::fs::read_to_string(out.join("rows.jsonl")).unwrap();
    let at: usize = text.split_inclusive('\n').take(12).map(str::len).sum();
    std::fs::write(out.join("rows.jsonl"), &text[..at + 40]).unwrap();
    let results = Results::open(&out, &pair).unwrap();
    assert_eq!(results.rows().len(), 11);
    drop(results);
    assert_eq!(rows(&out, &pair, &spec()), all);
    assert_eq!(std::fs::read_to_string(out.join("results.csv")).unwrap(), csv);
    // A line in the middle that is none is not passed over.
    std::fs::write(out.join("rows.jsonl"), text.replacen("\"key\"", "\"kex\"", 1)).unwrap();
    let error = Results::open(&out, &pair).unwrap_err().to_string();
    assert!(error.contains("line 2 is not of an evaluation"), "{error}");
    // Nor are results of other inputs taken for these.
    std::fs::write(out.join("rows.jsonl"), &text).unwrap();
    let mut other = spec_of_pair;
    other.truth = evpr_evaluate::Truth::Positions { tolerance_m: 3.0 };
    let error = Results::open(&out, &[open(&other)]).unwrap_err().to_string();
    assert!(
        error.contains("results of another pair map-query: ground_truth was"),
        "{error}"
    );
}

#[test]
fn the_table_has_a_named_column_for_each_denominator() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut far = pair_in(folder.path());
    // Half of the queries are at places that the map does not have.
    write(&plan(), &folder.path().join("far"), QUERIES, query_row, |t| {
        Some([place(t) as f64 + if t % 2 == 0 { 0.0 } else { 500.0 }, 0.0])
    });
    far.query = folder.path().join("far");
    let found = rows(&out, &[open(&far)], &spec());
    let csv = std::fs::read_to_string(out.join("results.csv")).unwrap();
    let mut lines = csv.lines().map(|l| l.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let at = |name: &str| header.iter().position(|h| *h == name).unwrap();
    for (line, row) in lines.zip(&found) {
        assert_eq!(line.len(), header.len());
        let number = |name: &str| line[at(name)].parse::<f64>().unwrap();
        let right = row.measures.right as f64;
        assert_eq!(number("recall_at_1_of_all"), right / 30.0);
        assert_eq!(number("recall_at_1_of_matchable"), right / 15.0);
        assert!(number("recall_at_1_pessimistic_of_all") <= number("recall_at_1_of_all"));
        assert!(number("recall_at_1_of_all") <= number("recall_at_1_optimistic_of_all"));
        assert!(number("recall_at_20_of_all") >= number("recall_at_5_of_all"));
        // Every answer to a query near the map is within 25 m of it, and no other.
        let near = number("recall_within_25m_of_matchable");
        assert!(near >= number("recall_at_1_of_matchable") && near <= 1.0);
        assert_eq!(number("recall_within_25m_of_all"), near / 2.0);
    }
}
