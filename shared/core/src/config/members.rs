//! `[ensemble]`: which members there are, and how they start.

use super::reader::{Table, Value};
use super::schema::key;
use super::sink::At;
use super::stages::Stages;
use super::words::not_one_of;
use crate::member::MAX_MEMBERS;
use crate::plan::{Extractor, Member, Reconstruction, Slicing};
use std::collections::{BTreeMap, BTreeSet};

/// The parts that names of members are made of; none where the configuration is broken.
pub(super) struct Parts<'p> {
    reconstructions: Option<Vec<&'p str>>,
    windows: Option<Vec<String>>,
    extractors: Option<Vec<&'p str>>,
}

impl<'p> Parts<'p> {
    pub(super) fn new(
        reconstructions: &'p Stages<Reconstruction>,
        slicing: Option<&Slicing>,
        extractors: &'p Stages<Extractor>,
    ) -> Self {
        let windows = |s: &Slicing| (0..s.windows.len()).map(|w| s.window_id(w)).collect();
        Self {
            reconstructions: reconstructions.known_ids(),
            windows: slicing.map(windows),
            extractors: extractors.known_ids(),
        }
    }

    /// Checks the name of a member as far as the parts are known.
    fn check(&self, name: &str) -> Result<(), String> {
        let parts = name.split_once('@').and_then(|(r, rest)| {
            let (w, e) = rest.split_once('/')?;
            Some((r, w, e))
        });
        let Some((reconstruction, window, extractor)) = parts else {
            return Err(format!(
                "\"{name}\" is not the name of a member; write reconstruction@window/extractor, such as \
                 \"event_count@250ms/patch_norm\""
            ));
        };
        let windows: Option<Vec<&str>> = self
            .windows
            .as_ref()
            .map(|all| all.iter().map(String::as_str).collect());
        let known = [
            ("reconstruction", reconstruction, self.reconstructions.as_ref()),
            ("window", window, windows.as_ref()),
            ("extractor", extractor, self.extractors.as_ref()),
        ];
        let wrong = known.into_iter().filter_map(|(what, part, all)| {
            let all = all.filter(|all| !all.contains(&part))?;
            Some(format!("no such {what}: {}", not_one_of(part, all)))
        });
        let wrong: Vec<String> = wrong.collect();
        if wrong.is_empty() {
            Ok(())
        } else {
            Err(wrong.join("; "))
        }
    }

    /// How many members there are when all are wanted; 0 when that is not known.
    fn count(&self) -> usize {
        let count = |len: Option<usize>| len.unwrap_or(0);
        count(self.reconstructions.as_ref().map(Vec::len))
            * count(self.windows.as_ref().map(Vec::len))
            * count(self.extractors.as_ref().map(Vec::len))
    }

    /// All members, reconstruction-major, then by window, then by extractor; none if a part is not known.
    fn all(&self) -> Option<Vec<Member>> {
        let (reconstructions, windows, extractors) = (
            self.reconstructions.as_ref()?,
            self.windows.as_ref()?,
            self.extractors.as_ref()?,
        );
        let mut members = Vec::new();
        for (reconstruction, r) in reconstructions.iter().enumerate() {
            for (window, w) in windows.iter().enumerate() {
                for (extractor, e) in extractors.iter().enumerate() {
                    members.push(Member {
                        name: format!("{r}@{w}/{e}"),
                        reconstruction,
                        window,
                        extractor,
                        enabled: true,
                        weight: 1.0,
                    });
                }
            }
        }
        Some(members)
    }
}

/// Which members are wanted.
enum Wanted {
    All,
    Named(BTreeSet<String>),
}

