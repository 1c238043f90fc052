//! Latency of every stage: a point per tick, and the median.

use super::{BLUE, FAINT, GRID, INK, LABEL, SMALL, SKY_BLUE, TITLE, canvas, finish, text};
use crate::demo::latency::Latency;
use crate::failure::Failure;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

const SIZE: (u32, u32) = (1600, 640);
/// Half of a bar's height; the stages are 1 apart.
const HALF_BAR: f64 = 0.3;

/// Draws the picture.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn draw(path: &Path, latency: &Latency) -> Result<(), Failure> {
    let canvas = canvas(path, SIZE)?;
    let (head, body) = canvas.split_vertically(120);
    head.draw_text("Latency after the end of a tick", &text(TITLE, INK), (30, 42))?;
    let caption = format!(
        "{} ticks in real time, {} members, {:.0} k events/s, {} cores; bar and number: median, point: each tick",
        latency.ticks,
        latency.members,
        latency.events_per_s / 1e3,
        latency.cores
    );
    head.draw_text(&caption, &text(SMALL, FAINT), (30, 92))?;
    let slowest_ms = latency.stages.iter().map(|s| s.slowest_us / 1e3).fold(0.1, f64::max);
    let stages = latency.stages.len() as f64;
    let mut chart = ChartBuilder::on(&body)
        .margin_right(60)
        .margin_top(10)
        .x_label_area_size(90)
        .y_label_area_size(210)
        .build_cartesian_2d(0.0..slowest_ms * 1.15, stages - 0.5..-0.5)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .light_line_style(WHITE)
        .bold_line_style(GRID)
        .axis_style(FAINT)
        .label_style(text(SMALL, INK))
        .axis_desc_style(text(LABEL, INK))
        .x_desc("milliseconds")
        .x_label_formatter(&|v| short(*v))
        .draw()?;
    for (row, stage) in latency.stages.iter().enumerate() {
        let (y, median_ms) = (row as f64, stage.median_us / 1e3);
        let color = if stage.stage == "total" { BLUE } else { SKY_BLUE };
        let bar = Rectangle::new([(0.0, y - HALF_BAR), (median_ms, y + HALF_BAR)], color.mix(0.8).filled());
        chart.draw_series(std::iter::once(bar))?;
        let points = stage.ticks_us.iter().map(|us| (us / 1e3, y));
        chart.draw_series(points.clone().map(|at| Circle::new(at, 8, WHITE.filled())))?;
        chart.draw_series(points.map(|at| Circle::new(at, 6, INK.filled())))?;
        let (left, middle) = chart.backend_coord(&(0.0, y));
        let label = text(LABEL, INK).pos(Pos::new(HPos::Right, VPos::Center));
        canvas.draw_text(stage.stage, &label, (left - 20, middle))?;
        let beyond = stage.slowest_us.max(stage.median_us) / 1e3;
        let (x, _) = chart.backend_coord(&(beyond, y));
        canvas.draw_text(&format!("{median_ms:.2}"), &text(LABEL, INK), (x + 22, middle))?;
    }
    finish(&canvas, path)
}

/// Without zeros that say nothing.
fn short(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
