//! The stanzas `[[reconstruction]]` and `[[extractor]]`, checked against what the binary knows and the registry of
//! models has.

use super::reader::{Table, Value};
use super::schema::{MAX_ID, key, name};
use super::sink::At;
use super::words::{Words, nearest, not_one_of, one_of};
use crate::member::{MAX_EXTRACTORS, MAX_WINDOWS};
use crate::message::ChannelOrder;
use crate::plan::{
    Catalog, Extractor, Model, ModelKind, Models, NETWORK_PARAMS, Network, ParamInfo, ParamKind, ParamValue,
    Params, Reconstruction, threads_of,
};

/// The most reconstructions a plan may have.
const MAX_RECONSTRUCTIONS: usize = 32;
/// The most threads of one network.
const MAX_THREADS: i64 = 256;
/// The most frames that one tick can have for an extractor.
const MAX_BATCH: i64 = (MAX_RECONSTRUCTIONS * MAX_WINDOWS) as i64;

/// Stages of one sort as far as they could be read.
pub(super) struct Stages<T> {
    /// The id of each stanza; none where it could not be read.
    pub ids: Vec<Option<String>>,
    /// The kind of each stanza that could be read, and where it is said.
    pub kinds: Vec<(At, String)>,
    /// All stages, if all of them are good.
    pub stages: Option<Vec<T>>,
}

impl<T> Stages<T> {
    /// The ids, if all of them are known.
    pub(super) fn known_ids(&self) -> Option<Vec<&str>> {
        let ids: Option<Vec<&str>> = self.ids.iter().map(Option::as_deref).collect();
        ids.filter(|ids| !ids.is_empty())
    }
}

/// What is said of a stage, whatever its kind.
struct Said {
    id: String,
    params: Params,
    how: How,
}

/// How a stage is run.
struct How {
    optional: bool,
    threads: Option<usize>,
    batch: Option<usize>,
}

/// A kind that a stanza may name: one of the binary, or a network of the registry.
struct Kind<'a, T> {
    name: &'a str,
    params: &'static [ParamInfo],
    is_network: bool,
    /// Whether it can compute several frames at once.
    takes_batches: bool,
    make: Box<dyn Fn(Said) -> Result<T, String> + 'a>,
}

/// What all stanzas of one sort have in common.
struct Sort<'a, T> {
    /// The section's name.
    section: &'static str,
    /// A stanza to write.
    example: &'static str,
    /// The most stanzas.
    most: usize,
    kinds: Vec<Kind<'a, T>>,
    registry: &'a str,
}

impl<T> Sort<'_, T> {
    fn find(&self, name: &str) -> Option<&Kind<'_, T>> {
        self.kinds.iter().find(|kind| kind.name == name)
    }

    /// That there is no such kind, what there is, and where networks come from.
    fn no_such_kind(&self, name: &str) -> String {
        let names: Vec<&str> = self.kinds.iter().map(|kind| kind.name).collect();
        format!("{}; {}", not_one_of(name, &names), self.no_network())
    }

    fn no_network(&self) -> String {
        format!("networks are those of {}", self.registry)
    }
}

/// How its process runs a network. Threads that are not given are dealt out by [`deal_threads`].
fn network(model: &Model, said: &Said) -> Network {
    Network {
        model: model.clone(),
        threads: said.how.threads.unwrap_or(0),
        batch: said.how.batch,
    }
}

/// `[[reconstruction]]`.
pub(super) fn reconstructions(root: &Table<'_>, catalog: &Catalog<'_>) -> Stages<Reconstruction> {
    let known = catalog.reconstructions.iter().map(|kind| Kind {
        name: kind.name,
        params: kind.params,
        is_network: false,
        takes_batches: false,
        make: Box::new(|said: Said| {
            Ok(Reconstruction {
                id: said.id,
                kind: kind.name.to_owned(),
                channels: kind.channel_order.channels(),
                params: said.params,
                masks_hot_pixels: kind.masks_hot_pixels,
                optional: said.how.optional,
                network: None,
            })
        }),
    });
    let models = of_kind(catalog.models, |kind| {
        matches!(kind, ModelKind::Reconstruction { .. })
    });
    let networks = models.map(|model| Kind {
        name: &model.id,
        params: NETWORK_PARAMS,
        is_network: true,
        takes_batches: false,
        make: Box::new(|said: Said| {
            Ok(Reconstruction {
                network: Some(network(model, &said)),
                id: said.id,
                kind: model.id.clone(),
                channels: ChannelOrder::Grey.channels(),
                params: said.params,
                masks_hot_pixels: true,
                optional: said.how.optional,
            })
        }),
    });
    let sort = Sort {
        section: "reconstruction",
        example: "[[reconstruction]] with id = \"event_count\"",
        most: MAX_RECONSTRUCTIONS,
        kinds: known.chain(networks).collect(),
        registry: catalog.models.registry,
    };
    stages(root, &sort)
}

