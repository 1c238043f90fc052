//! What a model's file says of itself, beside what the registry says of it.

use evpr_core::plan::{Model, ModelKind, Resize};
use std::collections::BTreeMap;

/// What the names of our metadata in a model's file begin with.
pub const METADATA_PREFIX: &str = "evpr.";

/// The metadata of a model's file whose names begin with [`METADATA_PREFIX`], without it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Facts(pub BTreeMap<String, String>);

impl Facts {
    pub(crate) fn of(session: &ort::session::Session) -> Self {
        let read = || -> ort::Result<BTreeMap<String, String>> {
            let metadata = session.metadata()?;
            let keys = metadata.custom_keys()?;
            let ours = keys.iter().filter_map(|key| {
                let name = key.strip_prefix(METADATA_PREFIX)?;
                Some((name.to_owned(), metadata.custom(key)?))
            });
            Ok(ours.collect())
        };
        Self(read().unwrap_or_default())
    }

    /// The first fact that is not as the registry has it: one line.
    pub(crate) fn contradiction(&self, model: &Model) -> Option<String> {
        claims(model).into_iter().find_map(|(name, registry)| {
            let file = self.0.get(name)?;
            (!same(file, &registry)).then(|| {
                format!(
                    "the file says {name} = \"{file}\", and the registry \"{registry}\"; correct the registry's entry"
                )
            })
        })
    }
}

/// The facts as the registry has them, under the names that the metadata use.
fn claims(model: &Model) -> Vec<(&'static str, String)> {
    let list = |values: &[f64]| {
        let values: Vec<String> = values.iter().map(f64::to_string).collect();
        values.join(",")
    };
    match &model.kind {
        ModelKind::Extractor {
            preprocessing: p,
            dimension,
        } => {
            let resize = match p.resize {
                Resize::None => "none",
                Resize::AntialiasedBilinear => "antialiased_bilinear",
            };
            vec![
                ("kind", "extractor".to_owned()),
                ("input_size", p.input.to_string()),
                ("resize", resize.to_owned()),
                ("color", p.color.name().to_owned()),
                ("range", p.range.to_string()),
                ("mean", list(&p.mean)),
                ("std", list(&p.std)),
                ("dimension", dimension.to_string()),
            ]
        }
        ModelKind::Reconstruction {
            bins,
            multiple,
            states,
        } => vec![
            ("kind", "reconstruction".to_owned()),
            ("bins", bins.to_string()),
            ("multiple", multiple.to_string()),
            ("states", states.join(",")),
        ],
    }
}

/// Equal, as text or as lists of numbers that differ by less than a millionth.
fn same(a: &str, b: &str) -> bool {
    let numbers =
        |text: &str| -> Option<Vec<f64>> { text.split(',').map(|v| v.trim().parse().ok()).collect() };
    match (numbers(a), numbers(b)) {
        (Some(a), Some(b)) => a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6),
        _ => a.trim() == b,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::{Color, InputSize, Preprocessing};

    fn model() -> Model {
        Model {
            id: "m".to_owned(),
            file: "m.onnx".into(),
            sha256: "0".repeat(64),
            output: "descriptor".to_owned(),
            kind: ModelKind::Extractor {
                preprocessing: Preprocessing {
                    input: InputSize::Native,
                    resize: Resize::None,
                    color: Color::Rgb,
                    range: 1.0,
                    mean: vec![0.485, 0.456, 0.406],
                    std: vec![0.229, 0.224, 0.225],
                },
                dimension: 64,
            },
            licence: String::new(),
            source: String::new(),
        }
    }

    fn facts(name: &str, value: &str) -> Facts {
        Facts([(name.to_owned(), value.to_owned())].into())
    }

    #[test]
    fn facts_that_agree_or_are_silent_pass() {
        assert_eq!(Facts::default().contradiction(&model()), None);
        for (name, value) in [
            ("mean", "0.485, 0.4560000001,0.406"),
            ("range", "1"),
            ("range", "1.0"),
            ("dimension", "64"),
            ("input_size", "native"),
            ("licence", "anything"),
        ] {
            assert_eq!(facts(name, value).contradiction(&model()), None, "{name}");
        }
    }

    #[test]
    fn facts_that_contradict_are_named() {
        for (name, value) in [
            ("mean", "0.5,0.5,0.5"),
            ("mean", "0.485"),
            ("range", "255"),
            ("dimension", "32"),
            ("color", "bgr"),
            ("kind", "reconstruction"),
        ] {
            let problem = facts(name, value).contradiction(&model());
            let problem = problem.unwrap_or_default();
            assert!(
                problem.contains(&format!("the file says {name} = \"{value}\"")),
                "{problem}"
            );
        }
    }
}
