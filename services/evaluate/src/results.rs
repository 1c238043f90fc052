//! Results on disk: one row per configuration, appended as it is ready, so that an interrupted run goes on.
//!
//! | file | holds |
//! |---|---|
//! | `rows.jsonl` | a first line that says of which pairs they are, then one row per line, in the order they were ready |
//! | `results.csv` | all rows, one line each, sorted by their keys |
//! | `results.json` | the same with the curves |

use crate::error::EvaluateError;
use crate::measure::{FRAMES, KS, Measures, Share, TOLERANCES_M};
use crate::pair::Pair;
use crate::spec::Configuration;
use evpr_core::config::{method_label, rule_label};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

const ROWS: &str = "rows.jsonl";
/// Version of the layout of all files.
const VERSION: u32 = 1;
/// Longest line that is read back, bytes.
const MAX_LINE_BYTES: u64 = 1 << 20;

/// One configuration on one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Names it among all rows.
    pub key: String,
    /// The pair.
    pub pair: String,
    /// Similarity, as in the configuration.
    pub similarity: String,
    /// Sequence method, with the parameters that are not the default ones.
    pub method: String,
    /// Sequence length, ticks.
    pub length: usize,
    /// Fusion rule, likewise.
    pub rule: String,
    /// Name of the weights; `equal` when all are 1.
    pub weights: String,
    /// Kind of the subset.
    pub kind: crate::SubsetKind,
    /// Its name.
    pub subset: String,
    /// How many members it has.
    pub members: usize,
    /// What was measured.
    pub measures: Measures,
}

impl Row {
    pub(crate) fn new(pair: &Pair, c: &Configuration, measures: Measures) -> Self {
        Self {
            key: c.key(pair.name()),
            pair: pair.name().to_owned(),
            similarity: c.similarity_word().to_owned(),
            method: method_label(&c.method),
            length: c.length,
            rule: rule_label(&c.rule),
            weights: c.weights.clone(),
            kind: c.subset.kind,
            subset: c.subset.name.clone(),
            members: c.subset.members.len(),
            measures,
        }
    }
}

/// The first line of `rows.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Head {
    format: String,
    version: u32,
    evpr: String,
    /// Per pair what decides whether results are of the same one.
    pairs: BTreeMap<String, BTreeMap<String, String>>,
    /// What all rows have in common besides.
    #[serde(default)]
    settings: BTreeMap<String, String>,
}

/// The results in a folder.
#[derive(Debug)]
pub struct Results {
    folder: PathBuf,
    head: Head,
    rows: Vec<Row>,
    keys: BTreeSet<String>,
    file: File,
}

impl Results {
    /// Opens the results in this folder, which is made if need be, to go on with them.
    ///
    /// # Errors
    /// When it cannot be read or written, or holds other results: of a pair of the same name with other inputs.
    pub fn open(folder: &Path, pairs: &[Pair]) -> Result<Self, EvaluateError> {
        std::fs::create_dir_all(folder).map_err(EvaluateError::io("make", folder))?;
        let path = folder.join(ROWS);
        let mut head = Head {
            format: "evpr-evaluation".to_owned(),
            version: VERSION,
            evpr: env!("CARGO_PKG_VERSION").to_owned(),
            pairs: BTreeMap::new(),
            settings: BTreeMap::new(),
        };
        let mut rows = Vec::new();
        if path.exists() {
            (head, rows) = read(&path)?;
        }
        for pair in pairs {
            let Some(before) = head
                .pairs
                .get(&pair.name)
                .filter(|before| **before != pair.identity)
            else {
                head.pairs.insert(pair.name.clone(), pair.identity.clone());
                continue;
            };
            let differs = before
                .iter()
                .find(|(key, value)| pair.identity.get(*key) != Some(value));
            let (key, value) = differs.map_or(("", ""), |(k, v)| (k.as_str(), v.as_str()));
            let now = pair.identity.get(key).map_or("", String::as_str);
            let reason = format!(
                "it holds results of another pair {}: {key} was {value} and is {now}; choose another folder, or remove \
                 this one",
                pair.name
            );
            return Err(EvaluateError::bad(folder, reason));
        }
        Ok(Self {
            folder: folder.to_owned(),
            file: anew(&path, &head, &rows)?,
            head,
            keys: rows.iter().map(|r| r.key.clone()).collect(),
            rows,
        })
    }

