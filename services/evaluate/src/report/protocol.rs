//! The protocol of LENS: sequences of 10, and right is what was within 3 s of the true place.

use super::html::{Section, Table, percent, percent_or_dash};
use super::view::{View, kind_title, mean_over_pairs};
use crate::results::Row;

/// LENS's sequences, ticks.
const LENGTH: usize = 10;

pub(super) fn lens(view: &View<'_>) -> Section {
    let mut section = Section::new("lens", "LENS's protocol");
    let rows: Vec<&Row> = view
        .main_rows()
        .filter(|r| r.length == LENGTH && r.measures.within_3s.is_some())
        .collect();
    if rows.is_empty() {
        section.lacks("For LENS's protocol evaluate sequences of 10 ticks, into a new folder: --length 10.");
        return section;
    }
    let mut heads = vec!["ensemble".to_owned()];
    for condition in &view.conditions {
        heads.push(format!("{condition}: AR@1"));
        heads.push("best".to_owned());
    }
    let mut table = Table::new(&heads.iter().map(String::as_str).collect::<Vec<_>>());
    for kind in view.kinds() {
        let mut cells = vec![kind_title(kind).to_owned()];
        for condition in &view.conditions {
            let these = rows
                .iter()
                .filter(|r| r.kind == kind && view.condition(&r.pair) == condition)
                .filter_map(|r| Some((r, r.measures.within_3s?.of_all)));
            cells.push(percent_or_dash(mean_over_pairs(
                these.clone().map(|(r, share)| (r.pair.as_str(), share)),
            )));
            let best = these.max_by(|a, b| a.1.total_cmp(&b.1));
            cells.push(best.map_or_else(
                || "–".to_owned(),
                |(r, share)| format!("{} {}, {}", percent(share), r.subset, r.pair),
            ));
        }
        table.row(cells);
    }
    let best: Vec<usize> = (0..view.conditions.len()).map(|at| 2 + 2 * at).collect();
    let table = table.words(&best);
    let caption = format!(
        "Sequences of {LENGTH} ticks; right is a place that the map passes within 3 s of the true one: of the place nearest to \
         the query where positions are known, else of a right place ({}). LENS itself, as the paper cites it on \
         Brisbane-Event-VPR: 73 % by day, 1 % by night.",
        view.main.name()
    );
    section.add(&table.caption(&caption).html());
    section
}
