//! The stanzas `[[reconstruction]]` and `[[extractor]]`, checked against what the binary knows.

use super::reader::{Table, Value};
use super::schema::{MAX_ID, key, name};
use super::sink::At;
use super::words::{Words, nearest, not_one_of, one_of};
use crate::member::MAX_EXTRACTORS;
use crate::plan::{
    Catalog, Extractor, ExtractorKind, ParamInfo, ParamKind, ParamValue, Params, Reconstruction,
    ReconstructionKind,
};

/// The most reconstructions a plan may have.
const MAX_RECONSTRUCTIONS: usize = 32;

/// Stages of one sort as far as they could be read.
pub(super) struct Stages<T> {
    /// The id of each stanza; none where it could not be read.
    pub ids: Vec<Option<String>>,
    /// The kind of each stanza that could be read, and where it is said.
    pub kinds: Vec<(At, &'static str)>,
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

/// What reconstructions and extractors have in common.
trait Kind: Copy + 'static {
    /// The section's name.
    const SECTION: &'static str;
    /// A stanza to write.
    const EXAMPLE: &'static str;
    /// The most stanzas.
    const MOST: usize;
    type Stage;
    fn name(&self) -> &'static str;
    fn params(&self) -> &'static [ParamInfo];
    fn stage(&self, id: String, params: Params) -> Result<Self::Stage, String>;
}

impl Kind for ReconstructionKind {
    const SECTION: &'static str = "reconstruction";
    const EXAMPLE: &'static str = "[[reconstruction]] with id = \"event_count\"";
    const MOST: usize = MAX_RECONSTRUCTIONS;
    type Stage = Reconstruction;
    fn name(&self) -> &'static str {
        self.name
    }
    fn params(&self) -> &'static [ParamInfo] {
        self.params
    }
    fn stage(&self, id: String, params: Params) -> Result<Reconstruction, String> {
        Ok(Reconstruction {
            id,
            kind: self.name.to_owned(),
            channels: self.channel_order.channels(),
            params,
            masks_hot_pixels: self.masks_hot_pixels,
        })
    }
}

impl Kind for ExtractorKind {
    const SECTION: &'static str = "extractor";
    const EXAMPLE: &'static str = "[[extractor]] with id = \"patch_norm\"";
    const MOST: usize = MAX_EXTRACTORS;
    type Stage = Extractor;
    fn name(&self) -> &'static str {
        self.name
    }
    fn params(&self) -> &'static [ParamInfo] {
        self.params
    }
    fn stage(&self, id: String, params: Params) -> Result<Extractor, String> {
        let dim = (self.dim)(&params)?;
        Ok(Extractor {
            id,
            kind: self.name.to_owned(),
            dim,
            params,
        })
    }
}

/// `[[reconstruction]]`.
pub(super) fn reconstructions(root: &Table<'_>, catalog: &Catalog) -> Stages<Reconstruction> {
    stages(root, catalog.reconstructions)
}

/// `[[extractor]]`.
pub(super) fn extractors(root: &Table<'_>, catalog: &Catalog) -> Stages<Extractor> {
    stages(root, catalog.extractors)
}

fn stages<K: Kind>(root: &Table<'_>, kinds: &[K]) -> Stages<K::Stage> {
    let stanzas = root.stanzas(K::SECTION);
    let Some(stanzas) = stanzas else {
        return Stages {
            ids: vec![None],
            kinds: Vec::new(),
            stages: None,
        };
    };
    let at = root.below(K::SECTION, 0);
    if stanzas.is_empty() {
        root.sink
            .report_absence(&at, format!("there is none; add a stanza {}", K::EXAMPLE));
    }
    let mut ids: Vec<Option<String>> = Vec::new();
    let mut known = Vec::new();
    let mut good: Vec<Option<K::Stage>> = Vec::new();
    for (index, stanza) in stanzas.into_iter().enumerate() {
        if index == K::MOST {
            let message = format!("is one too many; write at most {} of them", K::MOST);
            root.sink.report(&stanza.at, message);
            good.push(None);
        }
        let (id, stage) = stage(stanza, kinds, &ids, &mut known);
        ids.push(id);
        good.push(stage);
    }
    let stages: Option<Vec<K::Stage>> = good.into_iter().collect();
    Stages {
        ids,
        kinds: known,
        stages: stages.filter(|stages| !stages.is_empty()),
    }
}

/// One stanza: its id and, when all of it is good, the stage.
fn stage<K: Kind>(
    table: Table<'_>,
    kinds: &[K],
    earlier: &[Option<String>],
    known: &mut Vec<(At, &'static str)>,
) -> (Option<String>, Option<K::Stage>) {
    let names: Vec<&str> = kinds.iter().map(Kind::name).collect();
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
            names.first().unwrap_or(&"a")
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
            K::SECTION
        );
        table.sink.report(&id_at, message);
    }
    let find = |kind: &str| kinds.iter().find(|k| k.name() == kind).copied();
    let kind = table.read_optional(
        key(
            "kind",
            "name of a kind",
            None,
            "What it is; the id when not given.",
        ),
        |v| {
            let kind = v.text("the name of a kind in quotes")?;
            v.accept(find(kind).ok_or_else(|| not_one_of(kind, &names)))
        },
    );
    let kind: Option<K> = match (kind, &id) {
        (Some(None), Some(id)) => find(id).or_else(|| {
            table.sink.report(&id_at, no_such_kind(id, K::SECTION, &names));
            None
        }),
        (kind, _) => kind.flatten(),
    };
    known.extend(kind.map(|kind| (id_at.clone(), kind.name())));
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
    let stage = match (kind, given) {
        (Some(kind), Some(given)) => {
            let (params_table, at) = given.unwrap_or_else(|| (table.section("params"), table.at.clone()));
            let params = read_params(params_table, kind.params());
            params.and_then(|params| finish(&table, &kind, id.clone(), params, &at))
        }
        _ => None,
    };
    table.close();
    (id, if twice.is_some() { None } else { stage })
}

fn no_such_kind(id: &str, section: &str, names: &[&str]) -> String {
    let near = match nearest(id, names) {
        Some(near) => format!("did you mean \"{near}\"? "),
        None => String::new(),
    };
    let all: Vec<String> = names.iter().map(|n| format!("\"{n}\"")).collect();
    format!(
        "\"{id}\" is no kind of {section}; {near}write kind = {}",
        one_of(&all)
    )
}

fn finish<K: Kind>(
    table: &Table<'_>,
    kind: &K,
    id: Option<String>,
    params: Params,
    at: &At,
) -> Option<K::Stage> {
    // Checked under a stand-in when the id is bad, so that mistakes in the parameters are named all the same.
    let known = id.is_some();
    match kind.stage(id.unwrap_or_default(), params) {
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
