//! The plan: a configuration resolved into everything a process needs to know. It is made once, by the
//! supervisor, and handed to every process as a file.

mod channels;
mod frames;
mod fuse;
mod kind;
mod model;
mod noise;
mod placement;
mod positions;
mod slicing;
mod source;
mod supervision;

pub use channels::{Channel, SCORE_COLUMNS, SPANS_AT_ONCE, Topic};
pub use frames::{FRAMES, FrameSource, FrameTicks, OnOtherSize, StackOrder};
pub use fuse::{
    Filter, Fuse, MAX_DEADLINE_NS, MAX_LENGTH, Rule, SeqSlam, SequenceMethod, Similarity, Transition,
};
pub use kind::*;
pub use model::{
    Color, Inference, InputSize, Model, ModelKind, Models, Network, Preprocessing, Provider, Resize,
    threads_of,
};
pub use noise::{Filters, HotPixelRule, HotPixels, HotPixelsFrom, MaskedBy, Pixel};
pub use placement::Placement;
pub use positions::{
    Crop, DEFAULT_MAX_GAP_NS, PositionClock, PositionCompat, PositionKind, Positions, UtmZone,
};
pub use slicing::{Align, Origin, SegmentPlan, SliceMode, Slicing, WindowSpan};
pub use source::{LiveSource, OnBadEvent, Pace, Source, Street, StreetPass, TAPE, TimeUnit};
pub use supervision::Supervision;

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Size of the sensor in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sensor {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl Sensor {
    /// Pixels.
    pub fn pixels(self) -> usize {
        self.height * self.width
    }
}

impl std::fmt::Display for Sensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}×{} (height × width)", self.height, self.width)
    }
}

/// A parameter of a reconstruction or an extractor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ParamValue {
    /// A whole number; durations are in nanoseconds.
    Integer(i64),
    /// A number.
    Float(f64),
    /// A word.
    Text(String),
}

impl std::fmt::Display for ParamValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ParamValue::Integer(v) => write!(f, "{v}"),
            ParamValue::Float(v) => write!(f, "{v}"),
            ParamValue::Text(v) => write!(f, "{v}"),
        }
    }
}

/// All parameters of a kind, defaults filled in.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Params(pub BTreeMap<String, ParamValue>);

impl Params {
    /// A whole number (durations: ns); 0 when there is none of this name.
    pub fn integer(&self, name: &str) -> i64 {
        match self.0.get(name) {
            Some(ParamValue::Integer(v)) => *v,
            Some(ParamValue::Float(v)) => *v as i64,
            _ => 0,
        }
    }

    /// A number; 0 when there is none of this name.
    pub fn float(&self, name: &str) -> f64 {
        match self.0.get(name) {
            Some(ParamValue::Integer(v)) => *v as f64,
            Some(ParamValue::Float(v)) => *v,
            _ => 0.0,
        }
    }

    /// A word; empty when there is none of this name.
    pub fn text(&self, name: &str) -> &str {
        match self.0.get(name) {
            Some(ParamValue::Text(v)) => v,
            _ => "",
        }
    }
}

/// One reconstruction of the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reconstruction {
    /// Its name in member names and topics.
    pub id: String,
    /// The method: a row of the reconstruct crate's registry.
    pub kind: String,
    /// Channels per pixel that its frames may have. A frame says which it has; it may be grey instead.
    pub channels: usize,
    /// The method's parameters.
    pub params: Params,
    /// Whether its kind leaves hot pixels out by itself, as [`ReconstructionKind::masks_hot_pixels`].
    #[serde(default)]
    pub masks_hot_pixels: bool,
    /// Whether the rest goes on without it.
    #[serde(default)]
    pub optional: bool,
    /// The network, where it is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<Network>,
}

/// One extractor of the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Extractor {
    /// Its name in member names and topics.
    pub id: String,
    /// The kind: a row of the extract crate's registry.
    pub kind: String,
    /// Length of its rows.
    pub dim: usize,
    /// The kind's parameters.
    pub params: Params,
    /// Whether the rest goes on without it.
    #[serde(default)]
    pub optional: bool,
    /// The network, where it is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<Network>,
}

/// One member of the ensemble: reconstruction @ window / extractor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// `event_count@250ms/mixvpr`.
    pub name: String,
    /// Index into the plan's reconstructions.
    pub reconstruction: usize,
    /// Index into the plan's windows.
    pub window: usize,
    /// Index into the plan's extractors.
    pub extractor: usize,
    /// Whether it starts enabled.
    pub enabled: bool,
    /// Its weight at the start.
    pub weight: f64,
}

/// How processes hand data on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Delivery {
    /// Every stage waits for the next; two replays give the same answers.
    Lossless,
    /// The newest data wins; whole ticks are dropped and counted; answers at the deadline.
    Latest,
}

/// How the numbers of rows are kept on disk.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RowType {
    /// 32 bits: as they are.
    #[default]
    F32,
    /// 16 bits (IEEE 754 binary16): half the room; each number is rounded to 11 binary digits.
    F16,
}

impl RowType {
    /// As in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            RowType::F32 => "f32",
            RowType::F16 => "f16",
        }
    }

    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            RowType::F32 => 4,
            RowType::F16 => 2,
        }
    }
}

