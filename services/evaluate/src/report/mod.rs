//! The report of an evaluation: one page that asks nobody for anything, and its figures as pictures of their own.
//!
//! Each part of the page is a module that gives a section. A part whose data is not there says in one line what to give
//! for it.

mod binning;
mod chart;
mod curves;
mod ensembles;
mod html;
mod likeness;
mod look;
mod matrix;
mod picture;
mod protocol;
mod queries;
mod raster;
mod runtime;
mod sequences;
mod summary;
mod view;

pub use look::{Look, Shown, looks};
pub use picture::{Anchor, Color, Picture, Shape};
pub use raster::Raster;
pub use runtime::check_costs;

use crate::choose::Costs;
use crate::error::EvaluateError;
use crate::pair::Pair;
use crate::results::{Results, Row, replace};
use crate::spec::Spec;
use crate::statistics::{Comparison, Members};
use html::{Section, escaped};
use view::View;

/// The page, with `{{name}}` where something goes.
const TEMPLATE: &str = include_str!("page.html");
/// Most pairs that have pictures of their own.
const MAX_PAIRS: usize = 8;

/// Figures of the page, in its order.
type Figures = Vec<Picture>;

/// What a report is made of, besides the results.
#[derive(Debug)]
pub struct Report<'a> {
    /// The pairs that were evaluated.
    pub pairs: &'a [Pair],
    /// What they were evaluated with.
    pub spec: &'a Spec,
    /// See [`looks`].
    pub looks: &'a [Look],
    /// See [`comparisons`](crate::statistics::comparisons).
    pub comparisons: &'a [Comparison],
    /// See [`members`](crate::statistics::members); empty where it was not asked for.
    pub members: &'a [Members],
    /// What stages take, where that is known.
    pub costs: Option<&'a Costs>,
}

impl Results {
    /// Writes `report.html`, and gives its figures, to be drawn as files.
    ///
    /// # Errors
    /// When it cannot be written, or the costs do not know a stage.
    pub fn write_report(&self, report: &Report<'_>) -> Result<Vec<Picture>, EvaluateError> {
        let mut figures = Figures::new();
        let page = page(self.rows(), report, &mut figures)?;
        name_apart(&mut figures);
        replace(&self.folder().join("report.html"), &page)?;
        Ok(figures)
    }
}

fn page(rows: &[Row], report: &Report<'_>, figures: &mut Figures) -> Result<String, EvaluateError> {
    let sections = sections(rows, report, figures)?;
    let links: String = sections
        .iter()
        .map(|s| format!("<a href=\"#{}\">{}</a>\n", s.id, escaped(s.title)))
        .collect();
    let body: String = sections.iter().map(Section::html).collect();
    let values = [
        ("version", env!("CARGO_PKG_VERSION")),
        ("links", links.as_str()),
        // Last, as names of pairs may hold anything.
        ("sections", body.as_str()),
    ];
    Ok(values.iter().fold(TEMPLATE.to_owned(), |page, (name, value)| {
        page.replacen(&format!("{{{{{name}}}}}"), value, 1)
    }))
}

fn sections(rows: &[Row], report: &Report<'_>, figures: &mut Figures) -> Result<Vec<Section>, EvaluateError> {
    let Some(view) = View::new(rows, report.pairs) else {
        let mut section = Section::new("summary", "Nothing was evaluated");
        section.lacks("There are no results in this folder; evaluate a pair.");
        return Ok(vec![section]);
    };
    Ok(vec![
        summary::summary(&view),
        ensembles::ensembles(&view, figures),
        ensembles::parts(&view, figures),
        sequences::sequences(&view, figures),
        binning::binning(&view, report.pairs, figures),
        protocol::lens(&view),
        runtime::runtime(&view, report.pairs, report.spec, report.costs, figures)?,
        queries::matrices(report.looks, report.pairs.len(), figures),
        queries::worst_and_best(report.looks, figures),
        queries::routes(report.looks, report.pairs, figures),
        curves::precision_recall(&view, figures),
        curves::calibration(&view, figures),
        curves::tolerance(&view, figures),
        likeness::likeness(report.members, figures),
        summary::differences(report.comparisons),
        summary::best(&view),
    ])
}

/// Gives each figure a name of its own: those of pairs may differ only in what a file's name cannot hold.
fn name_apart(figures: &mut Figures) {
    let mut taken = std::collections::BTreeSet::new();
    for figure in figures {
        let plain = figure.name.clone();
        let mut next = 2;
        while !taken.insert(figure.name.clone()) {
            figure.name = format!("{plain}_{next}");
            next += 1;
        }
    }
}

/// Says how many pairs have no pictures, where there are such.
fn more_pairs(pairs: usize) -> String {
    match pairs.saturating_sub(MAX_PAIRS) {
        0 => String::new(),
        more => format!(
            "<p class=\"caption\">The first {MAX_PAIRS} pairs; for {more} more evaluate them by themselves.</p>\n"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_names_of_their_own() {
        let mut figures: Figures = ["a b", "a-b", "a_b", "c"]
            .map(|name| Picture::new(name, "", 1.0, 1.0))
            .into();
        name_apart(&mut figures);
        let names: Vec<&str> = figures.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["a_b", "a_b_2", "a_b_3", "c"]);
    }

    #[test]
    fn without_results_the_page_says_so_and_asks_nobody_for_anything() {
        let spec = Spec {
            subsets: Vec::new(),
            similarities: Vec::new(),
            methods: Vec::new(),
            lengths: Vec::new(),
            rules: Vec::new(),
            exclusion: 0,
            weights: None,
            memory_bytes: 0,
        };
        let report = Report {
            pairs: &[],
            spec: &spec,
            looks: &[],
            comparisons: &[],
            members: &[],
            costs: None,
        };
        let page = page(&[], &report, &mut Vec::new()).unwrap();
        assert!(page.contains("There are no results in this folder"));
        for outside in ["http:", "https:", "//", "<script", "@import", "url(", "{{", "NaN"] {
            assert!(!page.contains(outside), "{outside}");
        }
    }
}
