//! Comparisons of what was evaluated, over pairs of traverses.
//!
//! Two levels of one thing (two kinds of subsets, two methods with their lengths, two rules, two similarities, two
//! weights) are compared over everything else that both were evaluated with. Queries of one pair are not independent, so
//! a pair of traverses counts as one observation: the mean of its recalls. The paper's code tests all recalls as if they
//! were independent, and unpaired: that is [`Comparison::welch_of_all_p`].

use super::{paired_t, welch, wilcoxon};
use crate::results::Row;
use serde::Serialize;
use std::collections::BTreeMap;

/// Two levels compared by Recall@1 of all queries.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// What differs: `subsets`, `sequence`, `rule`, `similarity` or `weights`.
    pub what: &'static str,
    /// One level.
    pub a: String,
    /// The other.
    pub b: String,
    /// Pairs of traverses that both were evaluated on.
    pub pairs: usize,
    /// Mean of a over the pairs.
    pub mean_a: f64,
    /// Mean of b over the pairs.
    pub mean_b: f64,
    /// Wilcoxon's signed-rank test over the pairs.
    pub wilcoxon_p: Option<f64>,
    /// The paired t-test over the pairs.
    pub paired_t_p: Option<f64>,
    /// Welch's unpaired t-test over the pairs.
    pub welch_p: Option<f64>,
    /// Recalls of a and of b, not summed up.
    pub recalls: [usize; 2],
    /// Welch's unpaired t-test over all recalls, as in the paper's code.
    pub welch_of_all_p: Option<f64>,
}

/// Something that two rows may differ in.
struct Aspect {
    what: &'static str,
    /// What is compared.
    level: String,
    /// What must be equal when another aspect is compared.
    exact: String,
}

/// All that a row was evaluated with but the pair of traverses.
fn aspects(r: &Row) -> [Aspect; 5] {
    let plain = |what, level: &str| Aspect {
        what,
        level: level.to_owned(),
        exact: level.to_owned(),
    };
    let kind = r.kind.name();
    [
        Aspect {
            what: "subsets",
            level: kind.to_owned(),
            exact: format!("{kind}|{}", r.subset),
        },
        plain("sequence", &format!("{} L={}", r.method, r.length)),
        plain("rule", &r.rule),
        plain("similarity", &r.similarity),
        plain("weights", &r.weights),
    ]
}

/// All comparisons that the rows allow.
pub fn comparisons(rows: &[Row]) -> Vec<Comparison> {
    // Per aspect its name, and per level, pair and everything else the recalls.
    let mut tables: [(&'static str, BTreeMap<String, Level<'_>>); 5] = Default::default();
    for row in rows {
        let aspects = aspects(row);
        for (at, (what, levels)) in tables.iter_mut().enumerate() {
            let others = aspects.iter().enumerate().filter(|(other, _)| *other != at);
            let rest: Vec<&str> = others.map(|(_, aspect)| aspect.exact.as_str()).collect();
            let of_level = levels.entry(aspects[at].level.clone()).or_default();
            let recalls = of_level.entry((row.pair.as_str(), rest.join("|"))).or_default();
            recalls.push(row.measures.recall_at[0].of_all);
            *what = aspects[at].what;
        }
    }
    let mut all = Vec::new();
    for (what, levels) in tables {
        let levels: Vec<_> = levels.into_iter().collect();
        for (at, (a, of_a)) in levels.iter().enumerate() {
            for (b, of_b) in &levels[at + 1..] {
                all.extend(compare(what, (a, of_a), (b, of_b)));
            }
        }
    }
    all
}

type Level<'a> = BTreeMap<(&'a str, String), Vec<f64>>;

fn compare(what: &'static str, a: (&str, &Level<'_>), b: (&str, &Level<'_>)) -> Option<Comparison> {
    let (mut all_a, mut all_b) = (Vec::new(), Vec::new());
    let mut pairs: BTreeMap<&str, (Vec<f64>, Vec<f64>)> = BTreeMap::new();
    for (key, recalls_a) in a.1 {
        let Some(recalls_b) = b.1.get(key) else { continue };
        let of_pair = pairs.entry(key.0).or_default();
        of_pair.0.push(mean(recalls_a));
        of_pair.1.push(mean(recalls_b));
        all_a.extend_from_slice(recalls_a);
        all_b.extend_from_slice(recalls_b);
    }
    if pairs.is_empty() {
        return None;
    }
    let (means_a, means_b): (Vec<f64>, Vec<f64>) = pairs.values().map(|(a, b)| (mean(a), mean(b))).unzip();
    let differences: Vec<f64> = means_a.iter().zip(&means_b).map(|(a, b)| a - b).collect();
    // One pair of traverses alone says nothing about others.
    let over_pairs =
        |test: fn(&[f64]) -> Option<f64>| (differences.len() > 1).then(|| test(&differences)).flatten();
    Some(Comparison {
        what,
        a: a.0.to_owned(),
        b: b.0.to_owned(),
        pairs: pairs.len(),
        mean_a: mean(&means_a),
        mean_b: mean(&means_b),
        wilcoxon_p: over_pairs(wilcoxon),
        paired_t_p: over_pairs(paired_t),
        welch_p: welch(&means_a, &means_b),
        recalls: [all_a.len(), all_b.len()],
        welch_of_all_p: welch(&all_a, &all_b),
    })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
