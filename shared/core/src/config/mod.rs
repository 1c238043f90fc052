//! The configuration: TOML as written becomes a checked [`Config`], and that becomes a [`Plan`].
//!
//! [`parse`] reports all mistakes at once, each with its line and what to write instead; what it accepts can be
//! resolved as soon as the sensor's size is known. Every key is described where it is read; [`key_reference`] lists
//! them all.

mod error;
mod frames;
mod fuse;
mod governor;
mod inference;
mod labels;
mod members;
mod noise;
mod placement;
mod positions;
mod reader;
mod schema;
mod sink;
mod slicing;
mod source;
mod stages;
mod supervision;
mod syntax;
mod test_catalog;
mod words;

pub use error::{ConfigError, ConfigErrors};
pub use inference::{DEFAULT_REGISTRY, registry_path};
pub use labels::{method_label, parse_method, parse_rule, rule_label};
pub use positions::parse_zone;
pub use sink::KeyDoc;
pub use test_catalog::test_catalog;
pub use words::{
    ALIGNS, CROPS, DELIVERIES, FRAME_TICKS, MASKED_BY, ON_BACKWARD_TIME, ON_OTHER_SIZE, ON_OUTSIDE_SENSOR,
    POSITION_COMPATS, POSITION_KINDS, PROVIDERS, RAW_FORMATS, ROW_TYPES, RULES, SEQUENCE_METHODS,
    SIMILARITIES, SLICE_MODES, STACK_ORDERS, STREET_PASSES, TIME_UNITS, Words, parse_origin, parse_pace,
};

use crate::plan::{
    Catalog, Crop, Delivery, Extractor, FrameSource, FrameTicks, Fuse, Governor, Inference, LiveSource,
    Member, OnBadEvent, OnOtherSize, Pace, Placement, Plan, Positions, Reconstruction, RowType, Sensor,
    Slicing, Source, Street, StreetPass, Supervision,
};
use positions::PositionsSection;
use reader::Table;
use schema::RuntimeSection;
use sink::Sink;
use source::{SourceKind, SourceSection};
use std::path::PathBuf;

/// A checked configuration. What it leaves open is the sensor's size and the recording, where it does not name them.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    name: String,
    sensor: Option<Sensor>,
    source: SourceSection,
    positions: PositionsSection,
    slicing: Slicing,
    reconstructions: Vec<Reconstruction>,
    extractors: Vec<Extractor>,
    members: Vec<Member>,
    fuse: Fuse,
    inference: Inference,
    record_rows: RowType,
    runtime: RuntimeSection,
    governor: Option<Governor>,
    placements: Vec<Placement>,
    supervision: Supervision,
    /// Where to point when the sensor or the recording turns out to be wrong or missing.
    places: Places,
}

#[derive(Debug, Clone, PartialEq)]
struct Places {
    sensor: ConfigError,
    source: ConfigError,
    crop: ConfigError,
}

/// What the command line says instead of the configuration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overrides {
    /// `--name`: name of the instance, 1 to 20 of `a-z`, `0-9`, `_` and `-`.
    pub name: Option<String>,
    /// `--input`: the recording; of a street the pass.
    pub input: Option<PathBuf>,
    /// `--positions`: the file of positions that belongs to the recording.
    pub positions: Option<PathBuf>,
    /// `--pace`.
    pub pace: Option<Pace>,
    /// `--delivery`.
    pub delivery: Option<Delivery>,
    /// `--map`: the reference map; with it the plan has a fuser.
    pub map: Option<PathBuf>,
    /// `--record`: the traverse to write; with it the plan has a recorder.
    pub record: Option<PathBuf>,
}

