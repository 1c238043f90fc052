//! What is compared: the product of subsets, similarities, sequence methods, lengths and rules.

use crate::error::EvaluateError;
use crate::pair::Digest;
use crate::subsets::{Subset, SubsetKind, subsets};
use evpr_core::config::{SIMILARITIES, method_label, rule_label};
use evpr_core::plan::{Rule, SequenceMethod, Similarity};
use std::collections::BTreeMap;

/// Most configurations of one pair.
const MAX_CONFIGURATIONS: usize = 1 << 20;
/// Longest sequence, ticks: as in the configuration.
const MAX_LENGTH: usize = 1000;

/// Subsets that are asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SubsetChoice {
    /// All of one of the paper's kinds.
    Kind(SubsetKind),
    /// A list with a name; entries are members, or patterns such as `event_count@*/hog`.
    Named(String, Vec<String>),
}

/// Everything that is compared, the same for every pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Spec {
    /// Subsets.
    pub subsets: Vec<SubsetChoice>,
    /// Similarities, as words of the configuration.
    pub similarities: Vec<Similarity>,
    /// Sequence methods.
    pub methods: Vec<SequenceMethod>,
    /// Sequence lengths, ticks.
    pub lengths: Vec<usize>,
    /// Fusion rules; none: the one that each method has by default.
    pub rules: Vec<Rule>,
    /// For the confidence, candidates within so many references of the best are no rivals.
    pub exclusion: usize,
    /// Weights of members by name, with a name for all of them; none: all 1.
    pub weights: Option<(String, BTreeMap<String, f64>)>,
    /// Memory that may be used for rings and scores, bytes.
    pub memory_bytes: u64,
}

/// One of the things that are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Configuration {
    /// Similarity.
    pub similarity: Similarity,
    /// Sequence method.
    pub method: SequenceMethod,
    /// Sequence length, ticks.
    pub length: usize,
    /// Fusion rule.
    pub rule: Rule,
    /// Name of the weights; `equal` when all are 1.
    pub weights: String,
    /// Which members.
    pub subset: Subset,
}

impl Configuration {
    /// Its similarity as a word of the configuration.
    pub fn similarity_word(&self) -> &'static str {
        let words = SIMILARITIES.all();
        let found = words
            .into_iter()
            .find(|w| SIMILARITIES.parse(w) == Ok(self.similarity));
        found.unwrap_or("unknown")
    }

    /// What names it among the results of a pair; parameters that are not the default ones are part of it.
    pub fn key(&self, pair: &str) -> String {
        let similarity = self.similarity_word();
        let (method, rule) = (method_label(&self.method), rule_label(&self.rule));
        let (length, kind) = (self.length, self.subset.kind.name());
        // Two lists may have one name.
        let subset = match self.subset.kind {
            SubsetKind::Named => format!("{} {:x}", self.subset.name, members_digest(&self.subset)),
            _ => self.subset.name.clone(),
        };
        format!(
            "{pair}|{similarity}|{method}|{length}|{rule}|{}|{kind}|{subset}",
            self.weights
        )
    }
}

impl Spec {
    /// Checks what does not depend on the members.
    ///
    /// # Errors
    /// [`EvaluateError::Asked`] with what makes no sense.
    pub fn check(&self) -> Result<(), EvaluateError> {
        let asked = |text: &str| Err(EvaluateError::Asked(text.to_owned()));
        if self.subsets.is_empty() || self.similarities.is_empty() || self.methods.is_empty() {
            return asked("nothing to evaluate: give at least one subset, similarity and method");
        }
        if self.lengths.is_empty() || self.lengths.iter().any(|l| *l == 0 || *l > MAX_LENGTH) {
            return asked("a sequence has 1 to 1000 ticks; give such lengths");
        }
        if let Some((name, weights)) = &self.weights
            && let Some((member, weight)) = weights.iter().find(|(_, w)| !w.is_finite() || **w < 0.0)
        {
            return Err(EvaluateError::Asked(format!(
                "weights {name}: the weight {weight} of {member} makes no sense; give 0 or more"
            )));
        }
        Ok(())
    }

    /// All configurations for members of these names, without repetitions.
    ///
    /// # Errors
    /// [`EvaluateError::Asked`] when a named subset has no such member, or there are too many.
    pub fn configurations(&self, members: &[String]) -> Result<Vec<Configuration>, EvaluateError> {
        let subsets = self.subsets_of(members)?;
        let mut all = Vec::new();
        for similarity in &self.similarities {
            for (method, length) in self.sequences() {
                for rule in self.rules_of(method) {
                    all.extend(subsets.iter().map(|subset| {
                        Configuration {
                            similarity: *similarity,
                            method,
                            length,
                            rule,
                            weights: self
                                .weights
                                .as_ref()
                                .map_or("equal", |(name, _)| name.as_str())
                                .to_owned(),
                            subset: subset.clone(),
                        }
                    }));
                }
                if all.len() > MAX_CONFIGURATIONS {
                    return Err(EvaluateError::Asked(format!(
                        "these are more than {MAX_CONFIGURATIONS} configurations; evaluate them in several runs"
                    )));
                }
            }
        }
        Ok(all)
    }

