//! The page's beginning, in a few numbers, and its end, with all of them.

use super::html::{Section, Table, escaped, p_value, percent};
use super::view::{View, kind_title, mean_recall, recall};
use crate::results::Row;
use crate::statistics::Comparison;
use crate::subsets::SubsetKind;
use std::fmt::Write;

/// Most rows of the table of differences.
const MAX_DIFFERENCES: usize = 200;

/// What there is to be read at a glance.
pub(super) fn summary(view: &View<'_>) -> Section {
    let mut section = Section::new("summary", "At a glance");
    let mut tiles: Vec<(String, String)> = Vec::new();
    for kind in [SubsetKind::Single, SubsetKind::Combined] {
        if let Some(mean) = mean_recall(view.main_rows().filter(|r| r.kind == kind)) {
            let what = match kind {
                SubsetKind::Single => "AR@1 of single members, mean",
                _ => "AR@1 of all members together",
            };
            tiles.push((percent(mean), what.to_owned()));
        }
    }
    if let Some((name, mean)) = best_everywhere(view) {
        tiles.push((
            percent(mean),
            format!("best over all pairs, in hindsight: {name}"),
        ));
    }
    let queries: usize = view
        .pairs
        .iter()
        .filter_map(|pair| view.rows.iter().find(|r| r.pair == *pair))
        .map(|r| r.measures.queries)
        .sum();
    tiles.push((
        view.pairs.len().to_string(),
        format!(
            "{} with {queries} queries",
            plural(view.pairs.len(), "pair of traverses", "pairs of traverses")
        ),
    ));
    tiles.push((
        view.rows.len().to_string(),
        format!(
            "{}, all in results.csv",
            plural(view.rows.len(), "configuration", "configurations")
        ),
    ));
    section.add("<div class=\"tiles\">");
    for (value, what) in tiles {
        // Writing into a string cannot fail.
        let _ = write!(
            section.body,
            "<div><strong>{}</strong><span>{}</span></div>",
            escaped(&value),
            escaped(&what)
        );
    }
    section.add("</div>\n");
    section.say(&format!(
        "Shown, unless said otherwise: {}, {}. “Of all” counts queries without a right place as wrong; “of matchable” leaves \
         them out.",
        view.main.name(),
        view.lengths_text()
    ));
    section
}

fn plural<'t>(count: usize, one: &'t str, many: &'t str) -> &'t str {
    if count == 1 { one } else { many }
}

/// The configuration with the highest mean over the pairs, of those that were evaluated on all of them.
fn best_everywhere(view: &View<'_>) -> Option<(String, f64)> {
    let mut by_key: std::collections::BTreeMap<String, Vec<&Row>> = std::collections::BTreeMap::new();
    for row in view.rows {
        // A key without its pair is what was evaluated.
        let what = row.key.strip_prefix(&row.pair).unwrap_or(&row.key);
        by_key.entry(what.to_owned()).or_default().push(row);
    }
    let whole = by_key.into_values().filter(|rows| rows.len() == view.pairs.len());
    let means = whole.filter_map(|rows| Some((mean_recall(rows.iter().copied())?, rows)));
    let (mean, rows) = means.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let row = rows.first()?;
    let name = format!(
        "{} {}, {} L={}, {}, {}",
        row.kind.name(),
        row.subset,
        row.method,
        row.length,
        row.rule,
        row.similarity
    );
    Some((name, mean))
}

/// What differs, and whether that can be told from chance.
pub(super) fn differences(comparisons: &[Comparison]) -> Section {
    let mut section = Section::new("differences", "What differs over pairs");
    if comparisons.is_empty() {
        section.lacks(
            "Only one thing of each sort was evaluated; give several methods, lengths, rules or subsets.",
        );
        return section;
    }
    let mut table = Table::new(&[
        "a − b",
        "pairs",
        "mean a",
        "mean b",
        "difference",
        "Wilcoxon p",
        "paired t p",
        "Welch p",
        "Welch p, all recalls",
    ]);
    for c in comparisons.iter().take(MAX_DIFFERENCES) {
        table.row(vec![
            format!("{}: {} − {}", c.what, c.a, c.b),
            c.pairs.to_string(),
            percent(c.mean_a),
            percent(c.mean_b),
            format!("{:+.1} %", (c.mean_a - c.mean_b) * 100.0),
            p_value(c.wilcoxon_p),
            p_value(c.paired_t_p),
            p_value(c.welch_p),
            p_value(c.welch_of_all_p),
        ]);
    }
    let caption = "Each pair of traverses is one observation, so one pair alone has no p. Welch's test over all recalls is the \
                   paper's, which takes them for independent and unpaired. All are in comparisons.csv.";
    section.add(&table.caption(caption).html());
    section
}

/// Every measure of the best configuration of each kind on each pair.
pub(super) fn best(view: &View<'_>) -> Section {
    let mut section = Section::new("best", "The best of each kind");
    let mut table = Table::new(&[
        "pair",
        "configuration",
        "R@1 of all",
        "95 %",
        "of matchable",
        "R@5",
        "R@10",
        "R@20",
        "ties",
        "PR area",
        "R at 100 % P",
        "median error",
        "first right",
    ]);
    for pair in &view.pairs {
        for kind in view.kinds() {
            let rows = view.rows.iter().filter(|r| r.pair == *pair && r.kind == kind);
            let best = rows.max_by(|a, b| recall(a).total_cmp(&recall(b)).then_with(|| b.key.cmp(&a.key)));
            if let Some(row) = best {
                table.row(measures(row));
            }
        }
    }
    let table = table.words(&[1]);
    let caption = "Chosen in hindsight, of all settings. The interval holds 95 % of a bootstrap over blocks of consecutive \
                   queries. Ties: the recall if all were broken against the right place, and in its favour.";
    section.add(&table.caption(caption).html());
    section
}

fn measures(row: &Row) -> Vec<String> {
    let m = &row.measures;
    vec![
        row.pair.clone(),
        format!(
            "{} {}, {} L={}, {}, {}, {}",
            kind_title(row.kind),
            row.subset,
            row.method,
            row.length,
            row.rule,
            row.similarity,
            row.weights
        ),
        percent(recall(row)),
        format!(
            "{:.1}–{:.1}",
            m.interval_95.of_all_low * 100.0,
            m.interval_95.of_all_high * 100.0
        ),
        percent(m.recall_at[0].of_matchable),
        percent(m.recall_at[1].of_all),
        percent(m.recall_at[2].of_all),
        percent(m.recall_at[3].of_all),
        format!(
            "{:.1}–{:.1}",
            m.pessimistic_at_1.of_all * 100.0,
            m.optimistic_at_1.of_all * 100.0
        ),
        format!("{:.3}", m.precision_recall_area),
        percent(m.recall_at_full_precision),
        match (m.error_median_m, m.error_median_frames) {
            (Some(e), _) => format!("{e:.1} m"),
            (None, Some(e)) => format!("{e:.0} ticks"),
            (None, None) => "–".to_owned(),
        },
        m.first_right_s
            .map_or_else(|| "never".to_owned(), |s| format!("{s:.1} s")),
    ]
}
