//! Pictures as lists of shapes: the page shows them as SVG in the colours of its scheme, and they can be drawn elsewhere.

use super::html::escaped;
use super::raster::Raster;
use std::fmt::Write;

/// A colour by what it stands for. Series can be told apart by the colour-blind (Okabe and Ito).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Color {
    /// Names and numbers that matter.
    Ink,
    /// Axes' names and numbers.
    Faint,
    /// Grids.
    Grid,
    /// One of several things that are compared; they repeat after the eighth.
    Series(usize),
    /// Right answers.
    Right,
    /// Wrong answers.
    Wrong,
    /// What is true.
    Truth,
}

/// Colours of series on a light ground.
const SERIES: [[u8; 3]; 8] = [
    [0x00, 0x72, 0xb2],
    [0xe6, 0x9f, 0x00],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0xd5, 0x5e, 0x00],
    [0x56, 0xb4, 0xe9],
    [0x7a, 0x82, 0x8a],
    [0x8c, 0x6b, 0x3f],
];

impl Color {
    /// On a light ground: red, green, blue.
    pub fn rgb(self) -> [u8; 3] {
        match self {
            Self::Ink => [0x22, 0x26, 0x2a],
            Self::Faint => [0x5c, 0x63, 0x6a],
            Self::Grid => [0xdd, 0xe0, 0xe3],
            Self::Series(at) => SERIES[at % SERIES.len()],
            Self::Right => [0x00, 0x9e, 0x73],
            Self::Wrong => [0xd5, 0x5e, 0x00],
            Self::Truth => [0x00, 0x72, 0xb2],
        }
    }

    /// As the page names it.
    pub(super) fn css(self) -> String {
        match self {
            Self::Ink => "var(--ink)".to_owned(),
            Self::Faint => "var(--faint)".to_owned(),
            Self::Grid => "var(--line)".to_owned(),
            Self::Series(at) => format!("var(--c{})", at % SERIES.len()),
            Self::Right => "var(--c2)".to_owned(),
            Self::Wrong => "var(--c4)".to_owned(),
            Self::Truth => "var(--c0)".to_owned(),
        }
    }
}

/// Which end of a text lies at its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// It begins there.
    Start,
    /// Its middle is there.
    Middle,
    /// It ends there.
    End,
}

/// A shape; lengths are pixels of the picture, from its upper left corner.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)] // what they are called
pub enum Shape {
    Line {
        points: Vec<(f64, f64)>,
        color: Color,
        width: f64,
    },
    Bar {
        at: (f64, f64),
        size: (f64, f64),
        color: Color,
        /// Shown when it is pointed at.
        title: String,
    },
    Dot {
        at: (f64, f64),
        radius: f64,
        color: Color,
        /// Shown when it is pointed at.
        title: String,
    },
    Text {
        /// The foot of its letters.
        at: (f64, f64),
        text: String,
        size: f64,
        anchor: Anchor,
        color: Color,
    },
    Image {
        at: (f64, f64),
        size: (f64, f64),
        image: Raster,
    },
}

/// A picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// What its file is called, without an ending.
    pub name: String,
    /// What it shows, in a sentence.
    pub caption: String,
    /// Pixels.
    pub width: f64,
    /// Pixels.
    pub height: f64,
    /// From the back to the front.
    pub shapes: Vec<Shape>,
}

/// Size of most letters, pixels.
pub(super) const LETTERS: f64 = 12.5;

/// About how wide a text is drawn.
pub(super) fn text_width(text: &str, size: f64) -> f64 {
    text.chars().count() as f64 * size * 0.6
}

/// The text, cut so that it fits this width.
pub(super) fn fitted(text: &str, size: f64, width: f64) -> String {
    let most = (width / (size * 0.6)) as usize;
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let kept: String = text.chars().take(most.saturating_sub(1)).collect();
    kept + "…"
}

impl Picture {
    pub(super) fn new(name: &str, caption: &str, width: f64, height: f64) -> Self {
        Self {
            name: file_name(name),
            caption: caption.to_owned(),
            width,
            height,
            shapes: Vec::new(),
        }
    }

    pub(super) fn line(&mut self, points: Vec<(f64, f64)>, color: Color, width: f64) {
        self.shapes.push(Shape::Line { points, color, width });
    }

    pub(super) fn bar(&mut self, at: (f64, f64), size: (f64, f64), color: Color, title: &str) {
        let title = title.to_owned();
        self.shapes.push(Shape::Bar {
            at,
            size,
            color,
            title,
        });
    }

