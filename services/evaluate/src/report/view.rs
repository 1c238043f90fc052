//! What the page shows of the rows: the setting that it is about, and means over pairs.

use crate::pair::Pair;
use crate::results::Row;
use crate::subsets::{MemberName, SubsetKind};
use std::collections::{BTreeMap, BTreeSet};

/// The condition of pairs that have none.
const ALL: &str = "all pairs";

/// What ensembles are compared under.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Setting {
    pub(super) similarity: String,
    pub(super) method: String,
    pub(super) rule: String,
    pub(super) weights: String,
}

impl Setting {
    pub(super) fn of(row: &Row) -> Self {
        Self {
            similarity: row.similarity.clone(),
            method: row.method.clone(),
            rule: row.rule.clone(),
            weights: row.weights.clone(),
        }
    }

    pub(super) fn name(&self) -> String {
        format!(
            "{}, {}, {}, weights {}",
            self.method, self.rule, self.similarity, self.weights
        )
    }

    fn is_the_papers(&self) -> bool {
        (
            self.similarity.as_str(),
            self.method.as_str(),
            self.rule.as_str(),
            self.weights.as_str(),
        ) == ("l2", "paper", "sum", "equal")
    }
}

/// The rows, ordered for the page.
#[derive(Debug)]
pub(super) struct View<'a> {
    pub(super) rows: &'a [Row],
    /// In the order in which they were first seen.
    pub(super) settings: Vec<Setting>,
    /// The paper's where it was evaluated, else the one with most rows.
    pub(super) main: Setting,
    /// Names of pairs, in the order of the rows.
    pub(super) pairs: Vec<&'a str>,
    pub(super) conditions: Vec<String>,
    condition_of: BTreeMap<&'a str, String>,
}

impl<'a> View<'a> {
    /// None without rows.
    pub(super) fn new(rows: &'a [Row], pairs: &'a [Pair]) -> Option<Self> {
        let mut counts: Vec<(Setting, usize)> = Vec::new();
        let mut names: Vec<&str> = Vec::new();
        for row in rows {
            let setting = Setting::of(row);
            match counts.iter_mut().find(|(s, _)| *s == setting) {
                Some((_, count)) => *count += 1,
                None => counts.push((setting, 1)),
            }
            if !names.contains(&row.pair.as_str()) {
                names.push(&row.pair);
            }
        }
        let papers = counts.iter().find(|(s, _)| s.is_the_papers());
        let most = counts.iter().map(|(_, count)| *count).max()?;
        let main = papers.or_else(|| counts.iter().find(|(_, count)| *count == most))?;
        let condition = |name: &&'a str| {
            let known = pairs.iter().find(|p| p.name() == *name).and_then(Pair::condition);
            (*name, known.unwrap_or(ALL).to_owned())
        };
        let condition_of: BTreeMap<_, _> = names.iter().map(condition).collect();
        let mut conditions: Vec<String> = Vec::new();
        for name in &names {
            let condition = &condition_of[name];
            if !conditions.contains(condition) {
                conditions.push(condition.clone());
            }
        }
        Some(Self {
            main: main.0.clone(),
            settings: counts.iter().map(|(s, _)| s.clone()).collect(),
            rows,
            pairs: names,
            conditions,
            condition_of,
        })
    }

    /// Rows of the main setting.
    pub(super) fn main_rows(&self) -> impl Iterator<Item = &'a Row> + Clone + '_ {
        self.rows_of(&self.main)
    }

    pub(super) fn rows_of<'s>(&'s self, setting: &'s Setting) -> impl Iterator<Item = &'a Row> + Clone + 's {
        self.rows.iter().filter(move |r| Setting::of(r) == *setting)
    }

    pub(super) fn condition(&self, pair: &str) -> &str {
        self.condition_of.get(pair).map_or(ALL, String::as_str)
    }

    pub(super) fn pairs_of(&self, condition: &str) -> Vec<&'a str> {
        let is = |pair: &&&str| self.condition(pair) == condition;
        self.pairs.iter().filter(is).copied().collect()
    }

    /// Kinds of subsets that there are.
    pub(super) fn kinds(&self) -> Vec<SubsetKind> {
        let kinds: BTreeSet<SubsetKind> = self.rows.iter().map(|r| r.kind).collect();
        kinds.into_iter().collect()
    }

    /// Sequence lengths of the main setting.
    pub(super) fn lengths(&self) -> Vec<usize> {
        let lengths: BTreeSet<usize> = self.main_rows().map(|r| r.length).collect();
        lengths.into_iter().collect()
    }

    /// "L = 10, 20, 30".
    pub(super) fn lengths_text(&self) -> String {
        let lengths: Vec<String> = self.lengths().iter().map(usize::to_string).collect();
        format!("L = {}", lengths.join(", "))
    }

    /// Rows of single members without sequences, or, where there are none, with the shortest of the main setting; and
    /// what they are.
    pub(super) fn frames_alone(&self) -> (Vec<&'a Row>, String) {
        let single = self.rows.iter().filter(|r| r.kind == SubsetKind::Single);
        let main = |r: &&Row| r.similarity == self.main.similarity && r.weights == self.main.weights;
        let alone: Vec<&Row> = single
            .clone()
            .filter(main)
            .filter(|r| r.method == "none")
            .collect();
        if !alone.is_empty() {
            return (alone, "single members, each frame by itself".to_owned());
        }
        let shortest = self.lengths().first().copied().unwrap_or(1);
        let rows = single.filter(|r| Setting::of(r) == self.main && r.length == shortest);
        let what = match shortest {
            1 => "single members, each frame by itself".to_owned(),
            n => format!(
                "single members with sequences of {n} ticks by {}; for frames by themselves evaluate with --method {},none",
                self.main.method, self.main.method
            ),
        };
        (rows.collect(), what)
    }
}

/// Recall@1 of all queries.
pub(super) fn recall(row: &Row) -> f64 {
    row.measures.recall_at[0].of_all
}

/// Mean over pairs of their means: each pair counts once.
pub(super) fn mean_over_pairs<'r>(rows: impl Iterator<Item = (&'r str, f64)>) -> Option<f64> {
    let mut pairs: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (pair, value) in rows {
        pairs.entry(pair).or_default().push(value);
    }
    let means: Vec<f64> = pairs.values().filter_map(|v| mean(v)).collect();
    mean(&means)
}

/// The same of Recall@1.
pub(super) fn mean_recall<'r>(rows: impl Iterator<Item = &'r Row>) -> Option<f64> {
    mean_over_pairs(rows.map(|r| (r.pair.as_str(), recall(r))))
}

pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// What a part of a name is called on the page, and which part it is.
pub(super) const PARTS: [&str; 3] = ["reconstruction", "extractor", "window"];

/// A part of a single member's name.
pub(super) fn part<'n>(name: &'n str, which: &str) -> Option<&'n str> {
    let parts = MemberName::parse(name)?;
    Some(match which {
        "reconstruction" => parts.reconstruction,
        "extractor" => parts.extractor,
        _ => parts.window,
    })
}

/// How kinds are called on the page.
pub(super) fn kind_title(kind: SubsetKind) -> &'static str {
    match kind {
        SubsetKind::Single => "single members",
        SubsetKind::Temporal => "temporal",
        SubsetKind::Reconstruction => "reconstructions",
        SubsetKind::Extractor => "extractors",
        SubsetKind::Combined => "combined",
        SubsetKind::Named => "named",
    }
}
