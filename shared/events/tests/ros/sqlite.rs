//! Bags of ROS 2 in SQLite, and folders of bags.

use super::{BASE_NS, SENSOR, events, fixture, fixture_path, read, read_path};
use proptest::prelude::*;
use std::fs;

#[test]
fn bags_in_sqlite_are_read() {
    let got = read_path(&fixture_path("dvs.db3"));
    assert_eq!((got.error, got.sensor), (None, Some(SENSOR)));
    assert_eq!(got.events, events(BASE_NS));
    let text = "messages of topic /text (std_msgs/msg/String)".to_owned();
    assert_eq!(
        (got.info.unwrap().format, got.skipped),
        ("rosbag2", vec![(text, 5)])
    );
    // A table of several levels.
    let got = read_path(&fixture_path("many.db3"));
    assert_eq!((got.error, got.events), (None, events(BASE_NS)));
    assert_eq!(got.skipped.iter().map(|(_, count)| count).sum::<u64>(), 7 * 25);
    let got = read_path(&fixture_path("packets_evt3.db3"));
    assert_eq!((got.error, got.events), (None, events(5_000_000_000)));
    // Not from bytes in order.
    assert!(read(&fixture("dvs.db3")).error().contains("is read in any order"));
}

#[test]
fn a_folder_stands_for_its_file() {
    let dir = tempfile::tempdir().unwrap();
    let metadata = dir.path().join("metadata.yaml");
    assert!(read_path(dir.path()).error().contains("is a directory"));
    for name in ["dvs.db3", "dvs_zstd.mcap"] {
        fs::copy(fixture_path(name), dir.path().join(name)).unwrap();
        fs::write(
            &metadata,
            format!("info:\n  relative_file_paths:\n    - {name}\n  x: 1\n"),
        )
        .unwrap();
        let got = read_path(dir.path());
        assert_eq!((got.error, got.events), (None, events(BASE_NS)));
        assert_eq!(got.info.unwrap().path, dir.path().join(name));
    }
    for (names, says) in [
        ("", "names no file"),
        (
            "    - a.db3\n    - b.db3\n",
            "is a bag in 2 files; join them with ros2 bag convert",
        ),
        ("    - ../dvs.db3\n", "is not in its folder"),
        ("    - /dvs.db3\n", "is not in its folder"),
        ("    - gone.db3\n", "there is no such file"),
    ] {
        fs::write(
            &metadata,
            format!("info:\n  relative_file_paths:\n{names}  x: 1\n"),
        )
        .unwrap();
        let got = read_path(dir.path());
        assert!(got.error().contains(says), "{got:?}");
    }
}

#[test]
fn damage_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bag.db3");
    let whole = fixture("many.db3");
    let error = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        read_path(&path).error().to_owned()
    };
    for len in [50, 99, 100, 512, whole.len() - 1] {
        let error = error(&whole[..len]);
        assert!(error.contains("cut off"), "{len}: {error}");
    }
    let with = |at: usize, bytes: &[u8]| {
        let mut changed = whole.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        changed
    };
    assert!(error(&with(16, &[0, 3])).contains("a header that cannot be right"));
    assert!(error(&with(56, &[0, 0, 0, 2])).contains("UTF-16"));
    assert!(error(&with(100, &[9])).contains("a page that cannot be right"));
    // A bag without its table of topics.
    let at = whole.windows(11).position(|w| w == b"topicstopic").unwrap();
    assert!(error(&with(at, b"tropic")).contains("has no table topics; it is not a bag of ROS 2"));
    // A recorder that was killed leaves rows in a file beside it.
    fs::write(&path, &whole).unwrap();
    fs::write(dir.path().join("bag.db3-wal"), "").unwrap();
    assert_eq!(read_path(&path).error, None);
    fs::write(dir.path().join("bag.db3-wal"), "rows").unwrap();
    assert!(read_path(&path).error().contains("ends in -wal"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn nothing_that_is_flipped_makes_it_panic(
        many: bool,
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8u8), 1..12),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bag.db3");
        let mut bytes = fixture(if many { "many.db3" } else { "dvs.db3" });
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        fs::write(&path, bytes).unwrap();
        let got = read_path(&path);
        prop_assert!(got.events.len() <= 20 * events(0).len());
    }
}
