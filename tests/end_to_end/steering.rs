//! Settings changed while the graph runs, what members cost that are off, and the latency governor.

use super::members::{assert_as_offline, plan, switch};
use super::support::{Bench, Running, TICKS, assert_ticks, run_args, text};
use evpr_core::message::FuseSettings;
use evpr_core::plan::Rule;
use nix::sys::signal::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::time::Instant;

fn set(bench: &Bench, args: &[&str]) -> u64 {
    let said = bench.run(&[&["set", "--json"], args].concat());
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let reply: Value = serde_json::from_str(&said.stdout).unwrap();
    reply["from_tick"]
        .as_u64()
        .unwrap_or_else(|| panic!("no tick in {reply}"))
}

#[test]
fn settings_change_at_the_tick_that_is_named_and_leave_one_line_each() {
    let bench = Bench::new();
    let config = std::fs::read_to_string(bench.ensemble_config()).unwrap();
    let config = config.replace("[fuse]\n", "[fuse]\nmin_confidence = 0.02\n");
    let config = bench.file("confident.toml", &config);
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let recorded = bench.path("recorded");
    assert_eq!(bench.record(&config, &query, &recorded).code(), 0);
    let plan = plan(&bench, &config, &query, &map);
    // Without -q, as the lines of the audit log are no warnings.
    let args = [
        "run",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        text(&map),
        "--pace",
        "4",
    ];
    let mut running = Running::start(&bench, &args);
    let mut changes = Vec::new();
    let mut settings = FuseSettings::default();
    for (after, what) in [
        (10, "length 12"),
        (60, "rule median"),
        (110, "length 1"),
        (160, "length 7"),
        (190, "min_confidence 0.4"),
        (230, "min_confidence 0"),
    ] {
        assert!(running.read_to(after));
        let (name, value) = what.split_once(' ').unwrap();
        match name {
            "length" => settings.length = value.parse().unwrap(),
            "min_confidence" => {
                (settings.min_confidence, settings.sets_min_confidence) = (value.parse().unwrap(), 1);
            }
            _ => settings.rule = Rule::Median.code(),
        }
        changes.push((set(&bench, &[name, value]), settings));
    }
    let refused = |args: &[&str], words: &str, code: i32| {
        let said = bench.run(args);
        assert_eq!(said.code(), code, "{args:?}: {}", said.stderr);
        assert_eq!(
            said.stderr.lines().filter(|l| l.starts_with("error: ")).count(),
            1,
            "{}",
            said.stderr
        );
        assert!(said.stderr.contains(words), "{}", said.stderr);
    };
    refused(&["set", "rule", "best"], "there is no rule \"best\"", 1);
    refused(&["set", "length", "0"], "0 is not in 1..=1000", 2);
    refused(
        &["set", "deadline", "300ms"],
        "lossless delivery has no deadline",
        1,
    );
    refused(&["set", "min-confidence", "1.5"], "1.5 is not a confidence", 1);
    refused(
        &["set", "--name", "nobody", "length", "3"],
        "no instance named \"nobody\"",
        1,
    );
    refused(
        &["member", "disable", "nobody@50ms/patch_norm"],
        "there is no member",
        1,
    );
    let status: Value = serde_json::from_str(&bench.run(&["status", "--json"]).stdout).unwrap();
    assert_eq!(
        (&status["fuse"]["length"], &status["fuse"]["rule"]),
        (&7.into(), &"median".into())
    );
    assert_eq!(status["fuse"]["min_confidence"], 0.0);
    assert_eq!(status["changes"].as_array().unwrap().len(), changes.len());
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    let everyone = |_| (0..plan.members.len()).collect();
    assert_as_offline(&plan, &recorded, &answers, &everyone, |tick| {
        let now = changes.iter().rfind(|(from, _)| *from <= tick);
        now.map(|(_, settings)| *settings).unwrap_or_default()
    });
    let null = |from: u64, to: u64| {
        let answers = &answers[from as usize..to as usize];
        answers.iter().filter(|a| a["reason"] == "low confidence").count()
    };
    let (raised, lowered) = (changes[4].0, changes[5].0);
    assert!(null(raised, lowered) > 0, "0.4 is more than some answers have");
    assert_eq!(null(lowered, TICKS), 0, "any confidence will do");
    let uid = nix::unistd::getuid();
    for ((from, _), what) in changes.iter().zip([
        "length 12",
        "rule median",
        "length 1",
        "length 7",
        "min_confidence 0.4",
        "min_confidence 0",
    ]) {
        let audit = said.stderr.lines().filter(|l| {
            l.contains(&format!("uid {uid} pid ")) && l.contains(&format!(": {what} from tick {from} on"))
        });
        assert_eq!(audit.count(), 1, "{what} from tick {from}: {}", said.stderr);
    }
}

