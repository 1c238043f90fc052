//! Ensembles by condition and pair, what their parts do alone, and every setting's means.

use super::Figures;
use super::chart::{Bar, Group, bars};
use super::html::{Section, Table, percent, percent_or_dash};
use super::view::{PARTS, View, kind_title, mean_recall, part, recall};
use crate::results::Row;
use crate::subsets::SubsetKind;
use evpr_core::time::parse_duration_ns;
use std::collections::BTreeMap;

/// Most pairs of traverses with bars of their own.
const MAX_PAIRS: usize = 24;

/// AR@1 of the kinds of ensembles by condition, and their bars by pair.
pub(super) fn ensembles(view: &View<'_>, figures: &mut Figures) -> Section {
    let mut section = Section::new("ensembles", "Ensembles");
    section.add(&by_condition(view).html());
    if view.conditions.len() == 1 {
        section.lacks(
            "All pairs are of one condition. To tell day from night, give pairs a condition in the list of pairs \
             (--pairs): condition = \"day-night\".",
        );
    }
    let kinds: Vec<SubsetKind> = view.kinds();
    let titles: Vec<String> = kinds.iter().map(|k| title_in_bars(*k).to_owned()).collect();
    let mut pictures = Vec::new();
    for condition in &view.conditions {
        let pairs = view.pairs_of(condition);
        let best = best_single(view, &pairs);
        let group = |pair: &&str| Group {
            name: (*pair).to_owned(),
            bars: kinds
                .iter()
                .enumerate()
                .filter_map(|(at, kind)| bar_of(view, pair, *kind, at, best.as_deref()))
                .collect(),
        };
        let groups: Vec<Group> = pairs.iter().take(MAX_PAIRS).map(group).collect();
        let caption = format!(
            "{condition}: AR@1 by pair, mean over the ensembles of a kind and {}; of single members the one that is best \
             over these pairs{}. {}",
            view.lengths_text(),
            best.as_ref()
                .map_or_else(String::new, |name| format!(" ({name})")),
            left_out(pairs.len())
        );
        let name = format!("ensembles_{condition}");
        pictures.push(bars(
            &name,
            caption.trim_end(),
            "AR@1 of all queries",
            1.0,
            &titles,
            &groups,
        ));
    }
    section.pictures(&pictures);
    figures.extend(pictures);
    if view.settings.len() > 1 {
        section.say("Every setting, mean over pairs, ensembles and lengths:");
        section.add(&by_setting(view).html());
    }
    section
}

fn left_out(pairs: usize) -> String {
    match pairs.saturating_sub(MAX_PAIRS) {
        0 => String::new(),
        more => format!("{more} more pairs are in results.csv."),
    }
}

fn title_in_bars(kind: SubsetKind) -> &'static str {
    match kind {
        SubsetKind::Single => "best single member",
        kind => kind_title(kind),
    }
}

/// The single member with the highest mean over these pairs.
fn best_single(view: &View<'_>, pairs: &[&str]) -> Option<String> {
    let mut by_name: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
    for row in view.main_rows() {
        if row.kind == SubsetKind::Single && pairs.contains(&row.pair.as_str()) {
            by_name.entry(&row.subset).or_default().push(row);
        }
    }
    let means = by_name
        .into_iter()
        .filter_map(|(name, rows)| Some((name, mean_recall(rows.into_iter())?)));
    let best = means.max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(best.0.to_owned())
}

fn bar_of(view: &View<'_>, pair: &str, kind: SubsetKind, at: usize, best: Option<&str>) -> Option<Bar> {
    let alone = kind == SubsetKind::Single;
    let rows = view
        .main_rows()
        .filter(|r| r.kind == kind && r.pair == pair && (!alone || best.is_none_or(|best| r.subset == best)));
    let all: Vec<f64> = rows.clone().map(recall).collect();
    let (low, high) = (
        all.iter().copied().fold(f64::INFINITY, f64::min),
        all.iter().copied().fold(0.0, f64::max),
    );
    let value = mean_recall(rows)?;
    Some(Bar {
        series: at,
        value,
        range: None,
        title: format!(
            "{pair}, {}: {value:.4}, of {} from {low:.4} to {high:.4}",
            title_in_bars(kind),
            all.len()
        ),
    })
}

