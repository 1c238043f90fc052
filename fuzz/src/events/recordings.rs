//! Recordings of other formats, read to their end or their first error.

use super::Written;
use evpr_core::plan::Sensor;
use evpr_events::formats::aedat4_network;
use evpr_events::{BATCH_EVENTS, Input, MAX_TIME_NS, ReadOptions, Recording, SourceError, open, open_input};
use std::io::Cursor;

/// Most batches that are read of what unpacks to more than it is.
const BATCHES: usize = 64;

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

/// A bag of ROS 1.
pub fn rosbag(data: &[u8]) {
    read(open_input(input(data), &ReadOptions::default()));
}

/// MCAP, as ROS 2 writes it.
pub fn mcap(data: &[u8]) {
    read(open_input(input(data), &ReadOptions::default()));
}

/// A bag of ROS 2 in SQLite, read from a file.
pub fn rosbag2(data: &[u8]) {
    read_file(data, "db3", usize::MAX);
}

/// HDF5, which is read in any order and so from a file. What is not stored counts as 0, however much it is said to be.
pub fn hdf5(data: &[u8]) {
    read_file(data, "h5", BATCHES);
}

/// NumPy arrays, in order and from a file.
pub fn npy(data: &[u8]) {
    read(open_input(input(data), &ReadOptions::default()));
    read_file(data, "npy", usize::MAX);
}

/// Zip archives, of NumPy arrays and of text.
pub fn npz(data: &[u8]) {
    read_file(data, "npz", BATCHES);
}

/// What is packed by gzip.
pub fn gzip(data: &[u8]) {
    read_some(open_input(input(data), &ReadOptions::default()), BATCHES);
}

/// Parquet; without that feature the refusal.
pub fn parquet(data: &[u8]) {
    read_file(data, "parquet", BATCHES);
}

/// Text, from a pipe and from a file.
pub fn text(data: &[u8]) {
    read(open_input(input(data), &ReadOptions::default()));
    read_file(data, "txt", usize::MAX);
}

/// Reads a file of these bytes, at most so many batches, and enters it in its middle.
fn read_file(data: &[u8], extension: &str, batches: usize) {
    let file = Written::new(data, extension);
    read_some(open(&file.0, &ReadOptions::default()), batches);
    if let Ok(mut recording) = open(&file.0, &ReadOptions::default()) {
        let _ = recording.seek_before(1_600_000_000_500_000_000);
        let _ = recording.next_batch(&mut Vec::new());
    }
}

fn input(data: &[u8]) -> Input {
    Input::new("fuzz", Cursor::new(data.to_vec()))
}

/// Reads to the end, and checks what every recording promises.
fn read(recording: Result<Box<dyn Recording>, SourceError>) {
    read_some(recording, usize::MAX);
}

/// As `read`, but at most so many batches.
fn read_some(recording: Result<Box<dyn Recording>, SourceError>, batches: usize) {
    let one_line = |e: SourceError| assert!(!e.to_string().contains('\n'), "{e}");
    let mut recording = match recording {
        Ok(recording) => recording,
        Err(e) => return one_line(e),
    };
    let mut batch = Vec::new();
    for _ in 0..batches {
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
