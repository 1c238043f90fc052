//! Parquet: units, types and layouts as pyarrow writes them (fixtures/make_parquet.py), and what is wrong with bad
//! files. Where Python has pyarrow, it reads what is written here.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // a broken fixture must fail the test

use evpr_events::{ReadOptions, open};
use std::path::{Path, PathBuf};

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/parquet")
}

#[cfg(not(feature = "parquet"))]
#[test]
fn a_build_without_it_says_how_to_get_it() {
    let path = fixtures().join("us_i64.parquet");
    let Err(said) = open(&path, &ReadOptions::default()) else {
        panic!("it was read");
    };
    let said = said.to_string();
    assert!(
        said.contains("us_i64.parquet") && said.contains("--features parquet"),
        "{said}"
    );
}

#[cfg(feature = "parquet")]
mod built_in {
    use super::*;
    use evpr_core::plan::TimeUnit;
    use evpr_events::writers::{self, WriteOptions};
    use evpr_events::{BATCH_EVENTS, RawEvent, Recording, SourceError};
    use std::process::Command;

    const EVENTS: u64 = 300;

    /// Event i of the fixtures, its time cut to whole units.
    fn wants(i: u64, unit_ns: u64) -> RawEvent {
        let us = (1_587_452_582_350 + i) * 1000 + i % 7;
        RawEvent {
            t_ns: us * 1000 / unit_ns * unit_ns,
            x: (7 * i % 346) as u16,
            y: (3 * i % 260) as u16,
            on: i % 2 == 1,
        }
    }

    fn open_as(path: &Path, time_unit: TimeUnit) -> Result<Box<dyn Recording>, SourceError> {
        let options = ReadOptions {
            time_unit,
            ..ReadOptions::default()
        };
        open(path, &options)
    }

    /// All events until it ends or fails.
    fn read(path: &Path) -> (Vec<RawEvent>, Option<String>) {
        let mut all = Vec::new();
        let mut recording = match open_as(path, TimeUnit::Auto) {
            Ok(recording) => recording,
            Err(e) => return (all, Some(e.to_string())),
        };
        let mut batch = Vec::new();
        loop {
            let more = recording.next_batch(&mut batch);
            assert!(batch.len() <= BATCH_EVENTS);
            all.extend_from_slice(&batch);
            match more {
                Ok(true) => {}
                Ok(false) => return (all, None),
                Err(e) => {
                    assert!(!recording.next_batch(&mut batch).unwrap(), "it fails once");
                    return (all, Some(e.to_string()));
                }
            }
        }
    }

    #[test]
    fn every_unit_type_and_layout_is_read() {
        for (name, unit, from) in [
            ("seconds_f64", "s", "floating point"),
            ("ms_i64", "ms", "magnitude"),
            ("us_i64", "us", "magnitude"),
            ("ns_u64", "ns", "magnitude"),
            ("us_f64", "us", "magnitude"),
            ("named_us", "us", "name"),
            ("typed_ms", "ms", "format"),
            ("typed_us", "us", "format"),
            ("typed_ns", "ns", "format"),
            ("pages_v2", "us", "magnitude"),
            ("split", "us", "magnitude"),
            ("extra_columns_one_group", "us", "magnitude"),
            ("checked", "us", "magnitude"),
        ] {
            let path = fixtures().join(format!("{name}.parquet"));
            let about = open_as(&path, TimeUnit::Auto).unwrap().describe();
            assert_eq!(
                (about.format, about.time_unit, about.time_unit_from, about.events),
                ("parquet", unit, from, Some(EVENTS)),
                "{name}"
            );
            let unit_ns = if unit == "ms" { 1_000_000 } else { 1000 };
            let (events, failed) = read(&path);
            assert_eq!(failed, None, "{name}");
            assert_eq!(events.len() as u64, EVENTS, "{name}");
            for (i, event) in (0..).zip(events) {
                assert_eq!(event, wants(i, unit_ns), "{name}, event {i}");
            }
        }
    }

