//! The pictures of the report. They are drawn at twice the size that the page shows them in, in colours that can be told
//! apart by the colour-blind (Okabe and Ito), with a bundled font.

pub(crate) mod frames;
pub(crate) mod latency;
pub(crate) mod recall;
pub(crate) mod similarity;

use crate::colors::{OFF, ON};
use crate::failure::Failure;
use evpr_core::plan::StreetPass;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

/// DejaVu Sans; its licence lies beside it.
static FONT: &[u8] = include_bytes!("../../../assets/DejaVuSans.ttf");
/// What it is called here.
const FAMILY: &str = "sans-serif";

const INK: RGBColor = RGBColor(0x22, 0x26, 0x2a);
const FAINT: RGBColor = RGBColor(0x66, 0x6c, 0x72);
const GRID: RGBColor = RGBColor(0xdd, 0xe0, 0xe3);
const ORANGE: RGBColor = RGBColor(ON[0], ON[1], ON[2]);
const SKY_BLUE: RGBColor = RGBColor(OFF[0], OFF[1], OFF[2]);
const GREEN: RGBColor = RGBColor(0x00, 0x9e, 0x73);
const BLUE: RGBColor = RGBColor(0x00, 0x72, 0xb2);
const VERMILLION: RGBColor = RGBColor(0xd5, 0x5e, 0x00);

/// Sizes of letters, pixels.
const TITLE: u32 = 34;
const LABEL: u32 = 26;
const SMALL: u32 = 23;

type Canvas<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

/// A white picture of this width and height in pixels, to be written to `path` by its `present`.
fn canvas(path: &Path, size: (u32, u32)) -> Result<Canvas<'_>, Failure> {
    register_font(FAMILY, FontStyle::Normal, FONT)
        .map_err(|_| Failure::new("the bundled font cannot be used; this is a fault of evpr"))?;
    let canvas = BitMapBackend::new(path, size).into_drawing_area();
    canvas.fill(&WHITE)?;
    Ok(canvas)
}

/// Writes the file.
fn finish(canvas: &Canvas<'_>, path: &Path) -> Result<(), Failure> {
    canvas
        .present()
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", path.display())))
}

/// Letters of this size and colour, placed by their left and vertical middle.
fn text(size: u32, color: RGBColor) -> TextStyle<'static> {
    (FAMILY, size)
        .into_font()
        .color(&color)
        .pos(Pos::new(HPos::Left, VPos::Center))
}

/// As [`text`], placed by their middle.
fn centred(size: u32, color: RGBColor) -> TextStyle<'static> {
    text(size, color).pos(Pos::new(HPos::Center, VPos::Center))
}

/// What a drive is called in pictures and on the page.
pub(crate) fn pass_title(pass: StreetPass) -> &'static str {
    match pass {
        StreetPass::Day => "first drive, by day (the map)",
        StreetPass::Day2 => "second drive, by day",
        StreetPass::Night => "drive by night",
    }
}

/// The colour of a drive that is recognised.
fn pass_color(pass: StreetPass) -> RGBColor {
    match pass {
        StreetPass::Night => BLUE,
        StreetPass::Day | StreetPass::Day2 => ORANGE,
    }
}
