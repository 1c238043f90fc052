//! What is installed on a vehicle: the unit is one that systemd takes, and starts evpr as evpr wants to be started.

use super::support::{Bench, finish, text};
use std::fs;
use std::path::Path;
use std::process::Command;

fn unit() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    fs::read_to_string(root.join("packaging/systemd/evpr@.service")).unwrap()
}

#[test]
fn the_unit_starts_evpr_with_options_that_it_has() {
    let bench = Bench::new();
    let unit = unit();
    let start = unit.lines().find_map(|l| l.strip_prefix("ExecStart=")).unwrap();
    let mut words = start.split_whitespace();
    assert_eq!(words.next(), Some("/usr/bin/evpr"));
    let written = |word: &str| match word {
        "$EVPR_ARGS" => "--map=corridor-map".to_owned(),
        word => word.replace("%i", "corridor"),
    };
    let args: Vec<String> = words.map(written).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let said = bench.run(&args);
    // The wrong usage of options would be 2.
    assert_eq!(said.code(), 1, "{}", said.stderr);
    assert!(
        said.errors()[0].contains("/etc/evpr/corridor.toml"),
        "{}",
        said.stderr
    );
}

#[test]
fn systemd_takes_the_unit_and_finds_it_hardened() {
    let there = Command::new("systemd-analyze").arg("--version").output();
    if there.is_err() {
        println!("skipped: systemd_takes_the_unit_and_finds_it_hardened: there is no systemd-analyze");
        return;
    }
    let bench = Bench::new();
    let here = unit().replace("/usr/bin/evpr", env!("CARGO_BIN_EXE_evpr"));
    let path = bench.file("evpr@corridor.service", &here);
    let verify = finish(Command::new("systemd-analyze").args(["verify", "--man=no", text(&path)]));
    assert!(
        verify.status.success() && verify.stderr.is_empty(),
        "{}",
        verify.stderr
    );
    // From 0, safe, to 100.
    let security = ["security", "--offline=true", "--threshold=25", text(&path)];
    let security = finish(Command::new("systemd-analyze").args(security));
    assert!(security.status.success(), "{}", security.stdout);
}
