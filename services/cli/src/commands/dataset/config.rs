//! `evpr dataset config`: what a sequence needs to be run.

use super::files::{Drive, File};
use crate::args::DatasetConfigArgs;
use crate::catalog::{self, CATALOG};
use crate::failure::Failure;
use crate::output::say;
use crate::preset::{Preset, Role, Sequence};
use evpr_core::config::{self, CROPS, Overrides};
use evpr_core::plan::Source;
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

/// What is run unless it is said, to be changed at will.
const METHODS: &str = r#"
# How places are compared: change it alike in the files of reference and query.
[slicing]
tick = "1s"
windows = ["100ms", "250ms", "500ms", "1s"]

[[reconstruction]]
id = "event_count"

[[reconstruction]]
id = "event_count_no_polarity"

[[reconstruction]]
id = "time_surface"

[[extractor]]
id = "patch_norm"

[fuse]
sequence = { method = "paper", length = 10 }
"#;

/// The sections of a configuration that say what is run, whatever it is run on.
const SECTIONS: [&str; 8] = [
    "slicing",
    "reconstruction",
    "extractor",
    "ensemble",
    "fuse",
    "inference",
    "record",
    "runtime",
];

/// What is run, of a configuration.
fn methods_of(path: &Path) -> Result<String, Failure> {
    catalog::load(path)?;
    let wrong = |what: String| Failure::new(format!("{}: {what}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
    let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| wrong(e.to_string()))?;
    table.retain(|section, _| SECTIONS.contains(&section));
    let text = toml::to_string(&table).map_err(|e| wrong(e.to_string()))?;
    Ok(format!("\n# Of {}.\n{text}", path.display()))
}

/// `evpr dataset config`.
pub(super) fn config(args: &DatasetConfigArgs) -> Result<ExitCode, Failure> {
    let (reference, query) = args.pair.split_once(':').ok_or_else(|| {
        Failure::usage(format!(
            "--pair {} is no pair; write REFERENCE:QUERY, such as sunset1:sunset2",
            args.pair
        ))
    })?;
    let presets = super::presets(args.preset.as_deref(), &args.folder)?;
    let both = |p: &&Preset| p.sequence(reference).is_some() && p.sequence(query).is_some();
    let preset = presets.iter().find(both).ok_or_else(|| {
        let names: Vec<&str> = presets
            .iter()
            .flat_map(|p| p.sequences.iter().map(|s| s.name.as_str()))
            .collect();
        Failure::usage(format!(
            "--pair {}: the sequences are {}",
            args.pair,
            names.join(", ")
        ))
    })?;
    let folder = std::path::absolute(&args.folder)?;
    let sequences = [
        ("reference.toml", ready(preset, reference, &folder)?),
        ("query.toml", ready(preset, query, &folder)?),
    ];
    // A map fits only a run that is masked as it is.
    let unmasked: Vec<&str> = sequences
        .iter()
        .filter(|(_, (_, drive))| drive.file(Role::HotPixels).is_none())
        .map(|(_, (sequence, _))| sequence.name.as_str())
        .collect();
    let methods = args.methods.as_deref().map(methods_of).transpose()?;
    let mut texts = Vec::new();
    for (file, (sequence, drive)) in &sequences {
        let text = text(preset, sequence, &drive.files, unmasked.is_empty());
        let methods = methods.as_deref().unwrap_or(METHODS);
        texts.push((file, text.map_err(Failure::new)? + methods));
    }
    std::fs::create_dir_all(&args.out)
        .map_err(|e| Failure::new(format!("{}: cannot be made: {e}", args.out.display())))?;
    for (file, text) in texts {
        create(&args.out.join(file), &text)?;
    }
    if unmasked.len() == 1 {
        eprintln!(
            "no hot pixels are masked, as {} has no list of them; `evpr events hot-pixels` makes one",
            unmasked[0]
        );
    }
    let out = |name: &str| shell(&args.out.join(name));
    say!("evpr map build -c {} -o {}", out("reference.toml"), out("map"));
    say!(
        "evpr run -c {} -m {} -o {}",
        out("query.toml"),
        out("map"),
        out("matches.jsonl")
    );
    Ok(ExitCode::SUCCESS)
}

/// A sequence with its files, of which none that is needed is missing.
fn ready<'a>(preset: &'a Preset, name: &str, folder: &Path) -> Result<(&'a Sequence, Drive), Failure> {
    let sequence = preset
        .sequence(name)
        .ok_or_else(|| Failure::usage(format!("there is no sequence {name}")))?;
    let drive = Drive::look(preset, sequence, folder);
    if !drive.ready() {
        return Err(Failure::new(format!(
            "{name} has {}; `evpr dataset check` says what belongs where",
            drive.lacks.join(" and ")
        )));
    }
    Ok((sequence, drive))
}

