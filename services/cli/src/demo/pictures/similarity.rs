//! Fused scores of every query and place, with the answers marked right and wrong.

use super::{BLUE, FAINT, GREEN, INK, LABEL, SMALL, TITLE, VERMILLION, canvas, finish, pass_title, text};
use crate::demo::matrix::ScoreMatrix;
use crate::demo::recall::{Recorded, TOLERANCE_M};
use crate::failure::Failure;
use plotters::prelude::*;
use std::path::Path;

const SIZE: (u32, u32) = (1120, 1240);
/// Scores outside these shares of all scores are as light or as dark as those at them.
const SHADES: (f64, f64) = (0.02, 0.995);
/// The darkest shade: marks must stand out from it.
const DARKEST: f64 = 0.62;

/// Draws the picture of one drive.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn draw(path: &Path, recorded: &Recorded, matrix: &ScoreMatrix) -> Result<(), Failure> {
    let canvas = canvas(path, SIZE)?;
    let (head, rest) = canvas.split_vertically(128);
    let (body, foot) = rest.split_vertically(SIZE.1 - 128 - 64);
    let right = |query: usize| matrix.answers[query].is_some_and(|r| recorded.truth.is_right(query, r));
    let count = recorded.truth.recall(&matrix.answers).right;
    head.draw_text(
        &format!("Fused scores, {}", pass_title(recorded.pass)),
        &text(TITLE, INK),
        (30, 42),
    )?;
    let caption = format!(
        "{} members, sequences of {} ticks: {count} of {} answers within {TOLERANCE_M} m",
        recorded.plan.members.len(),
        recorded.plan.fuse.length,
        matrix.answers.len(),
    );
    head.draw_text(&caption, &text(SMALL, FAINT), (30, 92))?;

    let (columns, rows) = (matrix.references as f64, matrix.rows.len() as f64);
    let mut chart = ChartBuilder::on(&body)
        .margin_left(16)
        .margin_right(36)
        .x_label_area_size(86)
        .y_label_area_size(104)
        .build_cartesian_2d(0.0..columns, rows..0.0)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .axis_style(FAINT)
        .label_style(text(SMALL, INK))
        .axis_desc_style(text(LABEL, INK))
        .x_desc("place in the map, tick of the first drive")
        .y_desc("tick of this drive")
        .x_label_formatter(&|v| format!("{v:.0}"))
        .y_label_formatter(&|v| format!("{v:.0}"))
        .draw()?;
    let (low, high) = (
        matrix.quantile(SHADES.0).unwrap_or(0.0),
        matrix.quantile(SHADES.1).unwrap_or(1.0),
    );
    let cells = matrix.rows.iter().enumerate().flat_map(|(q, row)| {
        let scored = row.iter().enumerate().filter(|(_, score)| score.is_finite());
        scored.map(move |(r, score)| {
            let (x, y) = (r as f64, q as f64);
            Rectangle::new([(x, y), (x + 1.0, y + 1.0)], shade(*score, low, high).filled())
        })
    });
    chart.draw_series(cells)?;
    let middle = |v: usize| v as f64 + 0.5;
    let truth =
        (0..matrix.answers.len()).filter_map(|q| Some((middle(recorded.positions.nearest(q)?.0), middle(q))));
    chart.draw_series(std::iter::once(PathElement::new(
        truth.collect::<Vec<_>>(),
        BLUE.stroke_width(3),
    )))?;
    let answered = matrix
        .answers
        .iter()
        .enumerate()
        .filter_map(|(q, r)| Some((q, (*r)?)));
    for (query, reference) in answered {
        let at = (middle(reference), middle(query));
        if right(query) {
            chart.draw_series(std::iter::once(Circle::new(at, 6, GREEN.filled())))?;
        } else {
            chart.draw_series(std::iter::once(Cross::new(at, 7, VERMILLION.stroke_width(3))))?;
        }
    }
    legend(&foot)?;
    finish(&canvas, path)
}

fn legend(area: &super::Canvas<'_>) -> Result<(), Failure> {
    let y = 26;
    let style = text(SMALL, INK);
    area.draw(&Circle::new((50, y), 8, GREEN.filled()))?;
    area.draw_text("right", &style, (70, y))?;
    area.draw(&Cross::new((180, y), 9, VERMILLION.stroke_width(4)))?;
    area.draw_text("wrong", &style, (202, y))?;
    area.draw(&PathElement::new([(310, y), (350, y)], BLUE.stroke_width(4)))?;
    area.draw_text("nearest place", &style, (364, y))?;
    for step in 0..120 {
        let at = [(590 + step, y - 12), (591 + step, y + 12)];
        area.draw(&Rectangle::new(at, shade(f64::from(step), 0.0, 119.0).filled()))?;
    }
    area.draw_text("darker: more alike", &style, (728, y))?;
    Ok(())
}

/// From white for what is least alike to dark grey.
fn shade(score: f64, low: f64, high: f64) -> RGBColor {
    let share = ((score - low) / (high - low).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let level = (255.0 * (1.0 - DARKEST * share)) as u8;
    RGBColor(level, level, level)
}
