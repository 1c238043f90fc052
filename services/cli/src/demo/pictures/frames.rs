//! Frames of every method by day and by night: methods down, drives across.

use super::{Canvas, FAINT, INK, LABEL, ORANGE, SKY_BLUE, SMALL, TITLE, canvas, finish, pass_title, text};
use crate::demo::frames::{Frame, Place};
use crate::failure::Failure;
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
    let mut pixels = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let pixel = (y / zoom) * sensor.width + x / zoom;
            pixels.extend(frame.map_or([0xee; 3], |frame| color_of(frame, pixel)));
        }
    }
    if let Some(image) = BitMapElement::with_owned_buffer(at, (width as u32, height as u32), pixels) {
        canvas.draw(&image)?;
    }
    Ok(())
}

/// A pixel in red, green and blue: of two polarities, each in its colour.
fn color_of(frame: &Frame, pixel: usize) -> [u8; 3] {
    let channels = frame.order.channels();
    let value = |channel: usize| frame.pixels.get(pixel * channels + channel).copied().unwrap_or(0);
    match frame.order {
        ChannelOrder::Grey => [value(0); 3],
        ChannelOrder::BlueGreenRed => [value(2), value(1), value(0)],
        ChannelOrder::OffOnZero => mixed(value(1), value(0)),
        ChannelOrder::OnOffZero => mixed(value(0), value(1)),
    }
}

fn mixed(on: u8, off: u8) -> [u8; 3] {
    let (RGBColor(r, g, b), RGBColor(s, h, c)) = (ORANGE, SKY_BLUE);
    let mix =
        |a: u8, z: u8| ((u32::from(a) * u32::from(on) + u32::from(z) * u32::from(off)) / 255).min(255) as u8;
    [mix(r, s), mix(g, h), mix(b, c)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polarities_keep_their_colours_whatever_the_order_of_channels() {
        let frame = |order, pixels: &[u8]| Frame {
            order,
            pixels: pixels.to_vec(),
        };
        let orange = [ORANGE.0, ORANGE.1, ORANGE.2];
        let sky = [SKY_BLUE.0, SKY_BLUE.1, SKY_BLUE.2];
        assert_eq!(color_of(&frame(ChannelOrder::OffOnZero, &[0, 255, 0]), 0), orange);
        assert_eq!(color_of(&frame(ChannelOrder::OnOffZero, &[255, 0, 0]), 0), orange);
        assert_eq!(
            color_of(&frame(ChannelOrder::OffOnZero, &[0, 0, 0, 255, 0, 0]), 1),
            sky
        );
        assert_eq!(color_of(&frame(ChannelOrder::OnOffZero, &[0, 255, 0]), 0), sky);
        assert_eq!(color_of(&frame(ChannelOrder::Grey, &[7]), 0), [7; 3]);
        assert_eq!(
            color_of(&frame(ChannelOrder::OffOnZero, &[255, 255, 0]), 0)[1],
            255
        );
    }
}