#[test]
fn a_client_that_says_or_reads_nothing_keeps_nobody_waiting() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "6"]));
    assert!(running.read_to(5));
    let connect = || UnixStream::connect(bench.control_socket()).unwrap();
    let silent: Vec<_> = (0..4).map(|_| connect()).collect();
    let mut deaf = connect();
    deaf.write_all(b"{\"ask\":\"status\"}\n").unwrap();
    let mut babbling = connect();
    babbling.write_all(b"hello\n").unwrap();
    let mut line = String::new();
    BufReader::new(&babbling).read_line(&mut line).unwrap();
    assert!(line.contains("cannot understand the request"), "{line}");
    let list = bench.run(&["member", "list"]);
    assert_eq!(list.stdout.lines().count(), 9, "{}", list.stderr);
    let (answers, said) = running.finish();
    drop((silent, deaf));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
}

/// Processor time of a process so far, s.
fn cpu_s(pid: i32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let words = stat.rsplit_once(") ").unwrap().1.split(' ');
    words
        .skip(11)
        .take(2)
        .map(|w| w.parse::<f64>().unwrap())
        .sum::<f64>()
        / 100.0
}

#[test]
fn stages_that_no_member_needs_do_nothing_and_take_no_time() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "1"]));
    assert!(running.read_to(3));
    let counts = || {
        let status: Value = serde_json::from_str(&bench.run(&["status", "--json"]).stdout).unwrap();
        let services = status["services"].as_array().unwrap();
        let of = |s: &Value| {
            let number = |key: &str| s[key].as_u64().unwrap();
            (
                s["name"].as_str().unwrap().to_owned(),
                number("pid") as i32,
                number("events"),
                number("emitted"),
            )
        };
        services.iter().map(of).collect::<Vec<_>>()
    };
    // Nobody needs the time surface or raw pixels; ingest still has to read and to tell the time.
    for member in [
        "time_surface@50ms/patch_norm",
        "time_surface@100ms/patch_norm",
        "time_surface@50ms/raw_pixels",
        "time_surface@100ms/raw_pixels",
        "event_count@50ms/raw_pixels",
        "event_count@100ms/raw_pixels",
    ] {
        switch(&bench, "disable", member);
    }
    let last = running.answers.last().unwrap()["tick"].as_u64().unwrap();
    // Until the last change is in force everywhere and the stats have been sent.
    assert!(running.read_to(last + 30));
    let (before, began) = (counts(), Instant::now());
    let used: Vec<f64> = before.iter().map(|(_, pid, ..)| cpu_s(*pid)).collect();
    let now = running.answers.last().unwrap()["tick"].as_u64().unwrap();
    assert!(running.read_to(now + 50));
    let (after, wall_s) = (counts(), began.elapsed().as_secs_f64());
    let mut idle = 0;
    for (((name, pid, events, emitted), used), (_, _, later, sent)) in before.iter().zip(used).zip(&after) {
        let percent = 100.0 * (cpu_s(*pid) - used) / wall_s;
        println!(
            "{name}: {percent:.2} % of a core, {} events, {} messages",
            later - events,
            sent - emitted
        );
        if name == "reconstruct/time_surface" || name == "extract/raw_pixels" {
            idle += 1;
            assert_eq!((later, sent), (events, emitted), "{name}");
            assert!(percent < 2.0, "{name}: {percent} %");
        }
    }
    assert_eq!(idle, 2);
    // And with all of them off, no event leaves ingest.
    let off = switch(&bench, "disable", "all");
    assert!(running.read_to(off + 5));
    let before = counts();
    assert!(running.read_to(off + 25));
    let after = counts();
    assert_eq!((before[0].2, before[0].3), (after[0].2, after[0].3), "{after:?}");
    Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
}