/// Parses and checks a configuration. `file` is only used to name it in errors.
///
/// # Errors
/// All mistakes: in the syntax, unknown keys, wrong types, values out of range, names of things that do not exist,
/// and what contradicts itself.
pub fn parse(text: &str, file: &str, catalog: &Catalog<'_>) -> Result<Config, ConfigErrors> {
    let document = syntax::parse(text);
    let sink = Sink::new(text, file);
    let config = read(&sink, Table::root(&sink, &document.table), catalog);
    match (config, sink.into_errors(&document.errors, document.trusted_until)) {
        (Some(config), None) => Ok(config),
        (_, Some(errors)) => Err(errors),
        (None, None) => Err(ConfigErrors::new(vec![ConfigError {
            file: file.to_owned(),
            line: 0,
            column: 0,
            key: String::new(),
            message: "cannot be used, and no check says why; this is a fault of evpr".to_owned(),
        }])),
    }
}

/// Every key of the configuration, in the order of the sections. The parameters of a kind are in the [`Catalog`].
pub fn key_reference(catalog: &Catalog<'_>) -> Vec<KeyDoc> {
    let example = "[[reconstruction]]\n[[extractor]]\n[[placement]]\n";
    let document = syntax::parse(example);
    let sink = Sink::new(example, "");
    read(&sink, Table::root(&sink, &document.table), catalog);
    sink.keys()
}

fn read<'r>(sink: &Sink<'r>, root: Table<'r>, catalog: &Catalog<'_>) -> Option<Config> {
    let name = schema::run(root.section("run"));
    let sensor_table = root.section("sensor");
    let sensor_at = sensor_table.at.clone();
    let sensor = schema::sensor(sensor_table);
    let source_table = root.section("source");
    let source_at = |key| source_table.below(key, source_table.at.offset);
    let (path_at, address_at) = (source_at("path"), source_at("address"));
    let (source_kind, source) = source::source(source_table);
    let source_at = if source_kind.is_some_and(|kind| SourceKind::CONNECTED.contains(&kind)) {
        address_at
    } else {
        path_at
    };
    let positions = positions::positions(root.section("positions"), source_kind);
    let frames = source_kind.filter(|kind| *kind == SourceKind::Frames).map(|_| {
        // Where the section is bad no key of the slicing is refused that could be right.
        source
            .as_ref()
            .map_or(FrameTicks::Time, |source| source.frames.ticks)
    });
    let slicing = slicing::slicing(root.section("slicing"), frames);
    let mut reconstructions = stages::reconstructions(&root, catalog);
    for (at, kind) in &reconstructions.kinds {
        frames::check_reconstruction(sink, at, kind, source_kind);
    }
    let mut extractors = stages::extractors(&root, catalog);
    let (of_frames, of_rows) = (reconstructions.stages.as_mut(), extractors.stages.as_mut());
    stages::deal_threads(of_frames, of_rows, catalog.cores);
    if let (Some(source), Some(stages)) = (&source, &reconstructions.stages) {
        noise::check_masking(sink, source.hot_pixels.as_ref(), stages);
    }
    let parts = members::Parts::new(&reconstructions, slicing.as_ref(), &extractors);
    let members = members::ensemble(root.section("ensemble"), &parts);
    let fuse = fuse::fuse(root.section("fuse"));
    let inference = inference::inference(root.section("inference"));
    let record_rows = schema::record(root.section("record"));
    let runtime = schema::runtime(root.section("runtime"));
    let governor = governor::governor(root.section("governor"), members.as_deref());
    let (of_frames, of_rows) = (reconstructions.known_ids(), extractors.known_ids());
    let placements = placement::placements(&root, of_frames.as_deref(), of_rows.as_deref());
    let supervision = supervision::supervision(root.section("supervision"));
    // What `evpr evaluate` does with a configuration's members: not of the graph, and read there.
    let _ = root.section("study");
    root.close();
    let positions = positions?;
    Some(Config {
        name: name?,
        sensor: sensor?,
        source: source?,
        positions: positions.clone(),
        slicing: slicing?,
        reconstructions: reconstructions.stages?,
        extractors: extractors.stages?,
        members: members?,
        fuse: fuse?,
        inference: inference?,
        record_rows: record_rows?,
        runtime: runtime?,
        governor: governor?,
        placements: placements?,
        supervision: supervision?,
        places: Places {
            sensor: sink.error(&sensor_at, ""),
            source: sink.error(&source_at, ""),
            crop: sink.error(&positions.crop_at, ""),
        },
    })
}

