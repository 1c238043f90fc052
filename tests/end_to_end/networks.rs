//! Networks in the running graph: the small ones of `tests/models`. Need the library of ONNX Runtime
//! (`scripts/get-onnxruntime`); skipped by name without it.

use crate::support::{Bench, Running, Said, TICKS, assert_ticks, reasons, run_args, text, timeless};
use evpr_store::Traverse;
use nix::sys::signal::Signal;
use std::fs;
use std::path::{Path, PathBuf};

/// The library, or None with a note that names the test.
fn library(test: &str) -> Option<PathBuf> {
    match evpr_onnx::find_library(None) {
        Ok((path, _)) => Some(fs::canonicalize(path).unwrap()),
        Err(_) => {
            println!("skipped: {test}: no library of ONNX Runtime (scripts/get-onnxruntime)");
            None
        }
    }
}

fn models() -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/models");
    fs::canonicalize(folder).unwrap()
}

/// A configuration with these stanzas of stages, and the registry of the small networks.
fn config(bench: &Bench, name: &str, library: &Path, stages: &str, inference: &str) -> PathBuf {
    let registry = models().join("models.toml");
    let settings = format!(
        "[sensor]\nheight = 48\nwidth = 64\n[source]\non_outside_sensor = \"error\"\n\
         [slicing]\ntick = \"100ms\"\nwindows = [\"50ms\", \"100ms\"]\norigin = 0\n\
         [fuse]\nsequence = {{ method = \"paper\", length = 5 }}\n\
         [inference]\nmodels = {registry:?}\nlibrary = {library:?}\n{inference}\n{stages}\n"
    );
    bench.file(name, &settings)
}

const STAGES: &str = "[[reconstruction]]\nid = \"event_count\"\n\
    [[reconstruction]]\nid = \"tiny_e2vid\"\n\
    [[reconstruction]]\nid = \"carried\"\nkind = \"tiny_e2vid\"\nparams = { state = \"carry\" }\n\
    [[extractor]]\nid = \"tiny_extractor\"\nbatch = 4\n\
    [[extractor]]\nid = \"tiny_fixed\"\n[[extractor]]\nid = \"patch_norm\"\n";

fn assert_fails(bench: &Bench, said: &Said, words: &[&str]) {
    assert_eq!(said.code(), 1, "{}", said.stderr);
    let errors = said.errors();
    assert_eq!(errors.len(), 1, "{}", said.stderr);
    for word in words {
        assert!(errors[0].contains(word), "\"{word}\" is not in: {}", errors[0]);
    }
    assert!(!said.stderr.contains("panicked"), "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn networks_are_members_like_others_and_a_replay_gives_the_same_answers() {
    let Some(library) = library("networks_are_members_like_others_and_a_replay_gives_the_same_answers")
    else {
        return;
    };
    let bench = Bench::new();
    let config = config(&bench, "networks.toml", &library, STAGES, "");
    let map = bench.map(&config);
    let traverse = Traverse::open(&map).unwrap();
    assert_eq!(traverse.manifest().members.len(), 18);
    for entry in &traverse.manifest().members {
        let member = traverse.member(&entry.name).unwrap();
        assert!(member.present().iter().all(|present| *present), "{}", entry.name);
        for row in member.rows().chunks_exact(member.dim()) {
            let length: f64 = row.iter().map(|v| f64::from(*v).powi(2)).sum();
            assert!((length - 1.0).abs() < 1e-5, "{}: {length}", entry.name);
        }
    }
    let rows = |name: &str| traverse.member(name).unwrap().rows().to_vec();
    let (reset, carried) = (
        rows("tiny_e2vid@100ms/patch_norm"),
        rows("carried@100ms/patch_norm"),
    );
    let dim = reset.len() / traverse.len();
    assert_eq!(
        reset[..dim],
        carried[..dim],
        "the first tick has no memory to carry"
    );
    assert!(reset[dim..2 * dim] != carried[dim..2 * dim], "the second one has");

    let query = bench.recording("query.txt", TICKS, 2);
    let once = || {
        let (answers, said) = Running::start(&bench, &run_args(&config, &query, &map, &[])).finish();
        assert_eq!(said.code(), 0, "{}", said.stderr);
        assert_ticks(&answers, TICKS);
        assert!(reasons(&answers).is_empty(), "{:?}", reasons(&answers));
        answers.iter().map(timeless).collect::<Vec<_>>()
    };
    assert_eq!(once(), once());
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn a_network_s_process_that_is_killed_comes_back() {
    let Some(library) = library("a_network_s_process_that_is_killed_comes_back") else {
        return;
    };
    let bench = Bench::new();
    let stages = "[[reconstruction]]\nid = \"tiny_e2vid\"\n[[extractor]]\nid = \"tiny_extractor\"\n\
                  [[extractor]]\nid = \"patch_norm\"\n";
    let config = config(&bench, "networks.toml", &library, stages, "");
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "4"]));
    assert!(running.read_to(20));
    Running::signal(running.services("extract")[0], Signal::SIGKILL);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    let last = answers.last().unwrap();
    assert_eq!(last["missing"].as_object().unwrap().len(), 0, "{last}");
}

