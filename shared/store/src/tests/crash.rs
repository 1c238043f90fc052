//! Whatever is cut, torn or flipped in an unfinished recording, what is saved is its first ticks and nothing else.

use crate::commit::RECORD_BYTES;
use crate::files::{Files, present_offset};
use crate::manifest::Manifest;
use crate::npy::HEADER_BYTES;
use crate::test_support::{append, assert_is_prefix, has_row, new_traverse, recording};
use crate::{StoreError, Traverse, TraverseWriter, partial_path, repair, verify};
use proptest::prelude::*;
use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const DIMS: [usize; 2] = [3, 5];
const TICKS: u64 = 6;

/// The growing files of a recording with [`DIMS`].
fn growing(folder: &Path) -> Vec<PathBuf> {
    let names = [
        "commits.bin",
        "ticks.csv",
        "rows/m0/x.npy",
        "rows/m0/x.present.npy",
        "rows/m1/x.npy",
        "rows/m1/x.present.npy",
    ];
    names.iter().map(|name| folder.join(name)).collect()
}

/// How many ticks are wholly within the first `len` bytes of each of [`growing`], found independently of the crate.
fn ticks_within(folder: &Path) -> u64 {
    let wholes = growing(folder).into_iter().enumerate().map(|(i, file)| {
        let bytes = fs::read(file).unwrap();
        let data = bytes.len().saturating_sub(HEADER_BYTES);
        let whole = match i {
            0 => bytes.len() / RECORD_BYTES,
            1 => bytes.iter().filter(|b| **b == b'\n').count().saturating_sub(1),
            2 => data / 12,
            4 => data / 20,
            _ => data,
        };
        whole as u64
    });
    wholes.min().unwrap()
}

/// Leaves a recording as a crash would.
fn crashed(path: &Path) -> PathBuf {
    drop(recording(path, &DIMS, TICKS));
    partial_path(path).unwrap()
}

fn assert_repairs_to(path: &Path, ticks: u64) {
    match repair(path) {
        Ok(summary) => {
            assert_eq!(summary.ticks, ticks);
            assert_is_prefix(&Traverse::open(path).unwrap(), &DIMS, ticks);
            assert_eq!(verify(path).unwrap().problems, Vec::<String>::new());
            assert!(!partial_path(path).unwrap().exists());
        }
        Err(error) => {
            assert!(matches!(error, StoreError::Empty(_)), "{error}");
            assert_eq!(ticks, 0);
            assert!(!path.exists());
        }
    }
}

fn set_len(file: &Path, len: u64) {
    let file = OpenOptions::new().write(true).open(file).unwrap();
    file.set_len(len).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn files_cut_anywhere_give_a_prefix(cuts in prop::collection::vec(prop::option::of(0.0..1.0f64), 6)) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        let folder = crashed(&path);
        for (file, cut) in growing(&folder).iter().zip(cuts) {
            if let Some(cut) = cut {
                let len = fs::metadata(file).unwrap().len();
                set_len(file, (len as f64 * cut) as u64);
            }
        }
        assert_repairs_to(&path, ticks_within(&folder));
    }

    #[test]
    fn a_flipped_bit_gives_the_ticks_before_it(which in 0usize..6, at in 0.0..1.0f64, bit in 0u8..8) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        let folder = crashed(&path);
        let file = &growing(&folder)[which];
        let mut bytes = fs::read(file).unwrap();
        // Headers of .npy files are not written yet: nothing there counts.
        let skip = if which < 2 { 0 } else { HEADER_BYTES };
        let at = skip + ((bytes.len() - skip) as f64 * at) as usize;
        bytes[at] ^= 1 << bit;
        fs::write(file, &bytes).unwrap();
        let tick = match which {
            0 => at / RECORD_BYTES,
            1 => fs::read(&growing(&folder)[1]).unwrap()[..at].iter().filter(|b| **b == b'\n').count().saturating_sub(1),
            2 => (at - skip) / 12,
            4 => (at - skip) / 20,
            _ => at - skip,
        };
        assert_repairs_to(&path, tick as u64);
    }

    #[test]
    fn resuming_goes_on_where_the_cut_left_it(cuts in prop::collection::vec(prop::option::of(0.0..1.0f64), 6)) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        let folder = crashed(&path);
        for (file, cut) in growing(&folder).iter().zip(cuts) {
            if let Some(cut) = cut {
                let len = fs::metadata(file).unwrap().len();
                set_len(file, (len as f64 * cut) as u64);
            }
        }
        let whole = ticks_within(&folder);
        let mut writer = TraverseWriter::resume(&path, new_traverse(&DIMS)).unwrap();
        prop_assert_eq!(writer.next_tick(), whole);
        while writer.next_tick() < 9 {
            let tick = writer.next_tick();
            append(&mut writer, &DIMS, &[has_row(0, tick), has_row(1, tick)]);
        }
        let traverse = writer.close().unwrap();
        assert_is_prefix(&traverse, &DIMS, 9);
        prop_assert_eq!(verify(&path).unwrap().problems, Vec::<String>::new());
    }
}

