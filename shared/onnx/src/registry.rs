//! The registry of models: a TOML file with one stanza `[[model]]` per network.

use crate::error::OnnxError;
use evpr_core::plan::{Color, InputSize, Model, ModelKind, Preprocessing, Resize};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::{Path, PathBuf};

/// The most that a registry may be long, bytes.
const LONGEST: u64 = 1 << 20;

/// The networks that a registry describes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Registry {
    /// The models, in the file's order; their files are relative to the current folder, or absolute.
    pub models: Vec<Model>,
}

/// As written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    model: Vec<toml::Spanned<Stanza>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Sort {
    Extractor,
    Reconstruction,
}

/// A stanza as written: what belongs to one sort of network alone is optional here, and asked for in [`Stanza::model`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stanza {
    id: String,
    kind: Sort,
    file: PathBuf,
    sha256: String,
    output: Option<String>,
    #[serde(default)]
    licence: String,
    #[serde(default)]
    source: String,
    input: Option<InputSize>,
    resize: Option<Resize>,
    color: Option<Color>,
    range: Option<f64>,
    mean: Option<Vec<f64>>,
    std: Option<Vec<f64>>,
    dimension: Option<usize>,
    bins: Option<usize>,
    multiple: Option<usize>,
    states: Option<Vec<String>>,
}

impl Registry {
    /// Reads a registry. There may be none: nothing of it is needed until a configuration names a network.
    ///
    /// # Errors
    /// When it is there but cannot be read, or says what cannot be.
    pub fn read(path: &Path) -> Result<Option<Self>, OnnxError> {
        let wrong = |problem: String| OnnxError::Registry {
            path: path.to_path_buf(),
            problem,
        };
        let mut text = String::new();
        match std::fs::File::open(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(wrong(format!("cannot be read: {e}"))),
            Ok(file) => {
                let read = file.take(LONGEST + 1).read_to_string(&mut text);
                read.map_err(|e| wrong(format!("cannot be read: {e}")))?;
            }
        }
        if text.len() as u64 > LONGEST {
            return Err(wrong(format!(
                "is longer than {LONGEST} bytes, which no registry of models is"
            )));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse(&text, folder).map(Some).map_err(wrong)
    }

    /// Reads the text of a registry whose files are relative to `folder`. The error is one line with its place.
    fn parse(text: &str, folder: &Path) -> Result<Self, String> {
        let line = |offset: usize| text[..offset.min(text.len())].matches('\n').count() + 1;
        let file: File = toml::from_str(text).map_err(|e| {
            let at = e.span().map_or(0, |span| span.start);
            format!("line {}: {}", line(at), e.message().replace('\n', " "))
        })?;
        let mut models: Vec<Model> = Vec::new();
        for stanza in file.model {
            let at = line(stanza.span().start);
            let stanza = stanza.into_inner();
            let id = stanza.id.clone();
            let wrong = |problem: String| format!("line {at}: model {id:?}: {problem}");
            let model = stanza.model(folder).map_err(wrong)?;
            if models.iter().any(|other| other.id == model.id) {
                return Err(wrong("there is another of this id; write another one".to_owned()));
            }
            models.push(model);
        }
        Ok(Self { models })
    }
}

impl Stanza {
    fn model(self, folder: &Path) -> Result<Model, String> {
        let name_ok = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-';
        if !(1..=64).contains(&self.id.len()) || !self.id.chars().all(name_ok) {
            return Err("its id is no name; write 1 to 64 of a-z, 0-9, _ and -".to_owned());
        }
        let file = self.file.to_string_lossy();
        let texts = [
            file.as_ref(),
            self.output.as_deref().unwrap_or(""),
            &self.licence,
            &self.source,
        ];
        if texts.iter().any(|text| text.contains(char::is_control)) {
            return Err(
                "file, output, licence and source are one line each; remove control characters".to_owned(),
            );
        }
        let sha256 = self.sha256.to_ascii_lowercase();
        if sha256.len() != 64 || !sha256.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err("sha256 is no hash; write the 64 hexadecimal digits of `sha256sum FILE`".to_owned());
        }
        let (kind, output) = match self.kind {
            Sort::Extractor => (self.extractor()?, "descriptor"),
            Sort::Reconstruction => (self.reconstruction()?, "image"),
        };
        Ok(Model {
            file: folder.join(&self.file),
            id: self.id,
            sha256,
            output: self.output.unwrap_or_else(|| output.to_owned()),
            kind,
            licence: self.licence,
            source: self.source,
        })
    }