    /// Says how all rows are computed that come from now on.
    ///
    /// # Errors
    /// When rows that are there were computed otherwise, or it cannot be written.
    pub(crate) fn settle(&mut self, setting: &str, value: &str) -> Result<(), EvaluateError> {
        match self.head.settings.get(setting) {
            Some(before) if before == value => Ok(()),
            Some(before) => Err(EvaluateError::bad(
                &self.folder,
                format!(
                    "it holds results with {setting} {before}, not {value}; choose another folder, or remove this one"
                ),
            )),
            None => {
                self.head.settings.insert(setting.to_owned(), value.to_owned());
                self.file = anew(&self.folder.join(ROWS), &self.head, &self.rows)?;
                Ok(())
            }
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether there is a row of this key.
    pub fn has(&self, key: &str) -> bool {
        self.keys.contains(key)
    }

    /// All rows.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Adds a row, on disk too.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(&mut self, row: Row) -> Result<(), EvaluateError> {
        let path = self.folder.join(ROWS);
        let text = line(&row, &path)?;
        let written = self
            .file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.flush());
        written.map_err(EvaluateError::io("write", &path))?;
        self.keys.insert(row.key.clone());
        self.rows.push(row);
        Ok(())
    }

    /// Writes `results.csv` and `results.json`.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn write(&mut self) -> Result<(), EvaluateError> {
        self.rows.sort_by(|a, b| order(a).cmp(&order(b)));
        replace(&self.folder.join("results.csv"), &csv(&self.rows))?;
        let path = self.folder.join("results.json");
        #[derive(Serialize)]
        struct All<'a> {
            #[serde(flatten)]
            head: &'a Head,
            tolerances_m: [f64; 14],
            frames: [usize; 8],
            ks: [u32; 4],
            rows: &'a [Row],
        }
        let all = All {
            head: &self.head,
            tolerances_m: TOLERANCES_M,
            frames: FRAMES,
            ks: KS,
            rows: &self.rows,
        };
        let text =
            serde_json::to_string_pretty(&all).map_err(|e| EvaluateError::bad(&path, e.to_string()))?;
        replace(&path, &(text + "\n"))
    }
}

/// Writes the rows anew: what a crash cut off in the last line is gone, and the head is the newest. Gives the file for
/// more of them.
fn anew(path: &Path, head: &Head, rows: &[Row]) -> Result<File, EvaluateError> {
    let mut text = line(head, path)?;
    for row in rows {
        text.push_str(&line(row, path)?);
    }
    replace(path, &text)?;
    OpenOptions::new()
        .append(true)
        .open(path)
        .map_err(EvaluateError::io("open", path))
}

/// Pairs and what is compared in their order, so that neighbours differ little.
fn order(row: &Row) -> impl Ord + '_ {
    (
        &row.pair,
        &row.similarity,
        &row.method,
        row.length,
        &row.rule,
        &row.weights,
        row.kind,
        &row.subset,
    )
}

fn line(value: &impl Serialize, path: &Path) -> Result<String, EvaluateError> {
    let text = serde_json::to_string(value).map_err(|e| EvaluateError::bad(path, e.to_string()))?;
    Ok(text + "\n")
}

/// Reads what an earlier run left. A last line that was cut off is left out.
fn read(path: &Path) -> Result<(Head, Vec<Row>), EvaluateError> {
    use std::io::Read;
    let file = File::open(path).map_err(EvaluateError::io("open", path))?;
    let mut file = BufReader::new(file);
    let foreign = |number: usize| {
        EvaluateError::bad(
            path,
            format!(
                "line {number} is not of an evaluation of version {VERSION}; choose another folder, or remove this one"
            ),
        )
    };
    let (mut head, mut rows) = (None, Vec::new());
    let mut keys = BTreeSet::new();
    let mut text = String::new();
    for number in 1.. {
        text.clear();
        let mut limited = file.by_ref().take(MAX_LINE_BYTES);
        if limited
            .read_line(&mut text)
            .map_err(EvaluateError::io("read", path))?
            == 0
        {
            break;
        }
        let whole = text.ends_with('\n');
        if head.is_none() {
            let found: Head = serde_json::from_str(&text).map_err(|_| foreign(number))?;
            if found.format != "evpr-evaluation" || found.version != VERSION {
                return Err(foreign(number));
            }
            head = Some(found);
            continue;
        }
        match serde_json::from_str::<Row>(&text) {
            Ok(row) if whole => {
                if keys.insert(row.key.clone()) {
                    rows.push(row);
                }
            }
            _ if !whole && (text.len() as u64) < MAX_LINE_BYTES => break,
            _ => return Err(foreign(number)),
        }
    }
    Ok((head.ok_or_else(|| foreign(1))?, rows))
}