/// Writes a file that must not exist yet.
fn create(path: &Path, text: &str) -> Result<(), Failure> {
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|e| match e.kind() {
        std::io::ErrorKind::AlreadyExists => Failure::new(format!(
            "{} exists already; choose another folder or remove it",
            path.display()
        )),
        _ => Failure::new(format!("{}: cannot be written: {e}", path.display())),
    })
}

/// The source as a sequence's configuration has it: what is checked is what is run.
///
/// # Errors
/// What the configuration refuses of the preset, in one line.
pub(super) fn parse(preset: &Preset, sequence: &Sequence, files: &[File]) -> Result<Source, String> {
    let text = text(preset, sequence, files, false)? + METHODS;
    let config = config::parse(&text, &sequence.name, &CATALOG)
        .map_err(|e| e.to_string().lines().next().unwrap_or_default().to_owned())?;
    let source = config.source(&Overrides::default());
    source.ok_or_else(|| format!("sequence {}: names no recording", sequence.name))
}

/// The configuration of a sequence with these files but for what is run, and with its hot pixels masked if they shall be.
fn text(preset: &Preset, sequence: &Sequence, files: &[File], masked: bool) -> Result<String, String> {
    let path = |role: Role| {
        let file = files.iter().find(|file| file.role == role);
        file.filter(|_| masked || role != Role::HotPixels)
            .map(|file| {
                let path = file.path.to_str().ok_or_else(|| {
                    format!(
                        "{}: is no UTF-8, which a configuration must be; rename it",
                        file.path.display()
                    )
                })?;
                Ok::<String, String>(quoted(path))
            })
            .transpose()
    };
    let crop = CROPS
        .all()
        .into_iter()
        .find(|word| CROPS.parse(word) == Ok(preset.crop));
    let mut text = format!(
        "# {}, sequence {}.\n[sensor]\nheight = {}\nwidth = {}\n\n[source]\n",
        preset.title.replace('\n', " "),
        sequence.name.replace('\n', " "),
        preset.sensor.height,
        preset.sensor.width
    );
    let mut line = |line: String| {
        // A string takes what is written to it.
        let _ = writeln!(text, "{line}");
    };
    if let Some(path) = path(Role::Recording)? {
        line(format!("path = {path}"));
    }
    if let Some(path) = path(Role::HotPixels)? {
        line(format!("\n[source.hot_pixels]\nfile = {path}"));
    }
    line("\n[positions]".to_owned());
    if let Some(path) = path(Role::Positions)? {
        line(format!("path = {path}"));
    }
    if let Some(seconds) = sequence.first_at {
        line(format!("first_at = {seconds:?}"));
    }
    if let Some(seconds) = sequence.offset {
        line(format!("offset = {seconds:?}"));
    }
    line(format!("zone = {}", quoted(&preset.zone)));
    if let Some(crop) = crop {
        line(format!("crop = {}", quoted(crop)));
    }
    Ok(text)
}

/// A path as a word of the shell.
pub(super) fn shell(path: &Path) -> String {
    let path = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "/._-+:@".contains(c);
    if !path.is_empty() && path.chars().all(plain) {
        return path;
    }
    format!("'{}'", path.replace('\'', r"'\''"))
}

/// A string of TOML.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
