//! The header of RAW and DAT: lines `% keyword value`, up to `% end` or to where no such line begins.

use super::{Encoding, Evt21Order};
use crate::{Input, SourceError};
use evpr_core::plan::Sensor;

/// Longest line, and longest header, bytes.
const MAX_LINE: usize = 4 << 10;
const MAX_HEADER: u64 = 64 << 10;
/// Longest piece of a line that an error shows, characters.
const MAX_SHOWN: usize = 40;

/// Before this system, words of EVT 2.1 had their upper half first, and headers did not say so.
const FIRST_LITTLE_SYSTEM: u64 = 0x37;

/// Sensors by what names of them, or of their drivers, contain; longer names before those that begin like them.
const SENSORS: [(&str, usize, usize); 8] = [
    ("imx636", 720, 1280),
    ("imx646", 720, 1280),
    ("imx637", 512, 640),
    ("imx647", 512, 640),
    ("genx320", 320, 320),
    ("saphir", 320, 320),
    ("gen3", 480, 640),
    ("gen4", 720, 1280),
];

/// Sensors by their generation.
const GENERATIONS: [(&str, usize, usize); 2] = [("3.", 480, 640), ("4.", 720, 1280)];

/// What a header says that reading needs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Header {
    /// How the data is encoded.
    pub(super) encoding: Option<Encoding>,
    /// Size of the sensor: as said, else that of the sensor it names.
    pub(super) sensor: Option<Sensor>,
    /// Sensor time near the first event, µs: what EVT 3.0 itself cannot say.
    pub(super) time_base_us: Option<u64>,
}

/// Collects what the lines say.
#[derive(Debug, Default)]
struct Lines {
    /// `format` or what is said of DAT; and the older `evt`.
    format: Option<Encoding>,
    evt: Option<Encoding>,
    version: Option<String>,
    legacy_order: Option<bool>,
    system: Option<u64>,
    width: Option<usize>,
    height: Option<usize>,
    named: Option<Sensor>,
    by_generation: Option<Sensor>,
    time_base_us: Option<u64>,
}

/// True where a line of a header begins, or may begin when more bytes come.
pub(in crate::formats) fn begins(head: &[u8]) -> bool {
    matches!(head, [b'%'] | [b'%', b' ' | b'\n' | b'\r', ..])
}

/// Reads the header from the start of `input`; what follows is not taken.
///
/// # Errors
/// When a line is too long or not text, or what it says cannot be right or is not read here.
pub(super) fn read(input: &mut Input) -> Result<Header, SourceError> {
    let path = input.path().to_owned();
    let wrong = |what: String| SourceError::malformed(&path, what);
    let start = input.position();
    let mut lines = Lines::default();
    while begins(input.peek(2)?) {
        let Some(len) = line_len(input)? else {
            return Err(wrong(
                "has a header line of more than 4096 bytes; it is damaged".to_owned(),
            ));
        };
        if input.position() - start > MAX_HEADER {
            return Err(wrong(
                "has a header of more than 64 KiB; it is damaged".to_owned(),
            ));
        }
        let bytes = input.peek(len)?;
        let line = String::from_utf8_lossy(&bytes[..len.min(bytes.len())]);
        let line = line.trim_start_matches('%').trim();
        let end = line == "end";
        if !end {
            let (keyword, value) = line.split_once(' ').unwrap_or((line, ""));
            lines.take(keyword, value.trim()).map_err(wrong)?;
        }
        input.consume(len);
        if end {
            break;
        }
    }
    lines.header().map_err(wrong)
}

/// Length of the next line with its end; `None` if it is too long. A last line may have no end.
fn line_len(input: &mut Input) -> Result<Option<usize>, SourceError> {
    let mut wanted = 1;
    loop {
        let bytes = input.peek(wanted)?;
        if let Some(at) = bytes.iter().take(MAX_LINE).position(|b| *b == b'\n') {
            return Ok(Some(at + 1));
        }
        if bytes.len() < wanted {
            return Ok(Some(bytes.len()));
        }
        if bytes.len() >= MAX_LINE {
            return Ok(None);
        }
        wanted = bytes.len() + 1;
    }
}