#[test]
fn the_governor_sheds_what_is_slow_and_takes_it_back() {
    const BUDGET_MS: f64 = 150.0;
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let governed = std::fs::read_to_string(&config).unwrap() + "[governor]\nbudget = \"150ms\"\nhold = 12\n";
    let governed = bench.file("governed.toml", &governed);
    bench.delay("extract/raw_pixels", 0);
    // Ticks of half a second.
    let args = [
        "run",
        "-c",
        text(&governed),
        "-i",
        text(&query),
        "-m",
        text(&map),
        "--pace",
        "0.2",
    ];
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(5));
    assert_eq!(
        running.answers.last().unwrap()["members"]
            .as_array()
            .unwrap()
            .len(),
        8
    );
    bench.delay("extract/raw_pixels", 110);
    let ms = |answer: &Value| answer["latency_us"]["total"].as_f64().unwrap() / 1e3;
    let mut slow = 6;
    loop {
        assert!(running.read_to(slow));
        if ms(&running.answers[slow as usize]) > BUDGET_MS {
            break;
        }
        slow += 1;
        assert!(slow < 20, "raw pixels are slow, and answers should be late");
    }
    // A few ticks are late until enough is shed, and one more where the machine is busy with something else.
    assert!(running.read_to(slow + 14));
    let late: Vec<u64> = (slow..=slow + 14)
        .filter(|t| ms(&running.answers[*t as usize]) > BUDGET_MS)
        .collect();
    println!("late: {late:?}");
    assert!(late.iter().filter(|t| **t >= slow + 6).count() <= 1, "{late:?}");
    let status: Value = serde_json::from_str(&bench.run(&["status", "--json"]).stdout).unwrap();
    let shed = status["governor"]["shed"].as_array().unwrap();
    assert!(!shed.is_empty(), "{status}");
    for member in shed {
        assert!(
            member.as_str().unwrap().ends_with("/raw_pixels"),
            "{member}: the slow ones cost most"
        );
    }
    bench.delay("extract/raw_pixels", 0);
    let mut back = slow + 15;
    loop {
        assert!(running.read_to(back));
        if running.answers[back as usize]["members"]
            .as_array()
            .unwrap()
            .len()
            == 8
        {
            break;
        }
        back += 1;
        assert!(back < slow + 150, "they are taken back once they are quick");
    }
    println!("all back at tick {back}, {} ticks after", back - slow - 15);
    Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
    assert!(said.stderr.contains("governor: p95 "), "{}", said.stderr);
    assert!(
        said.stderr.contains("took time_surface") || said.stderr.contains("took event_count"),
        "{}",
        said.stderr
    );
}

#[test]
fn a_new_deadline_holds_from_the_tick_that_is_named() {
    const LONG_MS: f64 = 1_500.0;
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    // Raw pixels never come in time.
    bench.delay("extract/raw_pixels", 3_600_000);
    let more = ["--pace", "1", "--delivery", "latest"];
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &more));
    assert!(running.read_to(5));
    let from = set(&bench, &["deadline", "1500ms"]);
    assert!(running.read_to(from + 5));
    let back = set(&bench, &["deadline", "50ms"]);
    assert!(running.read_to(back + 3));
    let status: Value = serde_json::from_str(&bench.run(&["status", "--json"]).stdout).unwrap();
    assert_eq!(status["fuse"]["deadline_ms"], 50.0);
    Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
    let total_ms = |tick: u64| {
        let answer = &answers[tick as usize];
        assert!(!answer["missing"].as_object().unwrap().is_empty(), "{answer}");
        answer["latency_us"]["total"].as_f64().unwrap() / 1e3
    };
    assert!(
        (0..from).any(|tick| total_ms(tick) < LONG_MS),
        "300 ms, as configured"
    );
    for tick in from..back {
        assert!(total_ms(tick) >= LONG_MS, "tick {tick}: {} ms", total_ms(tick));
    }
}