impl Config {
    /// Size of the sensor, when the configuration gives it. When it does not, ask the recording.
    pub fn sensor(&self) -> Option<Sensor> {
        self.sensor
    }

    /// The source, when there is one to read: of the overrides or of the configuration. A street whose pass the
    /// overrides misname is that of the configuration; [`Config::resolve`] says what is wrong.
    pub fn source(&self, overrides: &Overrides) -> Option<Source> {
        let written = &self.source;
        let source = match written.kind {
            SourceKind::File => Source::file(overrides.input.clone().or_else(|| written.path.clone())?),
            SourceKind::Frames => {
                let path = overrides.input.clone().or_else(|| written.path.clone())?;
                let resize = written.frames.on_other_size == OnOtherSize::Resize;
                let frames = FrameSource {
                    size: self.sensor.filter(|_| resize),
                    ..written.frames.clone()
                };
                Source::frames(path, frames)
            }
            SourceKind::Street => Source::street(Street {
                pass: self.pass(overrides).ok().flatten().unwrap_or(written.street.pass),
                sensor: self.sensor.unwrap_or(written.street.sensor),
                ..written.street.clone()
            }),
            kind => {
                let connected = SourceKind::CONNECTED.contains(&kind);
                let given = overrides.input.as_ref().filter(|_| connected);
                let given = given.map(|input| input.to_string_lossy().into_owned());
                let live = LiveSource {
                    address: given.or_else(|| written.address.clone()),
                    serial: written.serial.clone(),
                    slack_ns: written.slack_ns,
                };
                if connected && live.address.is_none() {
                    return None;
                }
                Source::live(kind.name(), live)
            }
        };
        let delivery = overrides.delivery.unwrap_or(self.runtime.delivery);
        let waits = source.live.is_none() || (source.is_stdin() && delivery == Delivery::Lossless);
        let on_bad = if waits {
            OnBadEvent::Error
        } else {
            OnBadEvent::Drop
        };
        Some(Source {
            pace: overrides.pace.unwrap_or(written.pace),
            time_unit: written.time_unit,
            format: written.format.map(str::to_owned),
            on_backward_time: written.on_backward_time.unwrap_or(on_bad),
            on_outside_sensor: written.on_outside_sensor.unwrap_or(on_bad),
            hot_pixels: written.hot_pixels.as_ref().map(|section| section.mask.clone()),
            filters: written.filters,
            positions: self.positions(overrides),
            ..source
        })
    }

