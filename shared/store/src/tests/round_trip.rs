//! What is recorded is what is read.

use crate::test_support::{append, assert_is_prefix, new_traverse, record, recording};
use crate::{StoreError, Traverse, TraverseWriter, partial_path, verify};
use evpr_core::plan::RowType;
use proptest::prelude::*;
use std::process::Command;

#[test]
fn a_recording_becomes_a_traverse() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/deeper/map");
    let writer = recording(&path, &[3, 5], 7);
    assert_eq!(writer.next_tick(), 7);
    assert!(partial_path(&path).unwrap().is_dir() && !path.exists());
    let traverse = writer.close().unwrap();
    assert!(!partial_path(&path).unwrap().exists());
    assert_is_prefix(&traverse, &[3, 5], 7);
    let manifest = traverse.manifest();
    assert_eq!((manifest.ticks, manifest.complete), (7, true));
    // Members sit out the ticks with (tick + member) % 4 = 1: 1 and 5; 0 and 4.
    assert_eq!(
        manifest.members.iter().map(|m| m.present).collect::<Vec<_>>(),
        [5, 5]
    );
    let mut left: Vec<_> = std::fs::read_dir(&path)
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    left.sort();
    assert_eq!(left, ["rows", "ticks.csv", "traverse.json"]);
    let checked = verify(&path).unwrap();
    assert_eq!((checked.ticks, checked.positions), (7, 3));
    assert_eq!(checked.problems, Vec::<String>::new());
}

/// Rows of 16 bits: half the room, rounded to the nearest, readable by NumPy, verified and repaired like others.
#[test]
fn rows_of_16_bits_are_rounded_and_take_half_the_room() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map");
    let header = crate::NewTraverse {
        rows: RowType::F16,
        ..new_traverse(&[3, 500_000])
    };
    let mut writer = TraverseWriter::create(&path, header.clone()).unwrap();
    let long: Vec<f32> = (0..500_000).map(|i| i as f32 / 1e6).collect();
    let third = 1.0f32 / 3.0;
    writer
        .append(&record(0), &[Some(&[third, -0.5, 1.0]), Some(&long)])
        .unwrap();
    // The process dies, and another goes on.
    drop(writer);
    let other = crate::NewTraverse {
        rows: RowType::F32,
        ..header.clone()
    };
    let error = TraverseWriter::resume(&path, other).unwrap_err().to_string();
    assert!(
        error.contains("rows") && error.contains("f16") && error.contains("f32"),
        "{error}"
    );
    let mut writer = TraverseWriter::resume(&path, header).unwrap();
    assert_eq!(writer.next_tick(), 1);
    let error = writer
        .append(&record(1), &[Some(&[1e5, 0.0, 0.0]), None])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("number 0 of the row of member m0/x is 100000, too large for f16"),
        "{error}"
    );
    writer.append(&record(1), &[None, Some(&long)]).unwrap();
    let traverse = writer.close().unwrap();
    assert_eq!(
        traverse.member("m0/x").unwrap().rows(),
        [0.333_251_95, -0.5, 1.0, 0.0, 0.0, 0.0]
    );
    let rows = traverse.member("m1/x").unwrap();
    assert_eq!(rows.rows().len(), 1_000_000);
    let worst = rows
        .row(1)
        .iter()
        .zip(&long)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    assert!(worst <= 0.5 / 4096.0, "{worst}");
    let bytes = std::fs::metadata(path.join("rows/m1/x.npy")).unwrap().len();
    assert_eq!(bytes, 128 + 2 * 1_000_000);
    let head = std::fs::read(path.join("rows/m0/x.npy")).unwrap();
    assert!(
        String::from_utf8_lossy(&head).contains("'descr': '<f2', 'fortran_order': False, 'shape': (2, 3)")
    );
    assert_eq!(verify(&path).unwrap().problems, Vec::<String>::new());
    assert_eq!(
        Traverse::open(&path).unwrap().manifest().members[0].dtype,
        RowType::F16
    );
}

