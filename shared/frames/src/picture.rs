//! Decoding of PNG and JPEG files.

use crate::header::{Format, Header};
use crate::{FrameError, MAX_FRAME_BYTES};
use evpr_core::message::ChannelOrder;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// A decoded frame: height × width × channels bytes, row-major, channels interleaved.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Picture {
    /// [`ChannelOrder::Grey`] or [`ChannelOrder::BlueGreenRed`].
    pub order: ChannelOrder,
    /// The bytes.
    pub pixels: Vec<u8>,
}

impl Picture {
    pub(crate) fn reset(&mut self, order: ChannelOrder, len: usize) {
        self.order = order;
        self.pixels.resize(len, 0);
    }
}

/// Decodes files one after the other, through buffers that it keeps.
#[derive(Debug, Default)]
pub(crate) struct Decoder {
    file: Vec<u8>,
    decoded: Vec<u8>,
}

impl Decoder {
    /// Decodes a file with this header.
    pub(crate) fn decode(
        &mut self,
        path: &Path,
        header: &Header,
        picture: &mut Picture,
    ) -> Result<(), FrameError> {
        let channels = match header.format {
            Format::Png => self.png(path, header),
            Format::Jpeg => self.jpeg(path, header),
        }?;
        let pixels = header.size.pixels();
        if self.decoded.len() != pixels * channels {
            return Err(FrameError::new(
                path,
                "is not what its header says; copy it again, or leave it out",
            ));
        }
        // Red, green, blue (or grey), then alpha where there is one.
        if header.grey {
            picture.reset(ChannelOrder::Grey, pixels);
            for (to, from) in picture.pixels.iter_mut().zip(self.decoded.chunks_exact(channels)) {
                *to = from[0];
            }
        } else {
            picture.reset(ChannelOrder::BlueGreenRed, pixels * 3);
            let to = picture.pixels.as_chunks_mut::<3>().0;
            for (to, from) in to.iter_mut().zip(self.decoded.chunks_exact(channels)) {
                *to = [from[2], from[1], from[0]];
            }
        }
        Ok(())
    }

    /// Decodes a PNG file; gives its channels.
    fn png(&mut self, path: &Path, header: &Header) -> Result<usize, FrameError> {
        let file = File::open(path).map_err(|e| FrameError::read(path, e))?;
        let limits = png::Limits {
            bytes: 2 * MAX_FRAME_BYTES,
        };
        let mut decoder = png::Decoder::new_with_limits(BufReader::new(file), limits);
        // Palettes become colours, fewer bits than 8 become 8.
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().map_err(|e| damaged(path, &e))?;
        let (colour, depth) = reader.output_color_type();
        let channels = colour.samples();
        if depth != png::BitDepth::Eight || (channels < 3) != header.grey {
            return Err(FrameError::new(
                path,
                "is not what its header says; copy it again, or leave it out",
            ));
        }
        self.decoded.resize(reader.output_buffer_size(), 0);
        reader
            .next_frame(&mut self.decoded)
            .map_err(|e| damaged(path, &e))?;
        Ok(channels)
    }

    /// Decodes a JPEG file; gives its channels.
    fn jpeg(&mut self, path: &Path, header: &Header) -> Result<usize, FrameError> {
        let file = File::open(path).map_err(|e| FrameError::read(path, e))?;
        self.file.clear();
        file.take(MAX_FRAME_BYTES as u64)
            .read_to_end(&mut self.file)
            .map_err(|e| FrameError::read(path, e))?;
        let (space, channels) = match header.grey {
            true => (ColorSpace::Luma, 1),
            false => (ColorSpace::RGB, 3),
        };
        // Strict: else what is missing comes out grey.
        let options = DecoderOptions::default()
            .set_strict_mode(true)
            .jpeg_set_out_colorspace(space)
            .set_max_width(header.size.width)
            .set_max_height(header.size.height);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&self.file[..]), options);
        decoder.decode_headers().map_err(|e| damaged(path, &e))?;
        self.decoded.resize(header.size.pixels() * channels, 0);
        if decoder.output_buffer_size() != Some(self.decoded.len()) {
            return Err(FrameError::new(
                path,
                "is not what its header says; copy it again, or leave it out",
            ));
        }
        decoder
            .decode_into(&mut self.decoded)
            .map_err(|e| damaged(path, &e))?;
        Ok(channels)
    }
}

fn damaged(path: &Path, error: &dyn std::fmt::Display) -> FrameError {
    FrameError::new(
        path,
        format!("cannot be decoded ({error}); copy it again, or leave it out"),
    )
}
