//! A recording is stopped at every single write, synchronisation, renaming and removal: what is opened afterwards has
//! every tick that was appended, and nothing that was not.

use crate::disk::fail_points::{Fault, with_fault};
use crate::test_support::{assert_is_prefix, has_row, new_traverse, record, row};
use crate::{StoreError, Traverse, TraverseWriter, partial_path, repair, verify};
use std::path::Path;

const DIMS: [usize; 2] = [3, 5];
const TICKS: u64 = 3;

/// Appends what is missing up to [`TICKS`] ticks, counting them, and closes.
fn finish(mut writer: TraverseWriter, appended: &mut u64) -> Result<(), StoreError> {
    for tick in writer.next_tick()..TICKS {
        let rows: Vec<Option<Vec<f32>>> = DIMS
            .iter()
            .enumerate()
            .map(|(m, dim)| has_row(m, tick).then(|| row(m, tick, *dim)))
            .collect();
        let rows: Vec<Option<&[f32]>> = rows.iter().map(Option::as_deref).collect();
        writer.append(&record(tick), &rows)?;
        *appended += 1;
    }
    writer.close().map(|_| ())
}

/// Records [`TICKS`] ticks and closes; how many were appended, whatever came of the rest.
fn record_all(path: &Path) -> (u64, Result<(), StoreError>) {
    let mut appended = 0;
    let writer = TraverseWriter::create(path, new_traverse(&DIMS));
    let result = writer.and_then(|writer| finish(writer, &mut appended));
    (appended, result)
}

/// What is there is sound, and has at least `appended` ticks; they are how many.
fn assert_sound(path: &Path, appended: u64) -> u64 {
    let traverse = Traverse::open(path).unwrap();
    let ticks = traverse.ticks().len() as u64;
    assert!((appended..=TICKS).contains(&ticks), "{ticks} of {appended}");
    assert_is_prefix(&traverse, &DIMS, ticks);
    assert_eq!(verify(path).unwrap().problems, Vec::<String>::new());
    assert!(!partial_path(path).unwrap().exists());
    ticks
}

/// Every step of a recording with every fault; `then` looks at what is left, knowing how many ticks were appended.
fn at_every_step(then: impl Fn(&Path, u64)) {
    let undisturbed = tempfile::tempdir().unwrap();
    let (result, steps) = with_fault(None, || record_all(&undisturbed.path().join("map")));
    assert!(result.1.is_ok() && result.0 == TICKS);
    // Each tick is six writes: its line, two files per member, its commit.
    assert!(steps > 6 * TICKS + 20, "{steps}");
    for at in 0..steps {
        for fault in [Fault::Death, Fault::TornDeath, Fault::Full] {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("maps/map");
            let ((appended, result), _) = with_fault(Some((at, fault)), || record_all(&path));
            // A torn step that writes nothing is whole, and the next one fails.
            assert!(
                result.is_err() || fault == Fault::TornDeath,
                "step {at}, {fault:?}"
            );
            if let Err(error) = result {
                assert!(!error.to_string().contains('\n'), "{error}");
            }
            println!("step {at}, {fault:?}: {appended} ticks appended");
            then(&path, appended);
        }
    }
}

#[test]
fn what_was_appended_is_repaired_wherever_the_recording_stopped() {
    at_every_step(|path, appended| {
        if path.exists() {
            assert_eq!(assert_sound(path, appended), TICKS);
            return;
        }
        match repair(path) {
            Ok(summary) => assert_eq!(assert_sound(path, appended), summary.ticks),
            Err(StoreError::Empty(_) | StoreError::Missing(_)) => assert_eq!(appended, 0),
            Err(other) => panic!("{other}"),
        }
    });
}

#[test]
fn a_recording_goes_on_wherever_it_stopped() {
    at_every_step(|path, appended| {
        if path.exists() {
            return;
        }
        let mut more = 0;
        let writer = match TraverseWriter::resume(path, new_traverse(&DIMS)) {
            Err(StoreError::Missing(_)) if appended == 0 => {
                TraverseWriter::create(path, new_traverse(&DIMS)).unwrap()
            }
            // All that was missing is its name.
            Err(StoreError::ResumeComplete(_)) => {
                assert_eq!(repair(path).unwrap().ticks, TICKS);
                assert_sound(path, TICKS);
                return;
            }
            resumed => resumed.unwrap(),
        };
        assert!(writer.next_tick() >= appended);
        finish(writer, &mut more).unwrap();
        assert_eq!(assert_sound(path, appended), TICKS);
    });
}

#[test]
fn a_repair_that_stopped_is_repaired() {
    let crash = |path: &Path| {
        // Far enough that two ticks are whole and the third is under way.
        let torn = |at| Some((at, Fault::TornDeath));
        let undisturbed = tempfile::tempdir().unwrap();
        let (_, create) = with_fault(None, || {
            TraverseWriter::create(&undisturbed.path().join("map"), new_traverse(&DIMS)).map(drop)
        });
        let ((appended, _), _) = with_fault(torn(create + 6 * 2 + 3), || record_all(path));
        assert_eq!(appended, 2);
    };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map");
    crash(&path);
    let (repaired, steps) = with_fault(None, || repair(&path));
    assert_eq!(repaired.unwrap().ticks, 2);
    for at in 0..steps {
        for fault in [Fault::Death, Fault::TornDeath, Fault::Full] {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("map");
            crash(&path);
            let (stopped, _) = with_fault(Some((at, fault)), || repair(&path));
            if path.exists() {
                assert_eq!(assert_sound(&path, 2), 2);
                continue;
            }
            assert!(stopped.is_err(), "step {at}, {fault:?}");
            assert_eq!(repair(&path).unwrap().ticks, 2, "step {at}, {fault:?}");
            assert_eq!(assert_sound(&path, 2), 2);
        }
    }
}