#[test]
fn rows_outlive_the_traverse_and_are_shared_by_threads() {
    let folder = tempfile::tempdir().unwrap();
    let traverse = recording(&folder.path().join("map"), &[3], 2).close().unwrap();
    let rows = traverse.member("m0/x").unwrap();
    drop(traverse);
    let clone = rows.clone();
    let sum = std::thread::spawn(move || clone.rows().iter().sum::<f32>())
        .join()
        .unwrap();
    assert_eq!(sum, rows.rows().iter().sum::<f32>());
    assert!(sum > 0.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_pattern_of_presence_is_read_back(
        dims in prop::collection::vec(1usize..6, 1..4),
        seed in prop::collection::vec(prop::collection::vec(any::<bool>(), 3), 1..12),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = TraverseWriter::create(&folder.path().join("map"), new_traverse(&dims)).unwrap();
        for present in &seed {
            append(&mut writer, &dims, &present[..dims.len()]);
        }
        let traverse = writer.close().unwrap();
        prop_assert_eq!(traverse.len(), seed.len());
        for m in 0..dims.len() {
            let rows = traverse.member(&format!("m{m}/x")).unwrap();
            let expected: Vec<bool> = seed.iter().map(|p| p[m]).collect();
            prop_assert_eq!(rows.present(), expected.as_slice());
            for (tick, present) in expected.iter().enumerate() {
                let zero = rows.row(tick).iter().all(|v| *v == 0.0);
                prop_assert_eq!(zero, !present);
            }
        }
    }
}

#[test]
fn numpy_reads_the_rows() {
    let has_numpy = Command::new("python3").args(["-c", "import numpy"]).output();
    if !has_numpy.is_ok_and(|o| o.status.success()) {
        println!("skipped: numpy_reads_the_rows: python3 with numpy is absent");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map");
    let traverse = recording(&path, &[3, 5], 7).close().unwrap();
    let script = "import numpy, sys\n\
         r = numpy.load(sys.argv[1] + '/rows/m1/x.npy', mmap_mode='r')\n\
         p = numpy.load(sys.argv[1] + '/rows/m1/x.present.npy')\n\
         c = numpy.genfromtxt(sys.argv[1] + '/ticks.csv', delimiter=',', names=True)\n\
         print(r.dtype.str, r.shape, p.dtype, p.shape, p.sum(), list(c.dtype.names), c['end_us'][6])\n\
         print(repr(float(r.astype('f8').sum())))\n";
    let output = Command::new("python3")
        .args(["-c", script])
        .arg(&path)
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let expected = "<f4 (7, 5) bool (7,) 5 ['tick', 'start_us', 'end_us', 'east_m', 'north_m'] 7000.0";
    assert_eq!(lines.first(), Some(&expected));
    let rows = traverse.member("m1/x").unwrap();
    let sum: f64 = rows.rows().iter().map(|v| f64::from(*v)).sum();
    let theirs: f64 = lines[1].parse().unwrap();
    assert!((theirs - sum).abs() < 1e-9 * sum.abs(), "{theirs} against {sum}");
}

#[test]
fn a_map_is_compared_with_the_plan() {
    let folder = tempfile::tempdir().unwrap();
    let plan = evpr_core::plan::test_plan();
    let path = folder.path().join("map");
    let header = crate::NewTraverse::from_plan(&plan);
    let mut writer = TraverseWriter::create(&path, header).unwrap();
    writer.append(&record(0), &[None, None]).unwrap();
    let map = writer.close().unwrap();
    map.check_against(&plan).unwrap();

    let mut fewer = plan.clone();
    fewer.members.truncate(1);
    map.check_against(&fewer).unwrap();

    let mut other = plan.clone();
    other.slicing.tick = 2_000_000;
    other.reconstructions[1].kind = "time_surface".to_owned();
    other.members.push(other.members[0].clone());
    other.members[2].name = "c@1ms/x".to_owned();
    let error = map.check_against(&other).unwrap_err();
    assert!(matches!(&error, StoreError::Mismatch { differences, .. } if differences.len() == 4));
    let message = error.to_string();
    for part in [
        "tick is 1ms in the map and 2ms in the configuration (members a@1ms/x, b@1ms/x)",
        "reconstruction is event_count_no_polarity in the map and time_surface in the configuration \
         (member b@1ms/x)",
        "the map has no member c@1ms/x",
    ] {
        assert!(message.contains(part), "{message}");
    }
    assert!(!message.contains('\n'));
    let reopened = Traverse::open(&path).unwrap();
    assert_eq!(reopened.manifest(), map.manifest());
}
