//! `evpr dataset check`.

use super::config::shell;
use super::files::{Drive, File, State};
use crate::args::DatasetCheckArgs;
use crate::failure::Failure;
use crate::output::say;
use crate::preset::{Preset, Role};
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;

/// What is there of a dataset.
#[derive(Debug, Serialize)]
struct Report<'a> {
    preset: &'a str,
    title: &'a str,
    download: &'a str,
    sequences: Vec<Drive>,
    pairs: Vec<Pair<'a>>,
}

/// A comparison.
#[derive(Debug, Serialize)]
struct Pair<'a> {
    reference: &'a str,
    query: &'a str,
    /// Why it cannot be run; empty when it can.
    lacks: Vec<String>,
}

/// `evpr dataset check`.
pub(super) fn check(args: &DatasetCheckArgs) -> Result<ExitCode, Failure> {
    let presets = super::presets(args.preset.as_deref(), &args.folder)?;
    let reports: Vec<Report<'_>> = presets.iter().map(|p| report(p, &args.folder)).collect();
    if args.json {
        say!("{}", serde_json::to_string_pretty(&reports)?);
    } else {
        for (nth, report) in reports.iter().enumerate() {
            if nth > 0 {
                say!();
            }
            print(report, &args.folder);
        }
    }
    if reports.iter().any(|r| r.pairs.iter().any(|p| p.lacks.is_empty())) {
        return Ok(ExitCode::SUCCESS);
    }
    Err(Failure::new(format!(
        "{}: no pair can be run; a pair needs recordings and positions of both its sequences",
        args.folder.display()
    )))
}

fn report<'a>(preset: &'a Preset, folder: &Path) -> Report<'a> {
    let sequences: Vec<Drive> = preset
        .sequences
        .iter()
        .map(|sequence| Drive::look(preset, sequence, folder))
        .collect();
    let pair = |[reference, query]: &'a [String; 2]| {
        let drive = |name: &String| sequences.iter().find(|drive| drive.name == *name);
        let mut drives: Vec<&Drive> = [drive(reference), drive(query)].into_iter().flatten().collect();
        drives.dedup_by_key(|drive| &drive.name);
        let lacks = drives.into_iter().filter(|drive| !drive.ready());
        Pair {
            reference,
            query,
            lacks: lacks
                .map(|drive| format!("{} has {}", drive.name, drive.lacks.join(" and ")))
                .collect(),
        }
    };
    let pairs = preset.pairs.iter().map(pair).collect();
    Report {
        preset: &preset.name,
        title: &preset.title,
        download: &preset.download,
        sequences,
        pairs,
    }
}

fn print(report: &Report<'_>, folder: &Path) {
    say!("{} ({}) in {}", report.title, report.preset, folder.display());
    for drive in &report.sequences {
        say!("\n{}", drive.name);
        for file in &drive.files {
            say!("  {:<10}  {}", file.role.name(), told(file, folder));
        }
    }
    let missing = |file: &File| matches!(file.state, State::Missing);
    if report.sequences.iter().flat_map(|d| &d.files).any(missing) {
        say!(
            "\nmissing files are at {}; they belong in {}",
            report.download,
            folder.display()
        );
    }
    say!("\npairs (reference:query)");
    let names = report.pairs.iter().map(|p| p.reference.len() + p.query.len() + 1);
    let width = names.max().unwrap_or_default();
    for Pair {
        reference,
        query,
        lacks,
    } in &report.pairs
    {
        let name = format!("{reference}:{query}");
        match lacks.as_slice() {
            [] => say!("  {name:<width$}  ready"),
            lacks => say!("  {name:<width$}  not yet: {}", lacks.join("; ")),
        }
    }
    if let Some(pair) = report.pairs.iter().find(|p| p.lacks.is_empty()) {
        say!(
            "\nnext: evpr dataset config {} --pair {}:{} --out FOLDER",
            shell(folder),
            pair.reference,
            pair.query
        );
    }
}

/// A file for a person.
fn told(file: &File, folder: &Path) -> String {
    let short = |path: &Path| path.strip_prefix(folder).unwrap_or(path).display().to_string();
    let size = file.bytes.map(size).unwrap_or_default();
    match &file.state {
        State::Good(what) => format!("{} ({size}): {what}", short(&file.path)),
        State::Wrong(what) => format!("WRONG: {} ({size}): {what}", short(&file.path)),
        State::Missing => {
            let or: Vec<String> = file.or.iter().map(|path| short(path)).collect();
            let or = match or.as_slice() {
                [] => String::new(),
                names => format!(" (or {})", names.join(", ")),
            };
            let needed = match file.role {
                Role::HotPixels => "missing, not needed",
                Role::Recording | Role::Positions => "missing",
            };
            format!("{needed}: {}{or}", short(&file.path))
        }
    }
}

/// A number of bytes to three digits or more.
fn size(bytes: u64) -> String {
    match bytes as f64 {
        b if b < 1e3 => format!("{bytes} bytes"),
        b if b < 1e6 => format!("{:.1} kB", b / 1e3),
        b if b < 1e9 => format!("{:.1} MB", b / 1e6),
        b => format!("{:.2} GB", b / 1e9),
    }
}
