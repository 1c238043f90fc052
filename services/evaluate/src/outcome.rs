//! What came of one query: the answer, and where among all places the best right one stands.

/// What came of one query of one configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// The answered reference; `None` where there was no answer.
    pub answer: Option<u32>,
    /// Confidence of the answer, 0 to 1; 0 without one.
    pub confidence: f64,
    /// Places before the first right one, ties in the order of places as the fuser breaks them. [`Outcome::NOWHERE`]
    /// when no right place can be answered.
    pub rank: u32,
    /// Places with a higher score than the best right one.
    pub better: u32,
    /// Wrong places with the same score as the best right one.
    pub tied: u32,
}

impl Outcome {
    /// The rank of what is not there.
    pub const NOWHERE: u32 = u32::MAX;

    /// No answer.
    pub const NONE: Self = Self {
        answer: None,
        confidence: 0.0,
        rank: Self::NOWHERE,
        better: Self::NOWHERE,
        tied: 0,
    };

    /// Of the fused scores of all references; `eligible` says which may be answered, `right` which are right (ascending).
    pub fn new(answer: u32, confidence: f64, scores: &[f64], eligible: &[bool], right: &[u32]) -> Self {
        let mut outcome = Self {
            answer: Some(answer),
            confidence,
            ..Self::NONE
        };
        let may = |j: &&u32| eligible.get(**j as usize).copied().unwrap_or(false);
        let best = right
            .iter()
            .filter(may)
            .filter_map(|j| scores.get(*j as usize))
            .fold(f64::NEG_INFINITY, |most, s| most.max(*s));
        // −∞ is what cannot be scored, and is never the answer.
        if best == f64::NEG_INFINITY {
            return outcome;
        }
        let is_best = |j: &&u32| scores.get(**j as usize) == Some(&best);
        let Some(first) = right.iter().filter(may).find(is_best) else {
            return outcome;
        };
        let (mut better, mut tied, mut before) = (0u32, 0u32, 0u32);
        for (j, (score, eligible)) in (0u32..).zip(scores.iter().zip(eligible)) {
            better += u32::from(*eligible && *score > best);
            let equal = *eligible && *score == best;
            tied += u32::from(equal);
            before += u32::from(equal && j < *first);
        }
        let right_tied = right.iter().filter(may).filter(is_best).count() as u32;
        outcome.better = better;
        outcome.tied = tied - right_tied;
        outcome.rank = better + before;
        outcome
    }

    /// Whether the answer is right.
    pub fn is_right(&self) -> bool {
        self.rank == 0
    }

    /// Whether a right place is among the first `k`.
    pub fn is_within(&self, k: u32) -> bool {
        self.rank < k
    }

    /// The same if all ties were broken in favour of the right place.
    pub fn is_within_at_best(&self, k: u32) -> bool {
        self.better < k
    }

    /// The same if all ties were broken against the right place.
    pub fn is_within_at_worst(&self, k: u32) -> bool {
        self.better.saturating_add(self.tied) < k
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ties_are_bracketed() {
        let eligible = [true, true, true, true, false, true];
        let scores = [1.0, 2.0, 2.0, 2.0, 9.0, 3.0];
        let outcome = Outcome::new(5, 0.5, &scores, &eligible, &[2, 4]);
        assert_eq!((outcome.better, outcome.tied, outcome.rank), (1, 2, 2));
        assert!(!outcome.is_within(2) && outcome.is_within(3));
        assert!(
            outcome.is_within_at_best(2) && !outcome.is_within_at_worst(3) && outcome.is_within_at_worst(4)
        );
        assert_eq!(
            Outcome::new(5, 0.5, &scores, &eligible, &[4]).rank,
            Outcome::NOWHERE
        );
        assert_eq!(
            Outcome::new(5, 0.5, &scores, &eligible, &[]).rank,
            Outcome::NOWHERE
        );
        assert!(Outcome::new(5, 0.5, &scores, &eligible, &[5]).is_right());
        let none = f64::NEG_INFINITY;
        assert_eq!(
            Outcome::new(1, 0.5, &[none, 1.0], &[true; 2], &[0]).rank,
            Outcome::NOWHERE
        );
        for k in [1, 20, u32::MAX] {
            assert!(!Outcome::NONE.is_within(k) && !Outcome::NONE.is_within_at_best(k));
            assert!(!Outcome::NONE.is_within_at_worst(k));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn the_rank_is_that_of_a_stable_sort(
            entries in prop::collection::vec((-2i32..3, any::<bool>(), prop::bool::weighted(0.3)), 1..20),
        ) {
            let scores: Vec<f64> = entries.iter().map(|e| f64::from(e.0)).collect();
            let eligible: Vec<bool> = entries.iter().map(|e| e.1).collect();
            let right: Vec<u32> = (0u32..).zip(&entries).filter(|(_, e)| e.2).map(|(j, _)| j).collect();
            let mut order: Vec<u32> = (0..scores.len() as u32).filter(|j| eligible[*j as usize]).collect();
            order.sort_by(|a, b| scores[*b as usize].total_cmp(&scores[*a as usize]));
            let want = order.iter().position(|j| right.contains(j)).map_or(Outcome::NOWHERE, |p| p as u32);
            let outcome = Outcome::new(0, 0.0, &scores, &eligible, &right);
            prop_assert_eq!(outcome.rank, want);
            for k in [1, 2, 5] {
                prop_assert!(!outcome.is_within_at_worst(k) || outcome.is_within(k));
                prop_assert!(!outcome.is_within(k) || outcome.is_within_at_best(k));
            }
        }
    }
}
