//! What pictures are drawn on: a bundled font, and PNG files.

use crate::failure::Failure;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

/// DejaVu Sans; its licence lies beside it.
static FONT: &[u8] = include_bytes!("../assets/DejaVuSans.ttf");
/// What it is called here.
const FAMILY: &str = "sans-serif";

pub(crate) type Canvas<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

/// A white picture of this width and height in pixels, to be written to `path` by its `present`.
pub(crate) fn canvas(path: &Path, size: (u32, u32)) -> Result<Canvas<'_>, Failure> {
    register_font(FAMILY, FontStyle::Normal, FONT)
        .map_err(|_| Failure::new("the bundled font cannot be used; this is a fault of evpr"))?;
    let canvas = BitMapBackend::new(path, size).into_drawing_area();
    canvas.fill(&WHITE)?;
    Ok(canvas)
}

/// Writes the file.
pub(crate) fn finish(canvas: &Canvas<'_>, path: &Path) -> Result<(), Failure> {
    canvas
        .present()
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", path.display())))
}

/// Letters of this size and colour, placed by their left and vertical middle.
pub(crate) fn text(size: u32, color: RGBColor) -> TextStyle<'static> {
    (FAMILY, size)
        .into_font()
        .color(&color)
        .pos(Pos::new(HPos::Left, VPos::Center))
}

/// As [`text`], placed by their middle.
pub(crate) fn centred(size: u32, color: RGBColor) -> TextStyle<'static> {
    text(size, color).pos(Pos::new(HPos::Center, VPos::Center))
}