/// Writes a file beside its place and puts it there.
pub(crate) fn replace(path: &Path, text: &str) -> Result<(), EvaluateError> {
    let new = path.with_extension("new");
    std::fs::write(&new, text).map_err(EvaluateError::io("write", &new))?;
    std::fs::rename(&new, path).map_err(EvaluateError::io("write", path))
}

/// All rows as CSV. Empty fields are not known.
fn csv(rows: &[Row]) -> String {
    let mut out =
        "pair,similarity,method,length,rule,weights,kind,subset,members,queries,matchable,answered,right,\
         recall_at_1_of_all_low,recall_at_1_of_all_high,recall_at_1_of_matchable_low,recall_at_1_of_matchable_high"
            .to_owned();
    let both = |out: &mut String, name: &str| {
        let _ = write!(out, ",{name}_of_all,{name}_of_matchable");
    };
    KS.iter().for_each(|k| both(&mut out, &format!("recall_at_{k}")));
    both(&mut out, "recall_at_1_optimistic");
    both(&mut out, "recall_at_1_pessimistic");
    out.push_str(
        ",precision_recall_area,recall_at_full_precision,error_median_m,error_mean_m,error_median_frames,\
         first_right_ticks,first_right_s",
    );
    TOLERANCES_M
        .iter()
        .for_each(|t| both(&mut out, &format!("recall_within_{t}m")));
    FRAMES
        .iter()
        .for_each(|f| both(&mut out, &format!("recall_within_{f}_frames")));
    both(&mut out, "recall_within_3s");
    out.push('\n');
    for row in rows {
        csv_line(&mut out, row);
    }
    out
}

fn csv_line(out: &mut String, row: &Row) {
    let m = &row.measures;
    let number = |n: Option<f64>| n.map_or_else(String::new, |n| format!("{n}"));
    // Writing into a string cannot fail.
    let _ = write!(
        out,
        "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
        quoted(&row.pair),
        row.similarity,
        row.method,
        row.length,
        row.rule,
        quoted(&row.weights),
        row.kind.name(),
        quoted(&row.subset),
        row.members,
        m.queries,
        m.matchable,
        m.answered,
        m.right,
        m.interval_95.of_all_low,
        m.interval_95.of_all_high,
        m.interval_95.of_matchable_low,
        m.interval_95.of_matchable_high
    );
    let both = |out: &mut String, share: Option<&Share>| {
        let _ = match share {
            Some(share) => write!(out, ",{},{}", share.of_all, share.of_matchable),
            None => write!(out, ",,"),
        };
    };
    m.recall_at.iter().for_each(|s| both(out, Some(s)));
    both(out, Some(&m.optimistic_at_1));
    both(out, Some(&m.pessimistic_at_1));
    let _ = write!(
        out,
        ",{},{},{},{},{},{},{}",
        m.precision_recall_area,
        m.recall_at_full_precision,
        number(m.error_median_m),
        number(m.error_mean_m),
        number(m.error_median_frames),
        number(m.first_right_ticks.map(|t| t as f64)),
        number(m.first_right_s)
    );
    (0..TOLERANCES_M.len()).for_each(|i| both(out, m.by_tolerance_m.get(i)));
    (0..FRAMES.len()).for_each(|i| both(out, m.by_frames.get(i)));
    both(out, m.within_3s.as_ref());
    out.push('\n');
}

/// A field of a CSV file.
pub(crate) fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}
