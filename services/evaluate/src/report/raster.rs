//! Small images of pixels: matrices and frames.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Red, green and blue of each pixel, rows one after another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// `width · height` pixels.
    pub pixels: Vec<[u8; 3]>,
}

impl Raster {
    /// An image of one colour.
    pub(super) fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        Self {
            width,
            height,
            pixels: vec![color; width * height],
        }
    }

    /// A square of this half side around a pixel; what lies outside is left out.
    pub(super) fn mark(&mut self, x: usize, y: usize, half: usize, color: [u8; 3]) {
        for row in y.saturating_sub(half)..(y + half + 1).min(self.height) {
            for column in x.saturating_sub(half)..(x + half + 1).min(self.width) {
                if let Some(pixel) = self.pixels.get_mut(row * self.width + column) {
                    *pixel = color;
                }
            }
        }
    }

    /// As a PNG, with a palette where it has few colours. Empty when its size is not that of its pixels.
    pub fn png(&self) -> Vec<u8> {
        let mut palette: Vec<[u8; 3]> = Vec::new();
        let mut indices = Vec::with_capacity(self.pixels.len());
        for pixel in &self.pixels {
            let at = palette.iter().position(|color| color == pixel);
            let at = at.unwrap_or_else(|| {
                palette.push(*pixel);
                palette.len() - 1
            });
            if at > 255 {
                break;
            }
            indices.push(at as u8);
        }
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, self.width as u32, self.height as u32);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Best);
        let data = if indices.len() == self.pixels.len() {
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_palette(palette.concat());
            indices
        } else {
            encoder.set_color(png::ColorType::Rgb);
            self.pixels.concat()
        };
        let written = encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&data));
        if written.is_err() {
            return Vec::new();
        }
        out
    }

    /// The PNG as an address that needs nobody.
    pub(super) fn data_address(&self) -> String {
        format!("data:image/png;base64,{}", STANDARD.encode(self.png()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(image: &Raster) -> Vec<[u8; 3]> {
        let bytes = image.png();
        let mut decoder = png::Decoder::new(bytes.as_slice());
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut data = vec![0; reader.output_buffer_size()];
        reader.next_frame(&mut data).unwrap();
        data.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
    }

    #[test]
    fn few_colours_and_many_come_back_as_they_were() {
        let mut few = Raster::filled(9, 7, [1, 2, 3]);
        few.mark(0, 6, 1, [250, 0, 9]);
        assert_eq!(few.pixels.iter().filter(|p| p[0] == 250).count(), 4);
        assert_eq!(decoded(&few), few.pixels);
        let many = Raster {
            width: 30,
            height: 10,
            pixels: (0..300u32)
                .map(|i| [(i % 256) as u8, (i / 256) as u8, 7])
                .collect(),
        };
        assert_eq!(decoded(&many), many.pixels);
        assert_eq!(Raster::filled(0, 0, [0; 3]).png(), Vec::<u8>::new());
    }
}
