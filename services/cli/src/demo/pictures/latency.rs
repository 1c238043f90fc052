//! Latency of every stage: a point per tick, and the median.

use super::{BLUE, FAINT, GRID, INK, LABEL, SMALL, TITLE, VERMILLION, canvas, finish, text};
use crate::demo::latency::Latency;
use crate::failure::Failure;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

const SIZE: (u32, u32) = (1600, 620);
/// Room for the numbers at the right.
const NUMBERS: u32 = 330;
/// Half of a median's height; the stages are 1 apart.
const HALF: f64 = 0.32;

/// Draws the picture.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn draw(path: &Path, latency: &Latency) -> Result<(), Failure> {
    let canvas = canvas(path, SIZE)?;
    let (head, body) = canvas.split_vertically(120);
    head.draw_text("Latency after the end of a tick", &text(TITLE, INK), (30, 42))?;
    let caption = format!(
        "{} ticks in real time (a point each), {} members, {:.0} k events/s, {} cores",
        latency.ticks,
        latency.members,
        latency.events_per_s / 1e3,
        latency.cores
    );
    head.draw_text(&caption, &text(SMALL, FAINT), (30, 92))?;
    let right = text(LABEL, INK).pos(Pos::new(HPos::Right, VPos::Center));
    let numbers = [SIZE.0 as i32 - 180, SIZE.0 as i32 - 40];
    for (name, x) in ["median", "slowest"].into_iter().zip(numbers) {
        let style = text(SMALL, FAINT).pos(Pos::new(HPos::Right, VPos::Center));
        canvas.draw_text(name, &style, (x, 128))?;
    }
    let (low, high) = decades(latency);
    let mut chart = ChartBuilder::on(&body)
        .margin_right(NUMBERS)
        .margin_top(30)
        .x_label_area_size(90)
        .y_label_area_size(210)
        .build_cartesian_2d((low..high).log_scale(), latency.stages.len() as f64 - 0.5..-0.5)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .light_line_style(RGBColor(0xf1, 0xf2, 0xf4))
        .bold_line_style(GRID)
        .axis_style(FAINT)
        .label_style(text(SMALL, INK))
        .axis_desc_style(text(LABEL, INK))
        .x_desc("milliseconds (logarithmic)")
        .x_label_formatter(&|v| format!("{v}"))
        .draw()?;
    for (row, stage) in latency.stages.iter().enumerate() {
        let (y, median_ms, slowest_ms) = (row as f64, stage.median_us / 1e3, stage.slowest_us / 1e3);
        let points = stage.ticks_us.iter().map(|us| ((us / 1e3).max(low), y));
        chart.draw_series(points.map(|at| Circle::new(at, 9, BLUE.mix(0.55).filled())))?;
        let at = median_ms.max(low);
        let median = PathElement::new([(at, y - HALF), (at, y + HALF)], VERMILLION.stroke_width(5));
        chart.draw_series(std::iter::once(median))?;
        let (left, middle) = chart.backend_coord(&(low, y));
        canvas.draw_text(stage.stage, &right, (left - 20, middle + 4))?;
        for (ms, x) in [median_ms, slowest_ms].into_iter().zip(numbers) {
            canvas.draw_text(&format!("{ms:.2}"), &right, (x, middle + 4))?;
        }
    }
    finish(&canvas, path)
}

/// Powers of ten around all values, ms.
fn decades(latency: &Latency) -> (f64, f64) {
    let all = latency.stages.iter().flat_map(|s| &s.ticks_us);
    let (low, high) = all.fold((1.0f64, 1.0f64), |(low, high), us| {
        let ms = (us / 1e3).clamp(1e-3, 1e5);
        (low.min(ms), high.max(ms))
    });
    // A hair more, so that the ends have their labels.
    (
        0.999 * 10f64.powf(low.log10().floor()),
        10f64.powf((high * 1.001).log10().ceil()),
    )
}