    /// What is wrong with the source that the command line gives, by its option.
    fn wrong_options(&self, overrides: &Overrides) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let kind = self.source.kind;
        let has_no_effect = format!(
            "has no effect with source.kind = \"{}\"; leave it out",
            kind.name()
        );
        match &overrides.input {
            Some(input) if SourceKind::CONNECTED.contains(&kind) => {
                if let Err(message) = source::check_address(&input.to_string_lossy()) {
                    wrong.push(("--input", message));
                }
            }
            Some(_) if kind.is_live() => wrong.push(("--input", has_no_effect.clone())),
            _ => {}
        }
        if let Err(message) = self.pass(overrides) {
            wrong.push(("--input", format!("with source.kind = \"street\", {message}")));
        }
        if overrides.pace.is_some() && kind.is_live() {
            wrong.push(("--pace", has_no_effect));
        }
        wrong
    }

    /// The file of positions, if there is one.
    fn positions(&self, overrides: &Overrides) -> Option<Positions> {
        let path = overrides.positions.as_ref().or(self.positions.path.as_ref())?;
        Some(self.positions.of(path))
    }

    /// What is wrong with the file of positions beside these overrides.
    fn wrong_positions(&self, overrides: &Overrides) -> Option<(&'static str, String)> {
        let street = self.source.kind == SourceKind::Street;
        match (&overrides.positions, &self.positions.path, &overrides.input) {
            (Some(_), _, _) if street => Some((
                "--positions",
                "the simulated street knows where it is; leave it out".to_owned(),
            )),
            (None, Some(path), Some(input)) if self.source.path.as_ref().is_some_and(|own| own != input) => {
                let own = path.display();
                Some((
                    "--input",
                    format!(
                        "{own} (positions.path) belongs to source.path; give the positions of this recording with --positions"
                    ),
                ))
            }
            _ => None,
        }
    }

    /// The pass of the street that the overrides name, if they do.
    fn pass(&self, overrides: &Overrides) -> Result<Option<StreetPass>, String> {
        match (&overrides.input, self.source.kind) {
            (Some(input), SourceKind::Street) => STREET_PASSES.parse(&input.to_string_lossy()).map(Some),
            _ => Ok(None),
        }
    }

    /// How events are cut.
    pub fn slicing(&self) -> &Slicing {
        &self.slicing
    }

    /// The members, in the plan's order.
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// What the fuser does.
    pub fn fuse(&self) -> &Fuse {
        &self.fuse
    }

    /// The plan for this sensor: the configuration's own size, or else the recording's.
    ///
    /// # Errors
    /// All of: there is no recording to read, the sensor is not the one that the configuration gives or its size is
    /// out of range, an override is out of range.
    pub fn resolve(&self, sensor: Sensor, overrides: &Overrides) -> Result<Plan, ConfigErrors> {
        let mut errors = Vec::new();
        let in_file = |place: &ConfigError, message: String| ConfigError {
            message,
            ..place.clone()
        };
        let option = |key: &str, message: String| ConfigError {
            file: "command line".to_owned(),
            line: 0,
            column: 0,
            key: key.to_owned(),
            message: error::one_line(&message),
        };
        if let Some(given) = self.sensor.filter(|given| *given != sensor) {
            let message = format!("is {given}, but the recording's is {sensor}; correct it, or leave it out");
            errors.push(in_file(&self.places.sensor, message));
        } else if ![sensor.height, sensor.width]
            .iter()
            .all(|side| (1..=schema::MAX_SIDE).contains(side))
        {
            let message = format!(
                "{sensor} is out of range; height and width are 1 to {}",
                schema::MAX_SIDE
            );
            errors.push(in_file(&self.places.sensor, message));
        }
        let source = self.source(overrides);
        if source.is_none() {
            let message = if !SourceKind::CONNECTED.contains(&self.source.kind) {
                "is missing; write the recording's path here, or give it with --input"
            } else {
                "is missing; write the camera's address here, such as \"192.168.0.7:7777\", or give it with --input"
            };
            errors.push(in_file(&self.places.source, message.to_owned()));
        }
        let wrong = self.wrong_options(overrides).into_iter();
        errors.extend(wrong.map(|(key, message)| option(key, message)));
        if let Some((key, message)) = self.wrong_positions(overrides) {
            errors.push(option(key, message));
        }
        if self.positions.crop != Crop::None && self.positions(overrides).is_none() {
            let message =
                "has no effect without positions; write positions.path, or give them with --positions";
            errors.push(in_file(&self.places.crop, message.to_owned()));
        }
        let name = overrides.name.as_deref().unwrap_or(&self.name);
        if let Err(message) = schema::check_name(name, schema::MAX_RUN_NAME) {
            errors.push(option("--name", message));
        }
        if let Some(Pace::Factor(factor)) = overrides.pace
            && let Err(message) = words::pace_of_factor(factor)
        {
            errors.push(option("--pace", message));
        }
        let Some(source) = source.filter(|_| errors.is_empty()) else {
            return Err(ConfigErrors::new(errors));
        };
        Ok(Plan {
            name: name.to_owned(),
            source,
            sensor,
            slicing: self.slicing.clone(),
            reconstructions: self.reconstructions.clone(),
            extractors: self.extractors.clone(),
            members: self.members.clone(),
            fuse: self.fuse.clone(),
            inference: self.inference.clone(),
            delivery: overrides.delivery.unwrap_or(self.runtime.delivery),
            deadline_ns: self.runtime.deadline_ns,
            governor: self.governor.clone(),
            placements: self.placements.clone(),
            supervision: self.supervision,
            map: overrides.map.clone(),
            record: overrides.record.clone(),
            record_rows: self.record_rows,
            record_events: None,
            dashboard: false,
        })
    }
}
