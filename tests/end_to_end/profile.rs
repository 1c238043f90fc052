//! Seeing inside a run: status, metrics, traces, heartbeats.

use super::support::{Bench, Running, TICKS, assert_ticks, run_args, text};
use serde_json::Value;
use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};

fn status(bench: &Bench) -> Value {
    let said = bench.run(&["status", "--json"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    serde_json::from_str(&said.stdout).unwrap()
}

#[test]
fn status_says_what_every_process_and_member_does_and_costs() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let none = bench.run(&["status"]);
    assert_eq!(none.code(), 1);
    assert!(
        none.stderr.contains("no instance named \"evpr\" is running"),
        "{}",
        none.stderr
    );
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "5"]));
    assert!(running.read_to(100));
    let now = status(&bench);
    assert_eq!(now["state"], "running");
    assert!(now["answers"].as_u64().unwrap() >= 100);
    let services = now["services"].as_array().unwrap();
    let names: Vec<_> = services.iter().map(|s| s["name"].as_str().unwrap()).collect();
    let expected = [
        "ingest",
        "reconstruct/event_count",
        "reconstruct/time_surface",
        "extract/patch_norm",
        "extract/raw_pixels",
        "fuse",
    ];
    assert_eq!(names, expected);
    for s in services {
        assert_eq!(s["state"], "ready", "{s}");
        assert!(s["rss_bytes"].as_u64().unwrap() > 1 << 20, "{s}");
        let pid = s["pid"].as_i64().unwrap();
        assert!(std::path::Path::new(&format!("/proc/{pid}")).exists());
        let kind = s["kind"].as_str().unwrap();
        if kind != "ingest" {
            assert!(s["received"].as_u64().unwrap() > 0, "{s}");
            for part in ["waiting", "processing", "age"] {
                let (all, recent) = (&s[part]["whole"], &s[part]["last_10s"]);
                assert!(all["count"].as_u64() >= recent["count"].as_u64(), "{s}");
                let quantiles = ["p50_us", "p90_us", "p99_us", "p999_us", "max_us"];
                let quantiles = quantiles.map(|q| all[q].as_f64().unwrap());
                assert!(quantiles.is_sorted() && quantiles[0] > 0.0, "{part}: {s}");
            }
        }
        assert!(s["sending"]["whole"]["count"].as_u64().unwrap() > 0, "{s}");
    }
    for part in ["reconstruct", "extract", "fuse", "total"] {
        assert!(
            now["latency"][part]["whole"]["count"].as_u64().unwrap() >= 100,
            "{now}"
        );
    }
    let members = now["members"].as_array().unwrap();
    assert_eq!(members.len(), 8);
    for m in members {
        assert!(m["rows"].as_u64().unwrap() >= 50, "{m}");
        assert!(
            m["reconstruct_ms"].as_f64().unwrap() > 0.0 && m["extract_ms"].as_f64().unwrap() > 0.0,
            "{m}"
        );
    }
    let told = bench.run(&["status"]).stdout;
    for name in expected {
        assert!(told.contains(name), "{told}");
    }
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
}

fn get(address: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: evpr\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    text
}

#[test]
fn metrics_are_served_while_others_connect_and_say_or_read_nothing() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    // A port that is free now.
    let address = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .to_string();
    let args = run_args(&config, &query, &map, &["--pace", "5", "--metrics", &address]);
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(50));
    let silent = TcpStream::connect(&address).unwrap();
    let mut deaf = TcpStream::connect(&address).unwrap();
    write!(deaf, "GET /metrics HTTP/1.1\r\n\r\n").unwrap();
    let reply = get(&address, "/metrics");
    assert!(reply.starts_with("HTTP/1.1 200 OK\r\n"), "{reply}");
    let body = reply.split_once("\r\n\r\n").unwrap().1;
    for line in body.lines().filter(|l| !l.starts_with('#')) {
        let (name, value) = line.rsplit_once(' ').unwrap();
        assert!(name.starts_with("evpr_"), "{line}");
        assert!(value.parse::<f64>().is_ok(), "{line}");
    }
    let received = "evpr_messages_total{process=\"fuse\",what=\"received\"} ";
    let line = body.lines().find_map(|l| l.strip_prefix(received)).unwrap();
    assert!(line.parse::<u64>().unwrap() >= 50 * 8, "{line}");
    assert!(body.contains("evpr_latency_seconds{stage=\"total\",quantile=\"0.99\"} "));
    assert!(get(&address, "/").starts_with("HTTP/1.1 404"));
    // The port is taken: a second instance says so, and starts nothing.
    let more = ["--name", "other", "--metrics", &address];
    let said = bench.run(&run_args(&config, &query, &map, &more));
    assert_eq!(said.code(), 1);
    assert_eq!(said.errors().len(), 1, "{}", said.stderr);
    assert!(
        said.stderr.contains("cannot listen for metrics at"),
        "{}",
        said.stderr
    );
    // And so is the name.
    let said = bench.run(&run_args(&config, &query, &map, &[]));
    assert_eq!(said.code(), 1);
    assert!(said.stderr.contains("is running already"), "{}", said.stderr);
    let (answers, said) = running.finish();
    drop((silent, deaf));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

/// How much of `from..to` these stretches cover.
fn covered(mut stretches: Vec<(f64, f64)>, from: f64, to: f64) -> f64 {
    stretches.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut at, mut sum) = (from, 0.0);
    for (start, end) in stretches {
        let (start, end) = (start.max(at), end.min(to));
        if end > start {
            sum += end - start;
            at = end;
        }
    }
    sum
}

