//! `[inference]`: how networks are run, and which registry of models describes them.

use super::reader::{Table, Value};
use super::schema::key;
use super::syntax;
use super::words::{PROVIDERS, one_of};
use crate::plan::{Inference, Provider};
use std::path::{Path, PathBuf};
use toml::de::DeValue;

/// The registry of models when the configuration names none.
pub const DEFAULT_REGISTRY: &str = "models/models.toml";

/// The registry of models that a configuration names, relative to where it is read; [`DEFAULT_REGISTRY`] when it
/// names none that could be read. It is asked for before [`super::parse`], whose catalog has the models in it.
pub fn registry_path(text: &str) -> PathBuf {
    let document = syntax::parse(text);
    let section = document.table.get("inference").map(toml::Spanned::get_ref);
    let models = match section {
        Some(DeValue::Table(section)) => section.get("models").map(toml::Spanned::get_ref),
        _ => None,
    };
    match models {
        Some(DeValue::String(path)) => PathBuf::from(path.as_ref()),
        _ => PathBuf::from(DEFAULT_REGISTRY),
    }
}

/// `[inference]`.
pub(super) fn inference(table: Table<'_>) -> Option<Inference> {
    table.read_optional(
        key(
            "models",
            "path",
            Some("\"models/models.toml\""),
            "The registry of models: what scripts/export_models.py writes, or one of your own.",
        ),
        |v| path(v),
    );
    let library = table.read_optional(
        key(
            "library",
            "path",
            None,
            "The shared library of ONNX Runtime, 1.24 or newer. When not given: $ORT_DYLIB_PATH, else what \
             scripts/get-onnxruntime fetched.",
        ),
        |v| path(v),
    );
    let providers = table.read(
        key(
            "providers",
            "list of \"tensorrt\", \"cuda\", \"openvino\", \"xnnpack\", \"cpu\"",
            Some("[\"cpu\"]"),
            "Where networks are computed; the first one that starts.",
        ),
        vec![Provider::Cpu],
        providers,
    );
    let fallback = table.read(
        key(
            "fallback",
            "true or false",
            Some("false"),
            "Whether the next provider is taken, with a warning, where one cannot start; else the process ends with an \
             error.",
        ),
        false,
        |v| v.boolean(),
    );
    let spinning = table.read(
        key(
            "spinning",
            "true or false",
            Some("false"),
            "Whether a network's idle threads spin for work: faster where each network has cores of its own.",
        ),
        false,
        |v| v.boolean(),
    );
    table.close();
    Some(Inference {
        library: library?,
        providers: providers?,
        fallback: fallback?,
        spinning: spinning?,
    })
}

fn path(value: &Value<'_>) -> Option<PathBuf> {
    let text = value.text("a path in quotes")?;
    if text.is_empty() {
        return value.refuse("is empty; write a path, or remove the key");
    }
    Some(Path::new(text).to_path_buf())
}

fn providers(value: &Value<'_>) -> Option<Vec<Provider>> {
    let quoted: Vec<String> = PROVIDERS.all().iter().map(|word| format!("{word:?}")).collect();
    let listed = value.list(&format!("a list of {}", one_of(&quoted)), |v| v.word(&PROVIDERS))?;
    let listed: Vec<Provider> = listed.into_iter().collect::<Option<_>>()?;
    if listed.is_empty() {
        return value.refuse("is empty; write [\"cpu\"], or remove the key");
    }
    let twice = listed
        .iter()
        .enumerate()
        .find(|(i, provider)| listed[..*i].contains(provider));
    if let Some((_, provider)) = twice {
        return value.refuse(format!("names {:?} twice; write it once", provider.name()));
    }
    Some(listed)
}
