//! Live sources through the whole graph: standard input, and peers over TCP that come, go and flood.

use super::support::{Bench, Running, TICKS, assert_ticks, finish, read_answers, reasons, text, timeless};
use evpr_events::writers::{WriteOptions, create};
use evpr_events::{RawEvent, ReadOptions};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::fs;
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::JoinHandle;

/// Length of a tick of the synthetic recording, ns.
const TICK_NS: u64 = 100_000_000;
/// Members of the synthetic ensemble, half of them with windows of half a tick.
const MEMBERS: usize = 8;
/// What an answer says of members while the camera is away.
const AWAY: &str = "the camera was disconnected";
const AWAY_INGEST: &str = "lost on the way";

/// The configuration of the synthetic ensemble, with another source. No window closes by the host's clock in these tests
/// unless they ask for it, so that what is answered does not hang on how busy the machine is.
pub(super) fn config(bench: &Bench, source: &str) -> PathBuf {
    let file = bench.ensemble_config();
    let written = fs::read_to_string(&file).unwrap();
    let text = written.replace("[source]\n", &format!("[source]\n{source}"));
    assert_ne!(text, written);
    bench.file("live.toml", &text)
}

pub(super) fn events(recording: &Path) -> Vec<RawEvent> {
    let mut all = Vec::new();
    let mut batch = Vec::new();
    let mut recording = evpr_events::open(recording, &ReadOptions::default()).unwrap();
    while recording.next_batch(&mut batch).unwrap() {
        all.extend_from_slice(&batch);
    }
    all
}

/// Those of these ticks.
pub(super) fn of_ticks(events: &[RawEvent], ticks: std::ops::Range<u64>) -> &[RawEvent] {
    let at = |tick: u64| events.partition_point(|e| e.t_ns < tick * TICK_NS);
    &events[at(ticks.start)..at(ticks.end)]
}

/// As text, in µs.
pub(super) fn as_text(events: &[RawEvent]) -> Vec<u8> {
    let line = |e: &RawEvent| format!("{} {} {} {}\n", e.t_ns / 1_000, e.x, e.y, u8::from(e.on));
    events.iter().map(line).collect::<String>().into_bytes()
}

/// As bare words of EVT 3.0: every event with its whole time, row and column.
fn as_evt3(events: &[RawEvent]) -> Vec<u8> {
    let word = |kind: u16, value: u64| (kind << 12 | (value & 0xfff) as u16).to_le_bytes();
    let words = |e: &RawEvent| {
        let us = e.t_ns / 1_000;
        let x = u64::from(e.x) | u64::from(e.on) << 11;
        [
            word(8, us >> 12),
            word(6, us),
            word(0, u64::from(e.y)),
            word(2, x),
        ]
    };
    events.iter().flat_map(words).flatten().collect()
}

/// As DV software serves it: AEDAT4 without the first line and without the table of files.
fn as_aedat4(bench: &Bench, events: &[RawEvent]) -> Vec<u8> {
    const FIRST_LINE: usize = 14;
    const TABLE_AT: usize = FIRST_LINE + 40;
    let path = bench.path("served.aedat4");
    let sensor = Some(evpr_core::plan::Sensor {
        height: 48,
        width: 64,
    });
    let mut writer = create(&path, &WriteOptions { sensor }).unwrap();
    writer.write(events).unwrap();
    writer.finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    let table = u64::from_le_bytes(bytes[TABLE_AT..TABLE_AT + 8].try_into().unwrap()) as usize;
    bytes[FIRST_LINE..table].to_vec()
}