/// The paper's table: condition, kind, AR@1, gain over the temporal ensembles.
fn by_condition(view: &View<'_>) -> Table {
    let mut table = Table::new(&[
        "condition",
        "ensemble",
        "AR@1",
        "gain over temporal",
        "of matchable",
        "how many",
        "best",
    ]);
    for condition in &view.conditions {
        let of = |kind: SubsetKind| {
            let rows = view.main_rows();
            rows.filter(move |r| r.kind == kind && view.condition(&r.pair) == condition)
        };
        let temporal = mean_recall(of(SubsetKind::Temporal));
        for (at, kind) in view.kinds().into_iter().enumerate() {
            let Some(mean) = mean_recall(of(kind)) else {
                continue;
            };
            let names: std::collections::BTreeSet<&str> = of(kind).map(|r| r.subset.as_str()).collect();
            let matchable = of(kind).map(|r| (r.pair.as_str(), r.measures.recall_at[0].of_matchable));
            let gain = temporal.filter(|t| *t > 0.0 && kind != SubsetKind::Temporal);
            let best = of(kind).max_by(|a, b| recall(a).total_cmp(&recall(b)));
            table.row(vec![
                if at == 0 { condition.clone() } else { String::new() },
                kind_title(kind).to_owned(),
                percent(mean),
                gain.map_or_else(
                    || "–".to_owned(),
                    |t| format!("{:+.1} %", (mean / t - 1.0) * 100.0),
                ),
                percent_or_dash(super::view::mean_over_pairs(matchable)),
                names.len().to_string(),
                best.map_or_else(String::new, |b| {
                    format!("{} {}, L={}, {}", percent(recall(b)), b.subset, b.length, b.pair)
                }),
            ]);
        }
    }
    table.words(&[1, 6]).caption(&format!(
        "AR@1: Recall@1 of all queries, mean over pairs, ensembles of a kind and {} ({}). “Of matchable” leaves out queries \
         without a right place. “Best” is chosen in hindsight.",
        view.lengths_text(),
        view.main.name()
    ))
}

fn by_setting(view: &View<'_>) -> Table {
    let kinds = view.kinds();
    let mut heads = vec!["method", "rule", "similarity", "weights"];
    let words = [1, 2, 3];
    heads.extend(kinds.iter().map(|k| kind_title(*k)));
    let mut table = Table::new(&heads);
    for s in &view.settings {
        let mut cells = vec![
            s.method.clone(),
            s.rule.clone(),
            s.similarity.clone(),
            s.weights.clone(),
        ];
        cells.extend(
            kinds
                .iter()
                .map(|kind| percent_or_dash(mean_recall(view.rows_of(s).filter(|r| r.kind == *kind)))),
        );
        table.row(cells);
    }
    table.words(&words)
}

/// Of a window, from its name: ns, or events.
fn length(window: &str) -> u64 {
    let events = window.strip_suffix("ev").and_then(|n| n.parse().ok());
    events
        .or_else(|| parse_duration_ns(window).ok())
        .unwrap_or(u64::MAX)
}

/// Recall of single members by their reconstruction, extractor and window.
pub(super) fn parts(view: &View<'_>, figures: &mut Figures) -> Section {
    let mut section = Section::new("parts", "Reconstructions, extractors and windows");
    let (rows, what) = view.frames_alone();
    if rows.iter().all(|r| part(&r.subset, PARTS[0]).is_none()) {
        section.lacks("No single members were evaluated; give --subsets single, or leave --subsets out.");
        return section;
    }
    let mut pictures = Vec::new();
    for which in PARTS {
        let mut names: Vec<&str> = Vec::new();
        for name in rows.iter().filter_map(|r| part(&r.subset, which)) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        if which == "window" {
            names.sort_by_key(|name| length(name));
        }
        let group = |name: &&str| Group {
            name: (*name).to_owned(),
            bars: view
                .conditions
                .iter()
                .enumerate()
                .filter_map(|(at, condition)| {
                    let these = rows.iter().copied().filter(|r| {
                        part(&r.subset, which) == Some(name) && view.condition(&r.pair) == condition
                    });
                    let values: Vec<f64> = these.clone().map(recall).collect();
                    let (low, high) = (
                        values.iter().copied().fold(f64::INFINITY, f64::min),
                        values.iter().copied().fold(0.0, f64::max),
                    );
                    let value = mean_recall(these)?;
                    Some(Bar {
                        series: at,
                        value,
                        range: (values.len() > 1).then_some((low, high)),
                        title: format!("{name}, {condition}: {value:.4}, from {low:.4} to {high:.4}"),
                    })
                })
                .collect(),
        };
        let groups: Vec<Group> = names.iter().map(group).collect();
        let caption = format!("By {which}: mean over pairs and members, with the least and the most.");
        let name = format!("by_{which}");
        pictures.push(bars(
            &name,
            &caption,
            "Recall@1 of all queries",
            1.0,
            &view.conditions,
            &groups,
        ));
    }
    section.pictures(&pictures);
    section.say(&format!("Of {what}."));
    figures.extend(pictures);
    section
}