    fn extractor(&self) -> Result<ModelKind, String> {
        let strangers = [
            ("bins", self.bins.is_some()),
            ("multiple", self.multiple.is_some()),
            ("states", self.states.is_some()),
        ];
        no_strangers(&strangers, "extractor")?;
        let dimension = self
            .dimension
            .ok_or("dimension is missing; write the length of its descriptors")?;
        if !(1..=1 << 20).contains(&dimension) {
            return Err(format!(
                "dimension {dimension} is out of range; it is 1 to 1048576"
            ));
        }
        let preprocessing = Preprocessing {
            input: self.input.unwrap_or(InputSize::Native),
            resize: self.resize.unwrap_or(Resize::None),
            color: self.color.unwrap_or(Color::Rgb),
            range: self.range.unwrap_or(1.0),
            mean: self.mean.clone().unwrap_or_default(),
            std: self.std.clone().unwrap_or_default(),
        };
        let channels = preprocessing.color.channels();
        let counts = [("mean", &preprocessing.mean), ("std", &preprocessing.std)];
        for (key, values) in counts {
            if values.len() != channels {
                return Err(format!(
                    "{key} has {} numbers, and its input {channels} channels; write as many",
                    values.len()
                ));
            }
        }
        let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
        if !finite(&preprocessing.mean) || !preprocessing.std.iter().all(|v| v.is_finite() && *v > 0.0) {
            return Err("mean and std must be finite, and std above 0".to_owned());
        }
        if !(preprocessing.range.is_finite() && preprocessing.range > 0.0) {
            return Err("range must be above 0; write 1.0 or 255.0".to_owned());
        }
        let resizes = preprocessing.resize != Resize::None;
        if resizes && preprocessing.input == InputSize::Native {
            return Err(
                "resize has no effect with input = \"native\"; write the size, or resize = \"none\""
                    .to_owned(),
            );
        }
        if !resizes
            && matches!(
                preprocessing.input,
                InputSize::Fixed { .. } | InputSize::Multiple(_)
            )
        {
            return Err(format!(
                "input = \"{}\" needs resize = \"antialiased_bilinear\"; write it, or input = \"native\"",
                preprocessing.input
            ));
        }
        Ok(ModelKind::Extractor {
            preprocessing,
            dimension,
        })
    }

    fn reconstruction(&self) -> Result<ModelKind, String> {
        let strangers = [
            ("input", self.input.is_some()),
            ("resize", self.resize.is_some()),
            ("color", self.color.is_some()),
            ("range", self.range.is_some()),
            ("mean", self.mean.is_some()),
            ("std", self.std.is_some()),
            ("dimension", self.dimension.is_some()),
        ];
        no_strangers(&strangers, "reconstruction")?;
        let bins = self.bins.unwrap_or(5);
        let multiple = self.multiple.unwrap_or(1);
        if !(1..=64).contains(&bins) || !(1..=1024).contains(&multiple) {
            return Err("bins are 1 to 64, and multiple is 1 to 1024".to_owned());
        }
        Ok(ModelKind::Reconstruction {
            bins,
            multiple,
            states: self.states.clone().unwrap_or_default(),
        })
    }
}

fn no_strangers(keys: &[(&str, bool)], kind: &str) -> Result<(), String> {
    match keys.iter().find(|(_, there)| *there) {
        Some((key, _)) => Err(format!("{key} means nothing with kind = \"{kind}\"; remove it")),
        None => Ok(()),
    }
}

