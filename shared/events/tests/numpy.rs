//! NumPy arrays: layouts, types, units, and what is wrong with bad ones. Where Python has NumPy, it writes the files.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // a broken fixture must fail the test

use evpr_core::plan::TimeUnit;
use evpr_events::{RawEvent, ReadOptions, SourceError};
use std::path::{Path, PathBuf};
use std::process::Command;

const PACKED: &str = "[('t', '<i8'), ('x', '<u2'), ('y', '<u2'), ('p', '|u1')]";

fn npy(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let quoted = if descr.starts_with('[') {
        descr.to_owned()
    } else {
        format!("'{descr}'")
    };
    let header = format!("{{'descr': {quoted}, 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend_from_slice(data);
    bytes
}

fn packed(events: &[(i64, u16, u16, u8)]) -> Vec<u8> {
    let row = |e: &(i64, u16, u16, u8)| {
        let mut row = e.0.to_le_bytes().to_vec();
        row.extend_from_slice(&e.1.to_le_bytes());
        row.extend_from_slice(&e.2.to_le_bytes());
        row.push(e.3);
        row
    };
    events.iter().flat_map(row).collect()
}

fn read_as(path: &Path, time_unit: TimeUnit) -> Result<Vec<RawEvent>, SourceError> {
    let options = ReadOptions {
        time_unit,
        ..ReadOptions::default()
    };
    let mut recording = evpr_events::open(path, &options)?;
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    while recording.next_batch(&mut batch)? {
        all.extend_from_slice(&batch);
    }
    Ok(all)
}

fn read_bytes(bytes: &[u8]) -> Result<Vec<RawEvent>, SourceError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    std::fs::write(&path, bytes).unwrap();
    read_as(&path, TimeUnit::Auto)
}

fn event(t_ns: u64, x: u16, y: u16, on: bool) -> RawEvent {
    RawEvent { t_ns, x, y, on }
}

#[test]
fn every_layout_is_read() {
    let wants = [event(5_000, 1, 2, true), event(7_000, 3, 4, false)];
    let rows = packed(&[(5, 1, 2, 1), (7, 3, 4, 0)]);
    assert_eq!(read_bytes(&npy(PACKED, "False", "(2,)", &rows)).unwrap(), wants);
    let be = |v: [i16; 8]| v.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<_>>();
    let (c, f) = (be([5, 1, 2, 1, 7, 3, 4, -1]), be([5, 7, 1, 3, 2, 4, 1, -1]));
    assert_eq!(read_bytes(&npy(">i2", "False", "(2, 4)", &c)).unwrap(), wants);
    assert_eq!(read_bytes(&npy(">i2", "True", "(2, 4)", &f)).unwrap(), wants);
    assert_eq!(read_bytes(&npy(">i2", "False", "(4, 2)", &f)).unwrap(), wants);
    // Further fields, any order and any spelling; a long header of version 2.
    let mut odd = b"\x93NUMPY\x02\x00".to_vec();
    let header = "{'shape': (1L,), 'fortran_order': False, 'descr': [('Polarity', '|b1'), ('', '|V3'), ('why', '<U2', \
                  (2,)), (('Column', 'x'), '<f4'), ('y', '|i1'), ('timestamp', '>u8')]}";
    odd.extend_from_slice(&(header.len() as u32).to_le_bytes());
    odd.extend_from_slice(header.as_bytes());
    odd.extend_from_slice(&[1; 4 + 16]);
    odd.extend_from_slice(&300.0f32.to_le_bytes());
    odd.push(9);
    odd.extend_from_slice(&1_600_000_000_000_000_001u64.to_be_bytes());
    let wants = [event(1_600_000_000_000_000_001, 300, 9, true)];
    assert_eq!(read_bytes(&odd).unwrap(), wants);
}

