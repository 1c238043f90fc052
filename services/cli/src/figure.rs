//! Figures of an evaluation as PNG files, at twice the size that the page shows them in.

use crate::canvas::{Canvas, canvas, finish, text};
use crate::failure::Failure;
use evpr_evaluate::report::{Anchor, Color as Role, Picture, Raster, Shape};
use plotters::element::BitMapElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

/// Pixels of the file per pixel of the page.
const ZOOM: f64 = 2.0;

/// Draws the picture.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn draw(path: &Path, picture: &Picture) -> Result<(), Failure> {
    let size = |length: f64| (length * ZOOM).ceil().clamp(1.0, 16_384.0) as u32;
    let canvas = canvas(path, (size(picture.width), size(picture.height)))?;
    for shape in &picture.shapes {
        draw_shape(&canvas, shape)?;
    }
    finish(&canvas, path)
}

fn rgb(color: Role) -> RGBColor {
    let [r, g, b] = color.rgb();
    RGBColor(r, g, b)
}

fn pixel((x, y): (f64, f64)) -> (i32, i32) {
    ((x * ZOOM).round() as i32, (y * ZOOM).round() as i32)
}

fn draw_shape(canvas: &Canvas<'_>, shape: &Shape) -> Result<(), Failure> {
    match shape {
        Shape::Line { points, color, width } => {
            let style = rgb(*color).stroke_width((width * ZOOM).round().max(1.0) as u32);
            let points: Vec<_> = points.iter().copied().map(pixel).collect();
            canvas.draw(&PathElement::new(points, style))?;
        }
        Shape::Bar { at, size, color, .. } => {
            let end = (at.0 + size.0.max(0.0), at.1 + size.1.max(0.0));
            canvas.draw(&Rectangle::new([pixel(*at), pixel(end)], rgb(*color).filled()))?;
        }
        Shape::Dot {
            at, radius, color, ..
        } => {
            canvas.draw(&Circle::new(
                pixel(*at),
                (radius * ZOOM) as i32,
                rgb(*color).filled(),
            ))?;
        }
        Shape::Text {
            at,
            text: words,
            size,
            anchor,
            color,
        } => {
            let side = match anchor {
                Anchor::Start => HPos::Left,
                Anchor::Middle => HPos::Center,
                Anchor::End => HPos::Right,
            };
            // The foot of letters without descenders lies above the foot of their box.
            let style = text((size * ZOOM) as u32, rgb(*color)).pos(Pos::new(side, VPos::Center));
            canvas.draw_text(words, &style, pixel((at.0, at.1 - size * 0.35)))?;
        }
        Shape::Image { at, size, image } => {
            let (width, height) = (
                (size.0 * ZOOM).max(1.0) as usize,
                (size.1 * ZOOM).max(1.0) as usize,
            );
            let bytes = scaled(image, width, height);
            if let Some(image) =
                BitMapElement::with_owned_buffer(pixel(*at), (width as u32, height as u32), bytes)
            {
                canvas.draw(&image)?;
            }
        }
    }
    Ok(())
}

/// The nearest pixels of an image of another size.
fn scaled(image: &Raster, width: usize, height: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let at = (y * image.height / height) * image.width + x * image.width / width;
            bytes.extend(image.pixels.get(at).copied().unwrap_or([0xff; 3]));
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shape_is_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f.png");
        let color = Role::Series(0);
        let title = String::new;
        let shapes = vec![
            Shape::Bar {
                at: (0.0, 0.0),
                size: (10.0, 10.0),
                color,
                title: title(),
            },
            Shape::Dot {
                at: (35.0, 5.0),
                radius: 4.0,
                color: Role::Wrong,
                title: title(),
            },
            Shape::Line {
                points: vec![(0.0, 25.0), (40.0, 25.0)],
                color: Role::Right,
                width: 2.0,
            },
            Shape::Image {
                at: (0.0, 30.0),
                size: (10.0, 10.0),
                image: Raster {
                    width: 2,
                    height: 1,
                    pixels: vec![[1, 2, 3], [4, 5, 6]],
                },
            },
            Shape::Text {
                at: (20.0, 18.0),
                text: "MM".to_owned(),
                size: 12.0,
                anchor: Anchor::Start,
                color: Role::Ink,
            },
        ];
        let picture = Picture {
            name: "f".to_owned(),
            caption: String::new(),
            width: 40.0,
            height: 40.0,
            shapes,
        };
        draw(&path, &picture).unwrap();
        let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        assert_eq!(reader.info().size(), (80, 80));
        let mut data = vec![0; reader.output_buffer_size()];
        reader.next_frame(&mut data).unwrap();
        let at = |x: usize, y: usize| [0, 1, 2].map(|c| data[(y * 80 + x) * 3 + c]);
        assert_eq!(at(10, 10), color.rgb());
        assert_eq!(at(70, 10), Role::Wrong.rgb());
        assert_eq!(at(40, 50), Role::Right.rgb());
        assert_eq!((at(5, 70), at(15, 70)), ([1, 2, 3], [4, 5, 6]));
        assert_eq!(at(70, 70), [255; 3]);
        let dark = (40..70).any(|x| (20..40).any(|y| at(x, y) == Role::Ink.rgb()));
        assert!(dark, "letters");
    }
}