impl Lines {
    fn take(&mut self, keyword: &str, value: &str) -> Result<(), String> {
        match keyword.to_ascii_lowercase().as_str() {
            "format" => self.format(value)?,
            "evt" => self.evt = Some(evt_version(value)?),
            "endianness" => self.endianness(value)?,
            "geometry" => {
                let (width, height) = value.split_once('x').ok_or_else(|| bad("geometry", value))?;
                self.width(width)?;
                self.height(height)?;
            }
            "width" => self.width(value)?,
            "height" => self.height(value)?,
            // "Data file containing CD events."
            "data" if value.starts_with("file") => self.format = Some(Encoding::Dat),
            "version" => self.version = Some(value.to_owned()),
            "system_id" => self.system = value.parse().ok(),
            "time_base_us" => {
                let base = value.parse().map_err(|_| bad("time_base_us", value))?;
                self.time_base_us = Some(base);
            }
            "sensor_name" | "plugin_name" => {
                let value = value.to_ascii_lowercase();
                let named = SENSORS.iter().find(|(name, ..)| value.contains(name));
                self.named = self.named.or(named.map(sensor));
            }
            "generation" | "sensor_generation" => {
                let found = GENERATIONS.iter().find(|(name, ..)| value.starts_with(name));
                self.by_generation = self.by_generation.or(found.map(sensor));
            }
            _ => {}
        }
        Ok(())
    }

    /// `EVT3;height=720;width=1280`
    fn format(&mut self, value: &str) -> Result<(), String> {
        let mut parts = value.split(';');
        let name = parts.next().unwrap_or_default();
        self.format = Some(match name {
            "EVT2" => Encoding::Evt2,
            "EVT21" => Encoding::Evt21(Evt21Order::Little),
            "EVT3" => Encoding::Evt3,
            _ => {
                return Err(format!(
                    "holds {}; of RAW, EVT2, EVT21 and EVT3 are read",
                    shown(name)
                ));
            }
        });
        for part in parts {
            match part.split_once('=') {
                Some(("width", value)) => self.width(value)?,
                Some(("height", value)) => self.height(value)?,
                Some(("endianness", value)) => self.endianness(value)?,
                _ => {}
            }
        }
        Ok(())
    }

    fn endianness(&mut self, value: &str) -> Result<(), String> {
        self.legacy_order = Some(match value {
            "little" => false,
            "legacy" => true,
            _ => {
                return Err(format!(
                    "has words in the order {}; little and legacy are read: record it with one of these",
                    shown(value)
                ));
            }
        });
        Ok(())
    }

    fn width(&mut self, value: &str) -> Result<(), String> {
        side(&mut self.width, "width", value)
    }

    fn height(&mut self, value: &str) -> Result<(), String> {
        side(&mut self.height, "height", value)
    }

    fn header(self) -> Result<Header, String> {
        if let (Some(Encoding::Dat), Some(version)) = (self.format, &self.version)
            && !version.starts_with('2')
        {
            return Err(format!(
                "is DAT of version {}; version 2 is read: convert it",
                shown(version)
            ));
        }
        let legacy = self
            .legacy_order
            .unwrap_or(self.system.is_some_and(|id| id < FIRST_LITTLE_SYSTEM));
        let encoding = self.format.or(self.evt).map(|encoding| match encoding {
            Encoding::Evt21(_) if legacy => Encoding::Evt21(Evt21Order::HalvesSwapped),
            other => other,
        });
        let said = self.height.zip(self.width);
        let said = said.map(|(height, width)| Sensor { height, width });
        Ok(Header {
            encoding,
            sensor: said.or(self.named).or(self.by_generation),
            time_base_us: self.time_base_us,
        })
    }
}

fn sensor(&(_, height, width): &(&str, usize, usize)) -> Sensor {
    Sensor { height, width }
}

fn evt_version(value: &str) -> Result<Encoding, String> {
    match value {
        "2.0" => Ok(Encoding::Evt2),
        "2.1" => Ok(Encoding::Evt21(Evt21Order::Little)),
        "3.0" => Ok(Encoding::Evt3),
        _ => Err(format!(
            "is of EVT version {}; 2.0, 2.1 and 3.0 are read",
            shown(value)
        )),
    }
}

/// A side may be said several times, always the same.
fn side(side: &mut Option<usize>, name: &str, value: &str) -> Result<(), String> {
    let pixels = value
        .trim()
        .parse()
        .ok()
        .filter(|v| (1..=65_535).contains(v))
        .ok_or_else(|| bad(name, value))?;
    match *side {
        Some(other) if other != pixels => Err(format!(
            "its header says two values of the sensor's {name}, {other} and {pixels}; take the wrong one out"
        )),
        _ => {
            *side = Some(pixels);
            Ok(())
        }
    }
}

fn bad(keyword: &str, value: &str) -> String {
    format!(
        "its header has {keyword} {}, which cannot be; it is damaged, or correct the line",
        shown(value)
    )
}

/// A piece of the header for an error: in quotes, printable, short.
fn shown(text: &str) -> String {
    let short: String = text
        .chars()
        .take(MAX_SHOWN)
        .flat_map(char::escape_debug)
        .collect();
    format!("\"{short}\"")
}
