//! Places by frames: folders, lists and stacks of images, with no events at all.

use crate::support::{
    Bench, Running, Said, assert_ticks, read_answers, reasons, shared_data, text, timeless,
};
use evpr_store::{GroundTruth, Traverse};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

const HEIGHT: usize = 12;
const WIDTH: usize = 16;
/// Frames of a generated drive.
const FRAMES: u64 = 300;
/// Ticks of 20 ms on the wall.
const PACE: &str = "5";

fn config(bench: &Bench, size: (usize, usize), transform: &str, length: usize, more: &str) -> PathBuf {
    bench.file(
        "frames.toml",
        &format!(
            "[source]\nkind = \"frames\"\n{more}\n[slicing]\ntick = \"100ms\"\n[[reconstruction]]\nid = \"frames\"\n\
             [[extractor]]\nid = \"raw_pixels\"\n\
             params = {{ height = {}, width = {}, transform = \"{transform}\" }}\n\
             [fuse]\nsequence = {{ method = \"paper\", length = {length} }}\n[runtime]\ndeadline = \"300ms\"\n",
            size.0, size.1
        ),
    )
}

/// What the camera sees at a place: each one has its own picture; `seed` is the pass's noise.
fn pixel(place: u64, at: usize, seed: u64) -> u8 {
    let mix = |n: u64| (n ^ n >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40;
    let scene = mix(place.wrapping_mul(0x9e37_79b9_7f4a_7c15) + at as u64 / 3) % 200;
    (scene + mix(seed.wrapping_mul(0x94d0_49bb_1331_11eb) ^ place << 20 ^ at as u64) % 40) as u8
}

fn write_png(
    path: &Path,
    height: usize,
    width: usize,
    colour: png::ColorType,
    depth: png::BitDepth,
    data: &[u8],
) {
    let file = std::io::BufWriter::new(fs::File::create(path).unwrap());
    let mut encoder = png::Encoder::new(file, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(data).unwrap();
}

/// A folder of PNG files with positions: 2 m to the east from frame to frame.
fn drive(bench: &Bench, name: &str, seed: u64, frames: u64) -> PathBuf {
    let folder = bench.path(name);
    fs::create_dir(&folder).unwrap();
    for frame in 0..frames {
        let data: Vec<u8> = (0..HEIGHT * WIDTH).map(|at| pixel(frame, at, seed)).collect();
        let path = folder.join(format!("@{}.5@-7@{name}@.png", frame * 2));
        write_png(
            &path,
            HEIGHT,
            WIDTH,
            png::ColorType::Grayscale,
            png::BitDepth::Eight,
            &data,
        );
    }
    fs::write(folder.join("notes.txt"), "not a frame").unwrap();
    folder
}

fn build(bench: &Bench, config: &Path, input: &Path, out: &str) -> Said {
    bench.run(&[
        "map",
        "build",
        "-q",
        "-c",
        text(config),
        "-i",
        text(input),
        "-o",
        out,
    ])
}

/// A bench with a map of a generated drive, its configuration, and the folder of a second drive.
fn mapped() -> (Bench, PathBuf, PathBuf) {
    let bench = Bench::new();
    let config = config(&bench, (6, 8), "none", 1, "");
    let reference = drive(&bench, "reference", 1, FRAMES);
    let said = build(&bench, &config, &reference, "map");
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let query = drive(&bench, "query", 2, FRAMES);
    (bench, config, query)
}

/// Share of the queries with a match that are right, exactly and within 3 references.
fn recalls(answers: &[Value], truth: &GroundTruth) -> [f64; 2] {
    let reference = |answer: &Value| answer["reference"].as_u64().map(|reference| reference as usize);
    let given: Vec<Option<usize>> = answers.iter().map(reference).collect();
    let near = |(query, answer): (usize, &Option<usize>)| {
        let mut places = answer.iter().flat_map(|r| r.saturating_sub(3)..=r + 3);
        places.any(|place| truth.is_right(query, place))
    };
    let near = given.iter().enumerate().filter(|answer| near(*answer)).count();
    [
        truth.recall(&given).of_matchable(),
        near as f64 / truth.with_match() as f64,
    ]
}

#[test]
fn brisbane_is_recognised_as_often_as_published() {
    const TEST: &str = "brisbane_is_recognised_as_often_as_published";
    let Some(folder) = shared_data(TEST, "data/brisbane_7x7") else {
        return;
    };
    let bench = Bench::new();
    let first = config(&bench, (7, 7), "log1p", 1, "");
    let said = build(&bench, &first, &folder.join("reference_sunset2.npy"), "map");
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let references = Traverse::open(&bench.path("map")).unwrap().len();
    let truth = GroundTruth::from_pairs(&folder.join("ground_truth.csv"), 724, references).unwrap();
    let query = folder.join("query_sunset1.npy");
    for (length, known) in [(1, [0.185, 0.332]), (10, [0.558, 0.789]), (20, [0.571, 0.843])] {
        let config = config(&bench, (7, 7), "log1p", length, "");
        let said = bench.run(&[
            "run",
            "-q",
            "-c",
            text(&config),
            "-i",
            text(&query),
            "-m",
            "map",
            "-o",
            "a.jsonl",
        ]);
        assert_eq!(said.code(), 0, "{}", said.stderr);
        let answers = read_answers(&bench.path("a.jsonl"));
        assert_ticks(&answers, 724);
        for (recall, known) in recalls(&answers, &truth).into_iter().zip(known) {
            assert!(
                (recall - known).abs() < 0.01,
                "L = {length}: {recall:.3} instead of {known}"
            );
        }
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_folder_with_positions_is_mapped_and_recognised() {
    let (bench, config, query) = mapped();
    let ticks = fs::read_to_string(bench.path("map/ticks.csv")).unwrap();
    let lines: Vec<&str> = ticks.lines().collect();
    assert_eq!(
        (lines.len() as u64, lines[1], lines[11]),
        (FRAMES + 1, "0,0,100000,0.5,-7", "10,1000000,1100000,20.5,-7")
    );
    let said = bench.run(&[
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        "map",
        "-o",
        "a.jsonl",
    ]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let answers = read_answers(&bench.path("a.jsonl"));
    assert_ticks(&answers, FRAMES);
    for answer in &answers {
        assert_eq!(answer["reference"], answer["tick"], "{answer}");
    }
    // Live, at 20 ms a frame: nothing is late, so the answers are the same.
    let live = ["--pace", PACE, "--delivery", "latest"];
    let mut args = vec![
        "run",
        "-q",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        "map",
        "-o",
        "b.jsonl",
    ];
    args.extend(live);
    assert_eq!(bench.run(&args).code(), 0);
    let live = read_answers(&bench.path("b.jsonl"));
    assert_ticks(&live, FRAMES);
    for answer in live
        .iter()
        .filter(|a| a["missing"].as_object().unwrap().is_empty())
    {
        assert_eq!(answer["reference"], answer["tick"], "{answer}");
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn ingest_and_the_reconstruction_die_and_the_answers_are_the_same() {
    let (bench, config, query) = mapped();
    let args = ["run", "-q", "-c", text(&config), "-i", text(&query), "-m", "map"];
    let (undisturbed, said) = Running::start(&bench, &args).finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    for kind in ["ingest", "reconstruct"] {
        let mut paced = args.to_vec();
        paced.extend(["--pace", PACE]);
        let mut running = Running::start(&bench, &paced);
        assert!(running.read_to(40));
        Running::signal(running.services(kind)[0], Signal::SIGKILL);
        let (answers, said) = running.finish();
        assert_eq!(said.code(), 0, "{}", said.stderr);
        assert!(said.stderr.contains("died"), "{}", said.stderr);
        assert_ticks(&answers, FRAMES);
        let complete = |a: &&Value| a["missing"].as_object().unwrap().is_empty();
        if kind == "ingest" {
            assert!(answers.iter().all(|a| complete(&a)), "{:?}", reasons(&answers));
        }
        assert!(
            complete(&answers.last().unwrap()),
            "it did not come back\n{}",
            said.stderr
        );
        for answer in answers.iter().filter(complete) {
            let tick = answer["tick"].as_u64().unwrap() as usize;
            assert_eq!(timeless(answer), timeless(&undisturbed[tick]));
        }
    }
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_bad_frame_is_named_and_the_ticks_before_it_are_kept() {
    const BAD: u64 = 5;
    let bench = Bench::new();
    let config = config(&bench, (6, 8), "none", 1, "");
    let grey = png::ColorType::Grayscale;
    type Spoil = fn(&Path);
    let cases: [(&str, Spoil); 5] = [
        ("is cut short", |path| {
            let bytes = fs::read(path).unwrap();
            fs::write(path, &bytes[..bytes.len() - 20]).unwrap();
        }),
        (
            "is 3×4 (height × width) pixels, but the frames before are 12×16",
            |path| {
                write_png(
                    path,
                    3,
                    4,
                    png::ColorType::Grayscale,
                    png::BitDepth::Eight,
                    &[0; 12],
                );
            },
        ),
        ("is neither a PNG nor a JPEG image", |path| {
            fs::write(path, "<html></html>").unwrap()
        }),
        ("has 16 bits per channel", |path| {
            let data = vec![0; HEIGHT * WIDTH * 2];
            write_png(
                path,
                HEIGHT,
                WIDTH,
                png::ColorType::Grayscale,
                png::BitDepth::Sixteen,
                &data,
            );
        }),
        ("is cut short", |path| fs::write(path, "").unwrap()),
    ];
    for (case, (what, spoil)) in cases.into_iter().enumerate() {
        let folder = drive(&bench, &format!("drive{case}"), 1, 9);
        let bad = folder.join(format!("@{}.5@-7@drive{case}@.png", BAD * 2));
        spoil(&bad);
        let map = format!("map{case}");
        let said = build(&bench, &config, &folder, &map);
        assert_eq!(said.code(), 1, "{}", said.stderr);
        let named = |line: &str| line.contains(what) && line.contains(text(&bad));
        assert_eq!(
            said.stderr.lines().filter(|l| named(l)).count(),
            1,
            "{what}\n{}",
            said.stderr
        );
        let info = bench.run(&["map", "info", "--json", &map]);
        let manifest: Value = serde_json::from_str(&info.stdout).unwrap();
        assert_eq!(manifest["members"][0]["present"], BAD, "{what}");
    }
    // Damage in the middle shows only when it is decoded.
    let folder = drive(&bench, "damaged", 1, 9);
    let bad = folder.join(format!("@{}.5@-7@damaged@.png", BAD * 2));
    let mut bytes = fs::read(&bad).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    fs::write(&bad, bytes).unwrap();
    let said = build(&bench, &config, &folder, "map_damaged");
    assert_eq!(said.code(), 1, "{}", said.stderr);
    let named = |line: &&str| line.contains("cannot be decoded") && line.contains(text(&bad));
    assert_eq!(said.stderr.lines().filter(named).count(), 1, "{}", said.stderr);
    // With on_other_size = "resize" another size is no mistake, and colours may stand beside grey.
    let resize = self::config(
        &bench,
        (6, 8),
        "none",
        1,
        "frames = { on_other_size = \"resize\" }",
    );
    let mixed = drive(&bench, "mixed", 1, 3);
    write_png(
        &mixed.join("@9@9@.png"),
        24,
        32,
        grey,
        png::BitDepth::Eight,
        &[9; 24 * 32],
    );
    let rgb: Vec<u8> = (0..HEIGHT * WIDTH * 3).map(|i| (i * 7) as u8).collect();
    write_png(
        &mixed.join("@10@9@.png"),
        HEIGHT,
        WIDTH,
        png::ColorType::Rgb,
        png::BitDepth::Eight,
        &rgb,
    );
    let said = build(&bench, &resize, &mixed, "map_mixed");
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn sources_that_are_no_frames_are_refused_before_anything_starts() {
    let bench = Bench::new();
    let config = config(&bench, (6, 8), "none", 1, "");
    fs::create_dir(bench.path("empty")).unwrap();
    bench.file("list.csv", "file,t\nnowhere.png,0\n");
    bench.file("stack.npy", "\u{93}NUMPY");
    bench.file("events.h5", "");
    for (input, what) in [
        ("empty", "empty: holds no PNG or JPEG files"),
        ("nowhere", "nowhere: does not exist"),
        ("list.csv", "nowhere.png: does not exist"),
        ("stack.npy", "stack.npy: it does not begin as a .npy file"),
        (
            "events.h5",
            "events.h5: is neither a folder of PNG and JPEG files",
        ),
    ] {
        let said = bench.run(&["map", "build", "-c", text(&config), "-i", input, "-o", "map"]);
        assert_eq!(said.code(), 1, "{}", said.stderr);
        assert!(
            said.errors().len() == 1 && said.errors()[0].contains(what),
            "{}",
            said.stderr
        );
    }
}