#[test]
fn a_network_that_works_for_nobody_can_be_unloaded_and_is_loaded_again() {
    let Some(library) = library("a_network_that_works_for_nobody_can_be_unloaded_and_is_loaded_again") else {
        return;
    };
    let bench = Bench::new();
    let stages = "[[reconstruction]]\nid = \"tiny_e2vid\"\n[[reconstruction]]\nid = \"event_count\"\n\
                  [[extractor]]\nid = \"tiny_extractor\"\n[[extractor]]\nid = \"patch_norm\"\n";
    let config = config(&bench, "networks.toml", &library, stages, "");
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    // Without -q, as what is waited for is no warning.
    let args = [
        "run",
        "-c",
        text(&config),
        "-i",
        text(&query),
        "-m",
        text(&map),
        "--pace",
        "3",
    ];
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(20));
    let networks = [
        "tiny_e2vid@50ms/tiny_extractor",
        "tiny_e2vid@100ms/tiny_extractor",
        "tiny_e2vid@50ms/patch_norm",
        "tiny_e2vid@100ms/patch_norm",
        "event_count@50ms/tiny_extractor",
        "event_count@100ms/tiny_extractor",
    ];
    let said = bench.run(&[&["member", "disable", "--unload"], &networks[..]].concat());
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(running.logs("extract/tiny_extractor has given its memory back"));
    let said = bench.run(&[&["member", "enable", "--json"], &networks[..]].concat());
    let reply: serde_json::Value = serde_json::from_str(&said.stdout).unwrap();
    let back = reply["from_tick"].as_u64().unwrap();
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(
        said.stderr
            .contains("reconstruct/tiny_e2vid has given its memory back"),
        "{}",
        said.stderr
    );
    assert_ticks(&answers, TICKS);
    assert!(
        reasons(&answers).is_empty(),
        "{:?}: {}",
        reasons(&answers),
        said.stderr
    );
    for answer in &answers {
        let members = answer["members"].as_array().unwrap().len();
        assert!(
            members == 8 || answer["tick"].as_u64().unwrap() < back && members == 2,
            "{answer}"
        );
    }
}

#[test]
fn what_cannot_start_ends_the_run_with_one_line() {
    let Some(library) = library("what_cannot_start_ends_the_run_with_one_line") else {
        return;
    };
    let bench = Bench::new();
    let input = bench.recording("query.txt", 3, 2);
    let record = |name: &str, library: &Path, stages: &str, inference: &str, words: &[&str]| {
        println!("{name}");
        let config = config(&bench, &format!("{name}.toml"), library, stages, inference);
        let map = bench.path(name);
        let said = bench.build_map(&config, &input, &map);
        assert_fails(&bench, &said, words);
    };
    let with = |extractor: &str| {
        format!("[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"{extractor}\"\n")
    };
    let missing = bench.path("no-library.so");
    record(
        "library",
        &missing,
        &with("tiny_extractor"),
        "",
        &["no-library.so: there is no such file", "scripts/get-onnxruntime"],
    );
    record(
        "provider",
        &library,
        &with("tiny_extractor"),
        "providers = [\"openvino\"]\n",
        &["the provider \"openvino\" cannot start", "inference.fallback"],
    );
    record(
        "dimension",
        &library,
        &with("wrong_dim"),
        "",
        &["extractor \"wrong_dim\"", "it gives descriptor"],
    );
    record(
        "contradiction",
        &library,
        &with("contradiction"),
        "",
        &["the file says mean"],
    );
    record(
        "nan",
        &library,
        &with("nan"),
        "",
        &["nan.onnx: number ", "of its descriptor is none (NaN)"],
    );
    let carry = "[[reconstruction]]\nid = \"tiny_e2vid_stateless\"\nparams = { state = \"carry\" }\n\
                 [[extractor]]\nid = \"patch_norm\"\n";
    record(
        "memory",
        &library,
        carry,
        "",
        &["state = \"carry\" has no effect", "has no memory"],
    );
    record(
        "unknown",
        &library,
        &with("tiny_extraktor"),
        "",
        &["did you mean \"tiny_extractor\"", "tests/models/models.toml"],
    );
}

