//! Streams cut anywhere, cut off, slow, and of random bytes.

use super::words::*;
use evpr_events::formats::prophesee::{Encoding, Evt21Order};
use evpr_events::{Input, RawEvent, ReadOptions};
use proptest::prelude::*;
use std::io::Read;
use std::sync::mpsc::{Receiver, channel};

/// Gives what is sent, and waits for more.
struct Pipe(Receiver<Vec<u8>>);

impl Read for Pipe {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let Ok(bytes) = self.0.recv() else { return Ok(0) };
        assert!(bytes.len() <= out.len());
        out[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }
}

#[test]
fn events_that_have_come_are_not_held_up_by_those_that_have_not() {
    let (send, receive) = channel();
    send.send(b"% evt 3.0\n% format EVT3;heig".to_vec()).unwrap();
    send.send(b"ht=4;width=5\n% end\n".to_vec()).unwrap();
    let mut bytes = evt3(&[high(1), low(1), y(2), on(3), on(4)]);
    let last = bytes.pop().unwrap();
    send.send(bytes).unwrap();
    let mut recording =
        evpr_events::open_input(Input::new("pipe", Pipe(receive)), &ReadOptions::default()).unwrap();
    assert_eq!(recording.sensor().unwrap().width, 5);
    let mut batch = Vec::new();
    // The next read would wait for ever: nothing else has been sent.
    assert!(recording.next_batch(&mut batch).unwrap());
    assert_eq!(short(&batch), [(4097, 3, 2, true)]);
    send.send(vec![last]).unwrap();
    assert!(recording.next_batch(&mut batch).unwrap());
    assert_eq!(short(&batch), [(4097, 4, 2, true)]);
    drop(send);
    assert!(!recording.next_batch(&mut batch).unwrap());
    assert!(batch.is_empty());
}

#[test]
fn bare_words_on_a_pipe_are_opened_by_their_first_bytes() {
    let (send, receive) = channel();
    send.send(evt3(&[high(1)])).unwrap();
    let options = ReadOptions {
        encoding: Some(Encoding::Evt3),
        ..ReadOptions::default()
    };
    let mut recording = evpr_events::open_input(Input::new("pipe", Pipe(receive)), &options).unwrap();
    send.send(evt3(&[low(1), y(2), on(3)])).unwrap();
    let mut batch = Vec::new();
    assert!(recording.next_batch(&mut batch).unwrap() && batch.is_empty());
    assert!(recording.next_batch(&mut batch).unwrap());
    assert_eq!(short(&batch), [(4097, 3, 2, true)]);
}

#[test]
fn a_word_cut_off_at_the_end_is_an_error_after_the_events_before() {
    let event = evt2(&[0x8000_0001, 0x1000_0801]);
    let event21 = evt21(&[0x8000_0001 << 32, 0x1000_0801 << 32 | 1]);
    let event_dat = [vec![0, 8], dat(64, 1, 1, 1)].concat();
    let cases = [
        (Encoding::Evt2, event, 64, 4),
        (Encoding::Evt21(Evt21Order::Little), event21, 64, 8),
        (Encoding::Evt3, evt3(&[high(1), low(0), y(1), on(1)]), 4096, 2),
        (Encoding::Dat, event_dat, 64, 8),
    ];
    for (encoding, bytes, t, word) in cases {
        for rest in 0..word {
            let mut bytes = bytes.clone();
            bytes.extend(vec![0x25; rest]);
            let (events, end) = read(&bytes, Some(encoding));
            assert_eq!(short(&events), [(t, 1, 1, true)], "{encoding:?}");
            match end {
                Ok(()) => assert_eq!(rest, 0),
                Err(e) => assert_eq!(
                    e.to_string(),
                    format!(
                        "piped: ends within a word, after {rest} of {word} bytes; copy it again, or cut them off"
                    )
                ),
            }
        }
    }
}

#[test]
fn batches_are_full_and_whole() {
    // Vectors, single events and words that give none, in turns.
    let mut words = vec![high(0), low(0), y(1)];
    for i in 0..150_000_u32 {
        words.extend(match i / 1000 % 3 {
            0 => vec![0x3000, 0x4fff, 0x50f1],
            1 => vec![low((i & 0xfff) as u16), on(5)],
            _ => vec![0xe000],
        });
    }
    for i in 0..40_000_u32 {
        words.extend([0x3000, 0x4fff, low((i & 0xfff) as u16)]);
    }
    let bytes = evt3(&words);
    let mut whole = Vec::new();
    decoder(Encoding::Evt3).decode(&bytes, &mut whole);
    assert!(whole.len() > 8 * evpr_events::BATCH_EVENTS);
    let (events, end) = read(&bytes, Some(Encoding::Evt3));
    end.unwrap();
    assert!(events == whole);
}

