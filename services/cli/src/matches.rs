//! Answers as JSON lines.

use evpr_core::message::{Candidate, MatchHeader};
use evpr_core::{Plan, Reason};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// One line of the matches.
#[derive(Debug, Serialize)]
struct MatchLine<'p> {
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

fn line<'p>(plan: &'p Plan, header: &MatchHeader, candidates: &[Candidate]) -> MatchLine<'p> {
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

/// Writes matches to a file or to stdout.
pub(crate) struct MatchWriter {
    name: String,
    sink: Sink,
}

enum Sink {
    Stdout(io::Stdout),
    /// Of a regular file nothing is touched until the first answer is there: a run that does not start destroys nothing.
    File {
        path: PathBuf,
        file: Option<BufWriter<File>>,
    },
}

impl MatchWriter {
    /// Prepares for a file, or stdout, and checks that it can be written.
    pub(crate) fn open(path: Option<&Path>) -> Result<Self, String> {
        let Some(path) = path else {
            return Ok(Self {
                name: "stdout".to_owned(),
                sink: Sink::Stdout(io::stdout()),
            });
        };
        let failed = |e: io::Error| format!("cannot write {}: {e}", path.display());
        let file = match std::fs::metadata(path) {
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
        Ok(Self {
            name: path.display().to_string(),
            sink: Sink::File {
                path: path.to_owned(),
                file,
            },
        })
    }

    /// Writes one answer, out to the file: a reader that follows it sees whole lines.
    pub(crate) fn write(
        &mut self,
        plan: &Plan,
        header: &MatchHeader,
        candidates: &[Candidate],
    ) -> Result<(), String> {
        let failed = |e: &dyn std::fmt::Display| format!("cannot write matches to {}: {e}", self.name);
        let mut text = serde_json::to_string(&line(plan, header, candidates)).map_err(|e| failed(&e))?;
        text.push('\n');
        let sink: &mut dyn Write = match &mut self.sink {
            Sink::Stdout(stdout) => stdout,
            Sink::File { file: Some(file), .. } => file,
            Sink::File { path, file } => {
                file.insert(BufWriter::new(File::create(path).map_err(|e| failed(&e))?))
            }
        };
        sink.write_all(text.as_bytes())
            .and_then(|()| sink.flush())
            .map_err(|e| failed(&e))
    }
}
