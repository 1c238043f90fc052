//! Everything that is not a sound traverse is refused, with the reason, in one line.

use crate::test_support::{new_traverse, record, recording, row};
use crate::{StoreError, Traverse, TraverseWriter, partial_path, repair, verify};
use std::fs::{self, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// A sound traverse in a folder of its own.
fn sound() -> (tempfile::TempDir, std::path::PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    recording(&path, &[3, 5], 4).close().unwrap();
    (dir, path)
}

/// Opening must fail with a line that has all these words.
fn assert_refused(path: &Path, words: &[&str]) {
    let message = Traverse::open(path).unwrap_err().to_string();
    for word in words {
        assert!(message.contains(word), "\"{word}\" is not in: {message}");
    }
    assert!(!message.contains('\n'), "{message}");
}

fn replace(file: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(file).unwrap();
    assert!(text.contains(from), "{text}");
    fs::write(file, text.replacen(from, to, 1)).unwrap();
}

#[test]
fn paths_that_are_no_traverses() {
    let (dir, path) = sound();
    assert_refused(&dir.path().join("nope"), &["nope: there is no such traverse"]);
    assert_refused(dir.path(), &["is not a traverse", "no traverse.json"]);
    assert_refused(&path.join("traverse.json"), &["is not a traverse: it is a file"]);
    let other = dir.path().join("other");
    drop(recording(&other, &[3], 2));
    let words = [
        "other.partial is an unfinished recording",
        "evpr map repair",
        "/other`",
    ];
    assert_refused(&other, &words);
    assert_refused(&partial_path(&other).unwrap(), &words);
    fs::rename(partial_path(&other).unwrap(), &other).unwrap();
    assert_refused(&other, &["traverse.json", "not closed"]);
}

#[test]
fn manifests_that_cannot_be() {
    for (from, to, words) in [
        ("\"evpr-traverse\"", "\"rosbag\"", "another format"),
        (
            "\"version\": 1",
            "\"version\": 2",
            "has version 2, this release reads version 1",
        ),
        ("{", "", "traverse.json: "),
        ("\"ticks\": 4", "\"ticks\": \"four\"", "line "),
        (
            "\"ticks\": 4",
            "\"ticks\": 5",
            "it has 4 ticks, the manifest says 5",
        ),
        ("\"ticks\": 4", "\"ticks\": 18446744073709551615", "too many"),
        ("\"m0/x\"", "\"../../m0/x\"", "cannot name a member's files"),
        ("\"m0/x\"", "\"m1/x\"", "there twice"),
        (
            "\"f32\"",
            "\"f64\"",
            "unknown variant `f64`, expected `f32` or `f16`",
        ),
        (
            "\"dim\": 3",
            "\"dim\": 4",
            "its header says {'descr': '<f4', 'fortran_order': False, 'shape': (4, 3), }",
        ),
        (
            "\"present\": 3",
            "\"present\": 2",
            "x.present.npy: it marks 3 rows, the manifest says 2",
        ),
        ("\"present\": 3", "\"present\": 7", "has 7 rows in 4 ticks"),
    ] {
        let (_dir, path) = sound();
        replace(&path.join("traverse.json"), from, to);
        assert_refused(&path, &[words]);
    }
}

#[test]
fn files_that_do_not_fit_the_manifest() {
    let (_dir, path) = sound();
    let rows = path.join("rows/m1/x.npy");
    let whole = fs::read(&rows).unwrap();
    assert_eq!(whole.len(), 128 + 4 * 5 * 4);
    fs::write(&rows, &whole[..207]).unwrap();
    assert_refused(&path, &["m1/x.npy: it has 207 bytes, it must have 208"]);
    fs::write(&rows, [whole.as_slice(), b"x"].concat()).unwrap();
    assert_refused(&path, &["it has 209 bytes"]);
    fs::write(&rows, &whole[..90]).unwrap();
    assert_refused(&path, &["header is cut short"]);
    fs::write(&rows, [&[0; 128], &whole[128..]].concat()).unwrap();
    assert_refused(&path, &["does not begin as a .npy file"]);
    fs::remove_file(&rows).unwrap();
    assert_refused(&path, &["cannot open", "m1/x.npy"]);
    fs::write(&rows, &whole).unwrap();

    let present = path.join("rows/m0/x.present.npy");
    let mut marks = fs::read(&present).unwrap();
    marks[128] = 9;
    fs::write(&present, &marks).unwrap();
    assert_refused(&path, &["its entry 0 is 9"]);
    marks[128] = 1;
    fs::write(&present, &marks).unwrap();
    replace(&path.join("ticks.csv"), "2,2000", "7,2000");
    assert_refused(&path, &["ticks.csv: line 4: tick 7 where tick 2 must be"]);
}

#[test]
fn arrays_saved_by_others_are_read() {
    let (_dir, path) = sound();
    let file = path.join("rows/m0/x.npy");
    let data = fs::read(&file).unwrap().split_off(128);
    let mut text = b"{'descr':'<f4','fortran_order':False,'shape':(4,3)}".to_vec();
    text.resize(63 + 64 - 10, b' ');
    text.push(b'\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text);
    bytes.extend(data);
    fs::write(&file, bytes).unwrap();
    let opened = Traverse::open(&path).unwrap();
    assert_eq!(opened.member("m0/x").unwrap().row(0), row(0, 0, 3));
}

#[test]
fn unknown_members_are_told_what_there_is() {
    let (_dir, path) = sound();
    let error = Traverse::open(&path).unwrap().member("m9/x").unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("has no member m9/x; it has m0/x, m1/x"),
        "{error}"
    );
}

#[test]
fn nothing_is_overwritten() {
    let (dir, path) = sound();
    let create = |path: &Path| TraverseWriter::create(path, new_traverse(&[3])).unwrap_err();
    assert!(
        create(&path)
            .to_string()
            .contains("exists already; choose another name or remove it")
    );
    let other = dir.path().join("other");
    let writer = recording(&other, &[3], 2);
    assert!(matches!(create(&other), StoreError::PartialExists(_)));
    // Somebody takes the final name while it is recorded.
    fs::create_dir(&other).unwrap();
    let message = writer.close().unwrap_err().to_string();
    assert!(
        message.contains("what was recorded up to tick 1 is kept in"),
        "{message}"
    );
    assert!(matches!(repair(&other), Err(StoreError::Exists(_))));
    fs::remove_dir(&other).unwrap();
    assert_eq!(repair(&partial_path(&other).unwrap()).unwrap().ticks, 2);
    assert!(matches!(repair(&other), Err(StoreError::Finished(_))));
    assert!(matches!(
        repair(&dir.path().join("nope")),
        Err(StoreError::Missing(_))
    ));
}

#[test]
fn a_recording_has_one_writer() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let writer = recording(&path, &[3], 2);
    assert!(matches!(repair(&path), Err(StoreError::InUse(_))));
    let resumed = TraverseWriter::resume(&path, new_traverse(&[3]));
    assert!(matches!(resumed, Err(StoreError::InUse(_))));
    drop(writer);
    assert_eq!(repair(&path).unwrap().ticks, 2);
}

