//! What pairs are made of, and files that list them.

use crate::error::EvaluateError;
use evpr_store::Orientation;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest file of pairs, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Where it is said which places are right.
#[derive(Debug, Clone, PartialEq)]
pub enum Truth {
    /// The positions in both traverses: right is what lies within so many metres.
    Positions {
        /// Metres.
        tolerance_m: f64,
    },
    /// A file: pairs (`.csv`) or a matrix (`.npy`); besides what it names, places so many ticks away are right too.
    File {
        /// The file.
        path: PathBuf,
        /// Ticks of the map.
        tolerance_frames: usize,
        /// Of a matrix whose shape does not say which axis the queries are on.
        orientation: Option<Orientation>,
    },
}

/// What a pair is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct PairSpec {
    /// Its name in results.
    pub name: String,
    /// The reference map's folder.
    pub reference: PathBuf,
    /// The query traverse's folder.
    pub query: PathBuf,
    /// Which places are right.
    pub truth: Truth,
}

/// A file of pairs:
///
/// ```toml
/// [[pair]]
/// name = "sunset1-night"          # default: reference-query, by their folders
/// reference = "maps/sunset1"      # relative to the file
/// query = "traverses/night"
/// ground_truth = "positions"      # or a .csv of query_id,reference_id, or a .npy matrix
/// tolerance_m = 25.0              # with positions
/// # tolerance_frames = 2          # with a file
/// # orientation = "query_reference"
/// condition = "day-night"         # default: none; reports tell conditions apart
///
/// [subsets]
/// fast = ["event_count@250ms/*"]
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PairsFile {
    /// The pairs.
    pub pairs: Vec<PairSpec>,
    /// Subsets with names.
    pub subsets: BTreeMap<String, Vec<String>>,
    /// What sort of pair each is, by name, where that is said.
    pub conditions: BTreeMap<String, String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileText {
    #[serde(default)]
    pair: Vec<PairText>,
    #[serde(default)]
    subsets: BTreeMap<String, Vec<String>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PairText {
    name: Option<String>,
    reference: PathBuf,
    query: PathBuf,
    ground_truth: String,
    tolerance_m: Option<f64>,
    tolerance_frames: Option<usize>,
    orientation: Option<String>,
    condition: Option<String>,
}

/// The name of a pair that has none.
fn default_name(reference: &Path, query: &Path) -> String {
    let name = |path: &Path| {
        path.file_name().map_or_else(
            || path.display().to_string(),
            |n| n.to_string_lossy().into_owned(),
        )
    };
    format!("{}-{}", name(reference), name(query))
}

impl PairSpec {
    /// A pair named after its folders.
    pub fn new(reference: PathBuf, query: PathBuf, truth: Truth) -> Self {
        Self {
            name: default_name(&reference, &query),
            reference,
            query,
            truth,
        }
    }
}

impl PairsFile {
    /// Reads a file of pairs.
    ///
    /// # Errors
    /// When it cannot be read, is not such a file, or has two pairs of one name.
    pub fn read(path: &Path) -> Result<Self, EvaluateError> {
        use std::io::Read;
        let file = std::fs::File::open(path).map_err(EvaluateError::io("open", path))?;
        let mut text = String::new();
        file.take(MAX_FILE_BYTES)
            .read_to_string(&mut text)
            .map_err(EvaluateError::io("read", path))?;
        let bad = |reason: String| EvaluateError::bad(path, reason);
        let parsed: FileText =
            toml::from_str(&text).map_err(|e| bad(e.to_string().trim().replace('\n', " ")))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut pairs: Vec<PairSpec> = Vec::new();
        let mut conditions = BTreeMap::new();
        for p in parsed.pair {
            let (reference, query) = (folder.join(&p.reference), folder.join(&p.query));
            let name = p.name.unwrap_or_else(|| default_name(&reference, &query));
            let in_pair = |reason: &str| bad(format!("pair {name}: {reason}"));
            let orientation = match p.orientation.as_deref() {
                None => None,
                Some("query_reference") => Some(Orientation::QueryReference),
                Some("reference_query") => Some(Orientation::ReferenceQuery),
                Some(_) => {
                    return Err(in_pair("orientation is query_reference or reference_query"));
                }
            };
            let truth = if p.ground_truth == "positions" {
                if p.tolerance_frames.is_some() || orientation.is_some() {
                    return Err(in_pair(
                        "with positions the tolerance is tolerance_m, and there is no orientation",
                    ));
                }
                Truth::Positions {
                    tolerance_m: p.tolerance_m.unwrap_or(25.0),
                }
            } else if p.tolerance_m.is_some() {
                return Err(in_pair("with a file the tolerance is tolerance_frames"));
            } else {
                Truth::File {
                    path: folder.join(&p.ground_truth),
                    tolerance_frames: p.tolerance_frames.unwrap_or(0),
                    orientation,
                }
            };
            if name.is_empty() || name.contains(['|', '\n', '\r', '"']) {
                return Err(in_pair("a name is not empty and has no |, quotes or line breaks"));
            }
            if pairs.iter().any(|other| other.name == name) {
                return Err(in_pair("another pair has this name; give each its own"));
            }
            if let Some(condition) = p.condition {
                if condition.trim().is_empty() || condition.chars().any(char::is_control) {
                    return Err(in_pair("a condition is a few words, such as day-night"));
                }
                conditions.insert(name.clone(), condition);
            }
            pairs.push(PairSpec {
                name,
                reference,
                query,
                truth,
            });
        }
        if pairs.is_empty() {
            return Err(bad("it has no pair; add a [[pair]]".to_owned()));
        }
        Ok(Self {
            pairs,
            subsets: parsed.subsets,
            conditions,
        })
    }
}
