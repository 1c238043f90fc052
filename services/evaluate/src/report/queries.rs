//! What becomes of single queries: matrices, the worst and the best ones, and the route with errors.

use super::chart::{Axis, Series, WIDTH, axes};
use super::html::{Section, escaped};
use super::look::{Frames, Look, Shown};
use super::picture::{Anchor, Color, Picture};
use super::raster::Raster;
use super::{Figures, more_pairs};
use crate::pair::Pair;
use std::fmt::Write;

/// Most queries with a mark of their own on a route.
const MAX_MARKS: usize = 600;

pub(super) fn matrices(looks: &[Look], pairs: usize, figures: &mut Figures) -> Section {
    let mut section = Section::new("matrices", "Scores of queries and places");
    if looks.is_empty() {
        section.lacks("None of the ensembles at hand was evaluated in this setting; evaluate once more into a new folder.");
        return section;
    }
    section.say(
        "Queries down, places of the map across; the darker, the higher the score after sequence matching. Blue is true, green \
         a right answer, orange a wrong one.",
    );
    for look in looks {
        let panels = look.panels.iter().enumerate();
        let pictures: Vec<Picture> = panels
            .map(|(at, panel)| panel.picture(&format!("matrix_{}_{at}", look.pair), &look.pair))
            .collect();
        section.add(&format!("<h3>{}</h3>\n", escaped(&look.pair)));
        section.pictures(&pictures);
        figures.extend(pictures);
    }
    section.add(&more_pairs(pairs));
    section
}

pub(super) fn worst_and_best(looks: &[Look], figures: &mut Figures) -> Section {
    let mut section = Section::new("queries", "Worst and best queries");
    section.say(
        "The wrong answers of which it was surest, and the right ones of which it was surest; neighbours of one that is shown \
         are left out.",
    );
    let mut any = false;
    for look in looks.iter().filter(|l| !l.shown().is_empty()) {
        any = true;
        section.add(&format!(
            "<h3>{}: {}</h3>\n",
            escaped(&look.pair),
            escaped(&look.title)
        ));
        match look.frames() {
            Frames::NotAsked => {
                section.add(&table(look));
                section.lacks(
                    "For their frames give the configuration that the traverses were recorded with: --config FILE.",
                );
            }
            Frames::Failed(why) => {
                section.add(&table(look));
                section.lacks(&format!("There are no frames: {why}"));
            }
            Frames::Of(what) => {
                section.add(&format!(
                    "<p class=\"caption\">Frames of {}.</p>\n",
                    escaped(what)
                ));
                section.add("<div class=\"queries\">");
                for shown in look.shown() {
                    section.add(&card(shown));
                }
                section.add("</div>\n");
                for (at, shown) in look.shown().iter().enumerate() {
                    let name = format!("query_{}_{at}", look.pair);
                    figures.extend([strip(&name, shown)]);
                }
            }
        }
    }
    if !any {
        section.lacks("No query that has a right place was answered.");
    }
    section
}

/// How far an answer is off.
fn off(shown: &Shown) -> String {
    let ticks = match shown.error_ticks {
        Some(0) | None => String::new(),
        Some(1) => "1 tick off".to_owned(),
        Some(n) => format!("{n} ticks off"),
    };
    match shown.error_m {
        Some(m) if ticks.is_empty() => format!("{m:.1} m"),
        Some(m) => format!("{m:.1} m, {ticks}"),
        None => ticks,
    }
}

fn verdict(shown: &Shown) -> String {
    let (word, off) = (if shown.is_right { "right" } else { "wrong" }, off(shown));
    let off = if off.is_empty() { off } else { format!(" ({off})") };
    format!(
        "query {}: {word}{off}, confidence {:.3}",
        shown.query, shown.confidence
    )
}

const SEEN: [&str; 3] = ["query", "answer", "right place"];

fn places(shown: &Shown) -> [usize; 3] {
    [shown.query, shown.answer, shown.right]
}