/// The answers to a recording as a file.
fn answers_of_file(bench: &Bench, recording: &Path) -> Vec<Value> {
    let config = bench.ensemble_config();
    let out = bench.path("file.jsonl");
    let map = bench.path("map");
    let said = bench.run(&[
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(recording),
        "-m",
        text(&map),
        "-o",
        text(&out),
    ]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    read_answers(&out)
}

fn start(bench: &Bench, source: &str, delivery: &str, stdin: Stdio) -> Running {
    let config = config(bench, source);
    let map = bench.path("map");
    Running::start_with(
        bench,
        &[
            "run",
            "-q",
            "-c",
            text(&config),
            "-m",
            text(&map),
            "--delivery",
            delivery,
        ],
        stdin,
    )
}

/// A server at an address of its own.
pub(super) fn serve() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    (listener, format!("address = \"{address}\"\nslack = \"10s\"\n"))
}

/// Waits for the next connection and sends it these bytes; the connection then stays until it is dropped.
pub(super) fn send_next(listener: &TcpListener, bytes: &[u8]) -> TcpStream {
    let (mut peer, _) = listener.accept().unwrap();
    peer.write_all(bytes).unwrap();
    peer
}

/// Writes in a thread of its own, and then closes.
fn write_all(mut to: impl Write + Send + 'static, bytes: Vec<u8>) -> JoinHandle<bool> {
    std::thread::spawn(move || to.write_all(&bytes).is_ok())
}

fn missing(answer: &Value) -> Vec<&str> {
    let missing = answer["missing"].as_object().unwrap();
    missing.values().map(|reason| reason.as_str().unwrap()).collect()
}

/// Stops it by Ctrl-C and gives its answers.
fn interrupt(running: Running) -> Vec<Value> {
    Running::signal(running.pid(), Signal::SIGINT);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 130, "{}", said.stderr);
    assert_ticks(&answers, answers.len() as u64);
    answers
}

