//! Which queries each set of members answers rightly, computed once per set.

use super::Wanted;
use crate::error::EvaluateError;
use crate::evaluate::Progress;
use crate::outcome::Outcome;
use crate::pair::Pair;
use crate::spec::{Configuration, Spec};
use crate::subsets::{Subset, SubsetKind};
use crate::sweep::{Kept, most_configurations, sweep};
use std::collections::BTreeMap;

/// Members by their index, ascending.
pub(crate) type Set = Vec<usize>;

/// One bit per query.
#[derive(Debug, Clone, PartialEq)]
struct Bits(Vec<u64>);

impl Bits {
    fn new(bits: impl Iterator<Item = bool>) -> Self {
        let mut words = Vec::new();
        for (at, bit) in bits.enumerate() {
            if at % 64 == 0 {
                words.push(0);
            }
            if let Some(last) = words.last_mut() {
                *last |= u64::from(bit) << (at % 64);
            }
        }
        Self(words)
    }

    fn count(&self) -> usize {
        self.0.iter().map(|w| w.count_ones() as usize).sum()
    }

    fn common(&self, other: &Self) -> usize {
        let both = self
            .0
            .iter()
            .zip(&other.0)
            .map(|(a, b)| (a & b).count_ones() as usize);
        both.sum()
    }
}

/// Queries that have a right place, per pair: those that something is fitted or measured on.
#[derive(Debug, Clone)]
pub(crate) struct Queries(Vec<Bits>);

impl Queries {
    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        self.0.iter().map(Bits::count).sum()
    }
}

/// See the module.
pub(crate) struct Judge<'a> {
    pairs: &'a [Pair],
    spec: Spec,
    /// Per pair its scores, where all pairs' fit half of the memory.
    kept: Option<Vec<Kept>>,
    /// Per set and pair: the queries answered rightly.
    right: BTreeMap<Set, Vec<Bits>>,
}

impl<'a> Judge<'a> {
    pub(crate) fn new(pairs: &'a [Pair], wanted: &Wanted) -> Self {
        let bytes = pairs.iter().map(Kept::bytes).fold(0, u64::saturating_add);
        let keep = |pair: &Pair| Kept::new(pair, wanted.similarity, wanted.method, wanted.length);
        Self {
            pairs,
            kept: (bytes <= wanted.memory_bytes / 2).then(|| pairs.iter().map(keep).collect()),
            spec: wanted.spec(),
            right: BTreeMap::new(),
        }
    }

    /// All queries that have a right place.
    pub(crate) fn all_queries(&self) -> Queries {
        self.queries(|_, _| true)
    }

    /// Those among them of which `is` says so, by pair and query.
    pub(crate) fn queries(&self, is: impl Fn(usize, usize) -> bool) -> Queries {
        let of = |(at, pair): (usize, &Pair)| {
            Bits::new((0..pair.queries()).map(|q| is(at, q) && !pair.truth.matches(q).is_empty()))
        };
        Queries(self.pairs.iter().enumerate().map(of).collect())
    }

    /// All sets that were looked at.
    pub(crate) fn sets(&self) -> impl Iterator<Item = &Set> {
        self.right.keys()
    }

    /// Mean over the pairs that have some of these queries of the share of them that the set answers rightly; 0 for a set
    /// that was not looked at.
    pub(crate) fn recall(&self, set: &Set, queries: &Queries) -> f64 {
        let Some(right) = self.right.get(set) else {
            return 0.0;
        };
        let shares = right.iter().zip(&queries.0).filter_map(|(right, queries)| {
            let all = queries.count();
            (all > 0).then(|| right.common(queries) as f64 / all as f64)
        });
        super::mean(shares)
    }

    /// Finds out which queries these sets answer rightly, as far as that is not known.
    pub(crate) fn look_at(
        &mut self,
        mut sets: Vec<Set>,
        progress: &dyn Progress,
    ) -> Result<(), EvaluateError> {
        sets.sort_unstable();
        sets.dedup();
        sets.retain(|set| !self.right.contains_key(set));
        let work: usize = self.pairs.iter().map(Pair::queries).sum();
        progress.found((work * sets.len()) as u64);
        let (length, memory) = (self.spec.lengths[0], self.spec.memory_bytes / 2);
        for (at, pair) in self.pairs.iter().enumerate() {
            for some in sets.chunks(most_configurations(pair, length, memory).max(1)) {
                let configurations: Vec<Configuration> =
                    some.iter().map(|set| self.configuration(set)).collect();
                let configurations: Vec<&Configuration> = configurations.iter().collect();
                let advanced = |work| progress.advanced(work);
                let bits = |outcomes: Vec<Outcome>| Bits::new(outcomes.iter().map(Outcome::is_right));
                let mut found: Vec<(Set, Bits)> = Vec::new();
                match self.kept.as_ref().and_then(|kept| kept.get(at)) {
                    Some(kept) => {
                        let outcomes = kept.fuse(pair, &self.spec, &configurations, &advanced);
                        found.extend(some.iter().cloned().zip(outcomes.into_iter().map(bits)));
                    }
                    None => sweep(
                        pair,
                        &self.spec,
                        &configurations,
                        &advanced,
                        &mut |c, outcomes| {
                            found.push((c.subset.members.iter().collect(), bits(outcomes)));
                            Ok(())
                        },
                    )?,
                }
                for (set, bits) in found {
                    self.right.entry(set).or_default().push(bits);
                }
            }
        }
        Ok(())
    }

    fn configuration(&self, set: &Set) -> Configuration {
        Configuration {
            similarity: self.spec.similarities[0],
            method: self.spec.methods[0],
            length: self.spec.lengths[0],
            rule: self.spec.rules[0],
            weights: "equal".to_owned(),
            subset: Subset {
                kind: SubsetKind::Named,
                name: String::new(),
                members: set.iter().copied().collect(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_counted() {
        let bits = Bits::new((0..130).map(|i| i % 3 == 0));
        let even = Bits::new((0..130).map(|i| i % 2 == 0));
        assert_eq!((bits.count(), bits.common(&even)), (44, 22));
        assert_eq!(Bits::new(std::iter::empty()).count(), 0);
    }
}