/// Everything a process of one run needs to know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the instance.
    pub name: String,
    /// Where events come from.
    pub source: Source,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// How events are cut.
    pub slicing: Slicing,
    /// Reconstructions.
    pub reconstructions: Vec<Reconstruction>,
    /// Extractors.
    pub extractors: Vec<Extractor>,
    /// Members.
    pub members: Vec<Member>,
    /// What the fuser does.
    pub fuse: Fuse,
    /// How networks are run.
    #[serde(default)]
    pub inference: Inference,
    /// How processes hand data on.
    pub delivery: Delivery,
    /// Latest delivery: the answer is due this long after the tick's last window closed, ns.
    pub deadline_ns: u64,
    /// The latency that members are shed to keep, if it is kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub governor: Option<Governor>,
    /// Where processes run, if not wherever the system puts them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub placements: Vec<Placement>,
    /// When a process is killed, started again, and given up.
    #[serde(default)]
    pub supervision: Supervision,
    /// The reference map, when the graph has a fuser.
    pub map: Option<PathBuf>,
    /// The traverse to record, when the graph has a recorder.
    pub record: Option<PathBuf>,
    /// How the recorder keeps rows.
    #[serde(default)]
    pub record_rows: RowType,
    /// The tape of events that ingest writes, if it writes one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record_events: Option<PathBuf>,
    /// Whether the graph has a dashboard.
    #[serde(default)]
    pub dashboard: bool,
}

/// The latency governor: sheds members where window-close → answer takes longer than the budget, and takes them back.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Governor {
    /// The 95th percentile of window-close → answer is kept below this, ns.
    pub budget_ns: u64,
    /// Members in the order in which they are shed, by index; those that are not named never are. Empty: all, by price.
    pub order: Vec<usize>,
    /// Answers within the budget after which a member is tried again; doubled each time that fails.
    pub hold: u32,
}

/// A kind of process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ServiceKind {
    /// Reads and cuts events.
    Ingest,
    /// Makes frames.
    Reconstruct,
    /// Makes rows.
    Extract,
    /// Makes answers.
    Fuse,
    /// Writes a traverse.
    Record,
    /// Shows the run to whoever opens its page.
    Dashboard,
}

impl ServiceKind {
    /// As in the command line.
    pub fn name(self) -> &'static str {
        match self {
            ServiceKind::Ingest => "ingest",
            ServiceKind::Reconstruct => "reconstruct",
            ServiceKind::Extract => "extract",
            ServiceKind::Fuse => "fuse",
            ServiceKind::Record => "record",
            ServiceKind::Dashboard => "dashboard",
        }
    }
}

/// One process of the plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Service {
    /// What it does.
    pub kind: ServiceKind,
    /// Index among the plan's reconstructions or extractors; 0 for the others.
    pub index: usize,
    /// `ingest`, `reconstruct/event_count`, `extract/mixvpr`, `fuse`, `record`, `dashboard`.
    pub name: String,
}

impl Plan {
    /// All processes, upstream first. A service's index in this list is its number in headers.
    pub fn services(&self) -> Vec<Service> {
        let service = |kind: ServiceKind, index, id: Option<&str>| Service {
            kind,
            index,
            name: id.map_or_else(|| kind.name().to_owned(), |id| format!("{}/{id}", kind.name())),
        };
        let mut all = vec![service(ServiceKind::Ingest, 0, None)];
        for (i, r) in self.reconstructions.iter().enumerate() {
            all.push(service(ServiceKind::Reconstruct, i, Some(&r.id)));
        }
        for (i, e) in self.extractors.iter().enumerate() {
            all.push(service(ServiceKind::Extract, i, Some(&e.id)));
        }
        if self.map.is_some() {
            all.push(service(ServiceKind::Fuse, 0, None));
        }
        if self.record.is_some() {
            all.push(service(ServiceKind::Record, 0, None));
        }
        if self.dashboard {
            all.push(service(ServiceKind::Dashboard, 0, None));
        }
        all
    }

    /// Whether a frame depends on all ticks before it, and not only on its window: a network carries its memory on.
    /// What is done a second time is then done from the recording's start.
    pub fn carries_memory(&self) -> bool {
        self.reconstructions
            .iter()
            .any(|r| r.network.is_some() && r.params.text("state") == CARRY)
    }

    /// Whether the rest goes on without this service.
    pub fn is_optional(&self, service: &Service) -> bool {
        match service.kind {
            ServiceKind::Reconstruct => self
                .reconstructions
                .get(service.index)
                .is_some_and(|r| r.optional),
            ServiceKind::Extract => self.extractors.get(service.index).is_some_and(|e| e.optional),
            ServiceKind::Ingest | ServiceKind::Fuse | ServiceKind::Record => false,
            ServiceKind::Dashboard => true,
        }
    }