/// `[[extractor]]`.
pub(super) fn extractors(root: &Table<'_>, catalog: &Catalog<'_>) -> Stages<Extractor> {
    let known = catalog.extractors.iter().map(|kind| Kind {
        name: kind.name,
        params: kind.params,
        is_network: false,
        takes_batches: false,
        make: Box::new(|said: Said| {
            Ok(Extractor {
                dim: (kind.dim)(&said.params)?,
                id: said.id,
                kind: kind.name.to_owned(),
                params: said.params,
                optional: said.how.optional,
                network: None,
            })
        }),
    });
    let networks = catalog.models.models.iter().filter_map(|model| match model.kind {
        ModelKind::Extractor { dimension, .. } => Some((model, dimension)),
        ModelKind::Reconstruction { .. } => None,
    });
    let networks = networks.map(|(model, dim)| Kind {
        name: &model.id,
        params: &[],
        is_network: true,
        takes_batches: true,
        make: Box::new(move |said: Said| {
            Ok(Extractor {
                network: Some(network(model, &said)),
                id: said.id,
                kind: model.id.clone(),
                dim,
                params: said.params,
                optional: said.how.optional,
            })
        }),
    });
    let sort = Sort {
        section: "extractor",
        example: "[[extractor]] with id = \"patch_norm\"",
        most: MAX_EXTRACTORS,
        kinds: known.chain(networks).collect(),
        registry: catalog.models.registry,
    };
    stages(root, &sort)
}

fn of_kind<'a>(models: Models<'a>, is: impl Fn(&ModelKind) -> bool) -> impl Iterator<Item = &'a Model> {
    models.models.iter().filter(move |model| is(&model.kind))
}

/// Gives each network that names no threads its share of the cores that the others leave.
pub(super) fn deal_threads(
    reconstructions: Option<&mut Vec<Reconstruction>>,
    extractors: Option<&mut Vec<Extractor>>,
    cores: usize,
) {
    let of_frames = reconstructions
        .into_iter()
        .flatten()
        .filter_map(|r| r.network.as_mut());
    let of_rows = extractors
        .into_iter()
        .flatten()
        .filter_map(|e| e.network.as_mut());
    let (open, said): (Vec<&mut Network>, Vec<&mut Network>) =
        of_frames.chain(of_rows).partition(|network| network.threads == 0);
    let taken: usize = said.iter().map(|network| network.threads).sum();
    let count = open.len();
    for (index, network) in open.into_iter().enumerate() {
        network.threads = threads_of(index, count, cores.saturating_sub(taken));
    }
}

fn stages<T>(root: &Table<'_>, sort: &Sort<'_, T>) -> Stages<T> {
    let stanzas = root.stanzas(sort.section);
    let Some(stanzas) = stanzas else {
        return Stages {
            ids: vec![None],
            kinds: Vec::new(),
            stages: None,
        };
    };
    let at = root.below(sort.section, 0);
    if stanzas.is_empty() {
        let message = format!("there is none; add a stanza {}", sort.example);
        root.sink.report_absence(&at, message);
    }
    let mut ids: Vec<Option<String>> = Vec::new();
    let mut known = Vec::new();
    let mut good: Vec<Option<T>> = Vec::new();
    for (index, stanza) in stanzas.into_iter().enumerate() {
        if index == sort.most {
            let message = format!("is one too many; write at most {} of them", sort.most);
            root.sink.report(&stanza.at, message);
            good.push(None);
        }
        let (id, stage) = stage(stanza, sort, &ids, &mut known);
        ids.push(id);
        good.push(stage);
    }
    let stages: Option<Vec<T>> = good.into_iter().collect();
    Stages {
        ids,
        kinds: known,
        stages: stages.filter(|stages| !stages.is_empty()),
    }
}

/// One stanza: its id and, when all of it is good, the stage.
fn stage<T>(
    table: Table<'_>,
    sort: &Sort<'_, T>,
    earlier: &[Option<String>],
    known: &mut Vec<(At, String)>,
) -> (Option<String>, Option<T>) {
    let mut id_at = table.at.clone();
    let id = table.require(
        key(
            "id",
            "name, 1 to 64 of a-z, 0-9, _ and -",
            None,
            "Its name in member names. Required.",
        ),
        &format!(
            "write id = \"{}\", or another name",
            sort.kinds.first().map_or("a", |kind| kind.name)
        ),
        |v| {
            id_at = v.at.clone();
            name(v, MAX_ID)
        },
    );
    let twice = id
        .as_ref()
        .and_then(|id| earlier.iter().position(|e| e.as_ref() == Some(id)));
    if let (Some(id), Some(first)) = (&id, twice) {
        let message = format!(
            "\"{id}\" is the id of {}[{first}] already; write another one",
            sort.section
        );
        table.sink.report(&id_at, message);
    }
    let kind = table.read_optional(
        key(
            "kind",
            "name of a kind",
            None,
            "What it is: a kind that evpr has, or a network of the registry of models; the id when not given.",
        ),
        |v| {
            let kind = v.text("the name of a kind in quotes")?;
            v.accept(sort.find(kind).ok_or_else(|| sort.no_such_kind(kind)))
        },
    );
    let kind = match (kind, &id) {
        (Some(None), Some(id)) => sort.find(id).or_else(|| {
            table.sink.report(&id_at, no_such_kind(id, sort));
            None
        }),
        (kind, _) => kind.flatten(),
    };
    known.extend(kind.map(|kind| (id_at.clone(), kind.name.to_owned())));
    let params_key = key(
        "params",
        "table",
        Some("{}"),
        "Parameters of the kind, such as { tau = \"100ms\" }; see the kind for their names.",
    );
    let given = table.read_optional(params_key, |v| {
        v.table("a table, such as { tau = \"100ms\" }")
            .map(|t| (t, v.at.clone()))
    });
    let how = how(&table, kind);
    let stage = match (kind, given, how) {
        (Some(kind), Some(given), how) => {
            let (params_table, at) = given.unwrap_or_else(|| (table.section("params"), table.at.clone()));
            let params = read_params(params_table, kind.params);
            let said = params.zip(how);
            said.and_then(|(params, how)| finish(&table, kind, id.clone(), params, how, &at))
        }
        _ => None,
    };
    table.close();
    (id, if twice.is_some() { None } else { stage })
}