    #[test]
    fn the_configuration_decides_the_unit_unless_the_type_does() {
        let first = |name: &str, unit| {
            let mut recording = open_as(&fixtures().join(name), unit).unwrap();
            let mut batch = Vec::new();
            assert!(recording.next_batch(&mut batch).unwrap());
            (recording.describe().time_unit_from, batch[0].t_ns)
        };
        assert_eq!(
            first("us_i64.parquet", TimeUnit::Ns),
            ("config", 1_587_452_582_350_000)
        );
        assert_eq!(
            first("typed_us.parquet", TimeUnit::Ns),
            ("format", 1_587_452_582_350_000_000)
        );
    }

    #[test]
    fn bad_files_are_refused_in_one_line() {
        for (name, good, says) in [
            ("no_events", 0, "holds no events"),
            ("missing_x", 0, "has no column x among t, y, p; name one x or xs"),
            ("text_polarity", 0, "a column p that is not one integer"),
            ("list_x", 0, "has no column x"),
            ("two_times", 0, "two columns for t"),
            ("brotli", 0, "compressed with Brotli"),
            ("decimal_time", 0, "a column t that is not one integer"),
            ("null_y", 200, "event 200 (from 0): it has no y"),
            ("negative_x", 130, "event 130 (from 0): x is -3"),
            ("bad_polarity", 7, "event 7 (from 0): the polarity is 2"),
            ("nan_time", 299, "event 299 (from 0): the time NaN"),
        ] {
            let path = fixtures().join(format!("{name}.parquet"));
            let (events, said) = read(&path);
            let said = said.unwrap();
            assert!(said.contains(name) && said.contains(says), "{said}");
            assert!(!said.contains('\n'), "{said}");
            assert_eq!(events.len(), good, "{name}");
        }
    }

    #[test]
    fn it_can_be_entered_at_row_groups() {
        for (name, places) in [
            (
                "us_i64",
                [
                    (0, 0),
                    (127, 0),
                    (128, 0),
                    (129, 128),
                    (257, 256),
                    (299, 256),
                    (400, 256),
                ],
            ),
            (
                "extra_columns_one_group",
                [(0, 0), (127, 0), (128, 0), (129, 0), (257, 0), (299, 0), (400, 0)],
            ),
        ] {
            let path = fixtures().join(format!("{name}.parquet"));
            let mut recording = open_as(&path, TimeUnit::Auto).unwrap();
            let mut batch = Vec::new();
            for (event, index) in places {
                let found = recording.seek_before(wants(event, 1).t_ns).unwrap();
                assert_eq!(found, Some(index), "{name}, event {event}");
                assert!(recording.next_batch(&mut batch).unwrap());
                assert_eq!(batch[0], wants(index, 1), "{name}, event {event}");
            }
            let mut rest = 0;
            while recording.next_batch(&mut batch).unwrap() {
                rest += batch.len();
            }
            assert_eq!((rest, recording.progress_permille()), (0, 1000), "{name}");
        }
    }