fn card(shown: &Shown) -> String {
    let class = if shown.is_right { "right" } else { "wrong" };
    let mut out = format!(
        "<div class=\"query {class}\"><p>{}</p><div>",
        escaped(&verdict(shown))
    );
    for ((what, place), frame) in SEEN.iter().zip(places(shown)).zip(&shown.frames) {
        let seen = match frame {
            Some(frame) => format!("<img alt=\"{what} {place}\" src=\"{}\">", frame.data_address()),
            None => "<span class=\"none\">no frame</span>".to_owned(),
        };
        // Writing into a string cannot fail.
        let _ = write!(
            out,
            "<figure>{seen}<figcaption>{what} {place}</figcaption></figure>"
        );
    }
    out + "</div></div>\n"
}

fn table(look: &Look) -> String {
    let mut table = super::html::Table::new(&[
        "query",
        "answer",
        "right place",
        "verdict",
        "confidence",
        "off by",
    ]);
    for s in look.shown() {
        table.row(vec![
            s.query.to_string(),
            s.answer.to_string(),
            s.right.to_string(),
            if s.is_right { "right" } else { "wrong" }.to_owned(),
            format!("{:.3}", s.confidence),
            off(s),
        ]);
    }
    table.html()
}

/// The three frames in a row.
fn strip(name: &str, shown: &Shown) -> Picture {
    let wide = (WIDTH - 40.0) / 3.0;
    let size = |f: &Raster| f.height as f64 * wide / f.width.max(1) as f64;
    let high = shown.frames.iter().flatten().map(size).fold(40.0, f64::max);
    let mut picture = Picture::new(name, &verdict(shown), WIDTH, high + 50.0);
    picture.text((10.0, 16.0), &verdict(shown), Anchor::Start, Color::Ink);
    for (at, (what, place)) in SEEN.iter().zip(places(shown)).enumerate() {
        let left = 10.0 + at as f64 * (wide + 10.0);
        if let Some(frame) = &shown.frames[at] {
            picture.image((left, 24.0), (wide, size(frame)), frame.clone());
        }
        picture.text(
            (left, high + 40.0),
            &format!("{what} {place}"),
            Anchor::Start,
            Color::Faint,
        );
    }
    picture
}

pub(super) fn routes(looks: &[Look], pairs: &[Pair], figures: &mut Figures) -> Section {
    let mut section = Section::new("route", "The route with errors");
    let mut pictures = Vec::new();
    let mut without: Vec<&str> = Vec::new();
    for look in looks {
        let Some(pair) = pairs.iter().find(|p| p.name() == look.pair) else {
            continue;
        };
        match route(look, pair) {
            Some(picture) => pictures.push(picture),
            None => without.push(&look.pair),
        }
        pictures.push(errors(look));
    }
    if looks.is_empty() {
        section.lacks("There is nothing to show: see the matrices.");
        return section;
    }
    section.pictures(&pictures);
    figures.extend(pictures);
    if !without.is_empty() {
        section.lacks(&format!(
            "There is no route of {}: its traverses have no positions. Record them with [positions] in the configuration, or \
             give maps --positions.",
            without.join(", ")
        ));
    }
    section.add(&more_pairs(pairs.len()));
    section
}

