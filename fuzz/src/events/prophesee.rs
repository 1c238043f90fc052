//! Decoders of Prophesee's formats: pushed whole and in pieces, and as recordings with and without a header.

use evpr_events::formats::prophesee::{
    DatDecoder, Decoder, Encoding, Evt2Decoder, Evt3Decoder, Evt21Decoder, Evt21Order,
};
use evpr_events::{BATCH_EVENTS, Input, MAX_TIME_NS, RawEvent, ReadOptions};
use std::io::Cursor;

/// EVT 2.0.
pub fn evt2(data: &[u8]) {
    decoder(data, || Box::new(Evt2Decoder::new()));
    recording(data, Encoding::Evt2);
}

/// EVT 2.1, in both orders.
pub fn evt21(data: &[u8]) {
    for order in [Evt21Order::Little, Evt21Order::HalvesSwapped] {
        decoder(data, || Box::new(Evt21Decoder::new(order)));
        recording(data, Encoding::Evt21(order));
    }
}

/// EVT 3.0, from the start of a stream and from the last time of all.
pub fn evt3(data: &[u8]) {
    decoder(data, || Box::new(Evt3Decoder::new()));
    decoder(data, || Box::new(Evt3Decoder::with_time_base(u64::MAX)));
    recording(data, Encoding::Evt3);
}

/// DAT.
pub fn dat(data: &[u8]) {
    decoder(data, || Box::new(DatDecoder::new()));
    recording(data, Encoding::Dat);
}

/// Where the bytes are cut changes nothing; the first one says where.
fn decoder(data: &[u8], new: impl Fn() -> Box<dyn Decoder>) {
    let (mut decoder, mut whole) = (new(), Vec::new());
    decoder.decode(data, &mut whole);
    let word = decoder.word_bytes();
    assert!(whole.len() <= data.len() / word * decoder.most_events_per_word());
    assert_eq!(decoder.pending_bytes(), data.len() % word);
    assert!(whole.iter().all(|e| e.t_ns <= MAX_TIME_NS));
    let (mut decoder, mut pieces) = (new(), Vec::new());
    let cut = usize::from(data.first().copied().unwrap_or(0)) % 19 + 1;
    for piece in data.chunks(cut) {
        decoder.decode(piece, &mut pieces);
    }
    assert_eq!(decoder.pending_bytes(), data.len() % word);
    assert!(pieces == whole);
}

/// As a file of any kind, and as bare words.
fn recording(data: &[u8], encoding: Encoding) {
    for encoding in [None, Some(encoding)] {
        let options = ReadOptions {
            encoding,
            ..ReadOptions::default()
        };
        let input = Input::new("fuzzed", Cursor::new(data.to_vec()));
        let Ok(mut recording) = evpr_events::open_input(input, &options) else {
            continue;
        };
        let mut batch: Vec<RawEvent> = Vec::new();
        while let Ok(true) = recording.next_batch(&mut batch) {
            assert!(batch.len() <= BATCH_EVENTS);
        }
    }
}
