//! Method `filter`: a hidden Markov forward filter over places.
//!
//! The state is the place, p its probability, at first 1/R everywhere. Each tick, with z the fused row z-scores:
//! 1. predict: f\[j\] = (1 − restart) · Σ_s transition\[s\] · p\[j − s\] + restart/R; what would pass the end of the
//!    map is lost;
//! 2. weigh: p\[j\] ← f\[j\] · exp(β · (z\[j\] − max z)), divided by its sum.
//!
//! A tick on which no member has a row is predicted and not weighed: time passes without evidence.

use evpr_core::plan::Filter;

/// Probabilities of all places, tick by tick.
#[derive(Debug)]
pub struct ForwardFilter {
    parameters: Filter,
    probabilities: Vec<f64>,
    predicted: Vec<f64>,
    /// Ticks in a row without evidence.
    blind: u64,
}

impl ForwardFilter {
    /// A filter over so many places that has seen nothing yet.
    pub fn new(parameters: Filter, places: usize) -> Self {
        Self {
            parameters,
            probabilities: vec![1.0 / places as f64; places],
            predicted: vec![0.0; places],
            blind: 0,
        }
    }

    /// The probabilities of the last tick; they add up to 1.
    pub fn probabilities(&self) -> &[f64] {
        &self.probabilities
    }

    /// Ticks in a row without evidence.
    pub fn blind(&self) -> u64 {
        self.blind
    }

    /// Goes on from these probabilities after so many ticks without evidence, if there is one per place.
    pub fn resume(&mut self, probabilities: &[f64], blind: u64) {
        if probabilities.len() == self.probabilities.len() {
            self.probabilities.copy_from_slice(probabilities);
            self.blind = blind;
        }
    }

    /// Takes the next tick: one finite z-score per place, or `None` where there is no row at all. Gives the
    /// probabilities.
    ///
    /// It starts over from 1/R everywhere where no place is left possible (that takes a `restart` near 0), and after
    /// [`Filter::FORGETS_AFTER`] ticks in a row without any row.
    ///
    /// # Panics
    /// When there is not one z-score per place.
    pub fn advance(&mut self, z: Option<&[f64]>) -> &[f64] {
        self.predict();
        match z {
            Some(z) => {
                assert_eq!(z.len(), self.predicted.len(), "one z-score per place");
                let most = z.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                for (f, z) in self.predicted.iter_mut().zip(z) {
                    *f *= (self.parameters.beta * (z - most)).exp();
                }
                self.blind = 0;
            }
            None => self.blind = self.blind.saturating_add(1),
        }
        let sum: f64 = self.predicted.iter().sum();
        if sum > 0.0 && sum.is_finite() && self.blind < Filter::FORGETS_AFTER {
            for (p, f) in self.probabilities.iter_mut().zip(&self.predicted) {
                *p = f / sum;
            }
        } else {
            let places = self.probabilities.len() as f64;
            self.probabilities.fill(1.0 / places);
        }
        &self.probabilities
    }

    fn predict(&mut self) {
        let (restart, places) = (self.parameters.restart, self.predicted.len());
        self.predicted.fill(0.0);
        let transition = self.parameters.transition;
        for (step, weight) in transition.probabilities().iter().enumerate().take(places) {
            for (f, p) in self.predicted[step..].iter_mut().zip(&self.probabilities) {
                *f += weight * p;
            }
        }
        for f in &mut self.predicted {
            *f = (1.0 - restart) * *f + restart / places as f64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::Transition;

    fn filter(restart: f64, places: usize) -> ForwardFilter {
        let parameters = Filter {
            beta: 1.0,
            transition: Transition::new(&[0.0, 1.0]).unwrap_or(Filter::DEFAULT.transition),
            restart,
        };
        ForwardFilter::new(parameters, places)
    }

    #[test]
    fn probability_moves_on_and_is_lost_at_the_end() {
        let mut f = filter(0.0, 4);
        assert_eq!(f.advance(None), [0.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0]);
        assert_eq!(f.advance(None), [0.0, 0.0, 0.5, 0.5]);
        f.advance(None);
        assert_eq!(
            f.advance(None),
            [0.25; 4],
            "nothing is left possible: it starts over"
        );
    }

    #[test]
    fn evidence_counts_by_its_exponential() {
        let mut f = filter(1.0, 2);
        let p = f.advance(Some(&[0.0, 3f64.ln()]));
        assert!(
            (p[0] - 0.25).abs() < 1e-15 && (p[1] - 0.75).abs() < 1e-15,
            "{p:?}"
        );
        assert_eq!(filter(0.5, 1).advance(Some(&[-7.0])), [1.0]);
        let mut far = filter(0.0, 2);
        assert_eq!(far.advance(Some(&[0.0, -1e9])), [0.5; 2], "underflow starts over");
    }

    #[test]
    fn a_thousand_blind_ticks_are_forgotten() {
        let mut f = filter(0.02, 3);
        f.advance(Some(&[0.0, 9.0, 0.0]));
        for _ in 1..Filter::FORGETS_AFTER {
            f.advance(None);
        }
        assert_ne!(f.probabilities(), [1.0 / 3.0; 3]);
        assert_eq!(f.advance(None), [1.0 / 3.0; 3]);
    }
}