    pub(super) fn dot(&mut self, at: (f64, f64), radius: f64, color: Color, title: &str) {
        let title = title.to_owned();
        self.shapes.push(Shape::Dot {
            at,
            radius,
            color,
            title,
        });
    }

    pub(super) fn text(&mut self, at: (f64, f64), text: &str, anchor: Anchor, color: Color) {
        self.shapes.push(Shape::Text {
            at,
            text: text.to_owned(),
            size: LETTERS,
            anchor,
            color,
        });
    }

    pub(super) fn image(&mut self, at: (f64, f64), size: (f64, f64), image: Raster) {
        self.shapes.push(Shape::Image { at, size, image });
    }

    /// Squares with names, in as many rows as they need, from this height down. Gives where they end.
    pub(super) fn legend(&mut self, from: f64, entries: &[(String, Color)]) -> f64 {
        let (mut x, mut y) = (8.0, from + 12.0);
        for (name, color) in entries {
            let name = fitted(name, LETTERS, self.width - 34.0);
            let wide = 18.0 + text_width(&name, LETTERS) + 12.0;
            if x > 8.0 && x + wide > self.width {
                (x, y) = (8.0, y + 18.0);
            }
            self.bar((x, y - 10.0), (11.0, 11.0), *color, "");
            self.text((x + 17.0, y), &name, Anchor::Start, Color::Ink);
            x += wide;
        }
        y + 10.0
    }

    /// For the page.
    pub(super) fn svg(&self) -> String {
        let mut out = format!(
            "<figure><svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">",
            self.width,
            self.height,
            escaped(&self.caption)
        );
        for shape in &self.shapes {
            shape.svg(&mut out);
        }
        // Writing into a string cannot fail.
        let _ = writeln!(
            out,
            "</svg><figcaption>{}</figcaption></figure>",
            escaped(&self.caption)
        );
        out
    }
}

impl Shape {
    fn svg(&self, out: &mut String) {
        let titled = |title: &str| match title {
            "" => String::new(),
            title => format!("<title>{}</title>", escaped(title)),
        };
        // Writing into a string cannot fail.
        let _ = match self {
            Self::Line { points, color, width } => {
                let points: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
                write!(
                    out,
                    "<polyline fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" points=\"{}\"/>",
                    color.css(),
                    points.join(" ")
                )
            }
            Self::Bar {
                at,
                size,
                color,
                title,
            } => write!(
                out,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\">{}</rect>",
                at.0,
                at.1,
                size.0.max(0.0),
                size.1.max(0.0),
                color.css(),
                titled(title)
            ),
            Self::Dot {
                at,
                radius,
                color,
                title,
            } => write!(
                out,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius:.1}\" fill=\"{}\">{}</circle>",
                at.0,
                at.1,
                color.css(),
                titled(title)
            ),
            Self::Text {
                at,
                text,
                size,
                anchor,
                color,
            } => {
                let anchor = match anchor {
                    Anchor::Start => "start",
                    Anchor::Middle => "middle",
                    Anchor::End => "end",
                };
                write!(
                    out,
                    "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"{}\">{}</text>",
                    at.0,
                    at.1,
                    color.css(),
                    escaped(text)
                )
            }
            Self::Image { at, size, image } => write!(
                out,
                "<image x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" preserveAspectRatio=\"none\" href=\"{}\"/>",
                at.0,
                at.1,
                size.0,
                size.1,
                image.data_address()
            ),
        };
    }
}

/// A name that any file system takes.
fn file_name(name: &str) -> String {
    let plain = |c: char| {
        if c.is_ascii_alphanumeric() {
            c.to_ascii_lowercase()
        } else {
            '_'
        }
    };
    name.chars().map(plain).take(80).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_cut_to_fit() {
        assert_eq!(fitted("short", 10.0, 100.0), "short");
        let cut = fitted("a name that is far too long", 10.0, 60.0);
        assert!(cut.ends_with('…') && text_width(&cut, 10.0) <= 60.0, "{cut}");
    }

    #[test]
    fn legends_break_into_rows() {
        let mut picture = Picture::new("A/b", "", 200.0, 100.0);
        let entries: Vec<_> = (0..4).map(|i| ("a name".to_owned(), Color::Series(i))).collect();
        assert_eq!(picture.legend(0.0, &entries), 40.0);
        assert_eq!(picture.name, "a_b");
    }
}
