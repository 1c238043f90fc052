//! A RAW or DAT recording, or a bare stream: a header, and what a decoder makes of the rest.

use super::header::{self, Header};
use super::{DatDecoder, Decoder, Encoding, Evt2Decoder, Evt3Decoder, Evt21Decoder, Evt21Order};
use crate::{BATCH_EVENTS, Input, RawEvent, Recording, Skipped, SourceError, SourceInfo};
use evpr_core::plan::Sensor;

/// A batch is full when less room than this is left, so that decoding in pieces that surely fit comes to an end.
const MIN_ROOM: usize = BATCH_EVENTS / 16;

/// Types of events in DAT: of one pixel (in general; of change). All have 8 bytes.
const DAT_TYPES: [u8; 2] = [0x00, 0x0c];
const DAT_BYTES: u8 = 8;

/// See the module.
pub(in crate::formats) struct Prophesee {
    input: Input,
    decoder: Box<dyn Decoder>,
    encoding: Encoding,
    sensor: Option<Sensor>,
}

impl Prophesee {
    /// `bare`: the encoding that the caller knows. Then the header may be missing, or agrees.
    pub(in crate::formats) fn open(mut input: Input, bare: Option<Encoding>) -> Result<Self, SourceError> {
        let header = if bare.is_some() && !has_header(&mut input)? {
            Header::default()
        } else {
            header::read(&mut input)?
        };
        let path = input.path().to_owned();
        let encoding = match (header.encoding, bare) {
            (Some(said), Some(asked)) if said != asked => Err(format!(
                "its header says {}, but it was to be read as {}; leave the encoding to the header",
                said.name(),
                asked.name()
            )),
            (Some(encoding), _) | (None, Some(encoding)) => Ok(encoding),
            (None, None) => Err(
                "has the header of a Prophesee recording, but no line \"% format\" or \"% evt\" that says the \
                 encoding; add one, such as \"% evt 3.0\""
                    .to_owned(),
            ),
        };
        let encoding = encoding.map_err(|what| SourceError::malformed(&path, what))?;
        let decoder: Box<dyn Decoder> = match encoding {
            Encoding::Evt2 => Box::new(Evt2Decoder::new()),
            Encoding::Evt21(order) => Box::new(Evt21Decoder::new(order)),
            Encoding::Evt3 => Box::new(match header.time_base_us {
                Some(us) => Evt3Decoder::with_time_base(us.saturating_mul(1_000)),
                None => Evt3Decoder::new(),
            }),
            Encoding::Dat => {
                dat_type(&mut input)?;
                Box::new(DatDecoder::new())
            }
        };
        if input.peek(1)?.is_empty() {
            return Err(SourceError::malformed(&path, "holds no events"));
        }
        Ok(Self {
            input,
            decoder,
            encoding,
            sensor: header.sensor,
        })
    }
}

/// Whether bytes that may be bare words begin with a header: a word may look like its first two bytes, but hardly like
/// its first keyword too. Waits for no more bytes than it needs.
fn has_header(input: &mut Input) -> Result<bool, SourceError> {
    let percent = input.peek(1)?.first() == Some(&b'%');
    Ok(percent && matches!(input.peek(3)?, [_, b' ', c, ..] if c.is_ascii_alphabetic()))
}

fn dat_type(input: &mut Input) -> Result<(), SourceError> {
    let what = match *input.peek(2)? {
        [kind, DAT_BYTES, ..] if DAT_TYPES.contains(&kind) => {
            input.consume(2);
            return Ok(());
        }
        [kind, bytes, ..] => format!(
            "holds data of type {kind} with {bytes} bytes each; events of pixels (type 0 or 12, 8 bytes) are read"
        ),
        _ => "holds no events".to_owned(),
    };
    Err(SourceError::malformed(input.path(), what))
}

impl Recording for Prophesee {
    fn sensor(&self) -> Option<Sensor> {
        self.sensor
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        while BATCH_EVENTS - out.len() > MIN_ROOM {
            let words = (BATCH_EVENTS - out.len()) / self.decoder.most_events_per_word();
            let bytes = if out.is_empty() {
                self.input.peek(1)?
            } else {
                self.input.buffered()
            };
            if bytes.is_empty() && !out.is_empty() {
                break;
            }
            if bytes.is_empty() {
                return match self.decoder.pending_bytes() {
                    0 => Ok(false),
                    pending => Err(SourceError::malformed(
                        self.input.path(),
                        format!(
                            "ends within a word, after {pending} of {} bytes; copy it again, or cut them off",
                            self.decoder.word_bytes()
                        ),
                    )),
                };
            }
            let len = bytes.len().min(words * self.decoder.word_bytes());
            self.decoder.decode(&bytes[..len], out);
            self.input.consume(len);
            if out.is_empty() {
                break;
            }
        }
        Ok(true)
    }

    fn progress_permille(&self) -> u64 {
        self.input.progress_permille()
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: match self.encoding {
                Encoding::Evt2 => "EVT2",
                Encoding::Evt21(Evt21Order::Little) => "EVT2.1",
                Encoding::Evt21(Evt21Order::HalvesSwapped) => "EVT2.1 (legacy order)",
                Encoding::Evt3 => "EVT3",
                Encoding::Dat => "DAT",
            },
            path: self.input.path().to_owned(),
            time_unit: "us",
            time_unit_from: "format",
            events: None,
        }
    }

    fn skipped(&self) -> Vec<Skipped> {
        let passed = self.decoder.passed_over();
        [
            ("external triggers", passed.triggers),
            ("events before the first full time and place", passed.before_start),
        ]
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .map(|(what, count)| Skipped {
            what: what.to_owned(),
            count,
        })
        .collect()
    }
}
