//! Recordings of every kind, good and bad, through the public interface.
#![allow(clippy::unwrap_used)] // helpers of tests are not seen as tests

use evpr_core::plan::{HotPixelRule, Sensor, TimeUnit};
use evpr_events::{
    RawEvent, ReadOptions, Recording, RecordingInfo, SourceError, SourceInfo, estimate_hot_pixels, info,
};
use std::fs;
use std::path::{Path, PathBuf};

/// A recording to be opened: its path and how to read it.
struct Source {
    path: PathBuf,
    options: ReadOptions,
}

fn source(path: impl Into<PathBuf>, time_unit: TimeUnit) -> Source {
    Source {
        path: path.into(),
        options: ReadOptions {
            time_unit,
            ..ReadOptions::default()
        },
    }
}

fn open(source: &Source) -> Result<Box<dyn Recording>, SourceError> {
    evpr_events::open(&source.path, &source.options)
}

fn probe(source: &Source) -> Result<Option<Sensor>, SourceError> {
    Ok(open(source)?.sensor())
}

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures")
        .join(name)
}

/// All events, or those before the error with it.
fn read(source: &Source) -> (Vec<RawEvent>, Option<SourceError>) {
    let mut recording = match open(source) {
        Ok(recording) => recording,
        Err(e) => return (Vec::new(), Some(e)),
    };
    let (mut all, mut batch, mut permille) = (Vec::new(), Vec::new(), 0);
    loop {
        let outcome = recording.next_batch(&mut batch);
        all.append(&mut batch);
        assert!((permille..=1000).contains(&recording.progress_permille()));
        permille = recording.progress_permille();
        match outcome {
            Ok(true) => {}
            Ok(false) => {
                assert_eq!(permille, 1000);
                return (all, None);
            }
            Err(e) => return (all, Some(e)),
        }
    }
}

fn read_h5(name: &str) -> (Vec<RawEvent>, String) {
    let (events, error) = read(&source(fixture(name), TimeUnit::Auto));
    let error = error.map(|e| e.to_string()).unwrap_or_default();
    assert!(!error.contains('\n'), "{error}");
    assert!(error.is_empty() || error.contains(name), "{error}");
    (events, error)
}

/// What `make_fixtures.py` says is in `valid.h5`.
fn expected(i: u64) -> RawEvent {
    RawEvent {
        t_ns: 1_000_000_000 + 1_000_000 * i + i % 7,
        x: (7 * i % 32) as u16,
        y: (3 * i % 24) as u16,
        on: i % 2 == 1,
    }
}

#[test]
fn hdf5_recordings_are_read_exactly() {
    let want: Vec<_> = (0..300).map(expected).collect();
    for name in [
        "valid.h5",
        "contiguous_root_size.h5",
        "no_size.h5",
        "signed_polarity.h5",
    ] {
        assert_eq!(read_h5(name), (want.clone(), String::new()), "{name}");
        let sensor = (name != "no_size.h5").then_some(Sensor {
            height: 24,
            width: 32,
        });
        assert_eq!(
            probe(&source(fixture(name), TimeUnit::Auto)).unwrap(),
            sensor,
            "{name}"
        );
    }
    let about = open(&source(fixture("valid.h5"), TimeUnit::Auto))
        .unwrap()
        .describe();
    assert_eq!((about.time_unit, about.events), ("ns", Some(300)));
}

#[test]
fn what_is_wrong_with_an_hdf5_file_is_said_in_one_line() {
    for (name, whole, wanted) in [
        (
            "unequal_lengths.h5",
            0,
            "/events/timestamps has 300 entries but /events/y_coordinates has 295",
        ),
        (
            "missing_dataset.h5",
            0,
            "no dataset /events/timestamps (there: polarities, x_coordinates, y_coordinates)",
        ),
        (
            "wrong_type.h5",
            0,
            "/events/timestamps has type string, not a number",
        ),
        ("zero_events.h5", 0, "holds no events"),
        ("bad_size.h5", 0, "attribute width of /events is -1"),
        ("no_events_group.h5", 0, "has no group /events"),
        ("truncated.h5", 0, "truncated"),
        ("bad_polarity.h5", 200, "event 200 (from 0) has polarity 7"),
        ("damaged_chunk.h5", 0, "/events/timestamps cannot be read"),
    ] {
        let (events, error) = read_h5(name);
        assert!(error.contains(wanted), "{name}: {error}");
        assert_eq!(events.len(), whole, "{name}");
    }
}

