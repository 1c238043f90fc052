//! `evpr dataset`: presets, and what is there of a dataset.

use super::support::{Bench, Said, text};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

const SUNSET1: &str = "dvs_vpr_2020-04-21-17-03-03";
const SUNSET2: &str = "dvs_vpr_2020-04-22-17-24-21";
const SUNSET1_GPS: &str = "20200421_170039-sunset1_concat.nmea";
const SUNSET2_GPS: &str = "20200422_172431-sunset2_concat.nmea";

/// A recording of Brisbane's sensor: 5 s of the dot that walks, from `first_s` on.
fn recording(bench: &Bench, to: &str, first_s: u64, sensor: &str) {
    let (width, height) = sensor.split_once(' ').unwrap();
    let mut lines = format!("{width} {height}\n");
    for i in 0..5_000u64 {
        let (s, us) = (first_s + i / 1000, i % 1000 * 1000);
        writeln!(lines, "{s}.{us:06} {} {} {}", i / 50 % 100, i % 37, i % 2).unwrap();
    }
    bench.file("made.txt", &lines);
    let said = bench.run(&["events", "convert", "made.txt", to, "--force"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
}

/// GPS of a drive in Brisbane, one sentence a second, along a circle of 300 m that is closed after 100 s.
fn gps(start: (u64, u64, u64)) -> String {
    let mut lines = String::new();
    let first = start.0 * 3600 + start.1 * 60 + start.2;
    for i in 0..120u64 {
        let t = first + i;
        let angle = i as f64 / 100.0 * std::f64::consts::TAU;
        // Minutes of latitude and longitude; a minute of latitude is 1852 m.
        let (lat, lon) = (28.0 + 0.16 * angle.cos(), 0.5 + 0.18 * angle.sin());
        let body = format!(
            "GPRMC,{:02}{:02}{:02}.00,A,27{lat:07.4},S,153{lon:07.4},E,20.0,0.0,210420,,",
            t / 3600,
            t / 60 % 60,
            t % 60
        );
        let sum = body.bytes().fold(0, |sum, b| sum ^ b);
        writeln!(lines, "${body}*{sum:02X}").unwrap();
    }
    lines
}

/// A folder with what `sunset1` and `sunset2` need.
fn brisbane(bench: &Bench) {
    fs::create_dir(bench.path("data")).unwrap();
    recording(bench, &format!("data/{SUNSET1}.h5"), 1_587_452_582, "346 260");
    recording(bench, &format!("data/{SUNSET2}.h5"), 1_587_540_271, "346 260");
    bench.file(&format!("data/{SUNSET1_GPS}"), &gps((7, 3, 2)));
    bench.file(&format!("data/{SUNSET2_GPS}"), &gps((7, 24, 31)));
    bench.file(&format!("data/{SUNSET1}_hot_pixels.txt"), "3,4\n5,6\n");
}

/// The only report, as JSON.
fn report(bench: &Bench) -> (Said, Value) {
    let said = bench.run(&["dataset", "check", "data", "--json"]);
    let all: Value = serde_json::from_str(&said.stdout).unwrap();
    assert_eq!(all.as_array().unwrap().len(), 1);
    let report = all[0].clone();
    (said, report)
}

fn file<'a>(report: &'a Value, sequence: &str, role: &str) -> &'a Value {
    let named = |all: &'a Value, key: &str, name: &str| {
        let mut all = all.as_array().unwrap().iter();
        all.find(|v| v[key] == name).unwrap()
    };
    named(
        &named(&report["sequences"], "name", sequence)["files"],
        "role",
        role,
    )
}

