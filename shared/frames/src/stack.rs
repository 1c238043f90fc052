//! A stack of frames: a `.npy` of `uint8`.

use crate::{FrameError, MAX_FRAME_BYTES, Picture};
use evpr_core::message::ChannelOrder;
use evpr_core::plan::{Sensor, StackOrder};
use evpr_store::NpyHeader;
use std::fs::File;
use std::io::Read;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Longest header that is read, bytes.
const MAX_HEADER_BYTES: u64 = 64 << 10;

#[derive(Debug)]
pub(crate) struct Stack {
    path: PathBuf,
    file: File,
    /// Byte at which the frames begin.
    start: u64,
    len: usize,
    size: Sensor,
    colour: bool,
}

impl Stack {
    pub(crate) fn open(path: &Path) -> Result<Self, FrameError> {
        let wrong = |what: String| FrameError::new(path, what);
        let file = File::open(path).map_err(|e| FrameError::read(path, e))?;
        let mut head = Vec::new();
        (&file)
            .take(MAX_HEADER_BYTES)
            .read_to_end(&mut head)
            .map_err(|e| FrameError::read(path, e))?;
        let (header, start) = NpyHeader::decode(&head).map_err(wrong)?;
        if !["|u1", "<u1", ">u1", "=u1"].contains(&header.descr.as_str()) {
            return Err(wrong(format!(
                "holds {}, not uint8; write it with .astype(\"uint8\")",
                header.descr
            )));
        }
        if header.fortran_order {
            return Err(wrong(
                "is in Fortran order; write it with numpy.ascontiguousarray".to_owned(),
            ));
        }
        let (len, height, width, colour) = match header.shape[..] {
            [len, height, width] => (len, height, width, false),
            [len, height, width, 3] => (len, height, width, true),
            _ => {
                let what = format!(
                    "has the shape {:?}; frames are (N, H, W) or (N, H, W, 3)",
                    header.shape
                );
                return Err(wrong(what));
            }
        };
        let bytes = height
            .checked_mul(width)
            .and_then(|pixels| pixels.checked_mul(if colour { 3 } else { 1 }))
            .filter(|bytes| (1..=MAX_FRAME_BYTES as u64).contains(bytes));
        let Some(bytes) = bytes.filter(|_| len > 0) else {
            let what = format!(
                "has the shape {:?}; write at least one frame, of 1 to {MAX_FRAME_BYTES} bytes",
                header.shape
            );
            return Err(wrong(what));
        };
        let expected = len
            .checked_mul(bytes)
            .and_then(|all| all.checked_add(start as u64));
        let found = file.metadata().map_err(|e| FrameError::read(path, e))?.len();
        if expected != Some(found) {
            let what = format!(
                "has {found} bytes, which is not what its shape {:?} needs; write it again",
                header.shape
            );
            return Err(wrong(what));
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            start: start as u64,
            len: len as usize,
            size: Sensor {
                height: height as usize,
                width: width as usize,
            },
            colour,
        })
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn size(&self) -> Sensor {
        self.size
    }

    pub(crate) fn read(
        &self,
        frame: usize,
        order: StackOrder,
        picture: &mut Picture,
    ) -> Result<(), FrameError> {
        if frame >= self.len {
            return Err(FrameError::new(&self.path, format!("has no frame {frame}")));
        }
        let channels = match self.colour {
            true => ChannelOrder::BlueGreenRed,
            false => ChannelOrder::Grey,
        };
        picture.reset(channels, self.size.pixels() * channels.channels());
        let at = self.start + frame as u64 * picture.pixels.len() as u64;
        self.file
            .read_exact_at(&mut picture.pixels, at)
            .map_err(|e| FrameError::read(&self.path, e))?;
        if self.colour && order == StackOrder::Rgb {
            picture
                .pixels
                .as_chunks_mut::<3>()
                .0
                .iter_mut()
                .for_each(|pixel| pixel.reverse());
        }
        Ok(())
    }
}
