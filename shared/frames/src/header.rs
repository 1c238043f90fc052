//! What an image file says of itself, without decoding it.
//!
//! PNG: <https://www.w3.org/TR/png-3/#11IHDR>. JPEG: ITU-T T.81, annex B.

use crate::{FrameError, MAX_FRAME_BYTES};
use evpr_core::plan::Sensor;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

const PNG_SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
/// How far from the end of a file its end marker may stand: cameras pad.
const TAIL_BYTES: u64 = 64 << 10;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Format {
    Png,
    Jpeg,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Header {
    pub(crate) format: Format,
    pub(crate) size: Sensor,
    /// One channel, not three (alpha left out).
    pub(crate) grey: bool,
}

/// Reads a file's header.
///
/// # Errors
/// When it cannot be read, is neither PNG nor JPEG, or of a kind or size that is not read.
pub(crate) fn read(path: &Path) -> Result<Header, FrameError> {
    let file = File::open(path).map_err(|e| FrameError::read(path, e))?;
    let header = parse(&mut BufReader::new(file)).map_err(|e| match e {
        Wrong::Io(e) if e.kind() == ErrorKind::UnexpectedEof => cut_short(path),
        Wrong::Io(e) => FrameError::read(path, e),
        Wrong::Kind(what) => FrameError::new(path, what),
    })?;
    let Sensor { height, width } = header.size;
    // Sides have 32 bits at most.
    if height.saturating_mul(width).saturating_mul(3) > MAX_FRAME_BYTES {
        let what = format!(
            "is {} pixels; make it smaller: at most {MAX_FRAME_BYTES} bytes",
            header.size
        );
        return Err(FrameError::new(path, what));
    }
    Ok(header)
}

/// That the end of the image is there.
///
/// # Errors
/// When the file cannot be read, or is cut short.
pub(crate) fn check_end(path: &Path, format: Format) -> Result<(), FrameError> {
    let mut tail = Vec::new();
    let mut read = || {
        let mut file = File::open(path)?;
        let len = file.metadata()?.len();
        file.seek(SeekFrom::Start(len.saturating_sub(TAIL_BYTES)))?;
        file.take(TAIL_BYTES).read_to_end(&mut tail)
    };
    read().map_err(|e| FrameError::read(path, e))?;
    // IEND with its checksum, which is always the same; end of image.
    let mark: &[u8] = match format {
        Format::Png => b"IEND\xae\x42\x60\x82",
        Format::Jpeg => b"\xff\xd9",
    };
    if tail.windows(mark.len()).any(|w| w == mark) {
        Ok(())
    } else {
        Err(cut_short(path))
    }
}

/// The error for a file whose end is missing.
pub(crate) fn cut_short(path: &Path) -> FrameError {
    FrameError::new(path, "is cut short; copy it again, or leave it out")
}

enum Wrong {
    Io(std::io::Error),
    Kind(String),
}

impl From<std::io::Error> for Wrong {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

fn parse(file: &mut (impl Read + Seek)) -> Result<Header, Wrong> {
    let mut start = [0; 2];
    file.read_exact(&mut start)?;
    match start {
        [0x89, b'P'] => png(file),
        [0xff, 0xd8] => jpeg(file),
        _ => Err(Wrong::Kind(
            "is neither a PNG nor a JPEG image, whatever its name; convert it, or leave it out".to_owned(),
        )),
    }
}

fn png(file: &mut impl Read) -> Result<Header, Wrong> {
    // The rest of the signature, then length, name and the first ten bytes of IHDR.
    let mut head = [0; 6 + 8 + 10];
    file.read_exact(&mut head)?;
    let [.., w0, w1, w2, w3, h0, h1, h2, h3, depth, colour] = head;
    if head[..6] != PNG_SIGNATURE[2..] || head[10..14] != *b"IHDR" {
        return Err(Wrong::Kind(
            "is a damaged PNG image; copy it again, or leave it out".to_owned(),
        ));
    }
    if depth == 16 {
        let what = "has 16 bits per channel; convert it to 8, which is what frames have";
        return Err(Wrong::Kind(what.to_owned()));
    }
    Ok(Header {
        format: Format::Png,
        size: Sensor {
            height: u32::from_be_bytes([h0, h1, h2, h3]) as usize,
            width: u32::from_be_bytes([w0, w1, w2, w3]) as usize,
        },
        // Bit 1 of the colour type: colour, also with a palette.
        grey: colour & 2 == 0,
    })
}

fn jpeg(file: &mut (impl Read + Seek)) -> Result<Header, Wrong> {
    let damaged = || Wrong::Kind("is a damaged JPEG image; copy it again, or leave it out".to_owned());
    loop {
        let mut byte = [0; 1];
        file.read_exact(&mut byte)?;
        if byte != [0xff] {
            return Err(damaged());
        }
        // Any number of fill bytes may stand before a marker.
        while byte == [0xff] {
            file.read_exact(&mut byte)?;
        }
        let marker = byte[0];
        if marker == 0x01 || (0xd0..=0xd7).contains(&marker) {
            continue; // markers without a length
        }
        let mut len = [0; 2];
        file.read_exact(&mut len)?;
        let Some(len) = u16::from_be_bytes(len).checked_sub(2) else {
            return Err(damaged());
        };
        match marker {
            // Start of frame: precision, height, width, number of components.
            0xc0..=0xcf if ![0xc4, 0xc8, 0xcc].contains(&marker) => {
                let mut frame = [0; 6];
                file.read_exact(&mut frame)?;
                let [precision, h0, h1, w0, w1, components] = frame;
                if precision != 8 {
                    return Err(Wrong::Kind(format!(
                        "has {precision} bits per channel; convert it to 8"
                    )));
                }
                let grey = match components {
                    1 => true,
                    3 => false,
                    n => {
                        let what = format!("has {n} channels (CMYK?); convert it to RGB or grey");
                        return Err(Wrong::Kind(what));
                    }
                };
                let size = Sensor {
                    height: usize::from(u16::from_be_bytes([h0, h1])),
                    width: usize::from(u16::from_be_bytes([w0, w1])),
                };
                return match size.pixels() {
                    0 => Err(damaged()),
                    _ => Ok(Header {
                        format: Format::Jpeg,
                        size,
                        grey,
                    }),
                };
            }
            // Start of scan or end of image, and no start of frame before.
            0xda | 0xd9 => return Err(damaged()),
            _ => {
                file.seek(SeekFrom::Current(i64::from(len)))?;
            }
        }
    }
}
