//! The choice of members: what is planted is found, the budget holds, and fitted figures flatter.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::plan::{Rule, SequenceMethod, Similarity};
use evpr_evaluate::choose::{Chosen, Costs, Wanted, choose};
use evpr_evaluate::{Pair, PairSpec, Truth};
use std::path::Path;
use support::*;

fn wanted(budget_ms: f64) -> Wanted {
    Wanted {
        budget_ms,
        similarity: Similarity::L2,
        method: SequenceMethod::None,
        length: 1,
        rule: Rule::Sum,
        exact_up_to: 12,
        memory_bytes: 1 << 28,
    }
}

fn costs(folder: &Path) -> Costs {
    let path = folder.join("costs.toml");
    let text = "[reconstruction]\na = 10.0\nb = 10.0\n[extractor]\nx = 5.0\ny = 4.0\n";
    std::fs::write(&path, text).unwrap();
    Costs::read(&path).unwrap()
}

/// `a@1ms/x` knows the first half of the queries, `b@1ms/y` the second; the other two know little.
fn halves(folder: &Path) -> Pair {
    let plan = plan();
    let row = |m: usize, t: usize| match m {
        0 => (t < QUERIES / 2).then(|| noise(place(t), DIMS[0])),
        3 => (t >= QUERIES / 2).then(|| noise(3000 + place(t), DIMS[3])),
        m => t.is_multiple_of(10).then(|| noise(1000 * m + place(t), DIMS[m])),
    };
    let map_row = |m: usize, t: usize| Some(noise(1000 * m + t, DIMS[m]));
    write(&plan, &folder.join("map"), REFERENCES, map_row, |t| {
        Some([t as f64, 0.0])
    });
    write(&plan, &folder.join("query"), QUERIES, row, |t| {
        Some([place(t) as f64, 0.0])
    });
    let truth = Truth::Positions { tolerance_m: 0.5 };
    open(&PairSpec::new(folder.join("map"), folder.join("query"), truth))
}

fn run(pairs: &[Pair], budget_ms: f64, folder: &Path) -> Chosen {
    choose(pairs, &wanted(budget_ms), &costs(folder), &()).unwrap()
}

#[test]
fn members_that_complete_each_other_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let chosen = run(&[halves(folder.path())], 29.0, folder.path());
    assert_eq!(chosen.choice.members, ["a@1ms/x", "b@1ms/y"]);
    assert_eq!((chosen.choice.cost_ms, chosen.choice.recall), (29.0, 1.0));
    assert_eq!(chosen.exact.as_ref(), Some(&chosen.choice));
    assert_eq!(
        (chosen.cross_validated, chosen.exact_cross_validated),
        (1.0, Some(1.0))
    );
    assert_eq!(chosen.folds.len(), 5);
    assert_eq!(chosen.all.cost_ms, 38.0);
    let front: Vec<(f64, f64)> = chosen.front.iter().map(|c| (c.cost_ms, c.recall)).collect();
    assert!(front.is_sorted_by(|a, b| a.0 < b.0 && a.1 < b.1), "{front:?}");
    assert_eq!(front.last(), Some(&(29.0, 1.0)));
    assert_eq!(chosen.steps.len(), 2);
}

#[test]
fn what_is_fitted_flatters() {
    let folder = tempfile::tempdir().unwrap();
    // One member only: whichever is left out, the other half decides.
    let chosen = run(&[halves(folder.path())], 15.0, folder.path());
    assert_eq!((chosen.choice.members.len(), chosen.choice.recall), (1, 0.5));
    assert_eq!(chosen.choice.members, ["b@1ms/y"], "as good, and cheaper");
    assert!(chosen.cross_validated < 0.25, "{}", chosen.cross_validated);
    assert!(chosen.folds.iter().all(|f| f.choice.cost_ms <= 15.0));
}

#[test]
fn the_budget_holds_and_more_of_it_is_never_worse() {
    let folder = tempfile::tempdir().unwrap();
    let pair = [open(&pair_in(folder.path()))];
    let mut before = 0.0;
    for budget in [14.0, 15.0, 19.0, 24.0, 29.0, 38.0] {
        let chosen = run(&pair, budget, folder.path());
        let exact = chosen.exact.unwrap();
        assert!(chosen.choice.cost_ms <= budget && exact.cost_ms <= budget);
        assert!(exact.recall >= chosen.choice.recall && exact.recall >= before);
        before = exact.recall;
    }
    let error = choose(&pair, &wanted(13.0), &costs(folder.path()), &())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("no member fits 13 ms: the cheapest, a@1ms/y, takes 14.000 ms"),
        "{error}"
    );
}

#[test]
fn pairs_are_left_out_in_turn_and_little_memory_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    let mut second = pair_in(folder.path());
    second.name = "noise".to_owned();
    let pairs = [halves(&other), open(&second)];
    let chosen = run(&pairs, 29.0, folder.path());
    let left_out: Vec<&str> = chosen.folds.iter().map(|f| f.left_out.as_str()).collect();
    assert_eq!(left_out, ["map-query", "noise"]);
    let mean = (chosen.folds[0].recall + chosen.folds[1].recall) / 2.0;
    assert!((chosen.cross_validated - mean).abs() < 1e-12);
    let tight = Wanted {
        memory_bytes: 80_000,
        ..wanted(29.0)
    };
    assert_eq!(
        choose(&pairs, &tight, &costs(folder.path()), &()).unwrap(),
        chosen
    );
}

#[test]
fn pairs_of_other_members_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let spec = pair_in(folder.path());
    let few = Pair::open(
        &PairSpec {
            name: "few".to_owned(),
            ..spec.clone()
        },
        &["a@*/*".to_owned()],
    )
    .unwrap();
    let error = choose(&[open(&spec), few], &wanted(99.0), &costs(folder.path()), &()).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("pair few: its members are not those of pair map-query")
    );
}
