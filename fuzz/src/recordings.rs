//! Recordings of other formats, read to their end or their first error, with and without a size of the sensor.

use evpr_core::plan::Sensor;
use evpr_events::formats::aedat4_network;
use evpr_events::{BATCH_EVENTS, Input, MAX_TIME_NS, ReadOptions, Recording, SourceError, open_input};
use std::io::Cursor;

/// AEDAT4, as a file and as a network stream.
pub fn aedat4(data: &[u8]) {
    let options = ReadOptions::default();
    read(open_input(input(data), &options));
    let network = data.strip_prefix(b"#!AER-DAT4.0\r\n").unwrap_or(data);
    read(aedat4_network(input(network), &options));
}

/// AEDAT 2.0 by its chip, and by the size of the sensor.
pub fn aedat2(data: &[u8]) {
    let mut options = ReadOptions::default();
    read(open_input(input(data), &options));
    for (height, width) in [(128, 128), (260, 346)] {
        options.sensor = Some(Sensor { height, width });
        read(open_input(input(data), &options));
    }
}

/// Event Stream.
pub fn es(data: &[u8]) {
    read(open_input(input(data), &ReadOptions::default()));
}

fn input(data: &[u8]) -> Input {
    Input::new("fuzz", Cursor::new(data.to_vec()))
}

/// Reads to the end, and checks what every recording promises.
fn read(recording: Result<Box<dyn Recording>, SourceError>) {
    let one_line = |e: SourceError| assert!(!e.to_string().contains('\n'), "{e}");
    let mut recording = match recording {
        Ok(recording) => recording,
        Err(e) => return one_line(e),
    };
    let mut batch = Vec::new();
    loop {
        let outcome = recording.next_batch(&mut batch);
        assert!(batch.len() <= BATCH_EVENTS && batch.iter().all(|e| e.t_ns <= MAX_TIME_NS));
        match outcome {
            Ok(true) => {}
            Ok(false) => {
                assert!(batch.is_empty());
                assert_eq!(recording.progress_permille(), 1000);
                break;
            }
            Err(e) => {
                one_line(e);
                break;
            }
        }
    }
    assert!(
        recording
            .skipped()
            .iter()
            .all(|s| s.count > 0 && !s.what.contains('\n'))
    );
}