/// The map's route, and on it the queries, wrong ones joined to where they were taken to be.
fn route(look: &Look, pair: &Pair) -> Option<Picture> {
    let all = pair
        .reference_positions
        .iter()
        .chain(&pair.query_positions)
        .flatten();
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for position in all {
        for axis in 0..2 {
            low[axis] = low[axis].min(position[axis]);
            high[axis] = high[axis].max(position[axis]);
        }
    }
    if !pair.query_positions.iter().any(Option::is_some)
        || !pair.reference_positions.iter().any(Option::is_some)
    {
        return None;
    }
    let (wide, high_m) = ((high[0] - low[0]).max(1.0), (high[1] - low[1]).max(1.0));
    let scale = ((WIDTH - 40.0) / wide).min(320.0 / high_m);
    let tall = (high_m * scale).max(60.0);
    let (left, top) = ((WIDTH - wide * scale) / 2.0, 20.0 + (tall - high_m * scale) / 2.0);
    // East to the right, north up.
    let at = |p: [f64; 2]| (left + (p[0] - low[0]) * scale, top + (high[1] - p[1]) * scale);
    let step = look.outcomes.len().div_ceil(MAX_MARKS).max(1);
    let thinned = match step {
        1 => String::new(),
        n => format!(" Every {n}th query."),
    };
    let caption = format!(
        "{}: the map's route, east to the right and north up; wrong answers are joined to the place that was answered.{thinned}",
        look.pair
    );
    let mut picture = Picture::new(&format!("route_{}", look.pair), &caption, WIDTH, tall + 70.0);
    let mut stretch: Vec<(f64, f64)> = Vec::new();
    for position in &pair.reference_positions {
        match position {
            Some(p) => stretch.push(at(*p)),
            None => picture.line(std::mem::take(&mut stretch), Color::Faint, 2.0),
        }
    }
    picture.line(stretch, Color::Faint, 2.0);
    let queries = look
        .outcomes
        .iter()
        .zip(&pair.query_positions)
        .enumerate()
        .step_by(step);
    let known = queries.filter_map(|(q, (outcome, position))| Some((q, outcome, at((*position)?))));
    let known: Vec<_> = known.collect();
    for (_, outcome, from) in known.iter().filter(|k| !k.1.is_right()) {
        let place = outcome
            .answer
            .and_then(|a| pair.reference_positions.get(a as usize).copied().flatten());
        if let Some(place) = place {
            picture.line(vec![*from, at(place)], Color::Wrong, 0.7);
        }
    }
    for (query, outcome, from) in known {
        let color = match outcome.answer {
            None => Color::Grid,
            Some(_) if outcome.is_right() => Color::Right,
            Some(_) => Color::Wrong,
        };
        let off = look.errors_m.get(query).copied().flatten();
        let off = off.map_or_else(String::new, |m| format!(", {m:.1} m off"));
        picture.dot(from, 3.0, color, &format!("query {query}{off}"));
    }
    let bar_m = round_length(wide / 4.0);
    let floor = tall + 38.0;
    picture.line(
        vec![(20.0, floor), (20.0 + bar_m * scale, floor)],
        Color::Ink,
        2.0,
    );
    let text = format!("{} m", super::chart::short(bar_m));
    picture.text(
        (28.0 + bar_m * scale, floor + 4.0),
        &text,
        Anchor::Start,
        Color::Ink,
    );
    let entries = [
        ("the map", Color::Faint),
        ("right", Color::Right),
        ("wrong", Color::Wrong),
        ("no answer", Color::Grid),
    ];
    let entries = entries.map(|(name, color)| (name.to_owned(), color));
    picture.height = picture.legend(floor + 12.0, &entries);
    Some(picture)
}

/// 1, 2 or 5 times a power of ten, not above this.
fn round_length(most: f64) -> f64 {
    let unit = 10f64.powf(most.max(1e-3).log10().floor());
    let fits = |step: &f64| step * unit <= most;
    [5.0, 2.0, 1.0].into_iter().find(fits).unwrap_or(1.0) * unit
}

/// How far each answer is off, along the drive.
fn errors(look: &Look) -> Picture {
    let in_metres = look.errors_m.iter().any(Option::is_some);
    let error = |q: usize| {
        if in_metres {
            look.errors_m[q]
        } else {
            look.errors_ticks[q].map(|t| t as f64)
        }
    };
    let step = look.outcomes.len().div_ceil(MAX_MARKS).max(1);
    let known: Vec<(usize, f64)> = (0..look.outcomes.len())
        .step_by(step)
        .filter_map(|q| Some((q, error(q)?)))
        .collect();
    let most = known.iter().map(|(_, e)| *e).fold(1.0, f64::max);
    let series =
        [(true, "right", Color::Right), (false, "wrong", Color::Wrong)].map(|(is_right, name, color)| {
            Series {
                name: name.to_owned(),
                color,
                points: known
                    .iter()
                    .filter(|(q, _)| look.outcomes[*q].is_right() == is_right)
                    .map(|(q, e)| (*q as f64, *e, format!("query {q}: {e:.1}")))
                    .collect(),
                joined: false,
            }
        });
    let up = if in_metres {
        "error, m"
    } else {
        "error, ticks of the map"
    };
    axes(
        &format!("errors_along_{}", look.pair),
        &format!("{}: how far each answer is off, along the drive.", look.pair),
        Axis::new("query, ticks", 0.0, look.outcomes.len() as f64),
        Axis::new(up, 0.0, most * 1.05),
        &series,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_scales_are_round() {
        assert_eq!([0.7, 1.0, 34.0, 60.0].map(round_length), [0.5, 1.0, 20.0, 50.0]);
    }
}
