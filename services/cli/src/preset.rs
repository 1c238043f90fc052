//! Presets of published datasets: which files they have, how their times belong together, which pairs are compared.

use crate::failure::Failure;
use evpr_core::config::parse_zone;
use evpr_core::plan::{Crop, Sensor};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

/// The presets of this executable, by name.
const BUILT_IN: [(&str, &str); 2] = [
    ("brisbane", include_str!("../../../config/datasets/brisbane.toml")),
    ("nsavp", include_str!("../../../config/datasets/nsavp.toml")),
];
/// No preset is larger, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// A dataset.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Preset {
    /// What it is called on the command line.
    pub(crate) name: String,
    /// What it is called by its authors.
    pub(crate) title: String,
    /// Its page.
    pub(crate) page: String,
    /// The page that its files come from.
    pub(crate) download: String,
    /// The sensor of all its recordings.
    #[serde(deserialize_with = "size")]
    pub(crate) sensor: Sensor,
    /// UTM zone of its positions.
    pub(crate) zone: String,
    /// What is used of its recordings.
    pub(crate) crop: Crop,
    /// Reference and query of each comparison.
    pub(crate) pairs: Vec<[String; 2]>,
    #[serde(rename = "sequence")]
    pub(crate) sequences: Vec<Sequence>,
}

/// A sensor's size without anything beside it.
fn size<'de, D: Deserializer<'de>>(from: D) -> Result<Sensor, D::Error> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Size {
        height: usize,
        width: usize,
    }
    let Size { height, width } = Size::deserialize(from)?;
    Ok(Sensor { height, width })
}

/// One drive. Files are named by their place below the dataset's folder, the one of the download first.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Sequence {
    pub(crate) name: String,
    pub(crate) recording: Vec<String>,
    pub(crate) positions: Vec<String>,
    /// None, where the dataset has no such file.
    #[serde(default)]
    pub(crate) hot_pixels: Vec<String>,
    /// Seconds added to the times of positions to give sensor times.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) offset: Option<f64>,
    /// Or the sensor time of the first position, seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) first_at: Option<f64>,
}

/// What a file of a sequence is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Role {
    Recording,
    Positions,
    HotPixels,
}

impl Role {
    pub(crate) const ALL: [Self; 3] = [Self::Recording, Self::Positions, Self::HotPixels];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Recording => "recording",
            Self::Positions => "positions",
            Self::HotPixels => "hot pixels",
        }
    }
}

impl Sequence {
    /// Where such a file may stand; empty where the dataset has none.
    pub(crate) fn places(&self, role: Role) -> &[String] {
        match role {
            Role::Recording => &self.recording,
            Role::Positions => &self.positions,
            Role::HotPixels => &self.hot_pixels,
        }
    }
}

impl Preset {
    pub(crate) fn sequence(&self, name: &str) -> Option<&Sequence> {
        self.sequences.iter().find(|s| s.name == name)
    }
}

/// Those of this executable.
///
/// # Errors
/// Never: a test reads them.
pub(crate) fn built_in() -> Result<Vec<Preset>, Failure> {
    let all = BUILT_IN.iter().map(|(name, text)| parse(text, name));
    all.collect::<Result<_, String>>().map_err(Failure::new)
}

/// The preset of this name, or in this file.
///
/// # Errors
/// When there is neither, or the file is not as it must be: one line.
pub(crate) fn find(name: &str) -> Result<Preset, Failure> {
    if let Some((_, text)) = BUILT_IN.iter().find(|(known, _)| *known == name) {
        return parse(text, name).map_err(Failure::new);
    }
    let path = Path::new(name);
    if !path.exists() {
        let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
        return Err(Failure::usage(format!(
            "--preset {name} is neither a preset ({}) nor a file; `evpr dataset list` shows the presets",
            names.join(", ")
        )));
    }
    let mut text = String::new();
    let unreadable = |e: std::io::Error| Failure::new(format!("cannot read the preset {name}: {e}"));
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let bytes = file
        .take(MAX_BYTES + 1)
        .read_to_string(&mut text)
        .map_err(unreadable)?;
    if bytes as u64 > MAX_BYTES {
        return Err(Failure::new(format!(
            "{name}: is larger than 1 MiB; a preset is a file like those in config/datasets"
        )));
    }
    parse(&text, name).map_err(Failure::new)
}

