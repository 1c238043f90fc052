//! EVT 3.0 in a RAW file, as `formats/prophesee/evt3.rs` reads it and Prophesee's own software does.
//!
//! Neighbouring events of one time, row and polarity with ascending columns inside a block of 32 pixels become a vector
//! (12, 12 and 8 pixels) where that is shorter; all others are single. Order and every event are kept.
//!
//! The words say times modulo 16.777216 s: longer gaps are filled with high halves, as a sensor sends them too. Where
//! the first time lies beyond, the header says it (`% time_base_us`); readers that do not know this line see all times
//! shifted by a multiple of 16.777216 s.

use super::new_file::NewFile;
use super::{WriteError, WriteOptions, Writer};
use crate::RawEvent;
use evpr_core::plan::Sensor;
use std::io::Write;
use std::path::Path;

/// Greatest column and row.
const MAX_PLACE: u16 = 0x7ff;
/// Longest gap that is filled, µs: a day, 31 KB.
const MAX_GAP_US: u64 = 86_400_000_000;
/// High halves in the range of the time.
const HIGHS: u64 = 1 << 12;
/// Pixels of a vector, and its words without the base.
const VECTOR: u16 = 32;
const VECTOR_WORDS: usize = 3;

/// See the module.
pub(super) struct Evt3 {
    file: NewFile,
    sensor: Sensor,
    /// Events written.
    count: u64,
    /// What has been said last; `None` before the first event.
    said: Option<Said>,
}

/// What the words before have set.
struct Said {
    t_us: u64,
    y: Option<u16>,
    /// Where the next vector begins without a new base, and its polarity.
    base: Option<(u16, bool)>,
}

impl Evt3 {
    pub(super) fn create(path: &Path, options: &WriteOptions) -> Result<Self, WriteError> {
        let sensor = options.sensor.ok_or_else(|| WriteError::NoSensor {
            path: path.to_owned(),
            format: "EVT3",
        })?;
        Ok(Self {
            file: NewFile::create(path)?,
            sensor,
            count: 0,
            said: None,
        })
    }

    fn header(&mut self, first_us: u64) -> std::io::Result<()> {
        let Sensor { height, width } = self.sensor;
        write!(
            self.file,
            "% evt 3.0\n% format EVT3;height={height};width={width}\n% geometry {width}x{height}\n"
        )?;
        if first_us >> 24 > 0 {
            writeln!(self.file, "% time_base_us {first_us}")?;
        }
        self.file.write_all(b"% end\n")
    }

    fn word(&mut self, kind: u16, rest: u16) -> std::io::Result<()> {
        self.file.write_all(&(kind << 12 | rest).to_le_bytes())
    }

    /// Says time and row, each only when it changes. Times do not go back.
    fn time_and_row(&mut self, t_us: u64, y: u16) -> std::io::Result<Option<(u16, bool)>> {
        let (high, low) = (t_us >> 12, (t_us & 0xfff) as u16);
        let said = match self.said.take() {
            None => {
                self.header(t_us)?;
                self.word(0x8, (high % HIGHS) as u16)?;
                self.word(0x6, low)?;
                Said {
                    t_us,
                    y: None,
                    base: None,
                }
            }
            Some(said) => {
                let mut at = said.t_us >> 12;
                while at < high {
                    at = next_high(at, high);
                    self.word(0x8, (at % HIGHS) as u16)?;
                }
                if said.t_us != t_us {
                    self.word(0x6, low)?;
                }
                said
            }
        };
        if said.y != Some(y) {
            self.word(0x0, y)?;
        }
        let base = said.base;
        self.said = Some(Said {
            t_us,
            y: Some(y),
            base,
        });
        Ok(base)
    }

    /// Events of one time, row, polarity and block, with ascending columns.
    fn group(&mut self, events: &[RawEvent]) -> std::io::Result<()> {
        let Some(first) = events.first() else {
            return Ok(());
        };
        let base = self.time_and_row(first.t_ns / 1000, first.y)?;
        let (block, polarity) = (first.x - first.x % VECTOR, u16::from(first.on) << 11);
        let based = base == Some((block, first.on));
        let fits = usize::from(block + VECTOR) <= self.sensor.width;
        if !fits || events.len() <= VECTOR_WORDS + usize::from(!based) {
            return events
                .iter()
                .try_for_each(|event| self.word(0x2, polarity | event.x));
        }
        let valid = events
            .iter()
            .fold(0_u32, |valid, event| valid | 1 << (event.x - block));
        if !based {
            self.word(0x3, polarity | block)?;
        }
        self.word(0x4, (valid & 0xfff) as u16)?;
        self.word(0x4, (valid >> 12 & 0xfff) as u16)?;
        self.word(0x5, (valid >> 24) as u16)?;
        if let Some(said) = &mut self.said {
            said.base = Some((block + VECTOR, first.on));
        }
        Ok(())
    }

    /// Why an event does not fit.
    fn unfit(&self, event: &RawEvent, before_us: Option<u64>) -> Option<String> {
        let t_us = event.t_ns / 1000;
        if event.x > MAX_PLACE || event.y > MAX_PLACE {
            return Some(format!(
                "lies at x {} and y {}; EVT3 has columns and rows up to {MAX_PLACE}",
                event.x, event.y
            ));
        }
        match before_us {
            Some(before) if t_us < before => Some(format!(
                "at {} is earlier than the one before it at {before} us; put the recording in order first",
                crate::seconds(event.t_ns)
            )),
            Some(before) if t_us - before > MAX_GAP_US => Some(format!(
                "at {} comes more than a day after the one before it; cut the recording there",
                crate::seconds(event.t_ns)
            )),
            _ => None,
        }
    }
}

/// The next high half to be said on the way to `target`: steps that every reader follows, and none over the edge of
/// the range but that from its last value to its first.
fn next_high(at: u64, target: u64) -> u64 {
    let last = at | (HIGHS - 1);
    if at == last {
        at + 1
    } else {
        target.min(last).min(at + HIGHS / 2)
    }
}

/// Whether the second may follow the first in a group.
fn together(a: &RawEvent, b: &RawEvent) -> bool {
    a.t_ns / 1000 == b.t_ns / 1000 && (a.y, a.on, a.x / VECTOR) == (b.y, b.on, b.x / VECTOR) && a.x < b.x
}

impl Writer for Evt3 {
    fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        let mut before = self.said.as_ref().map(|said| said.t_us);
        let mut bad = None;
        for (at, event) in events.iter().enumerate() {
            bad = self.unfit(event, before).map(|what| (at, what));
            if bad.is_some() {
                break;
            }
            before = Some(event.t_ns / 1000);
        }
        let good = &events[..bad.as_ref().map_or(events.len(), |(at, _)| *at)];
        good.chunk_by(together)
            .try_for_each(|group| self.group(group))
            .map_err(|e| self.file.failed(e))?;
        self.count += good.len() as u64;
        match bad {
            None => Ok(()),
            Some((_, what)) => Err(WriteError::Event {
                path: self.file.path().to_owned(),
                index: self.count,
                what,
            }),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<(), WriteError> {
        if self.said.is_none() {
            self.header(0).map_err(|e| self.file.failed(e))?;
        }
        self.file.commit()
    }
}
