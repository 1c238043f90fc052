//! `[[placement]]`: which processors a process may use, and what starts it.

use super::reader::Table;
use super::schema::key;
use super::words::not_one_of;
use crate::plan::{Placement, ServiceKind};

/// The highest number of a processor.
const MAX_CPU: i64 = 1023;

/// The stanzas `[[placement]]`. `reconstructions` and `extractors` are the ids of stages, as far as they are known.
pub(super) fn placements(
    root: &Table<'_>,
    reconstructions: Option<&[&str]>,
    extractors: Option<&[&str]>,
) -> Option<Vec<Placement>> {
    let kinds = [
        ServiceKind::Ingest,
        ServiceKind::Reconstruct,
        ServiceKind::Extract,
        ServiceKind::Fuse,
        ServiceKind::Record,
    ];
    let mut processes: Vec<String> = kinds.iter().map(|kind| kind.name().to_owned()).collect();
    for (kind, ids) in [
        (ServiceKind::Reconstruct, reconstructions),
        (ServiceKind::Extract, extractors),
    ] {
        let named = |id: &&str| format!("{}/{id}", kind.name());
        processes.extend(ids.unwrap_or_default().iter().map(named));
    }
    // Where stages could not be read, what is wrong with them is said already.
    let all_known = reconstructions.is_some() && extractors.is_some();
    let mut placements: Vec<Option<Placement>> = Vec::new();
    for stanza in root.stanzas("placement")? {
        let placement = placement(&stanza, &processes, all_known);
        let twice = placement
            .as_ref()
            .filter(|new| placements.iter().flatten().any(|old| old.process == new.process));
        if let Some(placement) = twice {
            let message = format!("places \"{}\" a second time; write it once", placement.process);
            stanza.sink.report(&stanza.at, message);
        } else {
            placements.push(placement);
        }
        stanza.close();
    }
    placements.into_iter().collect()
}

fn placement(stanza: &Table<'_>, processes: &[String], all_known: bool) -> Option<Placement> {
    let process = stanza.require(
        key(
            "process",
            "name of a process, or kind of processes",
            None,
            "A process as evpr graph names it, such as \"extract/netvlad\", or all of a kind: \"ingest\", \"reconstruct\", \
             \"extract\", \"fuse\", \"record\". What is said of a process goes before what is said of its kind.",
        ),
        "write the name of a process, such as \"fuse\"",
        |v| {
            let name = v.text("the name of a process in quotes, such as \"fuse\"")?;
            if processes.iter().any(|process| process == name) || (!all_known && name.contains('/')) {
                return Some(name.to_owned());
            }
            let known: Vec<&str> = processes.iter().map(String::as_str).collect();
            v.refuse(not_one_of(name, &known))
        },
    );
    let cpus = stanza.read_optional(
        key(
            "cpus",
            "list of whole numbers from 0 to 1023",
            None,
            "Processors that it may use, as the system numbers them. When not given: all.",
        ),
        |v| {
            let cpus = v.list("a list of processors, such as [2, 3]", |v| v.integer(0..=MAX_CPU))?;
            let cpus: Vec<usize> = cpus
                .into_iter()
                .map(|cpu| cpu.map(|cpu| cpu as usize))
                .collect::<Option<_>>()?;
            if cpus.is_empty() {
                return v.refuse("is empty; write the numbers of processors, or remove the key");
            }
            Some(cpus)
        },
    );
    let launcher = stanza.read_optional(
        key(
            "launcher",
            "list of words",
            None,
            "A command that becomes the process: it gets evpr's command line as its last arguments, and must replace itself \
             by it, as chrt, nice, numactl and systemd-run --scope do. {process} in it is the process's name with - for /.",
        ),
        |v| {
            let expected = "a command and its arguments, such as [\"nice\", \"-n\", \"5\"]";
            let words = v.list(expected, |v| v.text("a word in quotes").map(str::to_owned))?;
            let words: Vec<String> = words.into_iter().collect::<Option<_>>()?;
            if words.first().is_none_or(String::is_empty) {
                return v.refuse(format!("names no command; write {expected}, or remove the key"));
            }
            Some(words)
        },
    );
    if matches!((&cpus, &launcher), (Some(None), Some(None))) {
        stanza
            .sink
            .report(&stanza.at, "says nothing; write cpus or launcher, or remove it");
        return None;
    }
    Some(Placement {
        process: process?,
        cpus: cpus?.unwrap_or_default(),
        launcher: launcher?.unwrap_or_default(),
    })
}