    /// Whether a network is at work in this service.
    pub fn has_network(&self, service: &Service) -> bool {
        match service.kind {
            ServiceKind::Reconstruct => self
                .reconstructions
                .get(service.index)
                .is_some_and(|r| r.network.is_some()),
            ServiceKind::Extract => self
                .extractors
                .get(service.index)
                .is_some_and(|e| e.network.is_some()),
            ServiceKind::Ingest | ServiceKind::Fuse | ServiceKind::Record | ServiceKind::Dashboard => false,
        }
    }

    /// Number in headers of the service that runs reconstruction `index`.
    pub fn reconstruct_service(&self, index: usize) -> usize {
        1 + index
    }

    /// Number in headers of the service that runs extractor `index`.
    pub fn extract_service(&self, index: usize) -> usize {
        1 + self.reconstructions.len() + index
    }

    /// Number in headers of the fuser, if the plan has one.
    pub fn fuse_service(&self) -> Option<usize> {
        let before = 1 + self.reconstructions.len() + self.extractors.len();
        self.map.as_ref().map(|_| before)
    }

    /// How many services [`Plan::services`] lists.
    pub fn service_count(&self) -> usize {
        let others = [self.map.is_some(), self.record.is_some(), self.dashboard];
        let others: usize = others.into_iter().map(usize::from).sum();
        1 + self.reconstructions.len() + self.extractors.len() + others
    }

    /// The member with these parts, if the plan has it.
    pub fn member_of(&self, reconstruction: usize, window: usize, extractor: usize) -> Option<usize> {
        self.members.iter().position(|m| {
            m.reconstruction == reconstruction && m.window == window && m.extractor == extractor
        })
    }

    /// The members enabled at the start.
    pub fn enabled_members(&self) -> crate::MemberSet {
        self.members
            .iter()
            .enumerate()
            .filter(|(_, m)| m.enabled)
            .map(|(i, _)| i)
            .collect()
    }

    /// What decides whether two rows of this member can be compared: every name and number that shapes a row.
    /// Two members with equal fingerprints are the same measurement.
    pub fn fingerprint(&self, member: usize) -> BTreeMap<String, String> {
        let mut print = BTreeMap::new();
        let Some(m) = self.members.get(member) else {
            return print;
        };
        let (r, e) = (
            &self.reconstructions[m.reconstruction],
            &self.extractors[m.extractor],
        );
        let mut put = |key: &str, value: String| print.insert(key.to_owned(), value);
        put("sensor", format!("{}x{}", self.sensor.height, self.sensor.width));
        put("window", self.slicing.window_id(m.window));
        put("align", self.slicing.align.name().to_owned());
        put("tick", self.slicing.tick_id());
        put("reconstruction", r.kind.clone());
        put("extractor", e.kind.clone());
        put("dim", e.dim.to_string());
        for (key, value) in self.source.noise_fingerprint(r) {
            put(key, value);
        }
        for (stage, network) in [("reconstruction", &r.network), ("extractor", &e.network)] {
            for (key, value) in network.iter().flat_map(|network| network.model.fingerprint()) {
                put(&format!("{stage}.{key}"), value);
            }
        }
        for (key, value) in &r.params.0 {
            put(&format!("reconstruction.{key}"), value.to_string());
        }
        for (key, value) in &e.params.0 {
            put(&format!("extractor.{key}"), value.to_string());
        }
        print
    }
}

/// A small plan for unit tests: 4×6 pixels, 1 ms ticks of one window, two reconstructions `a` and `b`, one
/// extractor `x` of dimension 3, two members, a map and no recorder.
#[doc(hidden)]
pub fn test_plan() -> Plan {
    let reconstruction = |id: &str| Reconstruction {
        id: id.to_owned(),
        kind: "event_count_no_polarity".to_owned(),
        channels: 1,
        params: Params::default(),
        masks_hot_pixels: false,
        optional: false,
        network: None,
    };
    let member = |r: usize, id: &str| Member {
        name: format!("{id}@1ms/x"),
        reconstruction: r,
        window: 0,
        extractor: 0,
        enabled: true,
        weight: 1.0,
    };
    Plan {
        name: "test".to_owned(),
        source: Source::file("events.h5"),
        sensor: Sensor { height: 4, width: 6 },
        slicing: Slicing {
            mode: SliceMode::Time,
            tick: 1_000_000,
            windows: vec![1_000_000],
            align: Align::Start,
            origin: Origin::FirstEvent,
        },
        reconstructions: vec![reconstruction("a"), reconstruction("b")],
        extractors: vec![Extractor {
            id: "x".to_owned(),
            kind: "raw_pixels".to_owned(),
            dim: 3,
            params: Params::default(),
            optional: false,
            network: None,
        }],
        members: vec![member(0, "a"), member(1, "b")],
        fuse: Fuse {
            similarity: Similarity::L2,
            sequence: SequenceMethod::Paper,
            length: 10,
            rule: Rule::Sum,
            top: 5,
            exclusion: 5,
            min_confidence: 0.0,
        },
        inference: Inference::default(),
        delivery: Delivery::Lossless,
        deadline_ns: 1_000_000_000,
        governor: None,
        placements: Vec::new(),
        supervision: Supervision::default(),
        map: Some(PathBuf::from("map")),
        record: None,
        record_rows: RowType::F32,
        record_events: None,
        dashboard: false,
    }
}
