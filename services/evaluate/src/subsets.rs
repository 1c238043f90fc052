//! Ensembles: which members are fused.

use evpr_core::MemberSet;
use serde::{Deserialize, Serialize};

/// The parts of a member's name, `reconstruction@window/extractor`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemberName<'a> {
    /// `event_count`
    pub reconstruction: &'a str,
    /// `250ms`
    pub window: &'a str,
    /// `mixvpr`
    pub extractor: &'a str,
}

impl<'a> MemberName<'a> {
    /// The parts of a name; `None` when it is not made so.
    pub fn parse(name: &'a str) -> Option<Self> {
        let (reconstruction, rest) = name.split_once('@')?;
        let (window, extractor) = rest.split_once('/')?;
        Some(Self {
            reconstruction,
            window,
            extractor,
        })
    }
}

/// What the members of an ensemble have in common: the paper's kinds, and lists of one's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SubsetKind {
    /// One member.
    Single,
    /// One reconstruction and one extractor, all windows.
    Temporal,
    /// One window and one extractor, all reconstructions.
    Reconstruction,
    /// One reconstruction and one window, all extractors.
    Extractor,
    /// All members.
    Combined,
    /// A list with a name.
    Named,
}

impl SubsetKind {
    /// The paper's kinds, smallest first.
    pub const PAPER: [Self; 5] = [
        Self::Single,
        Self::Temporal,
        Self::Reconstruction,
        Self::Extractor,
        Self::Combined,
    ];

    /// As in results and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Temporal => "temporal",
            Self::Reconstruction => "reconstruction",
            Self::Extractor => "extractor",
            Self::Combined => "combined",
            Self::Named => "named",
        }
    }

    /// Which parts of a name stay in the name of its ensemble of this kind.
    fn keeps(self) -> (bool, bool, bool) {
        match self {
            Self::Single | Self::Named => (true, true, true),
            Self::Temporal => (true, false, true),
            Self::Reconstruction => (false, true, true),
            Self::Extractor => (true, true, false),
            Self::Combined => (false, false, false),
        }
    }
}

/// An ensemble.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Subset {
    /// What its members have in common.
    pub kind: SubsetKind,
    /// `event_count@*/hog`: a star stands for all.
    pub name: String,
    /// Its members, by their index in the list they were found in.
    pub members: MemberSet,
}

/// All ensembles of these kinds among members of these names: the kinds in the order given, ensembles in that of their
/// first member. A name that is not made of three parts stands in `single` and `combined` only.
pub fn subsets<'a>(names: impl Iterator<Item = &'a str> + Clone, kinds: &[SubsetKind]) -> Vec<Subset> {
    let mut all: Vec<Subset> = Vec::new();
    for kind in kinds {
        let (keep_r, keep_w, keep_e) = kind.keeps();
        let part = |keep: bool, name: &str| if keep { name.to_owned() } else { "*".to_owned() };
        for (index, name) in names.clone().enumerate() {
            let name = match MemberName::parse(name) {
                Some(m) => format!(
                    "{}@{}/{}",
                    part(keep_r, m.reconstruction),
                    part(keep_w, m.window),
                    part(keep_e, m.extractor)
                ),
                None if *kind == SubsetKind::Single => name.to_owned(),
                None if *kind == SubsetKind::Combined => "*@*/*".to_owned(),
                None => continue,
            };
            match all.iter_mut().find(|s| s.kind == *kind && s.name == name) {
                Some(subset) => subset.members.set(index, true),
                None => all.push(Subset {
                    kind: *kind,
                    name,
                    members: std::iter::once(index).collect(),
                }),
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_member_is_once_in_each_kind_and_names_have_stars() {
        let names: Vec<String> = ["a", "b", "c"]
            .iter()
            .flat_map(|r| ["1s", "250ms"].iter().map(move |w| (r, w)))
            .flat_map(|(r, w)| ["x", "y", "z", "v"].iter().map(move |e| format!("{r}@{w}/{e}")))
            .collect();
        let all = subsets(names.iter().map(String::as_str), &SubsetKind::PAPER);
        for (kind, (count, size)) in
            SubsetKind::PAPER
                .into_iter()
                .zip([(24, 1), (12, 2), (8, 3), (6, 4), (1, 24)])
        {
            let of_kind: Vec<&Subset> = all.iter().filter(|s| s.kind == kind).collect();
            assert_eq!(of_kind.len(), count, "{kind:?}");
            assert!(of_kind.iter().all(|s| s.members.len() == size), "{kind:?}");
            let covered: MemberSet = of_kind
                .iter()
                .flat_map(|s| s.members.iter().collect::<Vec<_>>())
                .collect();
            assert_eq!(covered.len(), names.len());
        }
        assert_eq!(all[24].name, "a@*/x");
        assert_eq!(all[36].name, "*@1s/x");
        assert_eq!(all[44].name, "a@1s/*");
        assert_eq!(all[50].name, "*@*/*");
    }

    #[test]
    fn a_name_without_parts_is_alone_or_with_all() {
        let all = subsets(["plain", "a@1s/x"].into_iter(), &SubsetKind::PAPER);
        let of = |kind| {
            all.iter()
                .filter(|s| s.kind == kind)
                .map(|s| s.members.len())
                .collect::<Vec<_>>()
        };
        assert_eq!(of(SubsetKind::Single), [1, 1]);
        assert_eq!(of(SubsetKind::Temporal), [1]);
        assert_eq!(of(SubsetKind::Combined), [2]);
    }
}
