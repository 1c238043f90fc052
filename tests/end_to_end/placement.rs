//! Processes get the processors and the launcher of `[[placement]]`.

use super::support::{Bench, Running, TICKS, assert_ticks, run_args};
use std::fs;
use std::path::PathBuf;

fn config(bench: &Bench, placements: &str) -> PathBuf {
    let base = fs::read_to_string(bench.ensemble_config()).unwrap();
    bench.file("placed.toml", &format!("{base}{placements}"))
}

/// A field of /proc/PID/stat, counted from 1 as in proc(5).
fn stat(pid: i32, field: usize) -> i64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    // The name before may hold spaces; the third field comes behind its bracket.
    let rest = stat.rsplit_once(')').unwrap().1;
    rest.split_whitespace().nth(field - 3).unwrap().parse().unwrap()
}

fn processors(pid: i32) -> String {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status
        .lines()
        .find(|l| l.starts_with("Cpus_allowed_list:"))
        .unwrap();
    line.split_once('\t').unwrap().1.to_owned()
}

#[test]
fn processes_run_where_and_how_the_plan_says() {
    let bench = Bench::new();
    let mine = processors(std::process::id() as i32);
    let first: usize = mine.split([',', '-']).next().unwrap().parse().unwrap();
    let config = config(
        &bench,
        &format!(
            "[[placement]]\nprocess = \"extract\"\ncpus = [{first}]\n\
             [[placement]]\nprocess = \"fuse\"\nlauncher = [\"nice\", \"-n\", \"3\", \"env\", \"EVPR_PLACED={{process}}\"]\n"
        ),
    );
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "5"]));
    assert!(running.read_to(20));
    let extractors = running.services("extract");
    assert_eq!(extractors.len(), 2);
    for pid in extractors {
        assert_eq!(processors(pid), first.to_string());
    }
    for pid in running.services("reconstruct") {
        assert_eq!(processors(pid), mine);
    }
    let fuse = running.services("fuse")[0];
    assert_eq!(stat(fuse, 19) - stat(running.pid(), 19), 3, "nice");
    let environment = fs::read(format!("/proc/{fuse}/environ")).unwrap();
    assert!(
        environment
            .split(|b| *b == 0)
            .any(|word| word == b"EVPR_PLACED=fuse")
    );
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    assert!(bench.left_behind().is_empty());
}

#[test]
fn a_processor_or_a_launcher_that_is_not_there_ends_the_run_in_one_line() {
    let bench = Bench::new();
    let plain = bench.ensemble_config();
    let map = bench.map(&plain);
    let query = bench.recording("query.txt", 3, 2);
    for (placement, says) in [
        ("process = \"fuse\"\ncpus = [1023]\n", "cannot use processor 1023"),
        (
            "process = \"fuse\"\nlauncher = [\"no-such-launcher\"]\n",
            "no-such-launcher",
        ),
    ] {
        let config = config(&bench, &format!("[[placement]]\n{placement}"));
        let said = bench.run(&run_args(&config, &query, &map, &[]));
        assert_eq!(said.code(), 1, "{}", said.stderr);
        assert!(said.errors().len() == 1, "{}", said.stderr);
        assert!(said.errors()[0].contains(says), "{}", said.stderr);
        assert!(bench.left_behind().is_empty());
    }
}
