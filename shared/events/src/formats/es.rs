//! Event Stream, `.es`, version 2: events of DVS and ATIS sensors, a few bytes each.
//!
//! 12 letters, three bytes of version, a byte of type, width and height (u16, little-endian). Then one byte that holds
//! the µs since the event before and the flags, x and y (u16, little-endian) per event; all bits of the time set means
//! only that time goes on. From github.com/neuromorphic-paris/event_stream. Row 0 of the file is the lowest one of the
//! picture; rows given here count from the top.

use crate::{
    BATCH_EVENTS, Input, MAX_TIME_NS, RawEvent, ReadOptions, Recording, Skipped, SourceError, SourceInfo,
};
use evpr_core::plan::Sensor;

/// What a file begins with.
pub(super) const SIGNATURE: &[u8] = b"Event Stream";
/// Signature, version, type, width and height.
const HEADER_BYTES: usize = 20;
const EVENT_BYTES: usize = 5;
const MAX_TIME_US: u64 = MAX_TIME_NS / 1000;

/// The streams that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Time in bits 1 to 7, ON in bit 0.
    Dvs,
    /// Time in bits 2 to 7, ON in bit 1; bit 0 marks the measurements of brightness, which are passed over.
    Atis,
}

/// See the module.
pub(super) struct Es {
    input: Input,
    kind: Kind,
    sensor: Sensor,
    t_us: u64,
    brightness: u64,
    ended: bool,
}

impl Es {
    pub(super) fn open(mut input: Input, _: &ReadOptions) -> Result<Self, SourceError> {
        let head = input.peek(HEADER_BYTES)?;
        let wrong = |path: &std::path::Path, what: &str| Err(SourceError::malformed(path, what));
        let Some(head) = head.get(..HEADER_BYTES) else {
            return wrong(
                input.path(),
                "ends inside its header; it was cut off: get another copy",
            );
        };
        let (version, kind) = (head[12], head[15]);
        let side = |at: usize| usize::from(u16::from_le_bytes([head[at], head[at + 1]]));
        let sensor = Sensor {
            height: side(18),
            width: side(16),
        };
        if version != 2 {
            let what = format!("is Event Stream version {version}; this build reads version 2");
            return wrong(input.path(), &what);
        }
        let kind = match kind {
            1 => Kind::Dvs,
            2 => Kind::Atis,
            other => {
                let name = match other {
                    0 => "generic events",
                    3 => "events of a display",
                    4 => "colour events",
                    _ => "an unknown kind",
                };
                let what =
                    format!("is an Event Stream of {name} (type {other}); this build reads DVS and ATIS");
                return wrong(input.path(), &what);
            }
        };
        if sensor.width == 0 || sensor.height == 0 {
            let what = format!(
                "says that its sensor has {}x{} pixels",
                sensor.height, sensor.width
            );
            return wrong(input.path(), &what);
        }
        input.consume(HEADER_BYTES);
        Ok(Self {
            input,
            kind,
            sensor,
            t_us: 0,
            brightness: 0,
            ended: false,
        })
    }

    /// Decodes what is there already.
    fn decode(&mut self, out: &mut Vec<RawEvent>) -> Result<(), SourceError> {
        let bytes = self.input.buffered();
        let (shift, most) = match self.kind {
            Kind::Dvs => (1, 0x7f),
            Kind::Atis => (2, 0x3f),
        };
        let mut at = 0;
        while out.len() < BATCH_EVENTS {
            let Some(&first) = bytes.get(at) else { break };
            let step = u64::from(first >> shift);
            if step == most {
                // The flags say how often; 0 is a mark to begin again at, which needs nothing here.
                self.t_us += most * u64::from(first & ((1 << shift) - 1));
                at += 1;
                continue;
            }
            let Some(event) = bytes.get(at..at + EVENT_BYTES) else {
                break;
            };
            self.t_us += step;
            if self.t_us > MAX_TIME_US {
                let what = "holds times beyond 292 years; it is damaged";
                return Err(SourceError::malformed(self.input.path(), what));
            }
            at += EVENT_BYTES;
            if self.kind == Kind::Atis && first & 1 == 1 {
                self.brightness += 1;
                continue;
            }
            let row = usize::from(u16::from_le_bytes([event[3], event[4]]));
            let from_top = (self.sensor.height - 1).checked_sub(row);
            out.push(RawEvent {
                t_ns: self.t_us * 1000,
                x: u16::from_le_bytes([event[1], event[2]]),
                y: from_top.and_then(|y| u16::try_from(y).ok()).unwrap_or(u16::MAX),
                on: first >> (shift - 1) & 1 == 1,
            });
        }
        self.input.consume(at);
        Ok(())
    }
}

impl Recording for Es {
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
            format: match self.kind {
                Kind::Dvs => "Event Stream (DVS)",
                Kind::Atis => "Event Stream (ATIS)",
            },
            path: self.input.path().to_owned(),
            time_unit: "us",
            time_unit_from: "format",
            events: None,
        }
    }

    fn skipped(&self) -> Vec<Skipped> {
        let brightness = (self.brightness > 0).then(|| Skipped {
            what: "measurements of brightness".to_owned(),
            count: self.brightness,
        });
        brightness.into_iter().collect()
    }
}
