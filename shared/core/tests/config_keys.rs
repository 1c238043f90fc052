//! The reference of all keys agrees with what the parser does and with the documented example.
#![allow(clippy::panic, clippy::unwrap_used)] // helpers of tests are tests

use evpr_core::Plan;
use evpr_core::config::{KeyDoc, Overrides, key_reference, parse, test_catalog};
use evpr_core::plan::{FrameSource, HotPixelRule, HotPixelsFrom, MaskedBy, Sensor, Source, Street};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn keys() -> Vec<KeyDoc> {
    key_reference(&test_catalog())
}

fn config_file(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config")
        .join(name);
    std::fs::read_to_string(path).unwrap()
}

fn plan(text: &str) -> Plan {
    let config = parse(text, "x.toml", &test_catalog()).unwrap_or_else(|e| panic!("{e}\n{text}"));
    let overrides = Overrides {
        input: Some(PathBuf::from("input.h5")),
        ..Overrides::default()
    };
    let sensor = Sensor {
        height: 260,
        width: 346,
    };
    config.resolve(sensor, &overrides).unwrap()
}

#[test]
fn every_key_is_there_once_and_described() {
    let keys = keys();
    let mut names: Vec<String> = keys.iter().map(|k| format!("{}.{}", k.section, k.key)).collect();
    let count = names.len();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), count);
    for key in [
        "run.name",
        "slicing.windows",
        "reconstruction.params",
        "extractor.id",
        "fuse.sequence.length",
    ] {
        assert!(names.iter().any(|n| n == key), "{key} is missing");
    }
    for key in &keys {
        assert!(key.doc.ends_with('.') && !key.kind.is_empty(), "{key:?}");
    }
}

#[test]
fn the_defaults_are_what_the_reference_says() {
    let mut sections: BTreeMap<String, String> = BTreeMap::new();
    for key in keys() {
        // A deadline means something only in latest delivery, a slack only with a live source, and these sections only
        // when they are asked for.
        let only = ["source.street", "source.hot_pixels", "source.frames"];
        let means =
            !["deadline", "slack", "hold"].contains(&key.key) && !only.contains(&key.section.as_str());
        if let Some(default) = key.default.filter(|_| means) {
            *sections.entry(key.section).or_default() += &format!("{} = {default}\n", key.key);
        }
    }
    let minimal = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n";
    let mut text = String::new();
    for (section, lines) in &sections {
        match section.as_str() {
            "reconstruction" => text += &format!("[[reconstruction]]\nid = \"event_count\"\n{lines}"),
            "extractor" => text += &format!("[[extractor]]\nid = \"patch_norm\"\n{lines}"),
            _ => text += &format!("[{section}]\n{lines}"),
        }
    }
    assert!(sections.len() > 7, "{text}");
    assert_eq!(plan(&text), plan(minimal));
    let latest = format!("{minimal}[runtime]\ndelivery = \"latest\"\n");
    let deadline = keys()
        .into_iter()
        .find(|k| k.key == "deadline")
        .and_then(|k| k.default)
        .unwrap();
    assert_eq!(plan(&format!("{latest}deadline = {deadline}\n")), plan(&latest));
}

#[test]
fn the_defaults_of_the_street_are_what_the_reference_says() {
    let stages = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n";
    let short = format!("{stages}[source]\nkind = \"street\"\n");
    let mut long = format!("{short}[source.street]\n");
    let keys = keys().into_iter().filter(|k| k.section == "source.street");
    let count = keys
        .map(|k| long += &format!("{} = {}\n", k.key, k.default.unwrap()))
        .count();
    assert_eq!(count, 5);
    let source = |text: &str| {
        let config = parse(text, "x.toml", &test_catalog()).unwrap_or_else(|e| panic!("{e}\n{text}"));
        config.source(&Overrides::default()).unwrap()
    };
    assert_eq!(source(&long), source(&short));
    assert_eq!(source(&short), Source::street(Street::default()));
}

#[test]
fn the_defaults_of_hot_pixels_are_what_the_reference_says() {
    let stages = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n";
    let short = format!("{stages}[source.hot_pixels]\nlearn = \"5s\"\n");
    let mut long = short.clone();
    let keys = keys().into_iter().filter(|k| k.section == "source.hot_pixels");
    let count = keys
        .filter_map(|k| Some((k.key, k.default?)))
        .map(|(key, default)| long += &format!("{key} = {default}\n"))
        .count();
    assert_eq!(count, 3);
    assert_eq!(plan(&long), plan(&short));
    let hot = plan(&short).source.hot_pixels.unwrap();
    assert_eq!((hot.masked_by, hot.pixels), (MaskedBy::Ingest, None));
    assert_eq!(
        hot.from,
        HotPixelsFrom::Learn {
            period_ns: 5_000_000_000,
            rule: HotPixelRule::default()
        }
    );
}

#[test]
fn the_defaults_of_frames_are_what_the_reference_says() {
    let short = "[[reconstruction]]\nid = \"frames\"\n[[extractor]]\nid = \"patch_norm\"\n\
                 [source]\nkind = \"frames\"\npath = \"folder\"\n";
    let mut long = format!("{short}[source.frames]\n");
    let keys = keys().into_iter().filter(|k| k.section == "source.frames");
    let count = keys
        .map(|k| long += &format!("{} = {}\n", k.key, k.default.unwrap()))
        .count();
    assert_eq!(count, 3);
    let source = |text: &str| {
        let config = parse(text, "x.toml", &test_catalog()).unwrap_or_else(|e| panic!("{e}\n{text}"));
        config.source(&Overrides::default()).unwrap()
    };
    assert_eq!(source(&long), source(short));
    assert_eq!(source(short), Source::frames("folder", FrameSource::default()));
}

#[test]
fn the_default_of_the_slack_is_what_the_reference_says() {
    let keys = keys();
    let slack = keys.iter().find(|k| k.key == "slack").and_then(|k| k.default);
    let text = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n[source]\nkind = \"usb\"\n";
    let source = |text: &str| {
        let config = parse(text, "x.toml", &test_catalog()).unwrap_or_else(|e| panic!("{e}\n{text}"));
        config.source(&Overrides::default()).unwrap()
    };
    assert_eq!(
        source(&format!("{text}slack = {}\n", slack.unwrap())),
        source(text)
    );
}

#[test]
fn the_example_shows_every_key_and_parameter() {
    let text = config_file("ensemble.toml");
    let catalog = test_catalog();
    let params = catalog.reconstructions.iter().flat_map(|k| k.params);
    let params = params
        .chain(catalog.extractors.iter().flat_map(|k| k.params))
        .map(|p| p.name);
    for name in keys().iter().map(|k| k.key).chain(params) {
        assert!(
            text.contains(&format!("{name} = ")),
            "config/ensemble.toml lacks {name}"
        );
    }
}
