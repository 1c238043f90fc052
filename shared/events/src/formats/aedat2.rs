//! AEDAT 2.0, the format of jAER: pairs of an address and a time, both u32, big-endian, after a header of lines that
//! begin with `#`.
//!
//! What an address means depends on the chip, which the header names (`# AEChip: …`) or else the size of the sensor
//! that the caller gives. Columns are counted from the left and rows from the top here; jAER's files count columns from
//! the right and rows from the bottom, as its extractors `DVS128` and `DavisBaseCamera` undo it. Software other than
//! jAER has written files with columns from the left: the file does not say so, and they appear mirrored.
//!
//! Times are µs in 32 bits: a step back of more than half their range (35.8 minutes) is taken as their wrap-around,
//! any other as it is. When the recording began is not said. From docs.inivation.com, "AEDAT 2.0", and jAER.

use crate::{BATCH_EVENTS, Input, RawEvent, ReadOptions, Recording, Skipped, SourceError, SourceInfo};
use evpr_core::plan::Sensor;

/// What a file begins with.
pub(super) const FIRST_LINE: &[u8] = b"#!AER-DAT2";
/// Longest line of the header, and most bytes of all of them.
const MAX_LINE_BYTES: usize = 64 << 10;
const MAX_HEADER_BYTES: u64 = 16 << 20;
/// An address and a time.
const EVENT_BYTES: usize = 8;
/// The line that ends the header in newer files.
const END: &[u8] = b"end of ascii header";

/// How addresses are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Layout {
    /// Bit 0 is 0 for ON, 1 to 7 x, 8 to 14 y; with any higher bit it is no event.
    Dvs128,
    /// Bit 31: not an event, but an APS sample, or with bits 10 and 11 an IMU value. Else 22 to 30 y, 12 to 21 x, 11 ON,
    /// 10 an edge on the input pin.
    Davis,
}

/// Chips by what their names in jAER hold, in lower case.
const CHIPS: [(&str, Layout, usize, usize); 9] = [
    ("davis240", Layout::Davis, 180, 240),
    ("davis346", Layout::Davis, 260, 346),
    ("davi346", Layout::Davis, 260, 346),
    ("davis640", Layout::Davis, 480, 640),
    ("davis208", Layout::Davis, 192, 208),
    ("davis128", Layout::Davis, 128, 128),
    ("sbret10", Layout::Davis, 180, 240),
    ("dvs128", Layout::Dvs128, 128, 128),
    ("tmpdiff128", Layout::Dvs128, 128, 128),
];

/// What is passed over, in the order of its counts.
const OTHERS: [&str; 3] = ["APS samples", "IMU values", "external events"];
const APS: usize = 0;
const IMU: usize = 1;
const EXTERNAL: usize = 2;

/// See the module.
pub(super) struct Aedat2 {
    input: Input,
    layout: Layout,
    sensor: Sensor,
    /// The time before, whole and as it was written.
    t_us: i64,
    raw_us: Option<u32>,
    others: [u64; 3],
    ended: bool,
}

impl Aedat2 {
    pub(super) fn open(mut input: Input, options: &ReadOptions) -> Result<Self, SourceError> {
        let chip = header(&mut input)?;
        let (layout, sensor) = layout(chip.as_deref(), options.sensor)
            .map_err(|what| SourceError::malformed(input.path(), what))?;
        Ok(Self {
            input,
            layout,
            sensor,
            t_us: 0,
            raw_us: None,
            others: [0; 3],
            ended: false,
        })
    }

    /// Decodes what is there already.
    fn decode(&mut self, out: &mut Vec<RawEvent>) -> Result<(), SourceError> {
        let bytes = self.input.buffered();
        let mut at = 0;
        let mut before_zero = false;
        for pair in bytes.chunks_exact(EVENT_BYTES) {
            if out.len() == BATCH_EVENTS {
                break;
            }
            let address = u32::from_be_bytes([pair[0], pair[1], pair[2], pair[3]]);
            let raw_us = u32::from_be_bytes([pair[4], pair[5], pair[6], pair[7]]);
            match pixel(self.layout, address) {
                Ok((x, y, on)) => {
                    let step = self.raw_us.map_or(i64::from(raw_us), |before| {
                        i64::from(raw_us.wrapping_sub(before) as i32)
                    });
                    (self.t_us, self.raw_us) = (self.t_us + step, Some(raw_us));
                    before_zero = self.t_us < 0;
                    if before_zero {
                        break;
                    }
                    let mirrored = |side: usize, v: u32| {
                        let v = (side - 1).checked_sub(v as usize);
                        v.and_then(|v| u16::try_from(v).ok()).unwrap_or(u16::MAX)
                    };
                    out.push(RawEvent {
                        t_ns: self.t_us as u64 * 1000,
                        x: mirrored(self.sensor.width, x),
                        y: mirrored(self.sensor.height, y),
                        on,
                    });
                }
                Err(other) => self.others[other] += 1,
            }
            at += EVENT_BYTES;
        }
        let place = self.input.position() + at as u64;
        self.input.consume(at);
        if before_zero {
            let what =
                format!("the event at byte {place} has a time before 0; cut off what stands before it");
            return Err(SourceError::malformed(self.input.path(), what));
        }
        Ok(())
    }
}

