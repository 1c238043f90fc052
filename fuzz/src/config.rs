//! Configurations, from text to the plan as the command line makes it, and what is worked out of the plan; registries
//! of models.

use crate::replay::Target;
use evpr_core::config::{self, Overrides};
use evpr_core::plan::{Catalog, Models, Sensor};
use evpr_onnx::Registry;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::{env, fs, process, thread};

/// Every target of this module.
pub const TARGETS: &[Target] = &[("config", toml), ("models", models)];

/// Networks that a configuration may name.
static REGISTRY: LazyLock<Registry> = LazyLock::new(|| {
    let known = read(include_bytes!("../../tests/models/models.toml"));
    assert!(matches!(known, Ok(Some(_))), "{known:?}");
    known.ok().flatten().unwrap_or_default()
});

/// A registry of models.
pub fn models(data: &[u8]) {
    match read(data) {
        Ok(registry) => assert!(registry.is_some()),
        Err(e) => assert!(!e.to_string().contains('\n'), "{e}"),
    }
}

fn read(text: &[u8]) -> Result<Option<Registry>, evpr_onnx::OnnxError> {
    let (process, thread) = (process::id(), thread::current().id());
    let path = env::temp_dir().join(format!("evpr-fuzz-models-{process}-{thread:?}"));
    assert!(
        fs::write(&path, text).is_ok(),
        "{} cannot be written",
        path.display()
    );
    let registry = Registry::read(&path);
    let _ = fs::remove_file(&path);
    registry
}

/// A configuration file.
pub fn toml(data: &[u8]) {
    // As the command line, which takes only UTF-8.
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let one_line_each = |errors: config::ConfigErrors| {
        let text = errors.to_string();
        assert!(
            !text.is_empty()
                && text
                    .lines()
                    .all(|line| line.contains("fuzz.toml") || line.contains("command line")),
            "{text}"
        );
    };
    let _ = config::registry_path(text);
    let catalog = Catalog {
        reconstructions: &evpr_reconstruct::ALL_KINDS,
        extractors: &evpr_extract::KINDS,
        models: Models {
            models: &REGISTRY.models,
            registry: "models.toml",
        },
        cores: 2,
    };
    let config = match config::parse(text, "fuzz.toml", &catalog) {
        Ok(config) => config,
        Err(errors) => return one_line_each(errors),
    };
    let everything = Overrides {
        map: Some(PathBuf::from("map")),
        record: Some(PathBuf::from("record")),
        ..Overrides::default()
    };
    let recording = Overrides {
        input: Some(PathBuf::from("events.raw")),
        ..Overrides::default()
    };
    for overrides in [everything, recording] {
        let sensor = Sensor {
            height: 260,
            width: 346,
        };
        let plan = match config.resolve(config.sensor().unwrap_or(sensor), &overrides) {
            Ok(plan) => plan,
            Err(errors) => {
                one_line_each(errors);
                continue;
            }
        };
        let names: Vec<_> = plan.services().into_iter().map(|service| service.name).collect();
        assert!(!names.is_empty());
        let bytes: usize = plan.channels().iter().map(|channel| channel.bytes()).sum();
        assert!(bytes <= plan.shared_memory_bytes());
        assert!(plan.slicing.segments().per_tick() > 0);
        for member in 0..plan.members.len() {
            assert!(!plan.fingerprint(member).is_empty());
        }
        // As processes are handed it.
        let written = serde_json::to_string(&plan).unwrap_or_default();
        assert_eq!(serde_json::from_str(&written).ok(), Some(plan));
    }
}
