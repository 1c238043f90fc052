//! Frames of every method by day and by night: methods down, drives across.

use super::{Canvas, FAINT, INK, LABEL, ORANGE, SKY_BLUE, SMALL, TITLE, canvas, finish, pass_title, text};
use crate::colors;
use crate::demo::frames::Place;
use crate::failure::Failure;
use crate::seen::Frame;
use evpr_core::message::ChannelOrder;
use evpr_core::plan::Sensor;
use plotters::element::BitMapElement;
use plotters::prelude::*;
use std::path::Path;

/// Width that a frame is drawn in, at most, pixels.
const FRAME_WIDTH: usize = 520;
const MARGIN: i32 = 30;
const GAP: i32 = 20;
const HEAD: i32 = 150;
const ROW_HEAD: i32 = 54;

/// Draws the picture.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn draw(path: &Path, place: &Place) -> Result<(), Failure> {
    let zoom = (FRAME_WIDTH / place.sensor.width.max(1)).max(1);
    let (width, height) = (place.sensor.width * zoom, place.sensor.height * zoom);
    let (columns, rows) = (place.seen.len() as i32, place.methods.len() as i32);
    let (step_x, step_y) = (width as i32 + GAP, height as i32 + ROW_HEAD + GAP);
    let size = (
        2 * MARGIN + columns * step_x - GAP,
        HEAD + rows * step_y - GAP + MARGIN,
    );
    let canvas = canvas(path, (size.0.unsigned_abs(), size.1.unsigned_abs()))?;
    let title = format!("One place, as the methods see it within {}", place.window);
    canvas.draw_text(&title, &text(TITLE, INK), (MARGIN, 40))?;
    for (column, seen) in (0..).zip(&place.seen) {
        let x = MARGIN + column * step_x;
        canvas.draw_text(pass_title(seen.pass), &text(LABEL, INK), (x, 92))?;
        let where_ = format!("tick {}, {:.1} m along the street", seen.tick, seen.along_m);
        canvas.draw_text(&where_, &text(SMALL, FAINT), (x, 124))?;
        for (row, frame) in (0..).zip(&seen.frames) {
            let at = (x, HEAD + row * step_y + ROW_HEAD);
            frame_at(&canvas, at, place.sensor, zoom, frame.as_ref())?;
        }
    }
    let orders = place.seen.first().map_or(&[][..], |s| &s.frames);
    for (row, method) in (0..).zip(&place.methods) {
        let y = HEAD + row * step_y + ROW_HEAD / 2 + 6;
        let order = orders.get(row as usize).and_then(|f| f.as_ref().map(|f| f.order));
        legend(&canvas, (MARGIN, y), method, order)?;
    }
    finish(&canvas, path)
}

/// The method's name, and what its colours mean.
fn legend(
    canvas: &Canvas<'_>,
    at: (i32, i32),
    method: &str,
    order: Option<ChannelOrder>,
) -> Result<(), Failure> {
    let style = text(LABEL, INK);
    canvas.draw_text(method, &style, at)?;
    let (wide, _) = canvas.estimate_text_size(method, &style)?;
    let mut x = at.0 + wide as i32 + 36;
    let meanings = match order {
        Some(ChannelOrder::OffOnZero | ChannelOrder::OnOffZero) => &[
            ("brighter", Some(ORANGE)),
            ("darker", Some(SKY_BLUE)),
            ("white: both", None),
        ][..],
        Some(ChannelOrder::Grey) => &[("lighter: more", None)],
        _ => &[],
    };
    let style = text(SMALL, FAINT);
    for (meaning, color) in meanings {
        if let Some(color) = color {
            let square = [(x, at.1 - 10), (x + 22, at.1 + 12)];
            canvas.draw(&Rectangle::new(square, color.filled()))?;
            x += 32;
        }
        canvas.draw_text(meaning, &style, (x, at.1))?;
        x += canvas.estimate_text_size(meaning, &style)?.0 as i32 + 30;
    }
    Ok(())
}

/// One frame, each of its pixels `zoom` pixels wide and high; grey where there is none.
fn frame_at(
    canvas: &Canvas<'_>,
    at: (i32, i32),
    sensor: Sensor,
    zoom: usize,
    frame: Option<&Frame>,
) -> Result<(), Failure> {
    let (width, height) = (sensor.width * zoom, sensor.height * zoom);
    let colors: Vec<[u8; 3]> = match frame {
        Some(frame) => colors::pixels(frame.order, &frame.pixels)
            .map(|pixel| colors::color(frame.order, pixel))
            .collect(),
        None => vec![[0xee; 3]; sensor.pixels()],
    };
    let mut pixels = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let pixel = (y / zoom) * sensor.width + x / zoom;
            pixels.extend(colors.get(pixel).copied().unwrap_or_default());
        }
    }
    if let Some(image) = BitMapElement::with_owned_buffer(at, (width as u32, height as u32), pixels) {
        canvas.draw(&image)?;
    }
    Ok(())
}