#[test]
fn an_hdf5_recording_seeks_without_skipping_events() {
    let mut recording = open(&source(fixture("valid.h5"), TimeUnit::Auto)).unwrap();
    let mut batch = Vec::new();
    for wanted in [0, 1, 99, 150, 299] {
        let index = recording.seek_before(expected(wanted).t_ns).unwrap().unwrap();
        assert!(index <= wanted);
        assert!(recording.next_batch(&mut batch).unwrap());
        assert_eq!(batch[0], expected(index));
    }
}

#[test]
fn every_truncation_of_an_hdf5_file_is_an_error_or_whole() {
    let whole = fs::read(fixture("valid.h5")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("cut.h5");
    for len in (0..whole.len()).step_by(97) {
        fs::write(&path, &whole[..len]).unwrap();
        let (events, error) = read(&source(&path, TimeUnit::Auto));
        assert!(error.is_some() || events.len() == 300, "{len}");
    }
}

#[test]
fn damaged_bytes_in_an_hdf5_file_never_panic() {
    let whole = fs::read(fixture("valid.h5")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("damaged.h5");
    for at in (0..whole.len()).step_by(41) {
        let mut damaged = whole.clone();
        damaged[at] = !damaged[at];
        fs::write(&path, &damaged).unwrap();
        let (events, _) = read(&source(&path, TimeUnit::Auto));
        assert!(events.len() <= 300, "{at}: {}", events.len());
    }
}

fn text(content: impl AsRef<[u8]>, unit: TimeUnit) -> (Vec<(u64, u16, u16, bool)>, String) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("events.txt");
    fs::write(&path, content).unwrap();
    let (events, error) = read(&source(&path, unit));
    let error = error.map(|e| e.to_string()).unwrap_or_default();
    assert!(!error.contains('\n'), "{error}");
    let error = error
        .split_once("events.txt: ")
        .map_or(error.clone(), |(_, what)| what.to_owned());
    (
        events.into_iter().map(|e| (e.t_ns, e.x, e.y, e.on)).collect(),
        error,
    )
}

fn good(content: impl AsRef<[u8]>, unit: TimeUnit) -> Vec<(u64, u16, u16, bool)> {
    let (events, error) = text(content, unit);
    assert_eq!(error, "");
    events
}

#[test]
fn text_in_all_its_forms() {
    let want = vec![(100_000_000, 3, 4, true), (100_000_001, 5, 6, false)];
    for content in [
        "0.1 3 4 1\n0.100000001 5 6 0\n",
        "0.1 3 4 1\r\n0.100000001 5 6 -1\r\n",
        "0.1,3,4,1\n0.100000001,5,6,0",
        "0.1 ,3 , 4,\t1 \n\n  0.100000001\t5  6 0",
        "346 260\n0.1 3 4 true\n0.100000001 5 6 False\n",
        "# a comment\n346 260\n#t x y p\n0.1 3 4 1\n# another\n0.100000001 5 6 0\n",
        "\u{feff}x,y,polarity,timestamp\n3,4,1,0.1\n5,6,0,0.100000001\n",
        "346 260\n\"Time\",\"X\",\"Y\",\"On\",frame\n0.1,3,4,1,9\n0.100000001,5,6,0,9\n",
        "1e-1 3 4 1\n1.00000001e-1 5 6 0\n",
    ] {
        assert_eq!(good(content, TimeUnit::Auto), want, "{content:?}");
    }
}

#[test]
fn units_by_configuration_point_or_magnitude() {
    let first = |line: &str, unit| good(format!("{line} 0 0 1\n"), unit)[0].0;
    for (line, ns) in [
        ("1587452582.35", 1_587_452_582_350_000_000),
        ("12", 12_000),
        ("999999999999", 999_999_999_999_000),
        ("1587452582350", 1_587_452_582_350_000_000),
        ("1587452582350001", 1_587_452_582_350_001_000),
        ("1587452582350000001", 1_587_452_582_350_000_001),
    ] {
        assert_eq!(first(line, TimeUnit::Auto), ns, "{line}");
    }
    assert_eq!(first("12", TimeUnit::S), 12_000_000_000);
    assert_eq!(first("12.5", TimeUnit::Ms), 12_500_000);
    assert_eq!(first("12.5", TimeUnit::Us), 12_500);
    assert_eq!(first("1587452582350", TimeUnit::Ns), 1_587_452_582_350);
}

#[test]
fn what_text_says_of_itself() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.csv");
    fs::write(&path, "346 260\n0.5 1 2 1\n").unwrap();
    let source = source(&path, TimeUnit::Auto);
    assert_eq!(
        probe(&source).unwrap(),
        Some(Sensor {
            height: 260,
            width: 346
        })
    );
    assert_eq!(
        open(&source).unwrap().describe(),
        SourceInfo {
            format: "text",
            path: path.clone(),
            time_unit: "s",
            time_unit_from: "decimal point",
            events: None
        }
    );
    fs::write(&path, "5 1 2 1\n").unwrap();
    assert_eq!(probe(&source).unwrap(), None);
    assert_eq!(open(&source).unwrap().describe().time_unit_from, "magnitude");
}