/// The keys that say how a stage is run.
fn how<T>(table: &Table<'_>, kind: Option<&Kind<'_, T>>) -> Option<How> {
    let optional = table.read(
        key(
            "optional",
            "true or false",
            Some("false"),
            "Whether the rest goes on without its members when it cannot start or gives up; else the run ends.",
        ),
        false,
        |v| v.boolean(),
    );
    let of_network = |v: &Value<'_>, most: i64| match kind {
        Some(kind) if !kind.is_network => {
            v.refuse(format!("has no effect: {} is no network; remove it", kind.name))
        }
        _ => v.integer(1..=most).map(|n| n as usize),
    };
    let threads = table.read_optional(
        key(
            "threads",
            "whole number from 1 to 256",
            None,
            "Threads that compute the network. The cores are shared out evenly among the networks when not given.",
        ),
        |v| of_network(v, MAX_THREADS),
    );
    let batch = table.read_optional(
        key(
            "batch",
            "whole number from 1 to 1024",
            None,
            "The most frames that the network computes at once, of those that wait; its file must allow it. One on a \
             CPU, as many as wait on a GPU when not given.",
        ),
        |v| match kind {
            Some(kind) if kind.is_network && !kind.takes_batches => {
                v.refuse("has no effect: a reconstruction computes one frame after the other; remove it")
            }
            _ => of_network(v, MAX_BATCH),
        },
    );
    Some(How {
        optional: optional?,
        threads: threads?,
        batch: batch?,
    })
}

fn no_such_kind<T>(id: &str, sort: &Sort<'_, T>) -> String {
    let names: Vec<&str> = sort.kinds.iter().map(|kind| kind.name).collect();
    let near = match nearest(id, &names) {
        Some(near) => format!("did you mean \"{near}\"? "),
        None => String::new(),
    };
    let all: Vec<String> = names.iter().map(|n| format!("\"{n}\"")).collect();
    format!(
        "\"{id}\" is no kind of {}; {near}write kind = {}; {}",
        sort.section,
        one_of(&all),
        sort.no_network()
    )
}

fn finish<T>(
    table: &Table<'_>,
    kind: &Kind<'_, T>,
    id: Option<String>,
    params: Params,
    how: How,
    at: &At,
) -> Option<T> {
    // Checked under a stand-in when the id is bad, so that mistakes in the parameters are named all the same.
    let known = id.is_some();
    let said = Said {
        id: id.unwrap_or_default(),
        params,
        how,
    };
    match (kind.make)(said) {
        Ok(stage) => known.then_some(stage),
        Err(message) => {
            table.sink.report(at, message);
            None
        }
    }
}

/// The parameters of a kind, defaults filled in.
fn read_params(table: Table<'_>, infos: &[ParamInfo]) -> Option<Params> {
    let mut good = true;
    let mut params = Params::default();
    for info in infos {
        let value = match table.value(info.name) {
            None => Some(info.default_value()),
            Some(value) => param(&value, &info.kind),
        };
        match value {
            Some(value) => {
                params.0.insert(info.name.to_owned(), value);
            }
            None => good = false,
        }
    }
    table.close();
    good.then_some(params)
}

fn param(value: &Value<'_>, kind: &ParamKind) -> Option<ParamValue> {
    match *kind {
        ParamKind::Duration { .. } => {
            let ns = value.duration_ns()?;
            value.accept(
                i64::try_from(ns)
                    .map(ParamValue::Integer)
                    .map_err(|e| e.to_string()),
            )
        }
        ParamKind::Integer { min, max, .. } => value.integer(min..=max).map(ParamValue::Integer),
        ParamKind::Float { min, max, .. } => value.number(min..=max).map(ParamValue::Float),
        ParamKind::Choice { options, .. } => {
            let words: Vec<(&'static str, &'static str)> = options.iter().map(|o| (*o, *o)).collect();
            let word = value.word(&Words::new(&words))?;
            Some(ParamValue::Text(word.to_owned()))
        }
    }
}
