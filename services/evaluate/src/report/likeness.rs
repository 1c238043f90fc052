//! How alike members are: in what they see, and in what they get wrong.

use super::chart::heat;
use super::html::{Section, escaped};
use super::{Figures, MAX_PAIRS, more_pairs};
use crate::statistics::Members;

pub(super) fn likeness(members: &[Members], figures: &mut Figures) -> Section {
    let mut section = Section::new("likeness", "How alike members are");
    if members.is_empty() {
        section.lacks("It was not computed; give --likeness.");
        return section;
    }
    section.say(
        "Members that see alike (left) and fail alike (right) add little to one another. The numbers \
         are those of the list below.",
    );
    let mut pictures = Vec::new();
    let mut lists: Vec<&[String]> = Vec::new();
    for m in members.iter().take(MAX_PAIRS) {
        if !lists.contains(&m.members.as_slice()) {
            lists.push(&m.members);
        }
        pictures.push(heat(
            &format!("likeness_{}", m.pair),
            &format!(
                "{}: correlation of similarities ({}), mean over {} queries.",
                m.pair, m.similarity, m.queries
            ),
            &m.members,
            (0.0, 1.0),
            |a, b| m.similarity_correlation.get(a)?.get(b).copied().flatten(),
        ));
        pictures.push(heat(
            &format!("errors_{}", m.pair),
            &format!(
                "{}: of the queries that one of two members gets wrong, the share that both do ({}, L={}).",
                m.pair, m.method, m.length
            ),
            &m.members,
            (0.0, 1.0),
            |a, b| m.error_overlap.get(a)?.get(b).copied(),
        ));
    }
    section.pictures(&pictures);
    for list in lists {
        let names: String = list.iter().map(|n| format!("<li>{}</li>", escaped(n))).collect();
        section.add(&format!("<ol class=\"names\">{names}</ol>\n"));
    }
    section.add(&more_pairs(members.len()));
    figures.extend(pictures);
    section
}
