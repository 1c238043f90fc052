//! Lists of pixels as text: a line `x,y` for each (column and row, from 0); `#` begins a comment.

use crate::SourceError;
use evpr_core::plan::{Pixel, Sensor};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The largest list, bytes.
const MOST_BYTES: u64 = 16 << 20;
/// Most bad lines that are told.
const MOST_ERRORS: usize = 1000;

/// Everything that is wrong with a list: one line for each.
#[derive(Debug, thiserror::Error)]
#[error("{}", self.lines())]
pub struct PixelListErrors {
    /// The mistakes, in the order of the file; at least one.
    pub errors: Vec<SourceError>,
}

impl PixelListErrors {
    fn lines(&self) -> String {
        let lines: Vec<String> = self.errors.iter().map(SourceError::to_string).collect();
        lines.join("\n")
    }
}

impl From<SourceError> for PixelListErrors {
    fn from(error: SourceError) -> Self {
        Self { errors: vec![error] }
    }
}

/// Reads a list. The pixels come by rows, each once. An empty list is a list.
///
/// # Errors
/// When the file cannot be read; and for each line that is no pixel, or one outside the sensor.
pub fn read_pixel_list(path: &Path, sensor: Sensor) -> Result<Vec<Pixel>, PixelListErrors> {
    let failed = |e| SourceError::read(path, e);
    let file = File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(MOST_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(failed)?;
    if bytes.len() as u64 > MOST_BYTES {
        let what = "is larger than 16 MiB, so it is no list of pixels; write a line x,y for each";
        return Err(SourceError::malformed(path, what).into());
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let (mut pixels, mut errors) = (Vec::new(), Vec::new());
    for (line, text) in (1..).zip(bytes.split(|b| *b == b'\n')) {
        match pixel(text, sensor) {
            Ok(pixel) => pixels.extend(pixel),
            Err(what) => {
                let path = path.to_owned();
                errors.push(SourceError::Line { path, line, what });
                if errors.len() == MOST_ERRORS {
                    break;
                }
            }
        }
    }
    if !errors.is_empty() {
        return Err(PixelListErrors { errors });
    }
    pixels.sort_unstable_by_key(|p: &Pixel| (p.y, p.x));
    pixels.dedup();
    Ok(pixels)
}

/// The pixel of a line, if it has one.
fn pixel(line: &[u8], sensor: Sensor) -> Result<Option<Pixel>, String> {
    let content = line.split(|b| *b == b'#').next().unwrap_or_default().trim_ascii();
    if content.is_empty() {
        return Ok(None);
    }
    let shown = || {
        let text = String::from_utf8_lossy(content);
        let cut: String = text.chars().take(40).collect();
        if cut.len() < text.len() {
            format!("{cut}…")
        } else {
            cut
        }
        .escape_debug()
        .to_string()
    };
    let parsed = std::str::from_utf8(content).ok().and_then(|text| {
        let (x, y) = text.split_once(',')?;
        Some((x.trim().parse::<u32>().ok()?, y.trim().parse::<u32>().ok()?))
    });
    let Some((x, y)) = parsed else {
        return Err(format!(
            "\"{}\" is no pixel; write column and row, such as 12,34",
            shown()
        ));
    };
    let inside = (x as usize) < sensor.width && (y as usize) < sensor.height;
    match (u16::try_from(x), u16::try_from(y)) {
        (Ok(x), Ok(y)) if inside => Ok(Some(Pixel { x, y })),
        _ => Err(format!(
            "pixel {x},{y} lies outside the sensor of {sensor}; the list is of another camera, or has the row first"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor { height: 4, width: 6 };

    fn read(text: &[u8]) -> Result<Vec<(u16, u16)>, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("hot.txt");
        std::fs::write(&path, text).unwrap();
        let prefix = format!("{}: ", path.display());
        match read_pixel_list(&path, SENSOR) {
            Ok(pixels) => Ok(pixels.into_iter().map(Into::into).collect()),
            Err(errors) => Err(errors.to_string().replace(&prefix, "")),
        }
    }

    #[test]
    fn pixels_comments_and_spaces_are_read() {
        let text = b"\xef\xbb\xbf# x,y\n5,3\r\n 0 , 1  # worst\n\n5,3\n2,1";
        assert_eq!(read(text).unwrap(), [(0, 1), (2, 1), (5, 3)]);
        assert_eq!(read(b"").unwrap(), []);
        assert_eq!(read(b"# none\n").unwrap(), []);
    }

    #[test]
    fn every_bad_line_is_told() {
        let error = read(b"1,1\nx,y\n6,0\n0,4\n1\n1,2,3\n-1,0\n70000,0\n1 2\n\xff,1\n").unwrap_err();
        let lines: Vec<&str> = error.lines().collect();
        assert_eq!(lines.len(), 9, "{error}");
        assert_eq!(
            lines[0],
            "line 2: \"x,y\" is no pixel; write column and row, such as 12,34"
        );
        assert_eq!(
            lines[1],
            "line 3: pixel 6,0 lies outside the sensor of 4×6 (height × width); the list is of another camera, or has the \
             row first"
        );
        for (line, number) in lines.iter().zip([2, 3, 4, 5, 6, 7, 8, 9, 10]) {
            assert!(line.starts_with(&format!("line {number}: ")), "{line}");
        }
        let long = "z".repeat(300);
        assert!(read(long.as_bytes()).unwrap_err().len() < 200);
    }

    #[test]
    fn a_missing_file_is_told() {
        let error = read_pixel_list(Path::new("/no/such/list.txt"), SENSOR).unwrap_err();
        assert!(error.to_string().contains("there is no such file"), "{error}");
    }
}
