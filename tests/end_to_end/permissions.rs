//! What an instance has on the machine is its owner's alone.

use super::support::{Bench, Running, TICKS, run_args};
use std::fs;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::Path;

/// What others than the owner may do.
fn of_others(path: &Path) -> u32 {
    fs::symlink_metadata(path).unwrap().permissions().mode() & 0o077
}

#[test]
fn nobody_else_reads_shared_memory_or_steers() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "5"]));
    assert!(running.read_to(20));
    let shared = bench.shared_memory();
    assert!(shared.len() > 20, "{}", shared.len());
    for path in shared {
        assert_eq!(of_others(&path), 0, "{}", path.display());
    }
    // Nobody comes into the folder, so that what is in it need not be looked at one by one.
    assert_eq!(of_others(&bench.run_folder()), 0);
    let socket = bench.control_socket();
    assert!(fs::symlink_metadata(&socket).unwrap().file_type().is_socket());
    assert_eq!(of_others(&socket), 0);
    Running::signal(running.pid(), nix::sys::signal::Signal::SIGINT);
    let (_, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert!(bench.left_behind().is_empty());
}
