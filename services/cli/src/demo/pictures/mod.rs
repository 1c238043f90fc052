//! The pictures of the report. They are drawn at twice the size that the page shows them in, in colours that can be told
//! apart by the colour-blind (Okabe and Ito), with a bundled font.

pub(crate) mod frames;
pub(crate) mod latency;
pub(crate) mod recall;
pub(crate) mod similarity;

use crate::canvas::{Canvas, canvas, centred, finish, text};
use crate::colors::{OFF, ON};
use evpr_core::plan::StreetPass;
use plotters::prelude::*;

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