#[test]
fn a_trace_accounts_for_the_time_from_the_closing_of_windows_to_the_answers() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let trace = bench.path("trace.json");
    let args = run_args(&config, &query, &map, &["--pace", "10", "--trace", text(&trace)]);
    let mut running = Running::start(&bench, &args);
    // A second listener, in the middle of it.
    assert!(running.read_to(50));
    let second = bench.path("second.json");
    let said = bench.run(&["trace", "-o", text(&second), "-d", "1s"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    let read = |path| -> Value { serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap() };
    let has_rows = |trace: &Value| {
        let events = trace["traceEvents"].as_array().unwrap();
        events.iter().any(|e| {
            e["name"]
                .as_str()
                .is_some_and(|n| n.starts_with("row event_count@50ms"))
        })
    };
    assert!(has_rows(&read(&second)));
    let trace = read(&trace);
    assert!(has_rows(&trace));
    let events = trace["traceEvents"].as_array().unwrap();
    let tracks: Vec<_> = events.iter().filter(|e| e["name"] == "thread_name").collect();
    assert_eq!(tracks.len(), 6, "one track per process");

    let number = |e: &Value, key: &str| e[key].as_f64().unwrap();
    let mut stretches: HashMap<u64, Vec<(f64, f64)>> = HashMap::new();
    let mut closed: HashMap<u64, f64> = HashMap::new();
    let mut answered: HashMap<u64, f64> = HashMap::new();
    let mut waiting: HashMap<u64, f64> = HashMap::new();
    let (mut begun, mut ended) = (0, 0);
    for e in events {
        let tick = || e["args"]["tick"].as_u64().unwrap();
        match e["ph"].as_str().unwrap() {
            "X" => {
                let (start, end) = (number(e, "ts"), number(e, "ts") + number(e, "dur"));
                stretches.entry(tick()).or_default().push((start, end));
                if e["name"] == "answer" {
                    answered.insert(tick(), end);
                }
                if e["name"] == "closing chunk" {
                    let at = number(&e["args"], "window_closed_us");
                    let latest = closed.entry(tick()).or_insert(at);
                    *latest = latest.max(at);
                }
            }
            "b" => {
                waiting.insert(e["id"].as_u64().unwrap(), number(e, "ts"));
            }
            "e" => {
                let start = waiting[&e["id"].as_u64().unwrap()];
                stretches
                    .entry(tick())
                    .or_default()
                    .push((start, number(e, "ts")));
            }
            "s" => begun += 1,
            "f" => ended += 1,
            _ => {}
        }
    }
    assert_eq!(answered.len() as u64, TICKS, "an answer per tick");
    assert!(begun >= TICKS * 8, "an arrow per tick and member");
    assert_eq!(ended, TICKS * 8, "an arrow per tick and member");
    // Of a tick in the middle: while other programs have the processor nobody accounts for anything.
    let all: f64 = (0..TICKS).map(|tick| answered[&tick] - closed[&tick]).sum();
    let mut shares: Vec<f64> = (0..TICKS)
        .map(|tick| {
            let (from, to) = (closed[&tick], answered[&tick]);
            covered(stretches.remove(&tick).unwrap(), from, to) / (to - from)
        })
        .collect();
    shares.sort_by(f64::total_cmp);
    let share = shares[shares.len() / 2];
    println!("{:.2} % of a tick's time is accounted for", 100.0 * share);
    assert!(
        share >= 0.95,
        "{:.2} % of a tick's time is accounted for",
        100.0 * share
    );
    let said = answers
        .iter()
        .map(|a| a["latency_us"]["total"].as_f64().unwrap())
        .sum::<f64>();
    assert!(
        (all - said).abs() <= 0.05 * said,
        "{all} µs against {said} µs that the answers say"
    );
}

#[test]
fn while_one_process_is_stopped_the_others_say_whom_they_wait_for() {
    let bench = Bench::new();
    let patient =
        std::fs::read_to_string(bench.ensemble_config()).unwrap() + "[supervision]\nhang = \"1h\"\n";
    let config = bench.file("ensemble.toml", &patient);
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "10"]));
    assert!(running.read_to(5));
    let extract = running.services("extract")[0];
    Running::signal(extract, nix::sys::signal::Signal::SIGSTOP);
    let doing = |now: &Value, name: &str| {
        let mut services = now["services"].as_array().unwrap().iter();
        services.find(|s| s["name"] == name).unwrap()["doing"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    // Everybody upstream soon waits for room, and fuse for rows.
    loop {
        let now = status(&bench);
        if (
            doing(&now, "reconstruct/event_count").as_str(),
            doing(&now, "fuse").as_str(),
        ) == ("blocked", "waiting")
        {
            break;
        }
    }
    Running::signal(extract, nix::sys::signal::Signal::SIGCONT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    assert!(!said.stderr.contains("is killed"), "{}", said.stderr);
}

#[test]
fn a_process_that_computes_for_long_is_let_be() {
    let bench = Bench::new();
    let config = bench.file(
        "small.toml",
        "[sensor]\nheight = 48\nwidth = 64\n[slicing]\ntick = \"100ms\"\nwindows = [\"100ms\"]\norigin = 0\n\
         [[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n",
    );
    let map = bench.map(&config);
    let query = bench.recording("query.txt", 1, 2);
    bench.delay("extract/patch_norm", 7_000);
    let args = ["run", "-c", text(&config), "-i", text(&query), "-m", text(&map)];
    let (answers, said) = Running::start(&bench, &args).finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, 1);
    assert!(
        answers[0]["latency_us"]["extract"].as_f64().unwrap() > 6e6,
        "{}",
        answers[0]
    );
    assert!(!said.stderr.contains("is killed"), "{}", said.stderr);
}
