//! How two traverses, or a traverse and a plan, differ.

use crate::manifest::MemberEntry;
use std::collections::BTreeMap;

/// One thing that is not alike.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// The member; `None` where it concerns the whole traverse.
    pub member: Option<String>,
    /// Which property; `None` where one side lacks the whole member.
    pub key: Option<String>,
    /// What the traverse on disk has; `None` for nothing.
    pub stored: Option<String>,
    /// What is wanted; `None` for nothing.
    pub wanted: Option<String>,
}

/// Compares two members of the same name: their fingerprints, key by key.
pub(crate) fn of_fingerprints(
    member: &str,
    stored: &BTreeMap<String, String>,
    wanted: &BTreeMap<String, String>,
) -> Vec<Difference> {
    let mut keys: Vec<&String> = stored.keys().chain(wanted.keys()).collect();
    keys.sort_unstable();
    keys.dedup();
    keys.into_iter()
        .filter(|key| stored.get(*key) != wanted.get(*key))
        .map(|key| Difference {
            member: Some(member.to_owned()),
            key: Some(key.clone()),
            stored: stored.get(key).cloned(),
            wanted: wanted.get(key).cloned(),
        })
        .collect()
}

/// A member that the stored traverse lacks.
pub(crate) fn missing(member: &str) -> Difference {
    Difference {
        member: Some(member.to_owned()),
        key: None,
        stored: None,
        wanted: Some(member.to_owned()),
    }
}

/// Compares the headers of two recordings; equal ones may go on in the same files.
pub(crate) fn of_headers(stored: &crate::Manifest, wanted: &crate::NewTraverse) -> Vec<Difference> {
    let mut all = Vec::new();
    let mut whole = |key: &str, stored: String, wanted: String| {
        if stored != wanted {
            all.push(Difference {
                member: None,
                key: Some(key.to_owned()),
                stored: Some(stored),
                wanted: Some(wanted),
            });
        }
    };
    let kept = stored.members.first().map_or(wanted.rows, |m| m.dtype);
    whole("rows", kept.name().to_owned(), wanted.rows.name().to_owned());
    let slicing = |s| serde_json::to_string(s).unwrap_or_default();
    whole("source", stored.source.clone(), wanted.source.clone());
    whole("sensor", stored.sensor.to_string(), wanted.sensor.to_string());
    whole("slicing", slicing(&stored.slicing), slicing(&wanted.slicing));
    let names = |of: &mut dyn Iterator<Item = &str>| of.collect::<Vec<_>>().join(", ");
    whole(
        "members",
        names(&mut stored.members.iter().map(|m| m.name.as_str())),
        names(&mut wanted.members.iter().map(|m| m.name.as_str())),
    );
    for member in &wanted.members {
        let Some(entry) = find(&stored.members, &member.name) else {
            continue;
        };
        if entry.dim != member.dim {
            all.push(Difference {
                member: Some(member.name.clone()),
                key: Some("dim".to_owned()),
                stored: Some(entry.dim.to_string()),
                wanted: Some(member.dim.to_string()),
            });
        }
        all.extend(of_fingerprints(
            &member.name,
            &entry.fingerprint,
            &member.fingerprint,
        ));
    }
    all.dedup();
    all
}

/// The entry of this name.
pub(crate) fn find<'a>(members: &'a [MemberEntry], name: &str) -> Option<&'a MemberEntry> {
    members.iter().find(|m| m.name == name)
}

/// All differences in one line. Members that differ in the same way are named together.
pub(crate) fn listed(differences: &[Difference], stored: &str, wanted: &str) -> String {
    type Way<'a> = (Option<&'a str>, Option<&'a str>, Option<&'a str>);
    let mut ways: Vec<(Way<'_>, Vec<&str>)> = Vec::new();
    for d in differences {
        let named = d.key.is_some();
        let way = (
            d.key.as_deref(),
            d.stored.as_deref(),
            if named { d.wanted.as_deref() } else { None },
        );
        let index = ways.iter().position(|(w, _)| *w == way).unwrap_or_else(|| {
            ways.push((way, Vec::new()));
            ways.len() - 1
        });
        ways[index].1.extend(d.member.as_deref());
    }
    let texts: Vec<String> = ways
        .into_iter()
        .map(|((key, has, wants), members)| {
            let who = match members.as_slice() {
                [] => String::new(),
                [one] => format!("member {one}"),
                more => format!("members {}", more.join(", ")),
            };
            let Some(key) = key else {
                return format!("the {stored} has no {who}");
            };
            let value = |v: Option<&str>| v.unwrap_or("(none)").to_owned();
            let of = if who.is_empty() {
                String::new()
            } else {
                format!(" ({who})")
            };
            format!(
                "{key} is {} in the {stored} and {} in the {wanted}{of}",
                value(has),
                value(wants)
            )
        })
        .collect();
    texts.join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn print(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
        pairs
            .iter()
            .map(|(k, v)| ((*k).to_owned(), (*v).to_owned()))
            .collect()
    }

    #[test]
    fn every_key_that_differs_is_named_with_both_values() {
        let stored = print(&[("align", "start"), ("dim", "3"), ("old", "1")]);
        let wanted = print(&[("align", "end"), ("dim", "3"), ("new", "2")]);
        let found = of_fingerprints("a@1ms/x", &stored, &wanted);
        let keys: Vec<_> = found.iter().map(|d| d.key.as_deref().unwrap()).collect();
        assert_eq!(keys, ["align", "new", "old"]);
        assert_eq!(
            listed(&found, "map", "configuration"),
            "align is start in the map and end in the configuration (member a@1ms/x); \
             new is (none) in the map and 2 in the configuration (member a@1ms/x); \
             old is 1 in the map and (none) in the configuration (member a@1ms/x)"
        );
    }

    #[test]
    fn members_that_differ_alike_share_a_place() {
        let stored = print(&[("tick", "1s")]);
        let wanted = print(&[("tick", "2s")]);
        let mut found = of_fingerprints("a", &stored, &wanted);
        found.extend(of_fingerprints("b", &stored, &wanted));
        found.push(missing("c"));
        found.push(missing("d"));
        assert_eq!(
            listed(&found, "map", "configuration"),
            "tick is 1s in the map and 2s in the configuration (members a, b); the map has no members c, d"
        );
        assert!(of_fingerprints("a", &stored, &stored).is_empty());
    }
}