#[test]
fn it_can_be_entered_anywhere() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    let events: Vec<_> = (0..150_000i64).map(|i| (i / 3 * 2, 1, 2, 1)).collect();
    let rows = packed(&events);
    std::fs::write(&path, npy(PACKED, "False", "(150000,)", &rows)).unwrap();
    let mut recording = evpr_events::open(&path, &ReadOptions::default()).unwrap();
    let mut batch = Vec::new();
    for (t_ns, index) in [
        (90_000_000, 135_000),
        (0, 0),
        (1, 3),
        (99_998_000, 149_997),
        (99_998_001, 150_000),
        (3_000, 6),
    ] {
        assert_eq!(recording.seek_before(t_ns).unwrap(), Some(index));
        let more = recording.next_batch(&mut batch).unwrap();
        assert_eq!(more, index < 150_000);
        assert_eq!(
            batch.first().map(|e| e.t_ns),
            events.get(index as usize).map(|e| e.0 as u64 * 1000)
        );
    }
}

#[test]
fn bad_arrays_are_refused_in_one_line() {
    let good = packed(&[(5, 1, 2, 1), (7, 3, 4, 0)]);
    let of = |descr: &str, shape: &str| npy(descr, "False", shape, &good);
    for (bytes, wants) in [
        (b"\x93NUMPY\x09\x00\x10\x00xxxx".to_vec(), "version 1, 2 or 3"),
        (b"\x93NUMPY".to_vec(), "version 1, 2 or 3"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xffxx".to_vec(), "at most 65536"),
        (b"\x93NUMPY\x01\x00\x40\x00{'descr'".to_vec(), "cut short"),
        (of("[('t', '<i8')", "(2,)"), "no Python literal"),
        (of(PACKED, "2"), "'shape'"),
        (of(PACKED, "(0,)"), "holds no events"),
        (of(PACKED, "(2, 1)"), "shape (2, 1)"),
        (of("<f8", "(3, 3)"), "shape (3, 3)"),
        (of("<f8", "()"), "shape ()"),
        (of("|O", "(2, 4)"), "type '|O'"),
        (of("[('t', '<i8'), ('x', '<u2')]", "(2,)"), "without a field y"),
        (of("[('t', '<i8'), ('ts', '<u2')]", "(2,)"), "two fields for t"),
        (
            of("[('t', '<i8', (2,)), ('x', '<u2')]", "(2,)"),
            "'t' is not one number",
        ),
        (of("[('t', '<M8[ns]')]", "(2,)"), "'t' is not one number"),
        (of("[('t', [('a', '<i8')])]", "(2,)"), "fields of its own"),
        (of("[('t', '|V99999999')]", "(2,)"), "more than 65536 bytes"),
        (of("[]", "(2,)"), "no bytes"),
        (of("<i8", "(4, 18446744073709551615)"), "no file can hold"),
        (of(PACKED, "(3,)"), "ends after 2 of the 3 events"),
        (
            npy(PACKED, "False", "(2,)", &packed(&[(5, 1, 2, 1), (-7, 3, 4, 0)])),
            "event 1 (from 0): the time -7 is negative",
        ),
        (
            npy(PACKED, "False", "(1,)", &packed(&[(5, 1, 2, 2)])),
            "event 0 (from 0): the polarity is 2",
        ),
        (
            npy(
                "<f4",
                "False",
                "(1, 4)",
                &[0; 8]
                    .iter()
                    .copied()
                    .chain(2.5f32.to_le_bytes())
                    .chain([0; 4])
                    .collect::<Vec<_>>(),
            ),
            "y is 2.5",
        ),
    ] {
        let said = read_bytes(&bytes).unwrap_err().to_string();
        assert!(said.contains(wants), "{said}\nwants {wants}");
        assert!(said.contains("a.npy: ") && !said.contains('\n'), "{said}");
    }
}

#[test]
fn columns_one_after_another_need_a_file() {
    let bytes = npy("|u1", "True", "(1, 4)", &[1, 2, 3, 1]);
    assert_eq!(read_bytes(&bytes).unwrap(), [event(1_000, 2, 3, true)]);
    let input = evpr_events::Input::new("pipe", std::io::Cursor::new(bytes));
    let said = evpr_events::open_input(input, &ReadOptions::default())
        .err()
        .unwrap();
    assert!(said.to_string().contains("numpy.ascontiguousarray"), "{said}");
}

/// Runs a script in Python with NumPy in this folder; false when there is none.
fn python(dir: &Path, script: &str) -> bool {
    let has = Command::new("python3").args(["-c", "import numpy"]).output();
    if !has.is_ok_and(|o| o.status.success()) {
        return false;
    }
    let done = Command::new("python3")
        .args(["-c", script])
        .current_dir(dir)
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    true
}

const WRITE_ALL: &str = r"
import numpy as np
rng = np.random.default_rng(7)
n = 70_000
us = np.cumsum(rng.integers(0, 50, n)) + 1000
x, y, p = rng.integers(0, 640, n), rng.integers(0, 480, n), rng.integers(0, 2, n)
np.savetxt('truth.csv', np.stack([us, x, y, p], 1), '%d', ',')
for t in ['<i8', '>i8', '<u8', '<i4', '>u4', '<f8', '<f4', '>f8']:
    for c in ['<u2', '>i2', '<i4', '<f4']:
        for q in ['|b1', '|u1', '|i1', '<f2', '<i8']:
            for align in (False, True):
                a = np.zeros(n, np.dtype([('x', c), ('t', t), ('p', q), ('y', c)], align=align))
                a['t'], a['x'], a['y'] = us, x, y
                a['p'] = np.where(p == 0, -1, 1) if q in ('|i1', '<f2') else p
                np.save('_'.join(['s', t, c, q, str(align)]).replace('|', 'n') + '.npy', a)
for t in ['<i8', '>i4', '<f8', '<f4']:
    a = np.stack([us, x, y, p], 1).astype(t)
    np.save(f'c_{t}.npy', a)
    np.save(f'f_{t}.npy', np.asfortranarray(a))
    np.save(f't_{t}.npy', np.ascontiguousarray(a.T))
    np.savez(f'one_{t}.npz', a)
np.savez('four.npz', t=us, x=x, y=y, p=p.astype(bool))
np.savez_compressed('packed.npz', timestamps=us.astype('f8'), x=x, y=y, polarity=(2 * p - 1).astype('i1'), extra=np.eye(3))
";

#[test]
fn what_numpy_writes_is_read() {
    let dir = tempfile::tempdir().unwrap();
    if !python(dir.path(), WRITE_ALL) {
        println!("skipped: what_numpy_writes_is_read: python3 has no numpy");
        return;
    }
    let truth = read_as(&dir.path().join("truth.csv"), TimeUnit::Us).unwrap();
    let files: Vec<PathBuf> = std::fs::read_dir(dir.path())
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    let arrays: Vec<_> = files
        .iter()
        .filter(|p| p.extension().is_some_and(|e| e != "csv"))
        .collect();
    assert!(arrays.len() >= 8 * 4 * 5 * 2 + 12);
    for path in arrays {
        assert!(
            read_as(path, TimeUnit::Us).unwrap() == truth,
            "{}",
            path.display()
        );
    }
}

const READ_OURS: &str = r"
import numpy as np
a, z = np.load('a.npy'), np.load('a.npz')
assert a.dtype.names == ('t_ns', 'x', 'y', 'p') and a.shape == (100_000,), a.dtype
c = np.genfromtxt('a.csv', delimiter=',', names=True, dtype=['f8', 'u2', 'u2', 'u1'])
for name in a.dtype.names:
    assert (a[name] == z[name]).all() and a[name].dtype == z[name].dtype, name
assert (a['x'] == c['x']).all() and (a['y'] == c['y']).all() and (a['p'] == c['p']).all()
assert abs(a['t_ns'] / 1e9 - c['t']).max() < 1e-9
assert not __import__('zipfile').ZipFile('a.npz').testzip()
";

#[test]
fn numpy_reads_what_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let events: Vec<RawEvent> = (0..100_000u64)
        .map(|i| event(i * 1_234 + 5, (i % 346) as u16, (i % 260) as u16, i % 3 == 0))
        .collect();
    for name in ["a.npy", "a.npz", "a.csv"] {
        let path = dir.path().join(name);
        let mut writer = evpr_events::writers::create(&path, &Default::default()).unwrap();
        writer.write(&events).unwrap();
        writer.finish().unwrap();
        assert!(read_as(&path, TimeUnit::Auto).unwrap() == events, "{name}");
    }
    if !python(dir.path(), READ_OURS) {
        println!("skipped: numpy_reads_what_is_written: python3 has no numpy");
    }
}
