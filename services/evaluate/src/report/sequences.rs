//! Sequence lengths: the paper's method against SeqSLAM, and every method over length.

use super::Figures;
use super::chart::{Axis, Series, axes};
use super::html::{Section, Table, p_value, percent};
use super::view::{Setting, View, mean_recall};
use crate::results::Row;
use crate::statistics::comparisons;
use crate::subsets::SubsetKind;
use std::collections::BTreeSet;

pub(super) fn sequences(view: &View<'_>, figures: &mut Figures) -> Section {
    let mut section = Section::new("sequences", "Sequence lengths");
    // As in the paper, of single members where there are some.
    let alone = |r: &&Row| r.kind == SubsetKind::Single;
    let has_single = view.rows.iter().any(|r| alone(&r));
    let alike = |r: &&Row| {
        r.similarity == view.main.similarity && r.weights == view.main.weights && (!has_single || alone(r))
    };
    let of_method = |method: &str, rule: &str| -> Vec<Row> {
        let rows = view.rows.iter().filter(alike);
        rows.filter(|r| r.method == method && r.rule == rule)
            .cloned()
            .collect()
    };
    let what = if has_single {
        "single members"
    } else {
        "all ensembles"
    };
    let ours = of_method("paper", &view.main.rule);
    let seqslam = of_method("seqslam", &view.main.rule);
    let table = against(&seqslam, &ours, what);
    match table {
        Some(table) => section.add(&table.html()),
        None => section.lacks(
            "For SeqSLAM against the paper's method evaluate with both: --method paper,seqslam, and the lengths of the paper: \
             --length 10,20,30.",
        ),
    }
    let methods: Vec<&Setting> = view
        .settings
        .iter()
        .filter(|s| s.similarity == view.main.similarity && s.weights == view.main.weights)
        .collect();
    let mut series = Vec::new();
    let mut longest = 1;
    for (at, setting) in methods.iter().enumerate().take(8) {
        let rows = of_method(&setting.method, &setting.rule);
        let lengths: BTreeSet<usize> = rows.iter().map(|r| r.length).collect();
        longest = longest.max(lengths.last().copied().unwrap_or(1));
        let points = lengths.iter().filter_map(|length| {
            let of_length = rows.iter().filter(|r| r.length == *length);
            Some((*length as f64, mean_recall(of_length)?))
        });
        let name = format!("{}, {}", setting.method, setting.rule);
        series.push(Series::line(name, at, points));
    }
    let picture = axes(
        "sequence_lengths",
        &format!("AR@1 of {what} over the length of the sequences. Methods without history stand at 1."),
        Axis::new("sequence length L, ticks", 0.0, longest as f64 * 1.05),
        Axis::share("AR@1 of all queries"),
        &series,
    );
    section.pictures(std::slice::from_ref(&picture));
    figures.push(picture);
    if view.lengths().len() == 1 {
        section.lacks("One length was evaluated; give several, such as --length 10,20,30.");
    }
    section
}

/// The paper's table. None where the two have no length in common.
fn against(seqslam: &[Row], ours: &[Row], what: &str) -> Option<Table> {
    let mut table = Table::new(&[
        "L",
        "SeqSLAM",
        "ours",
        "difference",
        "pairs",
        "Wilcoxon p",
        "paired t p",
        "Welch p, all recalls",
    ]);
    let lengths: BTreeSet<usize> = ours.iter().map(|r| r.length).collect();
    let mut any = false;
    for length in lengths {
        let of_length =
            |rows: &[Row]| -> Vec<Row> { rows.iter().filter(|r| r.length == length).cloned().collect() };
        let both = [of_length(seqslam), of_length(ours)].concat();
        let found = comparisons(&both).into_iter().find(|c| c.what == "sequence");
        let Some(c) = found else { continue };
        any = true;
        // Levels come in alphabetical order: a is "paper".
        table.row(vec![
            length.to_string(),
            percent(c.mean_b),
            percent(c.mean_a),
            format!("{:+.1} %", (c.mean_a - c.mean_b) * 100.0),
            c.pairs.to_string(),
            p_value(c.wilcoxon_p),
            p_value(c.paired_t_p),
            p_value(c.welch_of_all_p),
        ]);
    }
    any.then(|| {
        table.caption(&format!(
            "AR@1 of {what}, with everything else equal. The paired tests take each pair of traverses as one observation; \
             the last column is the paper's test, which takes all recalls for independent."
        ))
    })
}