/// Column, row and polarity of an address as they are written, or what else it is.
fn pixel(layout: Layout, address: u32) -> Result<(u32, u32, bool), usize> {
    match layout {
        Layout::Dvs128 if address >> 15 != 0 => Err(EXTERNAL),
        Layout::Dvs128 => Ok((address >> 1 & 0x7f, address >> 8 & 0x7f, address & 1 == 0)),
        Layout::Davis if address >> 31 == 1 => Err(if address >> 10 & 3 == 3 { IMU } else { APS }),
        Layout::Davis if address >> 10 & 1 == 1 => Err(EXTERNAL),
        Layout::Davis => Ok((
            address >> 12 & 0x3ff,
            address >> 22 & 0x1ff,
            address >> 11 & 1 == 1,
        )),
    }
}

/// By the chip's name, or else by the size that the caller gives.
fn layout(chip: Option<&str>, said: Option<Sensor>) -> Result<(Layout, Sensor), String> {
    let sized = |(_, layout, height, width): &(&str, Layout, usize, usize)| {
        let sensor = Sensor {
            height: *height,
            width: *width,
        };
        (*layout, sensor)
    };
    if let Some(chip) = chip {
        let name = chip.to_lowercase();
        let known = CHIPS.iter().find(|(part, ..)| name.contains(part)).map(sized);
        return known.ok_or_else(|| {
            let chip: String = chip.chars().take(40).flat_map(char::escape_debug).collect();
            format!("is of the chip {chip}; this build knows the addresses of DVS128 and the DAVIS chips")
        });
    }
    // A 128x128 sensor without a name is the DVS128, of a time when names were not written.
    let by_size = |sensor: Sensor| CHIPS.iter().rev().map(sized).find(|(_, s)| *s == sensor);
    said.and_then(by_size).ok_or_else(|| {
        "does not say its chip (there is no line \"# AEChip: …\"), so what its addresses mean cannot be known; \
         give the size of the sensor: 128x128 for a DVS128, 180x240 or 260x346 (height x width) for a DAVIS"
            .to_owned()
    })
}

/// Takes the header; the name of the chip, without the package before it.
fn header(input: &mut Input) -> Result<Option<String>, SourceError> {
    let mut chip = None;
    let mut first = true;
    loop {
        let Some(line) = line(input, first)? else {
            return Ok(chip);
        };
        first = false;
        if input.position() + line.len() as u64 > MAX_HEADER_BYTES {
            let what = format!("has a header of more than {} MiB", MAX_HEADER_BYTES >> 20);
            return Err(SourceError::malformed(input.path(), what));
        }
        let text = line[1..].trim_ascii();
        if let Some(name) = text.strip_prefix(b"AEChip:") {
            let name = String::from_utf8_lossy(name.trim_ascii()).into_owned();
            chip = Some(name.rsplit('.').next().unwrap_or_default().to_owned());
        }
        let end = text.eq_ignore_ascii_case(END);
        input.consume(line.len());
        if end {
            return Ok(chip);
        }
    }
}

/// The next line, if it is one of the header. The first event may begin with `#` as well: a line of the header is of
/// printable letters up to its end, and of a length that is not one of damaged data.
fn line(input: &mut Input, first: bool) -> Result<Option<Vec<u8>>, SourceError> {
    let mut searched = 0;
    loop {
        let here = input.buffered();
        let printable = |b: &u8| matches!(b, b'\t' | b'\r' | b' '..=b'~' | 0x80..);
        if here.first().is_some_and(|b| *b != b'#') {
            return Ok(None);
        }
        let rest = here.get(searched..).unwrap_or_default();
        if let Some(at) = rest.iter().position(|b| !printable(b)) {
            let end = searched + at;
            return Ok((here[end] == b'\n').then(|| here[..=end].to_vec()));
        }
        searched = here.len();
        if searched > MAX_LINE_BYTES {
            return Ok(None);
        }
        if input.peek(searched + 1)?.len() == searched {
            if first {
                let what = "ends inside its header; it was cut off: get another copy";
                return Err(SourceError::malformed(input.path(), what));
            }
            return Ok(None);
        }
    }
}

impl Recording for Aedat2 {
    fn sensor(&self) -> Option<Sensor> {
        Some(self.sensor)
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        while !self.ended {
            self.decode(out).inspect_err(|_| self.ended = true)?;
            if !out.is_empty() {
                return Ok(true);
            }
            let here = self.input.buffered().len();
            if self.input.peek(here + 1)?.len() == here {
                self.ended = true;
                if here > 0 {
                    let what = "ends inside an event; it was cut off: get another copy";
                    return Err(SourceError::malformed(self.input.path(), what));
                }
            }
        }
        Ok(false)
    }

    fn progress_permille(&self) -> u64 {
        self.input.progress_permille()
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: "AEDAT 2.0",
            path: self.input.path().to_owned(),
            time_unit: "us",
            time_unit_from: "format",
            events: None,
        }
    }

    fn skipped(&self) -> Vec<Skipped> {
        let some = OTHERS.iter().zip(self.others).filter(|(_, count)| *count > 0);
        some.map(|(what, count)| Skipped {
            what: (*what).to_owned(),
            count,
        })
        .collect()
    }
}
