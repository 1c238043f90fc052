//! Answers as they are written: JSON lines, CSV and MCAP.

mod csv;
mod mcap;

use self::mcap::McapMatches;

use evpr_core::message::{Candidate, MatchHeader};
use evpr_core::{Plan, Reason};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// One line of the matches.
#[derive(Debug, Serialize)]
pub(crate) struct MatchLine<'p> {
    tick: u64,
    start_us: u64,
    end_us: u64,
    /// The map's tick, or null.
    reference: Option<u64>,
    /// Why there is no reference.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'static str>,
    /// East and north of the reference, metres, where the map has positions.
    #[serde(skip_serializing_if = "Option::is_none")]
    position: Option<[f64; 2]>,
    score: Option<f64>,
    confidence: Option<f64>,
    top: Vec<Place>,
    /// Members whose rows were used.
    members: Vec<&'p str>,
    /// Enabled members without a row, and why.
    missing: BTreeMap<&'p str, &'static str>,
    /// Every input was there: a row of each enabled member at this tick and at all that the sequence reaches back to.
    complete: bool,
    latency_us: Latency,
}

#[derive(Debug, Serialize)]
struct Place {
    reference: u32,
    score: f64,
}

/// From the closing of the last window; null where it is not known.
#[derive(Debug, Serialize)]
struct Latency {
    reconstruct: Option<f64>,
    extract: Option<f64>,
    fuse: Option<f64>,
    total: Option<f64>,
}

fn us(ns: u64) -> Option<f64> {
    (ns > 0).then(|| ns as f64 / 1_000.0)
}

/// An answer as it is written.
pub(crate) fn line<'p>(plan: &'p Plan, header: &MatchHeader, candidates: &[Candidate]) -> MatchLine<'p> {
    let mut members = Vec::new();
    let mut missing = BTreeMap::new();
    for (member, end) in plan.members.iter().zip(header.ends) {
        match (end, Reason::from_code(u32::from(end))) {
            (1, _) => members.push(member.name.as_str()),
            (_, Some(reason)) => {
                missing.insert(member.name.as_str(), reason.text());
            }
            _ => {}
        }
    }
    let reference = u64::try_from(header.reference).ok();
    MatchLine {
        tick: header.tick,
        start_us: header.start_us,
        end_us: header.end_us,
        reference,
        reason: Reason::from_code(header.reason).map(Reason::text),
        position: header
            .east_m
            .is_finite()
            .then_some([header.east_m, header.north_m]),
        score: reference.map(|_| header.score),
        confidence: reference.map(|_| header.confidence),
        top: candidates
            .iter()
            .map(|c| Place {
                reference: c.reference,
                score: c.score,
            })
            .collect(),
        members,
        missing,
        complete: header.complete != 0,
        latency_us: Latency {
            reconstruct: us(header.reconstruct_ns),
            extract: us(header.extract_ns),
            fuse: us(header.fuse_ns),
            total: us(header.total_ns),
        },
    }
}

impl MatchLine<'_> {
    /// As JSON.
    pub(crate) fn to_json(&self) -> Result<serde_json::Value, String> {
        serde_json::to_value(self).map_err(|e| e.to_string())
    }
}

/// An answer as one line of JSON, without its end.
pub(crate) fn text(
    plan: &Plan,
    header: &MatchHeader,
    candidates: &[Candidate],
) -> Result<String, serde_json::Error> {
    serde_json::to_string(&line(plan, header, candidates))
}

/// Writes matches to a file or to stdout: as CSV or MCAP where the file's name ends so, else as JSON lines.
pub(crate) struct MatchWriter {
    name: String,
    format: Format,
    target: Target,
    sink: Option<Sink>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    JsonLines,
    Csv,
    Mcap,
}

/// Of a regular file nothing is touched until the first answer is there: a run that does not start destroys nothing.
enum Target {
    Opened,
    File(PathBuf),
}

enum Sink {
    JsonLines(Box<dyn Write>),
    Csv(Box<dyn Write>),
    Mcap(Box<McapMatches>),
}

impl MatchWriter {
    /// Prepares for a file, or stdout, and checks that it can be written.
    pub(crate) fn open(path: Option<&Path>) -> Result<Self, String> {
        let Some(path) = path else {
            return Ok(Self {
                name: "stdout".to_owned(),
                format: Format::JsonLines,
                target: Target::Opened,
                sink: Some(Sink::JsonLines(Box::new(io::stdout()))),
            });
        };
        let failed = |e: io::Error| format!("cannot write {}: {e}", path.display());
        let ending = path.extension().map(|e| e.to_ascii_lowercase());
        let format = match ending.as_ref().and_then(|e| e.to_str()) {
            Some("csv") => Format::Csv,
            Some("mcap") => Format::Mcap,
            _ => Format::JsonLines,
        };
        let opened = match std::fs::metadata(path) {
            Ok(about) => {
                let file = File::options().write(true).open(path).map_err(failed)?;
                // Pipes and devices are waited for now, and cannot be emptied.
                (!about.is_file()).then(|| BufWriter::new(file))
            }
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                // Whether it can be made is only known by making it.
                File::create(path).map_err(failed)?;
                let made = path.canonicalize().map_err(failed)?;
                std::fs::remove_file(made).map_err(failed)?;
                None
            }
            Err(e) => return Err(failed(e)),
        };
        let name = path.display().to_string();
        let sink = match (opened, format) {
            (None, _) => None,
            (Some(_), Format::Mcap) => return Err(format!("{name}: MCAP can only be written to a file")),
            (Some(file), Format::JsonLines) => Some(Sink::JsonLines(Box::new(file))),
            (Some(file), Format::Csv) => Some(csv::begin(Box::new(file)).map_err(failed)?),
        };
        Ok(Self {
            name,
            format,
            target: match sink {
                Some(_) => Target::Opened,
                None => Target::File(path.to_owned()),
            },
            sink,
        })
    }

    /// Writes one answer, out to the file: a reader that follows it sees whole lines, or messages.
    pub(crate) fn write(&mut self, line: &MatchLine<'_>) -> Result<(), String> {
        let failed = |e: &dyn std::fmt::Display| format!("cannot write matches to {}: {e}", self.name);
        let sink = match (&mut self.sink, &self.target) {
            (Some(sink), _) => sink,
            (None, Target::File(path)) => {
                let file = BufWriter::new(File::create(path).map_err(|e| failed(&e))?);
                self.sink.insert(match self.format {
                    Format::JsonLines => Sink::JsonLines(Box::new(file)),
                    Format::Csv => csv::begin(Box::new(file)).map_err(|e| failed(&e))?,
                    Format::Mcap => Sink::Mcap(Box::new(McapMatches::begin(file).map_err(|e| failed(&e))?)),
                })
            }
            (None, Target::Opened) => return Ok(()),
        };
        match sink {
            Sink::JsonLines(out) => {
                let mut text = serde_json::to_string(line).map_err(|e| failed(&e))?;
                text.push('\n');
                out.write_all(text.as_bytes())
                    .and_then(|()| out.flush())
                    .map_err(|e| failed(&e))
            }
            Sink::Csv(out) => csv::write(line, out).map_err(|e| failed(&e)),
            Sink::Mcap(out) => out.write(line).map_err(|e| failed(&e)),
        }
    }

    /// Ends what has an end.
    pub(crate) fn finish(self) -> Result<(), String> {
        match self.sink {
            Some(Sink::Mcap(out)) => {
                let ended = out.finish();
                ended.map_err(|e| format!("cannot write matches to {}: {e}", self.name))
            }
            _ => Ok(()),
        }
    }
}
