//! The ensemble: the members' scores made one, the best place, its rivals and its confidence.

use crate::fusion::combine;
use crate::sequence::ForwardFilter;
use evpr_core::message::Candidate;
use evpr_core::plan::{Filter, Rule};

/// References that are passed over at once where none of them is among the best.
const BLOCK: usize = 64;
/// Scores looked at side by side.
const LANES: usize = 8;

/// What one member brings to a tick.
#[derive(Debug, Clone, Copy)]
pub struct Part<'a> {
    /// Its S̃, one score per reference.
    pub scores: &'a [f64],
    /// The references that the map has a row of this member for.
    pub valid: &'a [bool],
    /// Its weight w.
    pub weight: f64,
}

/// The best place of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Best {
    /// The map's tick.
    pub reference: usize,
    /// Its fused score E.
    pub score: f64,
    /// Margin against the best candidate elsewhere, 0 to 1. See [`Ensemble::fuse`].
    pub confidence: f64,
}

/// Fuses the members of a tick. Its memory is reused from tick to tick.
#[derive(Debug)]
pub struct Ensemble {
    rule: Rule,
    filter: Option<ForwardFilter>,
    top: usize,
    exclusion: usize,
    fused: Vec<f64>,
    eligible: Vec<bool>,
    candidates: Vec<Candidate>,
}

impl Ensemble {
    /// An ensemble over so many references, which names the `top` best candidates (at least 1); for the confidence,
    /// candidates within `exclusion` references of the best are no rivals.
    pub fn new(references: usize, top: usize, exclusion: usize) -> Self {
        let top = top.clamp(1, references.max(1));
        Self {
            rule: Rule::Sum,
            filter: None,
            top,
            exclusion,
            fused: vec![0.0; references],
            eligible: vec![false; references],
            candidates: Vec::with_capacity(top + 1),
        }
    }

    /// The same by another rule than the sum; [`mod@crate::fusion`] has their formulas.
    #[must_use]
    pub fn with_rule(self, rule: Rule) -> Self {
        Self { rule, ..self }
    }

    /// Fuses by this rule from now on.
    pub fn set_rule(&mut self, rule: Rule) {
        self.rule = rule;
    }

    /// The same with a filter that takes E for z-scores: the fused scores are then the probabilities of the places.
    /// Such an ensemble has to be shown every tick, those without any member too.
    #[must_use]
    pub fn with_filter(self, filter: Filter) -> Self {
        let filter = Some(ForwardFilter::new(filter, self.fused.len()));
        Self { filter, ..self }
    }

    /// The filter, where there is one.
    pub fn filter(&self) -> Option<&ForwardFilter> {
        self.filter.as_ref()
    }

    /// The filter goes on from these probabilities after so many ticks without evidence.
    pub fn resume(&mut self, probabilities: &[f64], blind: u64) {
        if let Some(filter) = &mut self.filter {
            filter.resume(probabilities, blind);
        }
    }

    /// Whether a tick bears on later ones, so that none may be left out.
    pub fn remembers(&self) -> bool {
        self.filter.is_some()
    }