    fn rules_of(&self, method: SequenceMethod) -> Vec<Rule> {
        if self.rules.is_empty() {
            vec![Rule::default_with(Some(method))]
        } else {
            self.rules.clone()
        }
    }

    /// The weight of each member of a pair.
    pub(crate) fn weights_of(&self, pair: &crate::Pair) -> Vec<f64> {
        let weight = |name: &String| match &self.weights {
            None => 1.0,
            Some((_, weights)) => weights.get(name).copied().unwrap_or(1.0),
        };
        pair.members.iter().map(weight).collect()
    }

    /// Methods with their lengths; 1 for those that have none.
    fn sequences(&self) -> Vec<(SequenceMethod, usize)> {
        let mut all = Vec::new();
        for method in &self.methods {
            for length in &self.lengths {
                let length = if method.has_length() { *length } else { 1 };
                if !all.contains(&(*method, length)) {
                    all.push((*method, length));
                }
            }
        }
        all
    }

    fn subsets_of(&self, members: &[String]) -> Result<Vec<Subset>, EvaluateError> {
        let mut all: Vec<Subset> = Vec::new();
        for choice in &self.subsets {
            let found = match choice {
                SubsetChoice::Kind(kind) => subsets(members.iter().map(String::as_str), &[*kind]),
                SubsetChoice::Named(name, list) => vec![named(name, list, members)?],
            };
            for subset in found {
                if !all.iter().any(|s| s.kind == subset.kind && s.name == subset.name) {
                    all.push(subset);
                }
            }
        }
        Ok(all)
    }
}

/// Tells lists of members of one name apart.
fn members_digest(subset: &Subset) -> u32 {
    let mut digest = Digest::default();
    subset.members.iter().for_each(|m| digest.add(m as u64));
    digest.0 as u32
}

fn named(name: &str, list: &[String], members: &[String]) -> Result<Subset, EvaluateError> {
    let mut set = evpr_core::MemberSet::default();
    for pattern in list {
        let before = set.len();
        let fits = members.iter().enumerate().filter(|(_, m)| matches(pattern, m));
        let mut found = false;
        for (index, _) in fits {
            set.set(index, true);
            found = true;
        }
        if !found && set.len() == before {
            return Err(EvaluateError::Asked(format!(
                "subset {name}: no member is {pattern}; there are {}",
                members.join(", ")
            )));
        }
    }
    if set.is_empty() {
        return Err(EvaluateError::Asked(format!(
            "subset {name} is empty; name its members"
        )));
    }
    Ok(Subset {
        kind: SubsetKind::Named,
        name: name.to_owned(),
        members: set,
    })
}

/// Whether a name fits a pattern in which a star stands for any text.
pub(crate) fn matches(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or_default();
    let Some(mut rest) = name.strip_prefix(first) else {
        return false;
    };
    let parts: Vec<&str> = parts.collect();
    let Some((last, between)) = parts.split_last() else {
        return rest.is_empty();
    };
    for part in between {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn spec() -> Spec {
        Spec {
            subsets: vec![SubsetChoice::Kind(SubsetKind::Single)],
            similarities: vec![Similarity::L2],
            methods: vec![SequenceMethod::Paper, SequenceMethod::None],
            lengths: vec![5, 10],
            rules: vec![Rule::Sum],
            exclusion: 5,
            weights: None,
            memory_bytes: 1 << 30,
        }
    }

    #[test]
    fn a_method_without_history_has_one_length() {
        let members = vec!["a@1s/x".to_owned(), "a@1s/y".to_owned()];
        let all = spec().configurations(&members).unwrap();
        assert_eq!(all.len(), 6);
        let keys: Vec<String> = all.iter().map(|c| c.key("p")).collect();
        assert_eq!(keys[0], "p|l2|paper|5|sum|equal|single|a@1s/x");
        assert_eq!(keys[5], "p|l2|none|1|sum|equal|single|a@1s/y");
    }

    #[test]
    fn patterns_have_stars() {
        for (pattern, name, fits) in [
            ("a@1s/x", "a@1s/x", true),
            ("a@*/x", "a@1s/x", true),
            ("*@*/*", "a@1s/x", true),
            ("a@*/y", "a@1s/x", false),
            ("*", "a@1s/x", true),
            ("a", "a@1s/x", false),
            ("*x*x", "x", false),
        ] {
            assert_eq!(matches(pattern, name), fits, "{pattern}");
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let members = vec!["a@1s/x".to_owned()];
        for broken in [
            Spec {
                lengths: vec![0],
                ..spec()
            },
            Spec {
                methods: vec![],
                ..spec()
            },
        ] {
            assert!(broken.check().is_err());
        }
        let named = |list: &[&str]| Spec {
            subsets: vec![SubsetChoice::Named(
                "mine".to_owned(),
                list.iter().map(|s| (*s).to_owned()).collect(),
            )],
            ..spec()
        };
        let error = named(&["b@1s/x"])
            .configurations(&members)
            .unwrap_err()
            .to_string();
        assert!(error.contains("no member is b@1s/x; there are a@1s/x"), "{error}");
        assert!(named(&[]).configurations(&members).is_err());
    }
}
