//! Traverses and ground truth. The first byte says which file of a sound traverse the others replace.

use crate::replay::Target;
use evpr_core::plan::{Align, Origin, Sensor, SliceMode, Slicing};
use evpr_store::{
    GroundTruth, NewMember, NewTraverse, StoreError, TickRecord, Traverse, TraverseWriter, partial_path,
    repair, verify,
};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::{env, fs, process, thread};

/// Every target of this module.
pub const TARGETS: &[Target] = &[
    ("ground_truth", ground_truth),
    ("traverse", traverse),
    ("unfinished", unfinished),
];

const MEMBER: &str = "m/x";
const DIM: usize = 2;
const TICKS: u64 = 3;
const FINISHED: [&str; 4] = [
    "traverse.json",
    "ticks.csv",
    "rows/m/x.npy",
    "rows/m/x.present.npy",
];
const UNFINISHED: [&str; 5] = [
    "traverse.json",
    "ticks.csv",
    "rows/m/x.npy",
    "rows/m/x.present.npy",
    "commits.bin",
];

/// A finished traverse.
pub fn traverse(data: &[u8]) {
    static SOUND: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    let Some((which, bytes)) = data.split_first() else {
        return;
    };
    let which = usize::from(*which) % FINISHED.len();
    let folder = Folder::new("traverse");
    let path = folder.0.join("t");
    let sound = SOUND.get_or_init(|| {
        let made = record(&path).and_then(TraverseWriter::close);
        assert!(made.is_ok(), "{made:?}");
        take(&path, &FINISHED)
    });
    put(&path, &FINISHED, sound, which, bytes);
    match Traverse::open(&path) {
        Ok(opened) => {
            assert_eq!(opened.len() as u64, opened.manifest().ticks);
            for entry in &opened.manifest().members {
                let rows = opened.member(&entry.name);
                assert!(rows.is_ok_and(|rows| rows.rows().len() == rows.len() * rows.dim()));
            }
            assert!(verify(&path).is_ok());
        }
        Err(e) => one_line(&e),
    }
}

/// A recording whose process died.
pub fn unfinished(data: &[u8]) {
    static SOUND: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    let Some((which, bytes)) = data.split_first() else {
        return;
    };
    let which = usize::from(*which) % UNFINISHED.len();
    let folder = Folder::new("unfinished");
    let path = folder.0.join("t");
    let partial = partial_path(&path).unwrap_or_default();
    let sound = SOUND.get_or_init(|| {
        assert!(record(&path).is_ok());
        let files = take(&partial, &UNFINISHED);
        let _ = fs::remove_dir_all(&partial);
        files
    });
    put(&partial, &UNFINISHED, sound, which, bytes);
    match repair(&path) {
        // A manifest may say that it is finished already; then nothing is looked at.
        Ok(_) if which == 0 => {}
        Ok(repaired) => {
            let opened = Traverse::open(&path);
            assert!(opened.is_ok_and(|t| t.len() as u64 == repaired.ticks));
        }
        Err(e) => one_line(&e),
    }
}

/// Right answers: pairs, and matrices in either orientation.
pub fn ground_truth(data: &[u8]) {
    let folder = Folder::new("truth");
    let path = folder.0.join("truth");
    assert!(fs::write(&path, data).is_ok());
    for (queries, references) in [(2, 3), (3, 3)] {
        match GroundTruth::from_pairs(&path, queries, references) {
            Ok(truth) => check(&truth, queries, references),
            Err(e) => one_line(&e),
        }
        match GroundTruth::from_npy(&path, queries, references, None) {
            Ok((truth, _)) => check(&truth, queries, references),
            Err(e) => one_line(&e),
        }
    }
}

fn check(truth: &GroundTruth, queries: usize, references: usize) {
    assert_eq!((truth.queries(), truth.references()), (queries, references));
    for query in 0..queries {
        let right = truth.matches(query);
        assert!(right.is_sorted_by(|a, b| a < b) && right.iter().all(|r| (*r as usize) < references));
    }
}

fn one_line(error: &StoreError) {
    assert!(!error.to_string().contains('\n'), "{error}");
}

/// Records some ticks, of which the second has no row.
fn record(path: &Path) -> Result<TraverseWriter, StoreError> {
    let header = NewTraverse {
        sensor: Sensor { height: 4, width: 6 },
        slicing: Slicing {
            mode: SliceMode::Time,
            tick: 1_000_000,
            windows: vec![1_000_000],
            align: Align::Start,
            origin: Origin::At(0),
        },
        members: vec![NewMember {
            name: MEMBER.to_owned(),
            dim: DIM,
            fingerprint: [("a".to_owned(), "b".to_owned())].into(),
        }],
        source: "events.raw".to_owned(),
        notes: String::new(),
        rows: evpr_core::plan::RowType::F32,
    };
    let mut writer = TraverseWriter::create(path, header)?;
    for tick in 0..TICKS {
        let record = TickRecord {
            tick,
            start_us: 1000 * tick,
            end_us: 1000 * (tick + 1),
            position: (tick == 0).then_some([1.5, -2.0]),
        };
        let row: &[f32] = &[0.6, 0.8];
        writer.append(&record, &[(tick != 1).then_some(row)])?;
    }
    Ok(writer)
}

/// Reads these files.
fn take(folder: &Path, names: &[&str]) -> Vec<Vec<u8>> {
    let files = names
        .iter()
        .map(|name| fs::read(folder.join(name)).unwrap_or_default());
    let files: Vec<_> = files.collect();
    assert!(files.iter().all(|bytes| !bytes.is_empty()));
    files
}

/// Writes these files, but for the one which is replaced.
fn put(folder: &Path, names: &[&str], files: &[Vec<u8>], which: usize, bytes: &[u8]) {
    let rows = folder.join("rows/m");
    assert!(
        fs::create_dir_all(&rows).is_ok(),
        "{} cannot be made",
        rows.display()
    );
    for (at, (name, sound)) in names.iter().zip(files).enumerate() {
        let path = folder.join(name);
        let written = fs::write(&path, if at == which { bytes } else { sound });
        assert!(written.is_ok(), "{} cannot be written", path.display());
    }
}

/// A folder for as long as this lives.
struct Folder(PathBuf);

impl Folder {
    fn new(kind: &str) -> Self {
        let (process, thread) = (process::id(), thread::current().id());
        let path = env::temp_dir().join(format!("evpr-fuzz-{kind}-{process}-{thread:?}"));
        assert!(
            fs::create_dir_all(&path).is_ok(),
            "{} cannot be made",
            path.display()
        );
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