#[test]
fn presets_are_listed() {
    let bench = Bench::new();
    let said = bench.run(&["dataset", "list"]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    for part in [
        "brisbane: Brisbane-Event-VPR",
        "    sunset1:night\n",
        "dvs_vpr_2020-04-27-18-13-29.bag",
        "nsavp: NSAVP",
        "    R0_RS0:R0_RN0\n",
        "R0_FA0_applanix.h5",
    ] {
        assert!(said.stdout.contains(part), "{part}: {}", said.stdout);
    }
    let json = bench.run(&["dataset", "list", "--json"]);
    let json: Value = serde_json::from_str(&json.stdout).unwrap();
    assert_eq!(json[1]["pairs"][0], serde_json::json!(["R0_FA0", "R0_FS0"]));
}

#[test]
fn a_folder_with_two_sequences_has_one_pair_that_runs() {
    let bench = Bench::new();
    brisbane(&bench);
    let said = bench.run(&["dataset", "check", "data"]);
    assert_eq!(said.code(), 0, "{}{}", said.stdout, said.stderr);
    for part in [
        "Brisbane-Event-VPR (brisbane) in data\n",
        "  sunset1:sunset2  ready\n",
        "  sunset1:night    not yet: night has no recording and no positions\n",
        "missing: dvs_vpr_2020-04-27-18-13-29.bag (or ",
        "missing files are at https://zenodo.org/records/4302805; they belong in data\n",
        "  hot pixels  missing, not needed: dvs_vpr_2020-04-22-17-24-21_hot_pixels.txt\n",
        "260×346 (height × width), begins at 1587452582.000 s\n",
        ": 2 pixels\n",
        "evpr dataset config data --pair sunset1:sunset2",
    ] {
        assert!(said.stdout.contains(part), "{part}: {}", said.stdout);
    }
    let (said, report) = report(&bench);
    assert_eq!(said.code(), 0);
    assert_eq!(file(&report, "sunset1", "positions")["state"], "good");
    assert_eq!(file(&report, "sunset2", "hot_pixels")["state"], "missing");
    let pairs = report["pairs"].as_array().unwrap();
    let ready: Vec<&Value> = pairs
        .iter()
        .filter(|p| p["lacks"].as_array().unwrap().is_empty())
        .map(|p| &p["query"])
        .collect();
    assert_eq!(ready, ["sunset2"]);
}

#[test]
fn the_configurations_of_a_pair_run() {
    let bench = Bench::new();
    brisbane(&bench);
    let config = |pair: &str| bench.run(&["dataset", "config", "data", "--pair", pair, "-o", "run"]);
    let said = config("sunset1:sunset2");
    assert_eq!(said.code(), 0, "{}", said.stderr);
    // A map that is masked would not fit a query that is not.
    assert!(
        said.stderr
            .contains("no hot pixels are masked, as sunset2 has no list"),
        "{}",
        said.stderr
    );
    let mut commands = said.stdout.lines();
    for (line, made) in [("evpr map build", "run/map"), ("evpr run", "run/matches.jsonl")] {
        let command = commands.next().unwrap();
        assert!(command.starts_with(line), "{command}");
        let words: Vec<&str> = command.split(' ').skip(1).collect();
        let done = bench.run(&[words.as_slice(), &["-q"]].concat());
        assert_eq!(done.code(), 0, "{}", done.stderr);
        assert!(bench.path(made).exists(), "{made}");
    }
    // Positions begin at 1587452582.35 s; what comes before is cropped, and 4 whole seconds remain of 5.
    let made = |name: &str| fs::read_to_string(bench.path(name)).unwrap();
    for (name, first_at) in [
        ("run/reference.toml", "first_at = 1587452582.35\n"),
        ("run/query.toml", "first_at = 1587540271.65\n"),
    ] {
        assert!(made(name).contains(first_at), "{}", made(name));
        assert!(!made(name).contains("hot_pixels"), "{}", made(name));
    }
    let info = bench.run(&["map", "info", "run/map"]);
    assert!(info.stdout.contains("4 with a position"), "{}", info.stdout);
    // What is run is that of another configuration, if it is named.
    bench.file(
        "mine.toml",
        "[source]\npath = \"elsewhere.h5\"\n[slicing]\nwindows = [\"500ms\"]\n[[reconstruction]]\nid = \"time_surface\"\n\
         [[extractor]]\nid = \"hog\"\n[study]\npresets = []\n",
    );
    let pair = [
        "dataset",
        "config",
        "data",
        "--pair",
        "sunset1:sunset2",
        "--methods",
        "mine.toml",
        "-o",
        "other",
    ];
    let said = bench.run(&pair);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let graph = bench.run(&["graph", "-c", "other/query.toml"]);
    assert!(
        graph.stdout.contains("time_surface@500ms/hog"),
        "{}{}",
        graph.stdout,
        graph.stderr
    );
    assert!(!made("other/query.toml").contains("elsewhere") && made("other/query.toml").contains("first_at"));

    // With both lists both are masked.
    bench.file(&format!("data/{SUNSET2}_hot_pixels.txt"), "7,8\n");
    let said = bench.run(&[
        "dataset",
        "config",
        "data",
        "--pair",
        "sunset1:sunset2",
        "-o",
        "masked",
    ]);
    assert_eq!((said.code(), said.stderr.as_str()), (0, ""));
    for (name, bag) in [("reference", SUNSET1), ("query", SUNSET2)] {
        let name = format!("masked/{name}.toml");
        assert!(
            made(&name).contains(&format!("data/{bag}_hot_pixels.txt\"\n")),
            "{}",
            made(&name)
        );
        assert_eq!(bench.run(&["validate", "-c", &name]).code(), 0);
    }

    // Nothing is overwritten, and what is not there is not configured.
    let again = config("sunset1:sunset2");
    assert_eq!(again.code(), 1);
    assert!(
        again.errors()[0].contains("run/reference.toml exists already"),
        "{}",
        again.stderr
    );
    for (pair, code, says) in [
        (
            "sunset1:night",
            1,
            "night has no recording and no positions; `evpr dataset check`",
        ),
        ("sunset1:noon", 2, "the sequences are sunset1, sunset2"),
        ("sunset1", 2, "write REFERENCE:QUERY"),
    ] {
        let said = config(pair);
        assert_eq!(said.code(), code, "{pair}");
        assert!(said.errors()[0].contains(says), "{}", said.stderr);
    }
}

#[test]
fn wrong_files_are_told_with_the_reason() {
    let bench = Bench::new();
    brisbane(&bench);
    let wrong = |sequence: &str, role: &str, says: &str| {
        let (said, report) = report(&bench);
        let file = file(&report, sequence, role);
        assert_eq!(file["state"], "wrong", "{file}");
        let what = file["what"].as_str().unwrap();
        assert!(what.contains(says), "{what}");
        assert_eq!(said.code(), 1);
        assert_eq!(said.errors().len(), 1, "{}", said.stderr);
        assert!(
            said.errors()[0].contains("data: no pair can be run"),
            "{}",
            said.stderr
        );
    };
    // Of another sensor, no recording at all, and one of another day.
    let h5 = format!("data/{SUNSET2}.h5");
    recording(&bench, &h5, 1_587_540_271, "640 480");
    wrong("sunset2", "recording", "480×640");
    bench.file(&h5, "<html>404</html>");
    wrong("sunset2", "recording", "not its signature");
    recording(&bench, &h5, 1_587_640_271, "346 260");
    wrong(
        "sunset2",
        "positions",
        "but the recording begins at 1587640271.000 s",
    );
    recording(&bench, &h5, 1_587_540_271, "346 260");
    bench.file(&format!("data/{SUNSET2}_hot_pixels.txt"), "3,400\n");
    wrong("sunset2", "hot_pixels", "line 1");
    fs::remove_file(bench.path(&format!("data/{SUNSET2}_hot_pixels.txt"))).unwrap();
    // A page of an error in place of GPS; then a drive without a loop.
    let nmea = format!("data/{SUNSET2_GPS}");
    bench.file(&nmea, "<html>404</html>");
    wrong("sunset2", "positions", "");
    let straight: Vec<String> = gps((7, 24, 31)).lines().take(50).map(str::to_owned).collect();
    bench.file(&nmea, &straight.join("\n"));
    wrong("sunset2", "positions", "has no loop");
}

#[test]
fn folders_and_presets_that_are_not_there_are_told() {
    let bench = Bench::new();
    fs::create_dir(bench.path("data")).unwrap();
    for (args, code, says) in [
        (
            &["data"][..],
            1,
            "data: holds no file of a known dataset (brisbane, nsavp)",
        ),
        (&["nowhere"], 1, "nowhere: is not a folder"),
        (
            &["data", "--preset", "mars"],
            2,
            "--preset mars is neither a preset (brisbane, nsavp) nor a file",
        ),
        (&["data", "--preset", "nsavp"], 1, "data: no pair can be run"),
    ] {
        let said = bench.run(&[&["dataset", "check"], args].concat());
        assert_eq!(said.code(), code, "{args:?}: {}", said.stderr);
        assert_eq!(said.errors().len(), 1, "{}", said.stderr);
        assert!(said.errors()[0].contains(says), "{}", said.stderr);
    }
}

/// A real recording under a preset of its own.
#[test]
fn a_preset_of_ones_own_is_a_file() {
    let real = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/events/davis346_lab.aedat4");
    if !real.exists() {
        println!("skipped: a_preset_of_ones_own_is_a_file: no {}", real.display());
        return;
    }
    let bench = Bench::new();
    let preset = bench.file(
        "lab.toml",
        "name = \"lab\"\ntitle = \"Lab\"\npage = \"https://example.org\"\ndownload = \"https://example.org\"\n\
         sensor = { height = 260, width = 346 }\nzone = \"32N\"\ncrop = \"none\"\npairs = [[\"a\", \"a\"]]\n\
         [[sequence]]\nname = \"a\"\nrecording = [\"a.bag\", \"a.aedat4\"]\npositions = [\"a.csv\"]\noffset = 0.0\n",
    );
    let check = || bench.run(&["dataset", "check", ".", "--preset", text(&preset)]);
    assert!(
        check()
            .stdout
            .contains("a:a  not yet: a has no recording and no positions\n")
    );
    fs::copy(&real, bench.path("a.aedat4")).unwrap();
    let begins = check().stdout;
    let (_, begins) = begins.split_once("begins at ").unwrap();
    let (s, _) = begins.split_once('.').unwrap();
    let s: u64 = s.parse().unwrap();
    bench.file("a.csv", &format!("t_s,x_m,y_m\n{s},0,0\n{},5,0\n", s + 1));
    let said = check();
    assert_eq!(said.code(), 0, "{}{}", said.stdout, said.stderr);
    assert!(said.stdout.contains("a:a  ready"), "{}", said.stdout);

    fs::write(&preset, "name = \"lab\"\nnam = 3\n").unwrap();
    let said = check();
    assert_eq!(said.code(), 1);
    assert!(
        said.errors()[0].contains("lab.toml: line 2: unknown field `nam`"),
        "{}",
        said.stderr
    );
}