/// A copy of the registry in the bench's folder, with one model's file replaced.
fn registry_with(bench: &Bench, file: &str, replace: impl Fn(&Path)) -> PathBuf {
    let folder = bench.path("models");
    fs::create_dir_all(&folder).unwrap();
    for entry in fs::read_dir(models()).unwrap().flatten() {
        if entry.path().is_file() {
            fs::copy(entry.path(), folder.join(entry.file_name())).unwrap();
        }
    }
    replace(&folder.join(file));
    folder.join("models.toml")
}

#[test]
fn a_model_that_is_not_what_it_should_be_is_named() {
    let Some(library) = library("a_model_that_is_not_what_it_should_be_is_named") else {
        return;
    };
    let bench = Bench::new();
    let input = bench.recording("query.txt", 3, 2);
    type Replace = fn(&Path);
    let cases: [(Replace, &str); 4] = [
        (
            |path| fs::remove_file(path).unwrap(),
            "there is no such file; put it there",
        ),
        (
            |path| fs::write(path, &fs::read(path).unwrap()[..9_000]).unwrap(),
            "it is cut short or another file",
        ),
        (|path| fs::write(path, "not a network").unwrap(), "its SHA-256 is"),
        (
            // A file of 4 TiB that takes no room on the disk: more than any memory here.
            |path| fs::File::create(path).unwrap().set_len(1 << 42).unwrap(),
            "MiB of memory are free; end other programs, or leave it out",
        ),
    ];
    for (replace, expected) in cases {
        let registry = registry_with(&bench, "tiny_extractor.onnx", replace);
        let text_of = format!(
            "[sensor]\nheight = 48\nwidth = 64\n[slicing]\ntick = \"100ms\"\n\
             [inference]\nmodels = {registry:?}\nlibrary = {library:?}\n\
             [[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"tiny_extractor\"\n"
        );
        let config = bench.file("broken.toml", &text_of);
        let map = bench.path("map");
        let said = bench.build_map(&config, &input, &map);
        assert_fails(&bench, &said, &["tiny_extractor.onnx: ", expected]);
    }
}

#[test]
fn the_run_goes_on_without_what_is_optional() {
    let Some(library) = library("the_run_goes_on_without_what_is_optional") else {
        return;
    };
    let bench = Bench::new();
    let good = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"tiny_extractor\"\n\
                [[extractor]]\nid = \"patch_norm\"\n";
    let whole = config(&bench, "whole.toml", &library, good, "");
    let map = bench.map(&whole);
    let registry = registry_with(&bench, "tiny_extractor.onnx", |path| {
        fs::remove_file(path).unwrap()
    });
    let optional = fs::read_to_string(&whole)
        .unwrap()
        .replace(text(&models().join("models.toml")), text(&registry))
        .replace(
            "id = \"tiny_extractor\"",
            "id = \"tiny_extractor\"\noptional = true",
        );
    let config = bench.file("optional.toml", &optional);
    let query = bench.recording("query.txt", TICKS, 2);
    let (answers, said) = Running::start(&bench, &run_args(&config, &query, &map, &[])).finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert!(
        said.stderr.contains("tiny_extractor.onnx: there is no such file"),
        "{}",
        said.stderr
    );
    assert!(
        said.stderr.contains("the run goes on without it"),
        "{}",
        said.stderr
    );
    assert_ticks(&answers, TICKS);
    // Two windows of one reconstruction.
    assert_eq!(
        reasons(&answers),
        [("extractor down".to_owned(), 2 * TICKS as usize)].into()
    );
    assert!(answers.iter().skip(5).all(|a| !a["reference"].is_null()));
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

/// What is done again after a death is done from the start, as every frame depends on those before it.
#[test]
fn a_memory_that_is_carried_outlives_the_deaths_of_others() {
    let Some(library) = library("a_memory_that_is_carried_outlives_the_deaths_of_others") else {
        return;
    };
    let bench = Bench::new();
    let stages = "[[reconstruction]]\nid = \"tiny_e2vid\"\nparams = { state = \"carry\" }\n\
                  [[extractor]]\nid = \"patch_norm\"\n";
    let config = config(&bench, "carry.toml", &library, stages, "");
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let args = run_args(&config, &query, &map, &["--pace", "8"]);
    let (undisturbed, said) = Running::start(&bench, &run_args(&config, &query, &map, &[])).finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    for victim in ["fuse", "ingest"] {
        let mut running = Running::start(&bench, &args);
        assert!(running.read_to(40));
        Running::signal(running.services(victim)[0], Signal::SIGKILL);
        let (answers, said) = running.finish();
        assert_eq!(said.code(), 0, "{}", said.stderr);
        assert_ticks(&answers, TICKS);
        for (answer, expected) in answers.iter().zip(&undisturbed) {
            assert_eq!(timeless(answer), timeless(expected), "{victim}");
        }
    }
}