#[test]
fn bad_lines_are_named_and_what_is_before_them_is_kept() {
    let start = "# x\n0.1 1 2 1\n0.2 3 4 0\n";
    for (line, wanted) in [
        (
            "nan 1 2 1",
            "line 4: the time \"nan\" is not a decimal number; correct the line or leave it out",
        ),
        ("-0.5 1 2 1", "line 4: the time \"-0.5\" is negative"),
        (
            "1e20 1 2 1",
            "line 4: the time \"1e20\" lies beyond the year 2262; check source.time_unit",
        ),
        ("0.3 1 2", "line 4: has 3 columns instead of 4: \"0.3 1 2\""),
        (
            "0.3 1 2 1 7",
            "line 4: has 5 columns instead of 4: \"0.3 1 2 1 7\"",
        ),
        (
            "0.3 -1 2 1",
            "line 4: x is \"-1\"; it must be a whole number from 0",
        ),
        (
            "0.3 1 2.5 1",
            "line 4: y is \"2.5\"; it must be a whole number from 0",
        ),
        ("0.3,,2,1", "line 4: x is \"\"; it must be a whole number from 0"),
        (
            "0.3 1 2 3",
            "line 4: the polarity is \"3\"; it must be 0 or 1 (or -1)",
        ),
        (
            "0.3 1 2 \u{1b}[31m",
            "line 4: the polarity is \"\\u{1b}[31m\"; it must be 0 or 1 (or -1)",
        ),
    ] {
        let (events, error) = text(format!("{start}{line}\n0.4 1 2 1\n"), TimeUnit::Auto);
        assert_eq!((events.len(), error.as_str()), (2, wanted), "{line}");
    }
    let (_, error) = text(format!("{start}0.3 1 2 {}\n", "9".repeat(500)), TimeUnit::Auto);
    assert!(error.len() < 200, "{error}");
    let (events, error) = text(format!("{start}{}\n", "1".repeat(70_000)), TimeUnit::Auto);
    assert_eq!(
        (events.len(), error.as_str()),
        (2, "line 4: is longer than 64 KiB; these are no lines of text")
    );
}

#[test]
fn bad_starts_are_named() {
    for (content, wanted) in [
        ("# nothing\n\n346 260\n", "holds no events"),
        (
            "t,x,y\n0.1,2,3\n",
            "line 1: the header \"t x y\" has no column p; name it p or pol or polarity or polarities or ps or on",
        ),
        (
            "t,x,y,p,time\n",
            "line 1: the header \"t x y p time\" has two columns t",
        ),
        (
            "0 260\n0.1 1 2 1\n",
            "line 1: \"0\" is not a side of a sensor; a line of two numbers is its width and height, 1 to 65535",
        ),
        (
            "nan 1 2 1\n",
            "line 1: the time \"nan\" is not a decimal number; correct the line or leave it out",
        ),
        (
            "hello\n",
            "line 1: the header \"hello\" has no column t; name it t or timestamp or timestamps or ts or time or times",
        ),
    ] {
        assert_eq!(
            text(content, TimeUnit::Auto),
            (vec![], wanted.to_owned()),
            "{content:?}"
        );
    }
}

#[test]
fn coordinates_beyond_any_sensor_are_kept_for_the_screen() {
    let events = good("0.1 70000 99999999999999999999999 1\n", TimeUnit::Auto);
    assert_eq!(events, [(100_000_000, u16::MAX, u16::MAX, true)]);
}