/// Reads a preset. `file` is only used to name it in errors.
fn parse(text: &str, file: &str) -> Result<Preset, String> {
    let preset: Preset = toml::from_str(text).map_err(|e| {
        let before = e
            .span()
            .and_then(|span| text.get(..span.start))
            .unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let what = e.message().replace('\n', "; ");
        format!("{file}: line {line}: {what}")
    })?;
    match fault(&preset) {
        None => Ok(preset),
        Some(what) => Err(format!("{file}: {what}")),
    }
}

/// What cannot be right.
fn fault(preset: &Preset) -> Option<String> {
    if let Err(what) = parse_zone(&preset.zone) {
        return Some(format!("zone: {what}"));
    }
    if preset.sequences.is_empty() || preset.pairs.is_empty() {
        return Some("has no sequence or no pair; it needs at least one of each".to_owned());
    }
    let mut names = BTreeSet::new();
    for sequence in &preset.sequences {
        let name = &sequence.name;
        if !names.insert(name) {
            return Some(format!("there are two sequences {name}; name each differently"));
        }
        if sequence.recording.is_empty() || sequence.positions.is_empty() {
            return Some(format!(
                "sequence {name} names no recording or no positions; it needs at least one file of each"
            ));
        }
        if sequence.offset.is_some() == sequence.first_at.is_some() {
            return Some(format!(
                "sequence {name} must have either offset or first_at; 0.0 is an offset too"
            ));
        }
    }
    let unknown = preset.pairs.iter().flatten().find(|name| !names.contains(name));
    unknown.map(|name| format!("pairs: there is no sequence {name}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_of_this_executable_are_read() {
        let presets = built_in().unwrap();
        let names: Vec<&str> = presets.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["brisbane", "nsavp"]);
        assert_eq!(presets.iter().map(|p| p.pairs.len()).sum::<usize>(), 10);
        for (preset, (name, _)) in presets.iter().zip(BUILT_IN) {
            assert_eq!(preset.name, name);
            assert_eq!(preset.sequences.len(), 6);
            // Every sequence is part of a comparison.
            let compared: BTreeSet<&String> = preset.pairs.iter().flatten().collect();
            assert_eq!(compared.len(), 6, "{name}");
        }
        let night = presets[0].sequence("night").unwrap();
        assert_eq!(night.first_at, Some(1_587_975_221.10));
        assert_eq!(
            night.places(Role::HotPixels),
            ["dvs_vpr_2020-04-27-18-13-29_hot_pixels.txt"]
        );
    }

    #[test]
    fn what_cannot_be_right_is_refused_with_its_place() {
        let good = BUILT_IN[1].1;
        for (from, to, says) in [
            ("zone = \"17N\"", "zone = \"17\"", "zone: \"17\" is not a zone"),
            (
                "zone = \"17N\"",
                "zone = \"17N\"\nspeed = 3",
                "line 12: unknown field `speed`",
            ),
            (
                "crop = \"first_motion\"",
                "crop = \"some\"",
                "line 12: unknown variant `some`",
            ),
            ("offset = 0.0", "", "R0_FA0 must have either offset or first_at"),
            (
                "offset = 0.0",
                "offset = 0.0\nfirst_at = 1.0",
                "either offset or first_at",
            ),
            (
                "[\"R0_FA0\", \"R0_FS0\"]",
                "[\"R0_FA0\", \"FS0\"]",
                "pairs: there is no sequence FS0",
            ),
            ("name = \"R0_FS0\"", "name = \"R0_FA0\"", "two sequences R0_FA0"),
            ("name = \"nsavp\"", "name = ", "line 6: "),
            (
                "width = 640",
                "width = 640, depth = 1",
                "line 10: unknown field `depth`",
            ),
        ] {
            assert!(good.contains(from), "{from}");
            let line = parse(&good.replacen(from, to, 1), "p.toml").unwrap_err();
            assert!(
                line.starts_with("p.toml: ") && line.contains(says),
                "{to}: {line}"
            );
            assert_eq!(line.lines().count(), 1, "{line}");
        }
    }
}
