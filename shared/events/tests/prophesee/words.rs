//! Streams written by hand, and what decoders and recordings make of them.

use evpr_events::formats::prophesee::{
    DatDecoder, Decoder, Encoding, Evt2Decoder, Evt3Decoder, Evt21Decoder, PassedOver,
};
use evpr_events::{Input, RawEvent, ReadOptions, Recording, SourceError};
use std::io::Cursor;

/// (time in µs, x, y, on)
pub(crate) type Event = (u64, u16, u16, bool);

pub(crate) fn short(events: &[RawEvent]) -> Vec<Event> {
    events
        .iter()
        .map(|e| {
            assert_eq!(e.t_ns % 1000, 0);
            (e.t_ns / 1000, e.x, e.y, e.on)
        })
        .collect()
}

pub(crate) fn decoder(encoding: Encoding) -> Box<dyn Decoder> {
    match encoding {
        Encoding::Evt2 => Box::new(Evt2Decoder::new()),
        Encoding::Evt21(order) => Box::new(Evt21Decoder::new(order)),
        Encoding::Evt3 => Box::new(Evt3Decoder::new()),
        Encoding::Dat => Box::new(DatDecoder::new()),
    }
}

pub(crate) fn decode(encoding: Encoding, bytes: &[u8]) -> (Vec<Event>, PassedOver) {
    let mut decoder = decoder(encoding);
    let mut out = Vec::new();
    decoder.decode(bytes, &mut out);
    (short(&out), decoder.passed_over())
}

pub(crate) fn evt3(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_le_bytes()).collect()
}

pub(crate) fn evt2(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_le_bytes()).collect()
}

pub(crate) fn evt21(words: &[u64]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_le_bytes()).collect()
}

/// An event of DAT.
pub(crate) fn dat(t: u32, x: u32, y: u32, p: u32) -> Vec<u8> {
    [t, x | y << 14 | p << 28]
        .iter()
        .flat_map(|w| w.to_le_bytes())
        .collect()
}

/// EVT 3.0: the high part of a time, the low part, a row, an ON event.
pub(crate) const fn high(high: u16) -> u16 {
    0x8000 | high
}

pub(crate) const fn low(low: u16) -> u16 {
    0x6000 | low
}

pub(crate) const fn y(y: u16) -> u16 {
    y
}

pub(crate) const fn on(x: u16) -> u16 {
    0x2800 | x
}

/// A recording of these bytes, read to its end or its error.
pub(crate) fn read(bytes: &[u8], encoding: Option<Encoding>) -> (Vec<RawEvent>, Result<(), SourceError>) {
    let mut recording = match open(bytes, encoding) {
        Ok(recording) => recording,
        Err(e) => return (Vec::new(), Err(e)),
    };
    read_all(recording.as_mut())
}

pub(crate) fn open(bytes: &[u8], encoding: Option<Encoding>) -> Result<Box<dyn Recording>, SourceError> {
    let options = ReadOptions {
        encoding,
        ..ReadOptions::default()
    };
    evpr_events::open_input(Input::new("piped", Cursor::new(bytes.to_vec())), &options)
}

pub(crate) fn read_all(recording: &mut dyn Recording) -> (Vec<RawEvent>, Result<(), SourceError>) {
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    loop {
        let more = recording.next_batch(&mut batch);
        assert!(batch.len() <= evpr_events::BATCH_EVENTS);
        all.append(&mut batch);
        match more {
            Ok(true) => {}
            Ok(false) => return (all, Ok(())),
            Err(e) => return (all, Err(e)),
        }
    }
}