/// `[ensemble]`: the members of the plan.
pub(super) fn ensemble(table: Table<'_>, parts: &Parts<'_>) -> Option<Vec<Member>> {
    let wanted = table.read(
        key(
            "members",
            "\"all\" or list of names of members",
            Some("\"all\""),
            "The members: every reconstruction, window and extractor combined, or these.",
        ),
        Wanted::All,
        |v| wanted(v, parts),
    );
    if matches!(wanted, Some(Wanted::All)) && parts.count() > MAX_MEMBERS {
        let message = format!(
            "all combinations are {} members; write a list of at most {MAX_MEMBERS}",
            parts.count()
        );
        table
            .sink
            .report(&table.below("members", table.at.offset), message);
    }
    let check = |name: &str, at: &At| {
        let listed = match &wanted {
            Some(Wanted::Named(names)) => names.contains(name),
            _ => true,
        };
        let checked = parts.check(name).and_then(|()| match listed {
            true => Ok(()),
            false => Err(format!(
                "\"{name}\" is not in the list ensemble.members; add it there, or remove it here"
            )),
        });
        checked
            .map_err(|message| table.sink.report_absence(at, message))
            .ok()
    };
    let disabled = table.read(
        key(
            "disabled",
            "list of names of members",
            Some("[]"),
            "Members that are off at the start; they can be switched on while it runs.",
        ),
        BTreeSet::new(),
        |v| {
            names(
                v,
                "a list of names, such as [\"event_count@250ms/patch_norm\"]",
                check,
            )
        },
    );
    let weights = table.read(
        key(
            "weights",
            "table of numbers of at least 0, by names of members",
            Some("{}"),
            "Weights of members at the start; 1 for those not named.",
        ),
        BTreeMap::new(),
        |v| weights(v, check),
    );
    table.close();
    let (wanted, disabled, weights) = (wanted?, disabled?, weights?);
    let mut members = parts
        .all()
        .filter(|_| parts.count() <= MAX_MEMBERS || matches!(wanted, Wanted::Named(_)))?;
    if let Wanted::Named(names) = &wanted {
        members.retain(|m| names.contains(&m.name));
    }
    for member in &mut members {
        member.enabled = !disabled.contains(&member.name);
        member.weight = weights.get(&member.name).copied().unwrap_or(1.0);
    }
    Some(members)
}

fn wanted(value: &Value<'_>, parts: &Parts<'_>) -> Option<Wanted> {
    if let Some(text) = value.as_text() {
        return match text {
            "all" => Some(Wanted::All),
            _ => value.refuse(format!(
                "\"{text}\" is not known here; write \"all\" or a list of names of members"
            )),
        };
    }
    let check = |name: &str, at: &At| {
        let checked = parts.check(name);
        checked
            .map_err(|message| value.sink.report_absence(at, message))
            .ok()
    };
    let names = names(
        value,
        "\"all\" or a list of names, such as [\"event_count@250ms/patch_norm\"]",
        check,
    )?;
    match names.len() {
        0 => value.refuse("is empty; write \"all\", or at least one name of a member"),
        n if n > MAX_MEMBERS => value.refuse(format!("has {n} members; write at most {MAX_MEMBERS}")),
        _ => Some(Wanted::Named(names)),
    }
}

/// A list of names of members, no two alike.
fn names(
    value: &Value<'_>,
    expected: &str,
    check: impl Fn(&str, &At) -> Option<()>,
) -> Option<BTreeSet<String>> {
    let mut seen = BTreeSet::new();
    let list = value.list(expected, |item| {
        let name = item.text("the name of a member, such as \"event_count@250ms/patch_norm\"")?;
        check(name, &item.at)?;
        if !seen.insert(name.to_owned()) {
            return item.refuse(format!(
                "\"{name}\" is in the list already; remove one of the two"
            ));
        }
        Some(())
    });
    let all_good = list?.iter().all(Option::is_some);
    all_good.then_some(seen)
}

fn weights(value: &Value<'_>, check: impl Fn(&str, &At) -> Option<()>) -> Option<BTreeMap<String, f64>> {
    let table = value.table("a table, such as { \"event_count@250ms/patch_norm\" = 0.5 }")?;
    let mut good = true;
    let mut weights = BTreeMap::new();
    for (name, entry) in table.entries() {
        match (check(name, &entry.at), entry.number(0.0..=f64::MAX)) {
            (Some(()), Some(weight)) => {
                weights.insert(name.to_owned(), weight);
            }
            _ => good = false,
        }
    }
    good.then_some(weights)
}
