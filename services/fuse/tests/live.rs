//! Comparisons made on the spot with the NumPy formulas, where python3 with NumPy and the shared folder are there.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::MemberSet;
use evpr_core::plan::SequenceMethod;
use evpr_core::stage::Sink;
use evpr_fuse::{SequenceMatcher, sequence_match};
use ndarray::{Array1, Array2, ArrayD};
use ndarray_npy::{read_npy, write_npy};
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};
use support::*;

/// True when the formulas can be run here; says so on stderr when not.
fn can_run(test: &str) -> bool {
    if shared(test, "oracle/oracle.py").is_none() {
        return false;
    }
    let numpy = Command::new("python3").args(["-c", "import numpy"]).output();
    let there = numpy.is_ok_and(|o| o.status.success());
    if !there {
        eprintln!("skipped: {test}: python3 with numpy is absent");
    }
    there
}

/// S̃ by the formulas: with holes, and without where nothing is missing.
fn by_numpy(folder: &Path, s: &Array2<f64>, present: &[bool], valid: &[bool], length: usize) -> ArrayD<f64> {
    write_npy(folder.join("s.npy"), s).unwrap();
    write_npy(folder.join("present.npy"), &Array1::from(present.to_vec())).unwrap();
    write_npy(folder.join("valid.npy"), &Array1::from(valid.to_vec())).unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scripts/make_fuse_golden.py");
    let output = Command::new("python3")
        .arg(script)
        .arg("--match")
        .arg(folder)
        .args(["--length", &length.to_string()])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    read_npy(folder.join("masked.npy")).unwrap()
}

/// Similarities with constant columns and columns that change by less than the threshold.
fn similarities(ticks: usize, references: usize) -> Array2<f64> {
    let values = noise(ticks + references, ticks * references);
    let mut s = Array2::from_shape_fn((ticks, references), |(t, j)| {
        f64::from(values[t * references + j])
    });
    for j in 0..references {
        let first = s[(0, j)];
        match j % 8 {
            1 | 4 => s.column_mut(j).fill(first),
            5 => s.column_mut(j).mapv_inplace(|v| first + 1e-5 * v),
            _ => {}
        }
    }
    s
}

#[test]
fn whole_matrices_up_to_5000_references() {
    if !can_run("whole_matrices_up_to_5000_references") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (references, length) in [
        (1, 10),
        (2, 2),
        (7, 30),
        (9, 2),
        (129, 10),
        (1000, 1),
        (5000, 10),
        (5000, 30),
    ] {
        let s = similarities(36, references);
        let masked = by_numpy(folder.path(), &s, &[true; 36], &vec![true; references], length);
        let whole: ArrayD<f64> = read_npy(folder.path().join("whole.npy")).unwrap();
        let got = sequence_match(s.view(), length, SequenceMethod::Paper).into_dyn();
        let what = format!("R = {references}, L = {length}");
        assert_close(&got, &whole, &what);
        assert_close(&got, &masked, &what);
    }
}

#[test]
fn places_that_change_alike() {
    if !can_run("places_that_change_alike") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (references, length) in [(3000, 2), (3000, 3), (1000, 10)] {
        // From steps as large as the places' own changes to steps that leave nothing else to see.
        for step in [1.0, 10.0, 100.0, 1e3, 1e5] {
            let mut s = similarities(16, references);
            for (t, mut row) in s.rows_mut().into_iter().enumerate() {
                let common = step * f64::from(noise(t, 1)[0]);
                row.mapv_inplace(|v| v + common);
            }
            by_numpy(folder.path(), &s, &[true; 16], &vec![true; references], length);
            let whole: ArrayD<f64> = read_npy(folder.path().join("whole.npy")).unwrap();
            let got = sequence_match(s.view(), length, SequenceMethod::Paper).into_dyn();
            assert_close(
                &got,
                &whole,
                &format!("R = {references}, L = {length}, step {step}"),
            );
        }
    }
}

#[test]
fn holes_up_to_5000_references() {
    if !can_run("holes_up_to_5000_references") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (references, length) in [(7, 10), (300, 3), (5000, 30)] {
        let s = similarities(36, references);
        let present: Vec<bool> = (0..36).map(|t| t % 5 != 3 && !(12..16).contains(&t)).collect();
        let valid: Vec<bool> = noise(5, references).iter().map(|v| *v > -0.6).collect();
        let want = by_numpy(folder.path(), &s, &present, &valid, length);
        let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, length, &valid);
        let mut got = Array2::zeros(s.dim());
        for (t, row) in s.rows().into_iter().enumerate() {
            matcher.push(present[t].then(|| row.as_slice().unwrap()));
            matcher.score(got.row_mut(t).into_slice().unwrap());
        }
        assert_close(
            &got.into_dyn(),
            &want,
            &format!("with holes, R = {references}, L = {length}"),
        );
    }
}

/// Per member: tick, S, S̃.
type Seen = Arc<Mutex<Vec<Vec<(usize, Vec<f64>, Vec<f64>)>>>>;

#[test]
fn the_running_fuser_on_the_similarities_it_used() {
    if !can_run("the_running_fuser_on_the_similarities_it_used") {
        return;
    }
    let (ticks, references, length, dims) = (30, 60, 6, [8, 5]);
    let plan = plan(&dims, length);
    let map = map(&plan, references, |m, j| (j + 3 * m) % 11 != 4);
    let mut fuser = fuser(&plan, map.clone(), 0, 0);
    let seen: Seen = Arc::new(Mutex::new(vec![Vec::new(); dims.len()]));
    let sink = Arc::clone(&seen);
    fuser.observe(Box::new(move |tick| {
        let mut sum = vec![0.0; tick.fused.len()];
        for member in tick.members {
            let entry = (
                tick.tick as usize,
                member.similarity.to_vec(),
                member.scores.to_vec(),
            );
            sink.lock().unwrap()[member.member].push(entry);
            sum.iter_mut()
                .zip(member.scores)
                .for_each(|(sum, s)| *sum += member.weight * s);
        }
        assert_eq!(sum, tick.fused);
    }));
    for tick in 0..ticks {
        // Member 0 is switched off for a while, member 1 has empty windows.
        let enabled: MemberSet = (0..2).filter(|m| *m == 1 || !(10..14).contains(&tick)).collect();
        let rows = [
            Some(noise(tick, dims[0])),
            (tick % 6 != 2).then(|| noise(900 + tick, dims[1])),
        ];
        feed(&mut fuser, tick as u64, enabled, &[1.0, 0.25], &rows);
    }
    settle(&mut fuser);
    assert_eq!(fuser.next_tick(), ticks as u64);
    let folder = tempfile::tempdir().unwrap();
    for (member, entries) in seen.lock().unwrap().iter().enumerate() {
        let mut present = vec![false; ticks];
        let (mut s, mut got) = (
            Array2::zeros((ticks, references)),
            Array2::from_elem((ticks, references), f64::NAN),
        );
        for (tick, similarity, scores) in entries {
            present[*tick] = true;
            s.row_mut(*tick).assign(&Array1::from(similarity.clone()));
            got.row_mut(*tick).assign(&Array1::from(scores.clone()));
        }
        let want = by_numpy(folder.path(), &s, &present, &map.members[member].valid, length);
        assert_close(&got.into_dyn(), &want, &format!("member {member}"));
    }
}
