//! Recall@1 of every kind of ensembles, by day and by night.

use super::{FAINT, GRID, INK, LABEL, SMALL, TITLE, canvas, centred, finish, pass_color, pass_title, text};
use crate::demo::recall::{KindRecall, kind_title};
use crate::demo::results::Results;
use crate::failure::Failure;
use evpr_core::plan::StreetPass;
use evpr_evaluate::SubsetKind;
use plotters::prelude::*;
use std::path::Path;

const SIZE: (u32, u32) = (1600, 900);
const PASSES: [StreetPass; 2] = [StreetPass::Day2, StreetPass::Night];
/// Width of a bar; the kinds are 1 apart.
const BAR: f64 = 0.36;

/// Draws the picture.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn draw(path: &Path, results: &Results) -> Result<(), Failure> {
    let length = results.scene.sequence_length;
    let canvas = canvas(path, SIZE)?;
    let (head, body) = canvas.split_vertically(170);
    let title = format!(
        "Recall@1 within {} m, sequences of {length} ticks",
        results.scene.tolerance_m
    );
    head.draw_text(&title, &text(TITLE, INK), (30, 42))?;
    let mut x = 30;
    for pass in PASSES {
        let (style, label) = (text(LABEL, INK), pass_title(pass));
        head.draw(&Rectangle::new(
            [(x, 84), (x + 26, 110)],
            pass_color(pass).filled(),
        ))?;
        head.draw_text(label, &style, (x + 40, 98))?;
        x += 40 + head.estimate_text_size(label, &style)?.0 as i32 + 50;
    }
    let explained = "bar: mean of the ensembles of a kind; point: each of them; number: the best";
    head.draw_text(explained, &text(SMALL, FAINT), (30, 144))?;

    let kinds = SubsetKind::PAPER;
    let mut chart = ChartBuilder::on(&body)
        .margin_left(16)
        .margin_right(30)
        .x_label_area_size(84)
        .y_label_area_size(96)
        .build_cartesian_2d(-0.5..kinds.len() as f64 - 0.5, 0.0..1.1)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .disable_x_axis()
        .light_line_style(WHITE)
        .bold_line_style(GRID)
        .axis_style(FAINT)
        .y_labels(6)
        .label_style(text(SMALL, INK))
        .axis_desc_style(text(LABEL, INK))
        .y_desc("Recall@1")
        .y_label_formatter(&|v| format!("{v:.1}"))
        .draw()?;
    for (at, kind) in kinds.into_iter().enumerate() {
        for (side, pass) in [-0.5, 0.5].into_iter().zip(PASSES) {
            if let Some(recall) = results.recall_of(kind, pass, length) {
                let x = at as f64 + side * (BAR + 0.04);
                chart.draw_series(std::iter::once(bar(recall, x)))?;
                let points = points(recall, x);
                chart.draw_series(points.iter().map(|at| Circle::new(*at, 7, WHITE.filled())))?;
                chart.draw_series(points.iter().map(|at| Circle::new(*at, 5, INK.filled())))?;
                let best = recall.best().map_or(0.0, |b| b.recall_at_1);
                let label = Text::new(
                    format!("{best:.2}"),
                    (x, best.max(recall.mean) + 0.045),
                    centred(LABEL, INK),
                );
                chart.draw_series(std::iter::once(label))?;
            }
        }
        let count = results
            .recall_of(kind, PASSES[0], length)
            .map_or(0, |r| r.ensembles.len());
        let (left, bottom) = chart.backend_coord(&(at as f64, 0.0));
        canvas.draw_text(kind_title(kind), &centred(LABEL, INK), (left, bottom + 30))?;
        canvas.draw_text(&ensembles(count), &centred(SMALL, FAINT), (left, bottom + 62))?;
    }
    finish(&canvas, path)
}

fn ensembles(count: usize) -> String {
    match count {
        1 => "all members".to_owned(),
        n => format!("{n} of them"),
    }
}

/// The bar of the mean.
fn bar(recall: &KindRecall, x: f64) -> Rectangle<(f64, f64)> {
    let corners = [(x - BAR / 2.0, 0.0), (x + BAR / 2.0, recall.mean)];
    Rectangle::new(corners, pass_color(recall.pass).mix(0.75).filled())
}

/// A point for each ensemble, spread over the bar's width so that equals are seen.
fn points(recall: &KindRecall, x: f64) -> Vec<(f64, f64)> {
    let count = recall.ensembles.len().max(1) as f64;
    let along = |i: usize| 0.8 * BAR * ((i as f64 + 0.5) / count - 0.5);
    let each = recall.ensembles.iter().enumerate();
    each.map(|(i, ensemble)| (x + along(i), ensemble.recall_at_1))
        .collect()
}
