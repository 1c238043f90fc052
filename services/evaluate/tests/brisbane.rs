//! Recall on real rows: Brisbane-Event-VPR at 7×7 pixels has the figures of the method's reference.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::plan::SequenceMethod;
use evpr_evaluate::{Pair, Results, Spec, evaluate};
use support::*;

#[test]
fn recall_is_as_published() {
    let Some(data) = shared("recall_is_as_published", "data/brisbane_7x7") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let pair = brisbane(&data, folder.path());
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