#[test]
fn another_header_cannot_continue_a_recording() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    drop(recording(&path, &[3], 2));
    let mut header = new_traverse(&[3]);
    header.notes = "again".to_owned();
    drop(TraverseWriter::resume(&path, header.clone()).unwrap());
    header.source = "other.h5".to_owned();
    header.members[0]
        .fingerprint
        .insert("align".to_owned(), "end".to_owned());
    let message = TraverseWriter::resume(&path, header).unwrap_err().to_string();
    assert!(
        message.contains("source is events.h5 in the recording and other.h5"),
        "{message}"
    );
    assert!(
        message.contains("align is (none) in the recording and end"),
        "{message}"
    );
    let missing = TraverseWriter::resume(&dir.path().join("b"), new_traverse(&[3]));
    assert!(matches!(missing, Err(StoreError::Missing(_))));
}

#[test]
fn ticks_that_do_not_belong_there_are_refused_and_the_recording_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = recording(&dir.path().join("map"), &[2], 1);
    let good = [1.0, 2.0];
    let mut backward = record(1);
    backward.end_us = 0;
    let mut nowhere = record(1);
    nowhere.position = Some([f64::NAN, 0.0]);
    type Rows<'a> = &'a [Option<&'a [f32]>];
    let cases: [(_, Rows<'_>, &str); 6] = [
        (record(2), &[Some(&good)], "tick 1 comes next"),
        (backward, &[Some(&good)], "before its start"),
        (nowhere, &[Some(&good)], "position is not finite"),
        (record(1), &[], "0 rows for 1 members"),
        (record(1), &[Some(&[1.0])], "has 1 numbers, it must have 2"),
        (
            record(1),
            &[Some(&[1.0, f32::INFINITY])],
            "number 1 of the row of member m0/x is inf",
        ),
    ];
    for (tick, rows, words) in cases {
        let message = writer.append(&tick, rows).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    writer.append(&record(1), &[Some(&good)]).unwrap();
    assert_eq!(writer.close().unwrap().len(), 2);
}

#[test]
fn an_empty_recording_is_not_closed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let writer = recording(&path, &[2], 0);
    assert!(matches!(writer.close(), Err(StoreError::Empty(_))));
    assert!(matches!(repair(&path), Err(StoreError::Empty(_))));
    assert!(!path.exists());
}

#[test]
fn verifying_lists_every_problem() {
    let (_dir, path) = sound();
    let write = |file: &str, bytes: &[u8], at: u64| {
        let file = OpenOptions::new().write(true).open(path.join(file)).unwrap();
        file.write_all_at(bytes, at).unwrap();
    };
    // Member 0 sits out tick 1, member 1 tick 0.
    write("rows/m0/x.npy", &f32::NAN.to_le_bytes(), 128);
    write("rows/m1/x.npy", &1f32.to_le_bytes(), 128);
    replace(&path.join("ticks.csv"), "2,2000,3000", "2,900,800");
    fs::write(path.join("commits.bin"), "").unwrap();
    let problems = verify(&path).unwrap().problems;
    let expected = [
        "tick 2 ends before it starts",
        "tick 2 starts before the one before it",
        "it holds a commits.bin",
        "map/rows/m0/x.npy: 1 rows have numbers that are not finite, the first at tick 0",
        "map/rows/m1/x.npy: 1 rows are not zero though they are marked absent, the first at tick 0",
    ];
    assert_eq!(problems.len(), expected.len(), "{problems:?}");
    for (problem, words) in problems.iter().zip(expected) {
        assert!(problem.contains(words), "{problem}");
    }
    fs::remove_file(path.join("rows/m0/x.npy")).unwrap();
    let checked = verify(&path).unwrap();
    assert_eq!(checked.members.len(), 1);
    assert!(
        checked.problems.iter().any(|p| p.contains("cannot open")),
        "{checked:?}"
    );
}

#[test]
fn verifying_finds_the_row_that_is_not_normalised() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let mut writer = TraverseWriter::create(&path, new_traverse(&[2])).unwrap();
    for tick in 0..20 {
        let row = if tick == 7 { [0.3, 0.4] } else { [0.6, 0.8] };
        writer.append(&record(tick), &[Some(&row)]).unwrap();
    }
    writer.close().unwrap();
    let checked = verify(&path).unwrap();
    let words = "1 rows do not have length 1 (L2), unlike the others, the first at tick 7";
    let expected = format!("{}: {words}", path.join("rows/m0/x.npy").display());
    assert_eq!(checked.problems, [expected]);
    assert!((checked.members[0].min_norm - 0.5).abs() < 1e-6);
}
