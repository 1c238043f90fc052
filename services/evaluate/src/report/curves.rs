//! Curves of each pair: precision and recall by confidence, calibration, recall by tolerance.

use super::chart::{Axis, Series, axes};
use super::html::Section;
use super::view::{View, kind_title, recall};
use super::{Figures, MAX_PAIRS, more_pairs};
use crate::measure::{FRAMES, TOLERANCES_M};
use crate::results::Row;

/// The best row of each kind on a pair, in the main setting.
fn best_of_kinds<'a>(view: &View<'a>, pair: &str) -> Vec<&'a Row> {
    let best = |kind| {
        let rows = view.main_rows().filter(|r| r.pair == pair && r.kind == kind);
        rows.max_by(|a, b| recall(a).total_cmp(&recall(b)).then_with(|| b.key.cmp(&a.key)))
    };
    view.kinds().into_iter().filter_map(best).collect()
}

fn title(row: &Row) -> String {
    match row.kind {
        crate::SubsetKind::Combined => format!("combined, L={}", row.length),
        kind => format!("{} {}, L={}", kind_title(kind), row.subset, row.length),
    }
}

/// A curve per kind, for each pair. `draw` gives the points of a row.
fn per_pair(
    view: &View<'_>,
    draw: impl Fn(&Row) -> Vec<(f64, f64)>,
    picture: impl Fn(&str, &[Series]) -> super::Picture,
) -> Vec<super::Picture> {
    let pairs = view.pairs.iter().take(MAX_PAIRS);
    pairs
        .map(|pair| {
            let best = best_of_kinds(view, pair);
            let series = best.iter().enumerate();
            let series = series.map(|(at, r)| Series::line(title(r), at, draw(r).into_iter()));
            picture(pair, &series.collect::<Vec<_>>())
        })
        .collect()
}

fn finish(
    mut section: Section,
    view: &View<'_>,
    pictures: Vec<super::Picture>,
    figures: &mut Figures,
) -> Section {
    section.pictures(&pictures);
    section.add(&more_pairs(view.pairs.len()));
    figures.extend(pictures);
    section
}

pub(super) fn precision_recall(view: &View<'_>, figures: &mut Figures) -> Section {
    let mut section = Section::new("precision", "Precision and recall by confidence");
    section.say("The best ensemble of each kind on each pair. From left to right answers of falling confidence are let in.");
    let draw = |row: &Row| {
        let points = row.measures.precision_recall.iter();
        points.map(|p| (p.recall, p.precision)).collect()
    };
    let pictures = per_pair(view, draw, |pair, series| {
        axes(
            &format!("precision_recall_{pair}"),
            &format!("{pair}: precision over recall."),
            Axis::share("recall of the queries that have a right place"),
            Axis::share("precision"),
            series,
        )
    });
    finish(section, view, pictures, figures)
}

pub(super) fn calibration(view: &View<'_>, figures: &mut Figures) -> Section {
    let mut section = Section::new("calibration", "Calibration");
    section.say(
        "Per tenth of confidence the share of answers that are right; tenths without answers are left out. Confidence is the \
         margin against the best place elsewhere, not a probability; with the method filter it is one.",
    );
    let draw = |row: &Row| {
        let table = row.calibration();
        let with_answers = table.iter().filter(|b| b.answers > 0);
        with_answers
            .map(|b| {
                (
                    f64::from(b.from) / 1000.0 + 0.05,
                    f64::from(b.right) / f64::from(b.answers),
                )
            })
            .collect()
    };
    let pictures = per_pair(view, draw, |pair, series| {
        axes(
            &format!("calibration_{pair}"),
            &format!("{pair}: right answers by confidence."),
            Axis::share("confidence"),
            Axis::share("share of right answers"),
            series,
        )
    });
    finish(section, view, pictures, figures)
}

pub(super) fn tolerance(view: &View<'_>, figures: &mut Figures) -> Section {
    let mut section = Section::new("tolerance", "Recall by tolerance");
    section.say("How recall grows with what counts as right; the best ensemble of each kind on each pair.");
    let in_metres = |pair: &str| {
        let rows = view.main_rows().filter(|r| r.pair == pair);
        rows.clone().any(|r| !r.measures.by_tolerance_m.is_empty())
    };
    let draw = |row: &Row| -> Vec<(f64, f64)> {
        let m = &row.measures;
        if m.by_tolerance_m.is_empty() {
            let frames = FRAMES.iter().zip(&m.by_frames);
            frames.map(|(f, s)| (*f as f64, s.of_all)).collect()
        } else {
            let metres = TOLERANCES_M.iter().zip(&m.by_tolerance_m);
            metres.map(|(t, s)| (*t, s.of_all)).collect()
        }
    };
    let pictures = per_pair(view, draw, |pair, series| {
        let along = if in_metres(pair) {
            Axis::new("tolerance, m", 0.0, 70.0)
        } else {
            Axis::new("ticks of the map beside a right place", 0.0, 20.0)
        };
        axes(
            &format!("tolerance_{pair}"),
            &format!("{pair}: recall by tolerance."),
            along,
            Axis::share("Recall@1 of all queries"),
            series,
        )
    });
    finish(section, view, pictures, figures)
}
