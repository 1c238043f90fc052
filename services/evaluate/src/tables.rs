//! Further tables beside the results: what differs, what confidence and members are worth, how alike members are.

use crate::confidence::Trust;
use crate::error::EvaluateError;
use crate::results::{Results, Row, quoted, replace};
use crate::statistics::{Comparison, Members};
use std::collections::BTreeMap;
use std::fmt::Write;

/// A threshold of confidence, learnt on one pair, and what it does there and elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct Learnt<'a> {
    /// The row it was learnt from.
    pub from: &'a Row,
    /// What it does there: fitted.
    pub fitted: Trust,
    /// What it does on other pairs, with their rows.
    pub elsewhere: Vec<(&'a Row, Trust)>,
}

/// Weights of members that were learnt on a pair.
#[derive(Debug, Clone, PartialEq)]
pub struct LearntWeights {
    /// The pair.
    pub pair: String,
    /// The similarity that they are for, as in results.
    pub similarity: String,
    /// The sequence method, as in results.
    pub method: String,
    /// The sequence length, ticks.
    pub length: usize,
    /// Per member its weight.
    pub weights: BTreeMap<String, f64>,
}

/// The threshold of every configuration on every pair, for a wanted precision; configurations that do not reach it are
/// left out.
pub fn thresholds(rows: &[Row], wanted_precision: f64) -> Vec<Learnt<'_>> {
    let learn = |from: &'_ Row| -> Option<Trust> { from.threshold(wanted_precision) };
    let mut all = Vec::new();
    for from in rows {
        let Some(fitted) = learn(from) else { continue };
        let same = rows
            .iter()
            .filter(|r| r.pair != from.pair && r.is_configuration_of(from));
        all.push(Learnt {
            from,
            fitted,
            elsewhere: same.map(|r| (r, r.trust(fitted.confidence))).collect(),
        });
    }
    all
}

impl Row {
    /// Whether the other row is of the same configuration, on whichever pair.
    pub fn is_configuration_of(&self, other: &Self) -> bool {
        let what = |r: &Self| {
            (
                r.similarity.clone(),
                r.method.clone(),
                r.length,
                r.rule.clone(),
                r.weights.clone(),
            )
        };
        self.kind == other.kind && self.subset == other.subset && what(self) == what(other)
    }
}

const CONFIGURATION: &str = "similarity,method,length,rule,weights,kind,subset";

fn configuration(row: &Row) -> String {
    format!(
        "{},{},{},{},{},{},{}",
        row.similarity,
        row.method,
        row.length,
        row.rule,
        quoted(&row.weights),
        row.kind.name(),
        quoted(&row.subset)
    )
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(String::new, |v| v.to_string())
}

impl Results {
    /// Writes `comparisons.csv` and `calibration.csv`.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn write_statistics(&self, comparisons: &[Comparison]) -> Result<(), EvaluateError> {
        let mut text =
            "what,a,b,pairs,mean_a,mean_b,difference,wilcoxon_p,paired_t_p,welch_p,recalls_a,recalls_b,\
                        welch_of_all_p\n"
                .to_owned();
        for c in comparisons {
            // Writing into a string cannot fail.
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{},{},{},{},{},{},{}",
                c.what,
                quoted(&c.a),
                quoted(&c.b),
                c.pairs,
                c.mean_a,
                c.mean_b,
                c.mean_a - c.mean_b,
                number(c.wilcoxon_p),
                number(c.paired_t_p),
                number(c.welch_p),
                c.recalls[0],
                c.recalls[1],
                number(c.welch_of_all_p)
            );
        }
        replace(&self.folder().join("comparisons.csv"), &text)?;
        let mut text = format!("pair,{CONFIGURATION},confidence_from,answers,right,precision\n");
        for row in self.rows() {
            for bin in row.calibration().iter().filter(|b| b.answers > 0) {
                let _ = writeln!(
                    text,
                    "{},{},{},{},{},{}",
                    quoted(&row.pair),
                    configuration(row),
                    f64::from(bin.from) / 1000.0,
                    bin.answers,
                    bin.right,
                    f64::from(bin.right) / f64::from(bin.answers)
                );
            }
        }
        replace(&self.folder().join("calibration.csv"), &text)
    }

    /// Writes `thresholds.csv`: per configuration and pair the threshold learnt there, and what it does on each pair.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_thresholds(&self, wanted_precision: f64) -> Result<(), EvaluateError> {
        let mut text = format!(
            "{CONFIGURATION},wanted_precision,learnt_on,threshold,measured_on,fitted,answers,precision,recall_of_matchable\n"
        );
        for learnt in thresholds(self.rows(), wanted_precision) {
            let there = std::iter::once((learnt.from, learnt.fitted));
            for (row, trust) in there.chain(learnt.elsewhere) {
                let _ = writeln!(
                    text,
                    "{},{wanted_precision},{},{},{},{},{},{},{}",
                    configuration(row),
                    quoted(&learnt.from.pair),
                    trust.confidence,
                    quoted(&row.pair),
                    row.pair == learnt.from.pair,
                    trust.answers,
                    trust.precision,
                    trust.recall
                );
            }
        }
        replace(&self.folder().join("thresholds.csv"), &text)
    }

    /// Writes `weights.csv`.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_weights(&self, learnt: &[LearntWeights]) -> Result<(), EvaluateError> {
        let mut text = "learnt_on,similarity,method,length,member,weight\n".to_owned();
        for l in learnt {
            for (member, weight) in &l.weights {
                let (pair, member) = (quoted(&l.pair), quoted(member));
                let _ = writeln!(
                    text,
                    "{pair},{},{},{},{member},{weight}",
                    l.similarity, l.method, l.length
                );
            }
        }
        replace(&self.folder().join("weights.csv"), &text)
    }

    /// Writes `members.json`.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_members(&self, members: &[Members]) -> Result<(), EvaluateError> {
        let path = self.folder().join("members.json");
        let text =
            serde_json::to_string_pretty(members).map_err(|e| EvaluateError::bad(&path, e.to_string()))?;
        replace(&path, &(text + "\n"))
    }
}