    /// Cut anywhere, a file is refused; with any byte changed it is refused, or read as something. It never panics.
    #[test]
    fn damaged_files_never_panic() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.parquet");
        // A new file each time: some file systems flush one that is written over.
        let write = |bytes: &[u8]| {
            let _ = std::fs::remove_file(&path);
            std::fs::write(&path, bytes).unwrap();
        };
        let mut by_sum = 0;
        for name in ["pages_v2", "split", "us_i64", "checked", "named_us"] {
            let whole = std::fs::read(fixtures().join(format!("{name}.parquet"))).unwrap();
            for len in (0..whole.len()).step_by(7) {
                write(&whole[..len]);
                let (events, said) = read(&path);
                assert!(said.is_some() && events.is_empty(), "{name}: {len} bytes");
            }
            for at in (0..whole.len()).step_by(3) {
                let mut bytes = whole.clone();
                bytes[at] ^= 1 << (at % 8);
                write(&bytes);
                let (events, said) = read(&path);
                assert!(said.as_ref().is_none_or(|said| !said.contains('\n')), "{said:?}");
                assert!(said.is_some() || !events.is_empty(), "{name}: byte {at}");
                by_sum += usize::from(said.is_some_and(|said| said.contains("check sum")));
            }
        }
        // Every third byte of the values of `checked` alone.
        assert!(by_sum > 300 * 12 / 3, "{by_sum}");
    }

    /// A page, a footer or a list that claims to be huge is refused before room is made for it.
    #[test]
    fn claimed_sizes_are_not_trusted() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.parquet");
        let said = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read(&path).1.unwrap()
        };
        let whole = std::fs::read(fixtures().join("checked.parquet")).unwrap();
        let end = whole.len() - 8;
        // Of the first page: its kind, 0, in two bytes; a field's byte, its size in two.
        assert_eq!(whole[4..7], [0x15, 0, 0x15]);
        let huge = [0xfe, 0xff, 0xff, 0xff, 0x0f];
        let header = [&whole[..7], &huge, &whole[9..]].concat();
        let says = said(&header);
        assert!(
            says.contains("a page of 2147483647 bytes (at most 33554432 are read)"),
            "{says}"
        );
        let mut footer = whole.clone();
        footer[end..end + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(said(&footer).contains("a footer of 4294967295 bytes"));
        footer[end..end + 4].copy_from_slice(&(whole.len() as u32).to_le_bytes());
        assert!(said(&footer).contains("damaged footer"));
        // A footer that is a schema of 2^31 - 1 elements, and one of lists in lists.
        for body in [
            vec![0x29, 0xfc, 0xff, 0xff, 0xff, 0xff, 0x07, 0],
            vec![0x39; 100_000],
        ] {
            let len = (body.len() as u32).to_le_bytes();
            let bytes = [b"PAR1", body.as_slice(), &len, b"PAR1"].concat();
            assert!(said(&bytes).contains("damaged footer"));
        }
        let encrypted = [&whole[..end + 4], b"PARE"].concat();
        assert!(said(&encrypted).contains("encrypted"));
    }

    fn python(script: &str, argument: &Path) -> Option<String> {
        let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let has = Command::new(&python)
            .args(["-c", "import pyarrow.parquet, numpy"])
            .output();
        if !has.is_ok_and(|o| o.status.success()) {
            println!("skipped: no {python} with pyarrow and numpy");
            return None;
        }
        let done = Command::new(&python)
            .args(["-c", script])
            .arg(argument)
            .output()
            .unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        Some(String::from_utf8(done.stdout).unwrap())
    }

    /// More than one row group.
    fn many() -> Vec<RawEvent> {
        (0..300_000)
            .map(|i| wants(i, 1))
            .map(|e| RawEvent {
                t_ns: e.t_ns + 123,
                ..e
            })
            .collect()
    }

    #[test]
    fn pyarrow_reads_what_is_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("written.parquet");
        let mut writer = writers::create(&path, &WriteOptions::default()).unwrap();
        writer.write(&many()).unwrap();
        writer.finish().unwrap();
        let about = open_as(&path, TimeUnit::Auto).unwrap().describe();
        assert_eq!((about.time_unit, about.time_unit_from), ("ns", "name"));
        let script = "
import sys, numpy as np, pyarrow.parquet as pq
file = pq.ParquetFile(sys.argv[1]); table = file.read(); i = np.arange(300_000)
wants = dict(t_ns=((1_587_452_582_350 + i)*1000 + i % 7)*1000 + 123, x=7*i % 346, y=3*i % 260, p=i % 2 == 1)
assert table.column_names == list(wants)
assert [str(t) for t in table.schema.types] == ['int64', 'uint16', 'uint16', 'bool'], table.schema
for name, values in wants.items():
    assert np.array_equal(table[name].to_numpy(), values), name
print(file.num_row_groups)";
        if let Some(said) = python(script, &path) {
            assert_eq!(said.trim(), "2");
        }
    }

    #[test]
    fn what_pyarrow_writes_in_its_usual_way_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("usual.parquet");
        let script = "
import sys, numpy as np, pyarrow as pa, pyarrow.parquet as pq
i = np.arange(300_000)
pq.write_table(pa.table(dict(t=((1_587_452_582_350 + i)*1000 + i % 7)*1000 + 123, x=7*i % 346, y=3*i % 260,
    p=i % 2)), sys.argv[1])";
        if python(script, &path).is_some() {
            assert!(read(&path) == (many(), None));
        }
    }
}