#[test]
fn a_tick_under_way_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let folder = crashed(&path);
    for file in growing(&folder) {
        let len = fs::metadata(&file).unwrap().len();
        let file = OpenOptions::new().write(true).open(&file).unwrap();
        file.write_all_at(b"torn", len).unwrap();
    }
    assert_repairs_to(&path, TICKS);
}

#[test]
fn data_that_never_reached_the_disk_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let folder = crashed(&path);
    // The commit records and the lengths of the files survived the power failure; a row of tick 4 did not.
    let rows = OpenOptions::new()
        .write(true)
        .open(folder.join("rows/m1/x.npy"))
        .unwrap();
    rows.write_all_at(&[0; 20], HEADER_BYTES as u64 + 2 * 20).unwrap();
    let writer = TraverseWriter::resume(&path, new_traverse(&DIMS)).unwrap();
    assert_eq!(writer.next_tick(), 2);
}

#[test]
fn every_step_of_closing_can_be_the_last() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let folder = crashed(&path);
    let draft = Manifest::read(&folder).unwrap();
    let commits = fs::read(folder.join("commits.bin")).unwrap();
    repair(&path).unwrap();
    let complete = Manifest::read(&path).unwrap();
    for (manifest, has_commits) in [(&draft, true), (&complete, true), (&complete, false)] {
        fs::rename(&path, &folder).unwrap();
        manifest.write(&folder).unwrap();
        if has_commits {
            fs::write(folder.join("commits.bin"), &commits).unwrap();
        }
        assert_repairs_to(&path, TICKS);
        assert!(!path.join("commits.bin").exists());
    }
}

#[test]
fn every_step_of_beginning_can_be_the_last() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let folder = partial_path(&path).unwrap();
    for step in 0..4 {
        fs::create_dir(&folder).unwrap();
        if step > 0 {
            fs::create_dir_all(folder.join("rows/m0")).unwrap();
        }
        if step > 1 {
            fs::write(folder.join("commits.bin"), "").unwrap();
        }
        if step > 2 {
            fs::write(folder.join("traverse.json.new"), "{").unwrap();
        }
        assert!(matches!(repair(&path), Err(StoreError::Empty(_))), "step {step}");
        let writer = TraverseWriter::resume(&path, new_traverse(&DIMS)).unwrap();
        assert_eq!(writer.next_tick(), 0);
        writer.discard().unwrap();
        assert!(!folder.exists());
    }
    // Somebody else's folder of that name is left alone.
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("thesis.tex"), "").unwrap();
    assert!(TraverseWriter::resume(&path, new_traverse(&DIMS)).is_err());
    assert!(folder.join("thesis.tex").exists());
}

#[test]
fn the_newest_commit_says_what_need_not_be_checked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    let folder = crashed(&path);
    let draft = Manifest::read(&folder).unwrap();
    let files = Files::open(&folder, &draft.members).unwrap();
    // Marks that are neither 0 nor 1 are refused whether synchronised or not.
    files.members[0]
        .present
        .write_at(&[2], present_offset(3))
        .unwrap();
    drop(files);
    assert_repairs_to(&path, 3);
}

/// Not a test of its own: the process that [`a_killed_process_loses_at_most_one_tick`] kills.
#[test]
fn child_that_records_until_killed() {
    let Ok(path) = std::env::var("EVPR_STORE_TEST_RECORD") else {
        return;
    };
    let mut writer = TraverseWriter::create(Path::new(&path), new_traverse(&DIMS)).unwrap();
    loop {
        let tick = writer.next_tick();
        append(&mut writer, &DIMS, &[has_row(0, tick), has_row(1, tick)]);
        println!("\nappended {tick}");
    }
}

#[test]
fn a_killed_process_loses_at_most_one_tick() {
    let dir = tempfile::tempdir().unwrap();
    for kill_after in [0, 1, 57] {
        let path = dir.path().join(format!("map{kill_after}"));
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "tests::crash::child_that_records_until_killed",
                "--nocapture",
            ])
            .env("EVPR_STORE_TEST_RECORD", &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let wanted = format!("appended {kill_after}");
        assert!(lines.any(|line| line.unwrap() == wanted), "the child ended early");
        child.kill().unwrap();
        // What it had told before it died must be there.
        let told = lines.filter_map(|line| line.unwrap().strip_prefix("appended ")?.parse::<u64>().ok());
        let last = told.last().unwrap_or(kill_after);
        child.wait().unwrap();
        let ticks = repair(&path).unwrap().ticks;
        assert!(
            ticks > last && ticks <= last + 2,
            "{ticks} ticks, {last} was told last"
        );
        assert_is_prefix(&Traverse::open(&path).unwrap(), &DIMS, ticks);
    }
}
