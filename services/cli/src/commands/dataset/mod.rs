//! `evpr dataset`: published datasets on this machine.

mod check;
mod config;
mod files;

use crate::args::{DatasetCommand, DatasetListArgs};
use crate::failure::Failure;
use crate::output::say;
use crate::preset::{self, Preset, Role};
use std::path::Path;
use std::process::ExitCode;

/// `evpr dataset …`.
pub(crate) fn dataset(command: &DatasetCommand) -> Result<ExitCode, Failure> {
    match command {
        DatasetCommand::List(args) => list(args),
        DatasetCommand::Check(args) => check::check(args),
        DatasetCommand::Config(args) => config::config(args),
    }
}

fn list(args: &DatasetListArgs) -> Result<ExitCode, Failure> {
    let presets = preset::built_in()?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&presets)?);
        return Ok(ExitCode::SUCCESS);
    }
    for (nth, preset) in presets.iter().enumerate() {
        if nth > 0 {
            say!();
        }
        say!("{}: {}, {}", preset.name, preset.title, preset.page);
        say!("  sensor {}, UTM zone {}", preset.sensor, preset.zone);
        say!("  files from {}", preset.download);
        for sequence in &preset.sequences {
            let files = Role::ALL.iter().filter_map(|role| sequence.places(*role).first());
            let files: Vec<&str> = files.map(String::as_str).collect();
            say!("  {:<8}  {}", sequence.name, files.join("  "));
        }
        say!("  pairs (reference:query)");
        for [reference, query] in &preset.pairs {
            say!("    {reference}:{query}");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The preset that was asked for; else those of which a file is there.
fn presets(asked: Option<&str>, folder: &Path) -> Result<Vec<Preset>, Failure> {
    if !folder.is_dir() {
        return Err(Failure::new(format!(
            "{}: is not a folder; name the one that holds the dataset's files",
            folder.display()
        )));
    }
    if let Some(name) = asked {
        return Ok(vec![preset::find(name)?]);
    }
    let mut all = preset::built_in()?;
    let names: Vec<String> = all.iter().map(|p| p.name.clone()).collect();
    let there = |preset: &Preset| {
        let places = preset
            .sequences
            .iter()
            .flat_map(|s| Role::ALL.map(|role| s.places(role)));
        places.flatten().any(|place| folder.join(place).exists())
    };
    all.retain(there);
    if all.is_empty() {
        return Err(Failure::new(format!(
            "{}: holds no file of a known dataset ({}); --preset NAME says which files belong here",
            folder.display(),
            names.join(", ")
        )));
    }
    Ok(all)
}