    /// E\[j\] = Σ w·S̃\[j\] over `parts`, in their order, or what another rule or a filter makes of it. The answer is
    /// its maximum among the references that at least one of `parts` has a row for and whose score is not −∞; the
    /// lowest index wins ties. None when there is no such reference.
    ///
    /// The confidence is (E_best − E_rival) / (E_best − mean E), clamped to 0…1: the rival is the best eligible
    /// reference more than `exclusion` away from the best, the mean goes over the eligible references. It is 1 when
    /// every other part of the map is no better than the average place, 0 when a place elsewhere is as good, and 0
    /// when it has no meaning: no rival, or all places alike.
    ///
    /// # Panics
    /// When a part does not have one entry per reference.
    pub fn fuse<'a>(&mut self, parts: impl Iterator<Item = Part<'a>>) -> Option<Best> {
        self.combine(parts);
        self.rank();
        let best = *self.candidates.first()?;
        let reference = best.reference as usize;
        Some(Best {
            reference,
            score: best.score,
            confidence: self.confidence(reference, best.score),
        })
    }

    /// Finds E and who is eligible.
    fn combine<'a>(&mut self, parts: impl Iterator<Item = Part<'a>>) {
        let references = self.fused.len();
        self.fused.fill(0.0);
        self.eligible.fill(false);
        self.candidates.clear();
        let (mut others, mut any) = (Vec::new(), false);
        for part in parts {
            assert_eq!(
                (part.scores.len(), part.valid.len()),
                (references, references),
                "a part has one entry per reference"
            );
            any = true;
            for (eligible, valid) in self.eligible.iter_mut().zip(part.valid) {
                *eligible |= valid;
            }
            if self.rule == Rule::Sum {
                for (sum, score) in self.fused.iter_mut().zip(part.scores) {
                    *sum += part.weight * score;
                }
            } else {
                others.push(part);
            }
        }
        if self.rule != Rule::Sum {
            combine(self.rule, &others, &mut self.fused);
        }
        if let Some(filter) = &mut self.filter {
            let probabilities = filter.advance(any.then_some(&self.fused));
            self.fused.copy_from_slice(probabilities);
        }
    }

    /// E of the last [`Ensemble::fuse`], one score per reference; with a filter its probability.
    pub fn fused(&self) -> &[f64] {
        &self.fused
    }

    /// Which references could be the answer of the last [`Ensemble::fuse`]: those that a part had a row for.
    pub fn eligible(&self) -> &[bool] {
        &self.eligible
    }

    /// The best candidates of the last [`Ensemble::fuse`], best first, ties by index.
    pub fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    fn rank(&mut self) {
        let mut best = std::mem::take(&mut self.candidates);
        let blocks = self.fused.chunks(BLOCK).zip(self.eligible.chunks(BLOCK));
        for (start, (scores, eligible)) in (0..).step_by(BLOCK).zip(blocks) {
            let worst = best.last().filter(|_| best.len() == self.top);
            if worst.is_some_and(|worst| highest(scores, eligible) <= worst.score) {
                continue;
            }
            for (index, (score, eligible)) in scores.iter().zip(eligible).enumerate() {
                if counts(*score, *eligible) {
                    insert(&mut best, self.top, start + index, *score);
                }
            }
        }
        self.candidates = best;
    }

    fn confidence(&self, best: usize, best_score: f64) -> f64 {
        let (sum, count) = sum_and_count(&self.fused, &self.eligible);
        let (before, after) = (
            ..best.saturating_sub(self.exclusion),
            (best + self.exclusion + 1).min(self.fused.len())..,
        );
        let rival = highest(&self.fused[before], &self.eligible[before])
            .max(highest(&self.fused[after.clone()], &self.eligible[after]));
        let spread = best_score - sum / count;
        if rival > f64::NEG_INFINITY && spread > 0.0 {
            ((best_score - rival) / spread).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }
}

/// Puts a reference among the `top` best so far, which stand best first, ties in the order they came.
fn insert(best: &mut Vec<Candidate>, top: usize, reference: usize, score: f64) {
    if best.len() == top {
        if best.last().is_some_and(|worst| score <= worst.score) {
            return;
        }
        best.pop();
    }
    let at = best.partition_point(|c| c.score >= score);
    let candidate = Candidate {
        score,
        reference: reference as u32,
        ..Candidate::default()
    };
    best.insert(at, candidate);
}

/// The highest eligible score; −∞ where there is none.
fn highest(scores: &[f64], eligible: &[bool]) -> f64 {
    let (lanes, rest) = scores.as_chunks::<LANES>();
    let (e_lanes, e_rest) = eligible.as_chunks::<LANES>();
    let mut most = [f64::NEG_INFINITY; LANES];
    for (scores, eligible) in lanes.iter().zip(e_lanes) {
        for k in 0..LANES {
            let score = if eligible[k] { scores[k] } else { f64::NEG_INFINITY };
            most[k] = if score > most[k] { score } else { most[k] };
        }
    }
    let rest = rest
        .iter()
        .zip(e_rest)
        .filter(|(_, e)| **e)
        .map(|(score, _)| *score);
    most.into_iter().chain(rest).fold(f64::NEG_INFINITY, f64::max)
}

/// Whether a place can be the answer: −∞ is what cannot be scored.
#[inline(always)]
fn counts(score: f64, eligible: bool) -> bool {
    eligible & (score > f64::NEG_INFINITY)
}

