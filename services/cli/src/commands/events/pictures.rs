//! Frames as pictures: an animated GIF, or a folder of PNG files.

use crate::colors::{color, pixels};
use evpr_core::message::ChannelOrder;
use gif::{Encoder, Frame, Repeat};
use std::borrow::Cow;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// Where a pixel stands in the palette of its order: 256 greys, 16 × 16 levels of the two polarities, or 8 × 8 × 4.
fn index(order: ChannelOrder, values: [u8; 3]) -> u8 {
    let [a, b, c] = values;
    match order {
        ChannelOrder::Grey => a,
        ChannelOrder::BlueGreenRed => a >> 6 << 6 | b >> 5 << 3 | c >> 5,
        _ => a & 0xf0 | b >> 4,
    }
}

/// The palette of this order, red, green and blue one after another.
fn palette(order: ChannelOrder) -> Vec<u8> {
    let entry = |i: u8| match order {
        ChannelOrder::Grey => [i; 3],
        // Each level stands for its share of full strength.
        ChannelOrder::BlueGreenRed => [(i >> 6) * 85, (i >> 3 & 7) * 36, (i & 7) * 36],
        _ => [(i >> 4) * 17, (i & 15) * 17, 0],
    };
    (0..=255).flat_map(|i| color(order, entry(i))).collect()
}

/// Where the pictures go. Until they are all there they stand under `<name>.partial`.
pub(super) struct Pictures {
    out: PathBuf,
    partial: PathBuf,
    to: To,
    size: (u16, u16),
    count: u64,
}

enum To {
    Gif {
        /// Opened with the first frame, which tells the order of channels.
        encoder: Option<Encoder<BufWriter<File>>>,
        order: ChannelOrder,
        /// How long a picture stands, hundredths of a second.
        delay: u16,
    },
    Folder,
}

impl Pictures {
    /// Pictures of this height and width that follow one another by `step_ns`.
    pub(super) fn create(
        out: &Path,
        height: u16,
        width: u16,
        order: ChannelOrder,
        step_ns: u64,
    ) -> io::Result<Self> {
        let mut partial = out.as_os_str().to_owned();
        partial.push(".partial");
        let partial = PathBuf::from(partial);
        let to = if out.extension().is_some_and(|e| e.eq_ignore_ascii_case("gif")) {
            // Players slow down what is faster than a fiftieth of a second.
            let delay = (step_ns / 10_000_000).clamp(2, u64::from(u16::MAX)) as u16;
            let file = BufWriter::new(File::create(&partial)?);
            let mut encoder = Encoder::new(file, width, height, &palette(order)).map_err(io::Error::other)?;
            encoder.set_repeat(Repeat::Infinite).map_err(io::Error::other)?;
            To::Gif {
                encoder: Some(encoder),
                order,
                delay,
            }
        } else {
            std::fs::create_dir(&partial)?;
            To::Folder
        };
        Ok(Self {
            out: out.to_owned(),
            partial,
            to,
            size: (height, width),
            count: 0,
        })
    }

    /// The picture of this tick.
    pub(super) fn add(&mut self, tick: u64, order: ChannelOrder, frame: &[u8]) -> io::Result<()> {
        let (height, width) = self.size;
        self.count += 1;
        match &mut self.to {
            To::Gif {
                encoder,
                order,
                delay,
            } => {
                let frame = Frame {
                    width,
                    height,
                    delay: *delay,
                    buffer: Cow::Owned(pixels(*order, frame).map(|p| index(*order, p)).collect()),
                    ..Frame::default()
                };
                let encoder = encoder.as_mut().ok_or(io::ErrorKind::NotConnected)?;
                encoder.write_frame(&frame).map_err(io::Error::other)
            }
            To::Folder => {
                let file = File::create(self.partial.join(format!("{tick:06}.png")))?;
                let mut encoder = png::Encoder::new(BufWriter::new(file), width.into(), height.into());
                encoder.set_color(png::ColorType::Rgb);
                let mut writer = encoder.write_header().map_err(io::Error::other)?;
                let rgb: Vec<u8> = pixels(order, frame).flat_map(|p| color(order, p)).collect();
                writer.write_image_data(&rgb).map_err(io::Error::other)?;
                writer.finish().map_err(io::Error::other)
            }
        }
    }

    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Gives the pictures their name. A GIF of that name is replaced.
    pub(super) fn finish(mut self) -> io::Result<()> {
        if let To::Gif { encoder, .. } = &mut self.to
            && let Some(encoder) = encoder.take()
        {
            let file = encoder.into_inner().map_err(io::Error::other)?;
            file.into_inner()
                .map_err(io::IntoInnerError::into_error)?
                .sync_all()?;
        }
        std::fs::rename(&self.partial, &self.out)
    }
}

impl Drop for Pictures {
    /// Removes what is half-written; nothing is there any more once it has its name.
    fn drop(&mut self) {
        let _ = match self.to {
            To::Gif { .. } => std::fs::remove_file(&self.partial),
            To::Folder => std::fs::remove_dir_all(&self.partial),
        };
    }
}