/// Words of which most mean something.
fn evt3_words() -> impl Strategy<Value = Vec<u16>> {
    let kind = prop_oneof![
        4 => Just(2_u16), 2 => Just(3), 3 => Just(4), 3 => Just(5), 2 => Just(6), 1 => Just(8), 1 => Just(0),
        1 => 0_u16..16
    ];
    let word = (kind, 0_u16..0x1000).prop_map(|(kind, rest)| kind << 12 | rest);
    prop::collection::vec(word, 0..400)
}

/// Cuts as lengths of pieces.
fn cuts() -> impl Strategy<Value = Vec<usize>> {
    prop::collection::vec(0_usize..40, 1..60)
}

fn in_pieces(encoding: Encoding, mut bytes: &[u8], cuts: &[usize]) -> (Vec<RawEvent>, usize) {
    let mut decoder = decoder(encoding);
    let mut out = Vec::new();
    for cut in cuts {
        let (piece, rest) = bytes.split_at((*cut).min(bytes.len()));
        decoder.decode(piece, &mut out);
        bytes = rest;
    }
    decoder.decode(bytes, &mut out);
    (out, decoder.pending_bytes())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn where_a_stream_is_cut_changes_nothing(
        words in evt3_words(),
        noise in prop::collection::vec(any::<u8>(), 0..400),
        cuts in cuts(),
    ) {
        let start = evt3(&[high(1), low(1), y(1)]);
        let bytes = [start, evt3(&words)].concat();
        for encoding in Encoding::ALL {
            for bytes in [&bytes[..], &noise[..]] {
                let whole = in_pieces(encoding, bytes, &[]);
                prop_assert_eq!(&in_pieces(encoding, bytes, &cuts), &whole);
                prop_assert_eq!(whole.1, bytes.len() % decoder(encoding).word_bytes());
            }
        }
    }

    #[test]
    fn random_bytes_never_panic(
        noise in prop::collection::vec(any::<u8>(), 0..2000),
        header in "(% [a-zA-Z_]{0,9} [ -~]{0,20}\n){0,3}(% (format EVT3|evt 2.1|Data file)\n)?(% end\n)?",
    ) {
        let bytes = [header.as_bytes(), &noise].concat();
        for encoding in Encoding::ALL.map(Some).into_iter().chain([None]) {
            let (events, end) = read(&bytes, encoding);
            let most = bytes.len() * 12;
            prop_assert!(events.len() <= most);
            if let Err(e) = end {
                prop_assert!(!e.to_string().contains('\n'));
            }
        }
    }

    #[test]
    fn the_other_decoder_of_evt3_agrees_where_times_are_plain(words in evt3_words()) {
        // Highs that only grow, each with its low; a row, a base and a time before all else. (It takes a repeated
        // high as low 0, so these are left out.)
        let mut stream = vec![high(0), low(0), y(0), 0x3000];
        let mut next_high = 0;
        for word in words {
            // Bases beyond 11 bits are the one other thing in which it differs: it panics.
            let base = stream.iter().rev().take(100).any(|w| w >> 12 == 3);
            match word >> 12 {
                8 => {
                    next_high += 1;
                    stream.extend([high(next_high), low(word & 0xfff)]);
                }
                4 | 5 if !base => {}
                _ => stream.push(word),
            }
        }
        let (mut theirs, mut triggers) = (Vec::new(), Vec::new());
        evt3::Evt3Decoder::new().decode_buffer(&stream, &mut theirs, &mut triggers);
        let theirs: Vec<_> = theirs.iter().map(|e| (e.timestamp, e.x, e.y, e.polarity == 1)).collect();
        let (ours, passed) = decode(Encoding::Evt3, &evt3(&stream));
        prop_assert_eq!(ours, theirs);
        prop_assert_eq!(passed.triggers, triggers.len() as u64);
        prop_assert_eq!(passed.before_start, 0);
    }
}