#[test]
fn many_lines_pass_the_buffer_whole() {
    let lines: String = (0..200_000u64)
        .map(|i| format!("{i} {} {} {}\n", i % 346, i % 260, i % 2))
        .collect();
    let events = good(lines, TimeUnit::Us);
    assert_eq!(events.len(), 200_000);
    for (i, e) in events.iter().enumerate() {
        let i = i as u64;
        assert_eq!(*e, (i * 1_000, (i % 346) as u16, (i % 260) as u16, i % 2 == 1));
    }
}

#[test]
fn what_is_no_recording_is_refused_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let error = |name: &str, content: Option<&[u8]>| {
        let path = dir.path().join(name);
        if let Some(content) = content {
            fs::write(&path, content).unwrap();
        }
        let error = open(&source(&path, TimeUnit::Auto)).err().unwrap().to_string();
        assert!(error.contains(name) && !error.contains('\n'), "{error}");
        error
    };
    assert!(error("missing.h5", None).contains("there is no such file"));
    assert!(error("empty.h5", Some(b"")).contains("is empty (0 bytes)"));
    assert!(error("empty.txt", Some(b"")).contains("is empty (0 bytes)"));
    assert!(error("text.h5", Some(b"0.1 1 2 1\n")).contains("not its signature"));
    assert!(error("binary.txt", Some(b"\0\x01\x02")).contains("is not text"));
    assert!(error("binary", Some(b"\0\x01\x02")).contains("of no known format"));
    assert!(error("a.aedat4", Some(b"#!AER-DAT4.0\r\n")).contains("ends inside its header"));
    assert!(error("a.csv.gz", Some(b"\x1f\x8b\x08\0")).contains("cannot be read"));
    assert!(error("/", None).contains("is a directory"));
}

#[test]
fn content_decides_before_the_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("events.txt");
    fs::copy(fixture("valid.h5"), &path).unwrap();
    assert_eq!(read(&source(&path, TimeUnit::Auto)).0.len(), 300);
    let path = dir.path().join("events.unknown");
    fs::write(&path, "0.1 1 2 1\n").unwrap();
    assert_eq!(read(&source(&path, TimeUnit::Auto)).0.len(), 1);
}

#[cfg(unix)]
#[test]
fn a_fifo_is_refused_and_not_waited_for() {
    let error = open(&source("/dev/null", TimeUnit::Auto))
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("not a regular file"), "{error}");
}

fn facts(path: &Path, sensor: Option<Sensor>) -> RecordingInfo {
    let mut last = 0;
    let facts = info(
        path,
        &ReadOptions {
            sensor,
            ..ReadOptions::default()
        },
        &mut |permille| last = permille,
    )
    .unwrap();
    assert_eq!(last, 1000);
    facts
}

#[test]
fn info_counts_without_policies() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    let lines = "0.0 0 0 1\n0.05 1 1 1\n0.05 40 2 1\n0.04 2 2 0\n0.30 3 9 0\n0.31 3 3 1\n";
    fs::write(&path, lines).unwrap();
    let i = facts(&path, None);
    assert_eq!(
        (i.events, i.first_ns, i.last_ns, i.max_gap_ns),
        (6, 0, 310_000_000, 250_000_000)
    );
    assert_eq!(
        (i.backward_times, i.duplicate_times, i.outside_sensor),
        (1, 1, None)
    );
    assert_eq!((i.max_x, i.max_y, i.on_share), (40, 9, 4.0 / 6.0));
    assert_eq!(
        (i.peak_rate_hz, i.mean_rate_hz, i.duration_s),
        (40.0, 6.0 / 0.31, 0.31)
    );
    let i = facts(&path, Some(Sensor { height: 9, width: 40 }));
    assert_eq!(
        (i.outside_sensor, i.height, i.width),
        (Some(2), Some(9), Some(40))
    );
    let i = facts(&fixture("backward_time.h5"), None);
    assert_eq!(
        (i.events, i.backward_times, i.outside_sensor, i.height),
        (300, 1, Some(0), Some(24))
    );
    let i = facts(&fixture("outside_sensor.h5"), None);
    assert_eq!((i.backward_times, i.outside_sensor), (0, Some(1)));
}