/// The sum of the eligible scores, and how many there are.
fn sum_and_count(scores: &[f64], eligible: &[bool]) -> (f64, f64) {
    let (lanes, rest) = scores.as_chunks::<LANES>();
    let (e_lanes, e_rest) = eligible.as_chunks::<LANES>();
    let (mut sums, mut numbers) = ([0.0; LANES], [0.0; LANES]);
    for (scores, eligible) in lanes.iter().zip(e_lanes) {
        for k in 0..LANES {
            let counts = counts(scores[k], eligible[k]);
            sums[k] += if counts { scores[k] } else { 0.0 };
            numbers[k] += f64::from(counts);
        }
    }
    let rest = rest.iter().zip(e_rest).filter(|(s, e)| counts(**s, **e));
    let (sum, number) = rest.fold((0.0, 0.0), |(sum, number), (score, _)| {
        (sum + score, number + 1.0)
    });
    (
        sums.into_iter().sum::<f64>() + sum,
        numbers.into_iter().sum::<f64>() + number,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn part<'a>(scores: &'a [f64], valid: &'a [bool], weight: f64) -> Part<'a> {
        Part {
            scores,
            valid,
            weight,
        }
    }

    fn references(e: &Ensemble) -> Vec<u32> {
        e.candidates().iter().map(|c| c.reference).collect()
    }

    #[test]
    fn adds_with_weights_and_ranks() {
        let mut e = Ensemble::new(3, 2, 0);
        let all = [true; 3];
        let best = e
            .fuse(
                [
                    part(&[1.0, 2.0, 3.0], &all, 1.0),
                    part(&[4.0, 0.0, 0.0], &all, 0.5),
                ]
                .into_iter(),
            )
            .unwrap();
        assert_eq!(e.fused(), [3.0, 2.0, 3.0]);
        assert_eq!((best.reference, best.score), (0, 3.0));
        assert_eq!(references(&e), [0, 2]);
        assert_eq!(best.confidence, 0.0, "another place is as good");
    }

    #[test]
    fn ties_go_to_the_lowest_index() {
        let mut e = Ensemble::new(4, 4, 1);
        let best = e
            .fuse([part(&[1.0, 1.0, 1.0, 1.0], &[true; 4], 1.0)].into_iter())
            .unwrap();
        assert_eq!((best.reference, best.confidence), (0, 0.0));
        assert_eq!(references(&e), [0, 1, 2, 3]);
    }

    #[test]
    fn a_place_that_no_member_has_a_row_for_is_never_the_answer() {
        let mut e = Ensemble::new(4, 9, 0);
        let a = part(&[0.0, -2.0, -3.0, 0.0], &[false, true, true, false], 1.0);
        let b = part(&[0.0, -1.0, 0.0, -9.0], &[false, true, false, true], 1.0);
        let best = e.fuse([a, b].into_iter()).unwrap();
        assert_eq!(best.reference, 1);
        assert_eq!(references(&e), [1, 2, 3]);
        assert_eq!(e.fuse(std::iter::empty()), None);
        assert_eq!(e.fuse([part(&[1.0; 4], &[false; 4], 1.0)].into_iter()), None);
        assert_eq!(references(&e), [] as [u32; 0]);
    }

    #[test]
    fn confidence_is_the_margin_to_elsewhere_on_the_scale_of_the_best() {
        let scores = [0.0, 3.0, 4.0, 3.0, 0.0, 2.0];
        let confidence = |exclusion| {
            let mut e = Ensemble::new(6, 1, exclusion);
            e.fuse([part(&scores, &[true; 6], 1.0)].into_iter())
                .unwrap()
                .confidence
        };
        assert_eq!(confidence(0), 0.5);
        assert_eq!(confidence(1), 1.0);
        assert_eq!(confidence(5), 0.0, "no rival");
        let mut e = Ensemble::new(1, 1, 0);
        assert_eq!(
            e.fuse([part(&[7.0], &[true], 1.0)].into_iter())
                .unwrap()
                .confidence,
            0.0
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn the_top_is_that_of_a_full_sort(
            entries in prop::collection::vec((-3i32..3, any::<bool>()), 1..40), top in 1usize..10,
        ) {
            let scores: Vec<f64> = entries.iter().map(|(s, _)| f64::from(*s)).collect();
            let valid: Vec<bool> = entries.iter().map(|(_, v)| *v).collect();
            let mut order: Vec<u32> = (0..scores.len() as u32).filter(|j| valid[*j as usize]).collect();
            order.sort_by(|a, b| scores[*b as usize].total_cmp(&scores[*a as usize]).then(a.cmp(b)));
            order.truncate(top);
            let mut e = Ensemble::new(scores.len(), top, 2);
            let best = e.fuse([part(&scores, &valid, 1.0)].into_iter());
            prop_assert_eq!(references(&e), order.clone());
            prop_assert_eq!(best.map(|b| b.reference as u32), order.first().copied());
            prop_assert!(best.is_none_or(|b| (0.0..=1.0).contains(&b.confidence)));
        }

        #[test]
        fn the_order_of_the_members_does_not_matter(
            rows in prop::collection::vec(prop::collection::vec(-30.0f64..30.0, 7), 1..9),
            weights in prop::collection::vec(0.0f64..4.0, 9),
        ) {
            let valid = [true; 7];
            let parts: Vec<_> = rows.iter().zip(&weights).map(|(r, w)| part(r, &valid, *w)).collect();
            let (mut a, mut b) = (Ensemble::new(7, 3, 1), Ensemble::new(7, 3, 1));
            a.fuse(parts.iter().copied());
            b.fuse(parts.iter().rev().copied());
            for (x, y) in a.fused().iter().zip(b.fused()) {
                prop_assert!((x - y).abs() <= 1e-9);
            }
        }
    }
}
