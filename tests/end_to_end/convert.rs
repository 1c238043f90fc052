//! `evpr events convert` and `evpr events render`.

use super::support::{Bench, text};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::fs;
use std::process::Stdio;

/// 1000 events, one per 1.5 ms from 1 s on, along the rows of a sensor of 8 × 10 pixels.
fn recording(bench: &Bench) {
    let mut lines = "10 8\n".to_owned();
    for i in 0..1000u64 {
        let t_ns = 1_000_000_000 + i * 1_500_000 + 1;
        let (x, y, p) = (i % 10, i / 10 % 8, i % 3 / 2);
        lines += &format!(
            "{}.{:09} {x} {y} {p}\n",
            t_ns / 1_000_000_000,
            t_ns % 1_000_000_000
        );
    }
    bench.file("in.txt", &lines);
}

fn lines(bench: &Bench, name: &str) -> Vec<String> {
    let text = fs::read_to_string(bench.path(name)).unwrap();
    text.lines().skip(1).map(str::to_owned).collect()
}

/// Names in the bench's folder.
fn files(bench: &Bench) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(bench.folder.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_recording_goes_through_every_format_and_comes_back() {
    let bench = Bench::new();
    recording(&bench);
    let done = |args: &[&str]| {
        let said = bench.run(&[&["events", "convert"], args].concat());
        assert_eq!(said.code(), 0, "{args:?}: {}", said.stderr);
        said.stderr
    };
    done(&["in.txt", "truth.csv"]);
    let truth = lines(&bench, "truth.csv");
    assert_eq!(truth.len(), 1000);
    assert_eq!(truth[3], "1.004500001,3,0,0");
    for extension in evpr_events::writers::extensions() {
        let there = format!("there.{extension}");
        let back = format!("{extension}.back.csv");
        let resolution = evpr_events::writers::resolution_ns(there.as_ref()).unwrap();
        let said = done(&["in.txt", &there, "--sensor", "8x10"]);
        assert!(said.contains("1000 events written to"), "{said}");
        assert_eq!(said.contains("rounded down to"), resolution > 1, "{said}");
        done(&[&there, &back]);
        let wants: Vec<String> = truth
            .iter()
            .map(|line| {
                let (time, rest) = line.split_once(',').unwrap();
                let ns: u64 = time.replace('.', "").parse().unwrap();
                let ns = ns / resolution * resolution;
                format!("{}.{:09},{rest}", ns / 1_000_000_000, ns % 1_000_000_000)
            })
            .collect();
        assert_eq!(lines(&bench, &back), wants, "{extension}");
    }
}

#[test]
fn a_piece_of_a_recording_is_cut_out() {
    let bench = Bench::new();
    recording(&bench);
    let mask = bench.file("mask.txt", "# dead\n4,2\n 5 , 2 # hot\n");
    for name in ["in.txt", "in.npy"] {
        let said = bench.run(&[
            "events",
            "convert",
            name,
            "out.csv",
            "--force",
            "--start",
            "150ms",
            "--duration",
            "300ms",
            "--crop",
            "3,1,4,5",
            "--mask",
            text(&mask),
        ]);
        assert_eq!(said.code(), 0, "{}", said.stderr);
        // Events 100 to 299: of the columns 3 to 6 and rows 1 to 5, without the two pixels of the mask.
        let wants: Vec<String> = (100..300u64)
            .map(|i| (i, i % 10, i / 10 % 8))
            .filter(|(_, x, y)| (3..7).contains(x) && (1..6).contains(y) && !(*y == 2 && (4..6).contains(x)))
            .map(|(i, x, y)| {
                let t_ns = 1_000_000_000 + i * 1_500_000 + 1;
                let (s, ns) = (t_ns / 1_000_000_000, t_ns % 1_000_000_000);
                format!("{s}.{ns:09},{},{},{}", x - 3, y - 1, i % 3 / 2)
            })
            .collect();
        assert_eq!(lines(&bench, "out.csv"), wants, "{name}");
        // The second time from a format that can be entered anywhere.
        assert_eq!(
            bench
                .run(&["events", "convert", "in.txt", "in.npy", "--force"])
                .code(),
            0
        );
    }
}

#[test]
fn what_cannot_be_converted_is_said_in_one_line() {
    let bench = Bench::new();
    recording(&bench);
    bench.file("mask.txt", "1,2\n3;4\n");
    bench.file("beyond.txt", "1,2\n9,7\n10,3\n");
    bench.file("there.csv", "older");
    let before = files(&bench);
    for (args, code, wants) in [
        (&["in.txt", "there.csv"][..], 1, "give --force"),
        (&["in.txt", "out.xyz"], 1, "use one of .csv"),
        (&["in.txt", "none/out.csv"], 1, "none/out.csv: cannot be written"),
        (&["none.txt", "out.csv"], 1, "there is no such file"),
        (&["in.txt", "out.csv", "--start", "1h"], 1, "nothing is written"),
        (&["in.txt", "out.csv", "--mask", "mask.txt"], 1, "line 2"),
        (
            &["in.txt", "out.csv", "--mask", "beyond.txt"],
            1,
            "beyond.txt: line 3: pixel 10,3 lies outside the sensor of 8×10",
        ),
        (
            &["in.txt", "out.csv", "--mask", "none"],
            1,
            "none: there is no such file",
        ),
        (
            &["in.txt", "out.csv", "--crop", "5,5,6,1"],
            2,
            "beyond the sensor",
        ),
        (
            &["in.txt", "out.csv", "--crop", "5,5"],
            2,
            "column,row,width,height",
        ),
        (&["in.txt", "out.csv", "--sensor", "8"], 2, "--sensor 8"),
    ] {
        let said = bench.run(&[&["events", "convert"], args].concat());
        assert_eq!(said.code(), code, "{args:?}: {}", said.stderr);
        assert!(said.stderr.contains(wants), "{args:?}: {}", said.stderr);
        assert_eq!(said.errors().len(), 1, "{}", said.stderr);
        assert_eq!(files(&bench), before, "{args:?}");
    }
    assert_eq!(fs::read(bench.path("there.csv")).unwrap(), b"older");
}

#[test]
fn ctrl_c_leaves_nothing_half_written() {
    let bench = Bench::new();
    let rows = 4_000_000u64;
    let header = format!(
        "{{'descr': [('t', '<i8'), ('x', '<u2'), ('y', '<u2'), ('p', '|u1')], 'fortran_order': False, 'shape': \
         ({rows},), }}\n"
    );
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    for i in 0..rows {
        bytes.extend(i.to_le_bytes());
        bytes.extend([0; 5]);
    }
    fs::write(bench.path("in.npy"), bytes).unwrap();
    for out in [
        &["convert", "in.npy", "out.npz"][..],
        &[
            "render", "in.npy", "--sensor", "8x8", "-w", "1ms", "-o", "out.gif",
        ],
        &[
            "reconstruct",
            "in.npy",
            "--sensor",
            "8x8",
            "-m",
            "event_count",
            "-w",
            "1ms",
            "-t",
            "1ms",
            "-o",
            "out.npy",
        ],
    ] {
        let mut child = bench
            .evpr()
            .arg("events")
            .args(out)
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let partial = bench.path(&format!("{}.partial", out.last().unwrap()));
        // It has begun when the partial file is there; signals are listened for before the first event is read.
        while !partial.exists() && child.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        while child.try_wait().unwrap().is_none() && fs::metadata(&partial).is_ok_and(|m| m.len() == 0) {
            std::thread::yield_now();
            if out[0] == "convert" {
                break; // columns wait elsewhere
            }
        }
        kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{out:?}");
        assert_eq!(files(&bench), ["in.npy"], "{out:?}");
    }
}

#[test]
fn frames_become_pictures() {
    let bench = Bench::new();
    recording(&bench);
    for method in ["event_count", "event_count_no_polarity", "time_surface"] {
        let said = bench.run(&[
            "events", "render", "in.txt", "-m", method, "-o", "a.gif", "--force",
        ]);
        assert_eq!(said.code(), 0, "{}", said.stderr);
        let gif = fs::read(bench.path("a.gif")).unwrap();
        assert!(gif.starts_with(b"GIF89a\x0a\x00\x08\x00") && gif.ends_with(b";"));
        // 1.5 s in pictures of 50 ms; the last one would not be whole.
        assert!(
            said.stderr.contains("29 pictures written to a.gif"),
            "{}",
            said.stderr
        );
    }
    let folder = [
        "events", "render", "in.txt", "-w", "20ms", "-t", "100ms", "--frames", "5", "-o", "folder",
    ];
    let said = bench.run(&folder);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    for tick in 0..5 {
        let png = fs::read(bench.path(&format!("folder/{tick:06}.png"))).unwrap();
        assert!(png.starts_with(b"\x89PNG"));
    }
    assert_eq!(fs::read_dir(bench.path("folder")).unwrap().count(), 5);
    let said = bench.run(&folder);
    assert!(said.code() == 1 && said.errors().len() == 1, "{}", said.stderr);
    assert_eq!(files(&bench), ["a.gif", "folder", "in.txt"]);
}

#[test]
fn what_is_read_is_never_written_over() {
    let bench = Bench::new();
    recording(&bench);
    let before = fs::read(bench.path("in.txt")).unwrap();
    fs::write(bench.path("other.csv.partial"), &before).unwrap();
    let refused = |arguments: &[&str], read: &str| {
        let said = bench.run(arguments);
        assert_eq!((said.code(), said.errors().len()), (1, 1), "{arguments:?}");
        assert_eq!(fs::read(bench.path(read)).unwrap(), before, "{arguments:?}");
    };
    let frames = ["-m", "event_count", "-w", "100ms", "-t", "1s", "-o", "in.txt"];
    refused(
        &[&["events", "reconstruct", "in.txt"][..], &frames].concat(),
        "in.txt",
    );
    refused(&["events", "hot-pixels", "in.txt", "-o", "in.txt"], "in.txt");
    refused(
        &["events", "hot-pixels", "in.txt", "-o", "in.txt", "--force"],
        "in.txt",
    );
    refused(
        &["events", "convert", "other.csv.partial", "other.csv"],
        "other.csv.partial",
    );
    let config = bench.ensemble_config();
    let query = bench.recording("query.txt", 4, 2);
    let map = bench.map(&config);
    let before = fs::read(&query).unwrap();
    let run = |out: &str| {
        let options = [
            "run",
            "-c",
            text(&config),
            "-i",
            text(&query),
            "-m",
            text(&map),
            "-o",
            out,
        ];
        let said = bench.run(&options);
        assert_eq!(said.code(), 1, "{out}");
        assert!(said.errors()[0].contains("which is read"), "{out}");
    };
    run(text(&query));
    run(text(&map.join("traverse.json")));
    assert_eq!(fs::read(&query).unwrap(), before);
}

/// The recording with a line more in its middle, behind event 499 at 1.748500001 s.
fn with_line(bench: &Bench, name: &str, line: &str) {
    recording(bench);
    let whole = fs::read_to_string(bench.path("in.txt")).unwrap();
    let mut lines: Vec<&str> = whole.lines().collect();
    lines.insert(501, line);
    bench.file(name, &(lines.join("\n") + "\n"));
}

const RECONSTRUCT: [&str; 6] = ["-m", "event_count", "-w", "100ms", "-t", "100ms"];

#[test]
fn what_was_whole_before_the_damage_is_kept() {
    let bench = Bench::new();
    // Damaged; outside the sensor; earlier than the one before.
    for (line, why) in [
        ("1.75 x 3 1", "line 502"),
        ("1.75 10 3 1", "event 500 (from 0)"),
        ("1.2 1 3 1", "event 500 (from 0)"),
    ] {
        with_line(&bench, "in.txt", line);
        let breaks = |args: &[&str], kept: &str| {
            let said = bench.run(&[&["events"], args].concat());
            assert_eq!((said.code(), said.errors().len()), (1, 1), "{}", said.stderr);
            assert!(
                said.errors()[0].contains(why) && said.errors()[0].ends_with(kept),
                "{}",
                said.stderr
            );
        };
        breaks(
            &["convert", "in.txt", "out.csv", "--force"],
            "the 500 events before that are kept in out.csv",
        );
        assert_eq!(lines(&bench, "out.csv").len(), 500);
        breaks(
            &["convert", "in.txt", "out.raw", "--force", "--start", "300ms"],
            "the 300 events before that are kept in out.raw",
        );
        // Ticks of 100 ms: seven are whole before event 500.
        breaks(
            &[&["reconstruct", "in.txt", "-o", "out.npy"][..], &RECONSTRUCT].concat(),
            "the 7 frames before that are kept in out.npy",
        );
        assert_eq!(fs::metadata(bench.path("out.npy")).unwrap().len(), 128 + 7 * 240);
        breaks(
            &["render", "in.txt", "-w", "100ms", "--force", "-o", "out.gif"],
            "the 7 pictures before that are kept in out.gif",
        );
        assert!(fs::read(bench.path("out.gif")).unwrap().ends_with(b";"));
        // Nothing before it: nothing is written.
        let none = [
            "reconstruct",
            "in.txt",
            "-m",
            "event_count",
            "-w",
            "1s",
            "-t",
            "1s",
        ];
        breaks(
            &[&none[..], &["-o", "none.npy"]].concat(),
            "nothing before that could be written",
        );
        assert_eq!(
            files(&bench),
            ["in.txt", "out.csv", "out.gif", "out.npy", "out.raw"]
        );
        if why == "event 500 (from 0)" && line.starts_with("1.2") {
            continue; // by its time, this one belongs to what comes before
        }
        // What comes behind all that is wanted may be as it likes.
        let before = ["convert", "in.txt", "out.npy", "--force", "--duration", "700ms"];
        let said = bench.run(&[&["events"], &before[..]].concat());
        assert_eq!(said.code(), 0, "{}", said.stderr);
    }
}

#[test]
fn events_that_cannot_be_right_are_left_out_where_that_is_asked_for() {
    let bench = Bench::new();
    for (line, option, what, tally, events) in [
        ("1.75 10 3 1", "--on-outside-sensor", "drop", "outside=1", 1000),
        (
            "1.2 1 3 1",
            "--on-backward-time",
            "drop",
            "backward_dropped=1",
            1000,
        ),
        (
            "1.2 1 3 1",
            "--on-backward-time",
            "clamp",
            "backward_clamped=1",
            1001,
        ),
    ] {
        with_line(&bench, "in.txt", line);
        let said = bench.run(&["events", "convert", "in.txt", "out.csv", "--force", option, what]);
        assert_eq!(said.code(), 0, "{}", said.stderr);
        assert!(said.stderr.contains(tally), "{}", said.stderr);
        let wants = format!("{events} events written to out.csv");
        assert!(said.stderr.contains(&wants), "{}", said.stderr);
        let written = lines(&bench, "out.csv");
        assert_eq!(written.len(), events);
        assert!(written.is_sorted_by_key(|line| line.split_once(',').unwrap().0.to_owned()));
        let frames = [
            &["events", "reconstruct", "in.txt", "-o", "out.npy"][..],
            &RECONSTRUCT,
        ]
        .concat();
        let said = bench.run(&[&frames[..], &[option, what]].concat());
        assert_eq!(said.code(), 0, "{}", said.stderr);
        assert!(said.stderr.contains(tally), "{}", said.stderr);
    }
    let said = bench.run(&[
        "events",
        "convert",
        "in.txt",
        "a.csv",
        "--on-outside-sensor",
        "clamp",
    ]);
    assert_eq!((said.code(), said.errors().len()), (2, 1), "{}", said.stderr);
}

#[test]
fn a_sensor_that_the_recording_contradicts_is_refused_everywhere() {
    let bench = Bench::new();
    recording(&bench);
    let before = files(&bench);
    for command in [
        &["convert", "in.txt", "out.csv"][..],
        &["hot-pixels", "in.txt", "-o", "out.txt"],
        &["render", "in.txt", "-o", "out.gif"],
        &[&["reconstruct", "in.txt", "-o", "out.npy"][..], &RECONSTRUCT].concat(),
    ] {
        let said = bench.run(&[&["events"], command, &["--sensor", "10x8"]].concat());
        assert_eq!((said.code(), said.errors().len()), (1, 1), "{}", said.stderr);
        for size in ["8×10", "10×8"] {
            assert!(said.errors()[0].contains(size), "{}", said.stderr);
        }
        assert_eq!(files(&bench), before);
        let said = bench.run(&[&["events"], command, &["--sensor", "8x10"]].concat());
        assert_eq!(said.code(), 0, "{}", said.stderr);
        fs::remove_file(bench.path(command[command.iter().position(|a| a.starts_with("out.")).unwrap()]))
            .unwrap();
    }
}

#[test]
fn pictures_are_not_written_under_a_name_that_promises_something_else() {
    let bench = Bench::new();
    recording(&bench);
    let said = bench.run(&["events", "render", "in.txt", "-o", "street.mp4"]);
    assert_eq!((said.code(), said.errors().len()), (2, 1), "{}", said.stderr);
    assert!(said.errors()[0].contains(".gif"), "{}", said.stderr);
    assert_eq!(files(&bench), ["in.txt"]);
}