/// SHA-256 of these bytes, in hexadecimal digits.
pub(crate) fn hex_sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(hash: &[u8]) -> String {
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256 of a file, in hexadecimal digits.
///
/// # Errors
/// When it cannot be read.
pub fn sha256_of(path: &Path) -> std::io::Result<String> {
    let mut file = std::fs::File::open(path)?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        let read = file.read(&mut buffer)?;
        if read == 0 {
            break;
        }
        hash.update(&buffer[..read]);
    }
    Ok(hex(&hash.finalize()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extractor(changed: &str) -> String {
        let sha = "a".repeat(64);
        let all = [
            ("id", "id = \"mixvpr\"".to_owned()),
            ("kind", "kind = \"extractor\"".to_owned()),
            ("file", "file = \"mixvpr.onnx\"".to_owned()),
            ("sha256", format!("sha256 = \"{sha}\"")),
            ("mean", "mean = [0.485, 0.456, 0.406]".to_owned()),
            ("std", "std = [0.229, 0.224, 0.225]".to_owned()),
            ("dimension", "dimension = 4096".to_owned()),
        ];
        let changed_key = changed.split('=').next().unwrap_or("").trim().to_owned();
        let lines = all.into_iter().filter(|(key, _)| *key != changed_key);
        let lines: Vec<String> = lines.map(|(_, line)| line).collect();
        format!("[[model]]\n{}\n{changed}\n", lines.join("\n"))
    }

    fn parse(text: &str) -> Result<Registry, String> {
        Registry::parse(text, Path::new("models"))
    }

    #[test]
    fn an_entry_has_the_paper_s_preprocessing_where_it_is_silent() {
        let registry = parse(&extractor("")).unwrap();
        let model = &registry.models[0];
        assert_eq!(model.file, Path::new("models/mixvpr.onnx"));
        assert_eq!(model.output, "descriptor");
        let ModelKind::Extractor {
            preprocessing,
            dimension,
        } = &model.kind
        else {
            panic!("{model:?}");
        };
        assert_eq!(*dimension, 4096);
        assert_eq!(preprocessing.input, InputSize::Native);
        assert_eq!(preprocessing.color, Color::Rgb);
        assert_eq!(preprocessing.range, 1.0);
        let e2vid = format!(
            "[[model]]\nid = \"e2vid\"\nkind = \"reconstruction\"\nfile = \"/m/e2vid.onnx\"\nsha256 = \"{}\"\n\
             multiple = 8\nstates = [\"h0\", \"c0\"]\n",
            "0".repeat(64)
        );
        let model = &parse(&e2vid).unwrap().models[0];
        assert_eq!(model.file, Path::new("/m/e2vid.onnx"));
        let states = vec!["h0".to_owned(), "c0".to_owned()];
        assert_eq!(
            model.kind,
            ModelKind::Reconstruction {
                bins: 5,
                multiple: 8,
                states
            }
        );
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        for (changed, expected) in [
            ("id = \"Mix VPR\"", "line 1: model \"Mix VPR\": its id is no name"),
            ("sha256 = \"abc\"", "sha256 is no hash"),
            ("id = \"a\\nb\"", "line 1: model \"a\\nb\": its id is no name"),
            ("source = \"\\u001b[31m\"", "remove control characters"),
            ("mean = [1.0]", "mean has 1 numbers, and its input 3 channels"),
            ("std = [1.0, 0.0, 1.0]", "std above 0"),
            ("dimension = 0", "dimension 0 is out of range"),
            ("kind = \"network\"", "line 8: unknown variant `network`"),
            ("range = -1.0", "range must be above 0"),
            ("input = \"320\"", "line 9: \"320\" is no input size"),
            ("input = \"320x320\"", "needs resize = \"antialiased_bilinear\""),
            (
                "resize = \"antialiased_bilinear\"",
                "resize has no effect with input = \"native\"",
            ),
            ("bins = 5", "bins means nothing with kind = \"extractor\""),
            ("colour = \"rgb\"", "line 9: unknown field `colour`"),
        ] {
            let problem = parse(&extractor(changed)).unwrap_err();
            assert!(problem.contains(expected), "{changed}: {problem}");
            assert!(!problem.contains('\n'), "{problem}");
        }
        let twice = extractor("") + &extractor("");
        assert!(
            parse(&twice)
                .unwrap_err()
                .contains("line 10: model \"mixvpr\": there is another")
        );
    }

    #[test]
    fn a_registry_that_is_not_there_is_none() {
        assert_eq!(Registry::read(Path::new("/nowhere/models.toml")), Ok(None));
        let problem = Registry::read(Path::new("/")).unwrap_err().to_string();
        assert!(problem.starts_with("/: cannot be read: "), "{problem}");
    }
}
