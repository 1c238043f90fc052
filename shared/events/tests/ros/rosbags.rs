//! Larger recordings, written by `rosbags` now.

use super::{BASE_NS, SENSOR, events_of, fixture_path, read_path};
use std::process::Command;

#[test]
fn what_rosbags_writes_is_read() {
    const COUNT: u64 = 4_000;
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = Command::new(&python)
        .args(["-c", "import rosbags, mcap"])
        .output();
    if !has.is_ok_and(|out| out.status.success()) {
        println!("skipped: {python} has no rosbags and mcap");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let out = Command::new(&python)
        .arg(fixture_path("make_fixtures.py"))
        .arg(dir.path())
        .arg(COUNT.to_string())
        .output()
        .unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let mut files = 0;
    for file in std::fs::read_dir(dir.path()).unwrap() {
        let path = file.unwrap().path();
        let evt3 = path.to_string_lossy().contains("evt3");
        let start_ns = if evt3 { 5_000_000_000 } else { BASE_NS };
        let got = read_path(&path);
        assert_eq!(
            (got.error, got.sensor),
            (None, Some(SENSOR)),
            "{}",
            path.display()
        );
        assert!(got.events == events_of(start_ns, COUNT), "{}", path.display());
        files += 1;
    }
    assert_eq!(files, 19);
}