#[test]
fn info_tells_rates_gaps_duplicates_and_hot_pixels() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    // 25 events in the first second at one pixel, among them one twice; then little, and a step back of 0.5 s.
    let mut lines: String = (0..24).map(|i| format!("0.{:03} 7 5 1\n", i * 40)).collect();
    lines += "0.920 7 5 1\n3.000 1 1 0\n2.500 2 1 0\n3.000 1 1 1\n3.500 1 1 1\n";
    fs::write(&path, lines).unwrap();
    let i = facts(&path, None);
    assert_eq!((i.events, i.on_events, i.max_x, i.max_y), (29, 27, 7, 5));
    assert_eq!(
        (i.rate.bin_ns, i.rate.events.as_slice()),
        (1_000_000_000, [25, 0, 1, 3].as_slice())
    );
    assert_eq!(i.fine_rate.events.len(), 3_501);
    let gaps: Vec<_> = i
        .gaps
        .iter()
        .map(|g| (g.from_ns / 1_000_000, g.length_ns / 1_000_000))
        .collect();
    assert_eq!(gaps, [(920, 2080), (3000, 500), (0, 40), (40, 40), (80, 40)]);
    assert_eq!(
        (i.max_gap_ns, i.backward_times, i.largest_backward_ns),
        (2_080_000_000, 1, 500_000_000)
    );
    assert_eq!((i.duplicate_times, i.duplicate_events), (1, 1));
    let hot = i.hot_pixels.unwrap();
    assert_eq!((hot.count, hot.events, hot.worst.len()), (1, 25, 1));
    assert_eq!(
        (hot.worst[0].x, hot.worst[0].y, hot.worst[0].rate_hz),
        (7, 5, 25.0 / 3.5)
    );
    // A damaged coordinate: whether a pixel is hot cannot be told without the sensor.
    fs::write(&path, "0 0 0 1\n1 65535 65535 1\n").unwrap();
    assert_eq!(facts(&path, None).hot_pixels, None);
    let sensor = Sensor { height: 4, width: 4 };
    assert_eq!(facts(&path, Some(sensor)).hot_pixels.unwrap().count, 0);
}

/// The camera of the corridor has the same hot pixels on both walks.
#[test]
fn the_hot_pixels_of_the_corridor_are_the_same_on_both_walks() {
    let name = "the_hot_pixels_of_the_corridor_are_the_same_on_both_walks";
    let mut found = Vec::new();
    for file in ["query_events.h5", "reference_events.h5"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../../shared/data/corridor")
            .join(file);
        if !path.exists() {
            println!("skipped: {name}: {} is absent", path.display());
            return;
        }
        let rule = HotPixelRule::default();
        let estimate = estimate_hot_pixels(&path, &ReadOptions::default(), &rule, &mut |_| ()).unwrap();
        let pixels: Vec<_> = estimate.hot_pixels.iter().map(|h| (h.x, h.y)).collect();
        assert_eq!(
            estimate.hot_events,
            estimate.hot_pixels.iter().map(|h| h.events).sum::<u64>()
        );
        found.push(pixels);
    }
    // As counted and compared by NumPy.
    assert_eq!(found[0], [(112, 4), (51, 18), (78, 21), (112, 22)]);
    assert!(found[0].iter().all(|p| found[1].contains(p)), "{found:?}");
}

#[test]
fn info_fails_where_the_recording_does() {
    let error = info(&fixture("bad_polarity.h5"), &ReadOptions::default(), &mut |_| ()).unwrap_err();
    assert!(error.to_string().contains("polarity 7"));
}

#[test]
fn the_corridor_is_as_described() {
    let name = "the_corridor_is_as_described";
    for (file, events, first_ns, last_ns) in [
        (
            "query_events.h5",
            3_585_918,
            1_700_086_400_000_066_867,
            1_700_086_549_999_899_699,
        ),
        (
            "reference_events.h5",
            3_450_622,
            1_700_000_000_000_000_000,
            1_700_000_140_499_799_398,
        ),
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../../shared/data/corridor")
            .join(file);
        if !path.exists() {
            println!("skipped: {name}: {} is absent", path.display());
            return;
        }
        let i = facts(&path, None);
        assert_eq!((i.events, i.first_ns, i.last_ns), (events, first_ns, last_ns));
        assert_eq!((i.height, i.width, i.on_share), (Some(128), Some(128), 1.0));
        assert_eq!((i.backward_times, i.outside_sensor), (0, Some(0)));
    }
}
