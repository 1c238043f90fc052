//! A frame for the page: small, and in red, green and blue.

use bytes::Bytes;
use std::sync::OnceLock;

/// The longest side that a frame has on the page, pixels; larger ones are shrunk.
const LONGEST: usize = 400;

/// A frame of one reconstruction and window.
#[derive(Debug)]
pub struct Frame {
    height: usize,
    width: usize,
    rgb: Vec<u8>,
    png: OnceLock<Option<Bytes>>,
}

impl Frame {
    /// A frame of this size, with its pixels in red, green and blue, row by row. Of a large one each pixel is the mean of
    /// a square of its pixels; what is left over at the right and below is left out. None when there are too few pixels.
    pub fn new(height: usize, width: usize, pixels: impl Iterator<Item = [u8; 3]>) -> Option<Self> {
        let factor = height.max(width).div_ceil(LONGEST).max(1);
        let (small_height, small_width) = (height / factor, width / factor);
        if small_height == 0 || small_width == 0 {
            return None;
        }
        let mut sums = vec![0u32; small_height * small_width * 3];
        let mut seen = 0;
        for (index, pixel) in pixels.take(height * width).enumerate() {
            seen += 1;
            let (row, column) = (index / width / factor, index % width / factor);
            if row < small_height && column < small_width {
                let at = (row * small_width + column) * 3;
                for (sum, value) in sums[at..at + 3].iter_mut().zip(pixel) {
                    *sum += u32::from(value);
                }
            }
        }
        let area = (factor * factor) as u32;
        (seen == height * width).then(|| Self {
            height: small_height,
            width: small_width,
            rgb: sums.into_iter().map(|sum| (sum / area) as u8).collect(),
            png: OnceLock::new(),
        })
    }

    /// The picture as PNG, made when it is first asked for.
    pub(crate) fn png(&self) -> Option<Bytes> {
        self.png
            .get_or_init(|| self.encode().ok().map(Bytes::from))
            .clone()
    }

    fn encode(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish()?;
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(frame: &Frame) -> (u32, u32, Vec<u8>) {
        let png = frame.png().unwrap();
        let mut reader = png::Decoder::new(&png[..]).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size()];
        let info = reader.next_frame(&mut pixels).unwrap();
        (info.height, info.width, pixels)
    }

    #[test]
    fn small_frames_stay_as_they_are_and_large_ones_shrink() {
        let small = Frame::new(1, 2, [[1, 2, 3], [4, 5, 6]].into_iter()).unwrap();
        assert_eq!(decoded(&small), (1, 2, vec![1, 2, 3, 4, 5, 6]));
        // 2 × 2 pixels become one: their mean.
        let pixels = (0..3 * 801).map(|i| if i % 2 == 0 { [10, 0, 255] } else { [20, 0, 255] });
        let large = Frame::new(3, 801, pixels).unwrap();
        let (height, width, pixels) = decoded(&large);
        assert_eq!((height, width), (1, 267));
        assert_eq!(pixels[2], 255);
        assert!((13..=16).contains(&pixels[0]), "{}", pixels[0]);
    }

    #[test]
    fn nonsense_is_no_frame() {
        assert!(Frame::new(0, 5, std::iter::empty()).is_none());
        assert!(Frame::new(2, 2, [[0; 3]; 3].into_iter()).is_none());
        assert!(
            Frame::new(1, 1000, [[0; 3]; 1000].into_iter()).is_none(),
            "nothing is left of its height"
        );
    }
}
