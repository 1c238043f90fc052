//! A study: what is evaluated of the pairs of datasets, `[study]` in config/paper.toml.

use crate::failure::Failure;
use crate::preset;
use evpr_evaluate::{PairSpec, Truth};
use serde::Deserialize;
use std::io::Read;
use std::path::{Path, PathBuf};

/// No study is larger, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// The section; its words are those of the command line.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Study {
    presets: Vec<String>,
    traverses: PathBuf,
    tolerance_m: f64,
    #[serde(default)]
    pub(crate) methods: Vec<String>,
    #[serde(default)]
    pub(crate) lengths: Vec<usize>,
    #[serde(default)]
    pub(crate) similarities: Vec<String>,
    #[serde(default)]
    pub(crate) rules: Vec<String>,
    #[serde(default)]
    pub(crate) subsets: Vec<String>,
}

impl Study {
    /// The study in this file; `None` where it has none.
    ///
    /// # Errors
    /// When it cannot be read, or is not as it must be.
    pub(crate) fn find(path: &Path) -> Result<Option<Self>, Failure> {
        let wrong = |what: String| Failure::new(format!("{}: {what}", path.display()));
        let file = std::fs::File::open(path).map_err(|e| wrong(format!("cannot open: {e}")))?;
        let mut text = String::new();
        let read = file.take(MAX_BYTES).read_to_string(&mut text);
        read.map_err(|e| wrong(format!("cannot read: {e}")))?;
        // Who reads the rest of the file says what is wrong with it.
        let Ok(mut table) = text.parse::<toml::Table>() else {
            return Ok(None);
        };
        let study = table.remove("study").map(toml::Value::try_into).transpose();
        study.map_err(|e: toml::de::Error| wrong(format!("[study]: {}", e.message().replace('\n', " "))))
    }

    /// The pairs of which both traverses are there, and those of which one is not, with what is missing.
    ///
    /// # Errors
    /// When a preset is not known, or no pair is there.
    pub(crate) fn pairs(&self) -> Result<(Vec<PairSpec>, Vec<String>), Failure> {
        let (mut pairs, mut missing) = (Vec::new(), Vec::new());
        for name in &self.presets {
            let preset = preset::find(name)?;
            for [reference, query] in &preset.pairs {
                let folder = |sequence: &String| self.traverses.join(&preset.name).join(sequence);
                let (map, drive) = (folder(reference), folder(query));
                let name = format!("{}:{reference}-{query}", preset.name);
                let absent = [&map, &drive].into_iter().find(|path| !path.exists());
                if let Some(path) = absent {
                    missing.push(format!("{name} ({} is not there)", path.display()));
                    continue;
                }
                pairs.push(PairSpec {
                    name,
                    reference: map,
                    query: drive,
                    truth: Truth::Positions {
                        tolerance_m: self.tolerance_m,
                    },
                });
            }
        }
        if pairs.is_empty() {
            return Err(Failure::new(format!(
                "no pair of the study can be evaluated, as its traverses are missing: {}; make them with evpr map build",
                missing.join(", ")
            )));
        }
        Ok((pairs, missing))
    }
}

/// The name of a pair of a study, and whether it is of day and night, as the paper tells pairs apart.
pub(crate) fn condition(pair: &PairSpec) -> Option<(String, String)> {
    let (preset, sequences) = pair.name.split_once(':')?;
    // `night` of Brisbane-Event-VPR; FN0 and RN0 of NSAVP.
    let is_night = |sequence: &str| sequence == "night" || sequence.contains('N');
    let when = if sequences.split('-').any(is_night) {
        "night"
    } else {
        "day"
    };
    Some((pair.name.clone(), format!("{preset}, day–{when}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_told_apart_as_in_the_paper() {
        for (name, wanted) in [
            ("brisbane:sunset1-night", "brisbane, day–night"),
            ("brisbane:sunset1-morning", "brisbane, day–day"),
            ("nsavp:FA0-FS0", "nsavp, day–day"),
            ("nsavp:FN0-FS0", "nsavp, day–night"),
        ] {
            let truth = Truth::Positions { tolerance_m: 25.0 };
            let mut pair = PairSpec::new("map".into(), "drive".into(), truth);
            name.clone_into(&mut pair.name);
            assert_eq!(condition(&pair), Some((name.to_owned(), wanted.to_owned())));
        }
    }
}