#[test]
fn a_pipe_on_standard_input_gives_the_answers_of_the_file() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 200, 2);
    let expected = answers_of_file(&bench, &recording);
    let events = events(&recording);
    for (format, bytes) in [
        ("auto", fs::read(&recording).unwrap()),
        ("evt3", as_evt3(&events)),
    ] {
        let source = format!("kind = \"stdin\"\nformat = \"{format}\"\n");
        let mut running = start(&bench, &source, "lossless", Stdio::piped());
        let writer = write_all(running.stdin.take().unwrap(), bytes);
        let (answers, said) = running.finish();
        assert_eq!((said.code(), said.stderr.as_str()), (0, ""), "{format}");
        assert!(writer.join().unwrap());
        assert_eq!(answers.len(), expected.len());
        for (a, b) in answers.iter().zip(&expected) {
            assert_eq!(timeless(a), timeless(b), "{format}");
        }
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn the_unit_of_times_that_is_guessed_is_said_once() {
    let bench = Bench::new();
    let recording = bench.recording("query.txt", 5, 2);
    let config = config(&bench, "kind = \"stdin\"\n");
    for (delivery, out) in [("lossless", "a"), ("latest", "b")] {
        let args = ["run", "-c", text(&config), "-r", out, "--delivery", delivery];
        let mut running = Running::start_with(&bench, &args, Stdio::piped());
        let bytes = as_text(&events(&recording));
        let writer = write_all(running.stdin.take().unwrap(), bytes);
        let (_, said) = running.finish();
        assert!(writer.join().unwrap());
        assert_eq!(said.code(), 0, "{}", said.stderr);
        let unit = "time_unit=\"us\" time_unit_from=\"magnitude\"";
        assert_eq!(said.stderr.matches(unit).count(), 1, "{}", said.stderr);
    }
}

#[test]
fn a_pipe_that_stays_open_is_answered_as_it_comes_and_quiet_windows_close() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 10, 2);
    let bytes = fs::read(&recording).unwrap();
    let mut running = start(&bench, "kind = \"stdin\"\n", "latest", Stdio::piped());
    let mut pipe = running.stdin.take().unwrap();
    pipe.write_all(&bytes).unwrap();
    pipe.flush().unwrap();
    // The recording ends in tick 10; nothing but the clock closes the ones after.
    assert!(running.read_to(20));
    let answers = interrupt(running);
    assert!(reasons(&answers[11..]).contains_key("empty window"));
    drop(pipe);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn ctrl_c_ends_the_wait_for_a_pipe_and_for_a_connection() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    for delivery in ["lossless", "latest"] {
        let mut running = start(&bench, "kind = \"stdin\"\n", delivery, Stdio::piped());
        let pipe = running.stdin.take();
        while running.services("ingest").is_empty() {
            std::thread::yield_now();
        }
        assert_eq!(interrupt(running).len(), 0);
        drop(pipe);
    }
    let source = "kind = \"tcp\"\naddress = \"127.0.0.1:1\"\n";
    let running = start(&bench, source, "latest", Stdio::null());
    assert!(running.logs("127.0.0.1:1: cannot connect"));
    assert_eq!(interrupt(running).len(), 0);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_peer_that_speaks_aedat4_drives_the_graph() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 60, 2);
    let expected = answers_of_file(&bench, &recording);
    let bytes = as_aedat4(&bench, &events(&recording));
    let (listener, address) = serve();
    let source = format!("kind = \"aedat4_tcp\"\n{address}");
    let mut running = start(&bench, &source, "lossless", Stdio::null());
    let peer = send_next(&listener, &bytes);
    assert!(running.read_to(59));
    let answers = interrupt(running);
    drop(peer);
    for (a, b) in answers.iter().zip(&expected) {
        assert_eq!(timeless(a), timeless(b));
    }
    assert_eq!(answers.len(), 60);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn dv_processing_drives_the_graph() {
    const SCRIPT: &str = "
import sys, time
import dv_processing as dv
writer = dv.io.NetworkWriter('127.0.0.1', int(sys.argv[2]), dv.io.Stream.EventStream(0, 'events', 'camera', (64, 48)))
print('serves', flush=True)
sys.stdin.readline()
store = dv.EventStore()
for line in open(sys.argv[1]):
    t, x, y, p = line.split()
    store.push_back(int(t), int(x), int(y), p == '1')
writer.writeEvents(store)
sys.stdin.readline()
";
    let python = std::env::var("EVPR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let imports = Command::new(&python)
        .args(["-c", "import dv_processing"])
        .output();
    if !imports.is_ok_and(|out| out.status.success()) {
        println!("skipped: dv_processing_drives_the_graph: {python} cannot import dv_processing");
        return;
    }
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 30, 2);
    let expected = answers_of_file(&bench, &recording);
    let events = events(&recording);
    let served = bench.path("served.txt");
    fs::write(&served, as_text(&events)).unwrap();
    let (listener, address) = serve();
    let port = listener.local_addr().unwrap().port();
    drop(listener);
    let mut peer = Command::new(&python)
        .args(["-c", SCRIPT, text(&served), &port.to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let mut said = std::io::BufReader::new(peer.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut said, &mut line).unwrap();
    assert_eq!(line, "serves\n");
    let source = format!("kind = \"aedat4_tcp\"\n{address}");
    let config = config(&bench, &source);
    let map = bench.path("map");
    let args = [
        "run",
        "-c",
        text(&config),
        "-m",
        text(&map),
        "--delivery",
        "lossless",
    ];
    let mut running = Running::start(&bench, &args);
    assert!(running.logs("connected"));
    let mut to_peer = peer.stdin.take().unwrap();
    to_peer.write_all(b"\n").unwrap();
    assert!(running.read_to(29));
    let answers = interrupt(running);
    drop(to_peer);
    peer.wait().unwrap();
    for (a, b) in answers.iter().zip(&expected) {
        assert_eq!(timeless(a), timeless(b));
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn unplugging_costs_only_the_ticks_in_between_which_are_named() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 60, 2);
    let expected = answers_of_file(&bench, &recording);
    let events = events(&recording);
    let (listener, address) = serve();
    let source = format!("kind = \"tcp\"\n{address}");
    let mut running = start(&bench, &source, "lossless", Stdio::null());
    let peer = send_next(&listener, &as_text(of_ticks(&events, 0..21)));
    assert!(running.read_to(19));
    drop(peer);
    let peer = send_next(&listener, &as_text(of_ticks(&events, 25..61)));
    assert!(running.read_to(59));
    let answers = interrupt(running);
    drop(peer);
    for (tick, answer) in answers.iter().enumerate() {
        match tick {
            // Of the tick that it went in, only the first half is known to be whole.
            20 => assert_eq!(missing(answer), vec![AWAY; MEMBERS / 2]),
            // The one that it came back in is not whole.
            21..26 => assert_eq!(missing(answer), vec![AWAY; MEMBERS], "tick {tick}"),
            _ => assert_eq!(missing(answer), Vec::<&str>::new(), "tick {tick}"),
        }
        // Where no missing tick is within the sequence of 5.
        if !(20..30).contains(&tick) {
            assert_eq!(timeless(answer), timeless(&expected[tick]));
        }
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_server_that_comes_later_is_connected_to_later() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 20, 2);
    let (listener, address) = serve();
    let at = listener.local_addr().unwrap();
    drop(listener);
    let mut running = start(
        &bench,
        &format!("kind = \"tcp\"\n{address}"),
        "lossless",
        Stdio::null(),
    );
    assert!(running.logs("cannot connect"));
    let listener = TcpListener::bind(at).unwrap();
    let peer = send_next(&listener, &as_text(&events(&recording)));
    assert!(running.read_to(19));
    let answers = interrupt(running);
    drop(peer);
    assert!(reasons(&answers).is_empty());
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn ingest_that_died_goes_on_with_the_ticks_of_the_one_before() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", 60, 2);
    let expected = answers_of_file(&bench, &recording);
    let events = events(&recording);
    let (listener, address) = serve();
    let mut running = start(
        &bench,
        &format!("kind = \"tcp\"\n{address}"),
        "lossless",
        Stdio::null(),
    );
    let peer = send_next(&listener, &as_text(of_ticks(&events, 0..3)));
    assert!(running.read_to(1));
    for pid in running.services("ingest") {
        Running::signal(pid, Signal::SIGKILL);
    }
    let again = send_next(&listener, &as_text(of_ticks(&events, 12..61)));
    assert!(running.read_to(59));
    let answers = interrupt(running);
    drop((peer, again));
    // One grid: the ticks in between are missing, and the sensor times of the others are those of the recording.
    for (tick, answer) in answers.iter().enumerate().take(12).skip(3) {
        assert_eq!(missing(answer), vec![AWAY_INGEST; MEMBERS], "tick {tick}");
    }
    for (a, b) in answers.iter().zip(&expected) {
        assert_eq!((&a["start_us"], &a["end_us"]), (&b["start_us"], &b["end_us"]));
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_flood_drops_whole_ticks_and_never_stalls_the_peer() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let recording = bench.recording("query.txt", TICKS, 2);
    let bytes = as_text(&events(&recording));
    let (listener, address) = serve();
    let mut running = start(
        &bench,
        &format!("kind = \"tcp\"\n{address}"),
        "latest",
        Stdio::null(),
    );
    let peer = send_next(&listener, &bytes);
    assert!(running.read_to(TICKS - 1));
    let answers = interrupt(running);
    drop(peer);
    let missing = reasons(&answers);
    assert!(!missing.is_empty(), "30 s in an instant, and nothing was dropped");
    let known = ["late", "dropped", "incomplete", "lost"];
    assert!(
        missing.keys().all(|r| known.iter().any(|k| r.starts_with(k))),
        "{missing:?}"
    );
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn standard_input_that_is_no_recording_says_so() {
    let bench = Bench::new();
    bench.map(&bench.ensemble_config());
    let config = config(&bench, "kind = \"stdin\"\n");
    let map = bench.path("map");
    // `finish` gives it nothing at all to read.
    let said = finish(
        bench
            .evpr()
            .args(["run", "-q", "-c", text(&config), "-m", text(&map)]),
    );
    assert_eq!(said.code(), 1);
    assert_eq!(
        said.errors(),
        ["error: standard input: is empty (0 bytes); it holds no events"]
    );
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}
