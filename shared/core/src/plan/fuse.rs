//! What the fuser does: similarity, sequence method, and rule of fusion, with their parameters.

use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// The longest sequence that can be asked for while a run goes on, ticks.
pub const MAX_LENGTH: u32 = 1_000;
/// The longest deadline that can be asked for while a run goes on, ns: an hour.
pub const MAX_DEADLINE_NS: u64 = 3_600_000_000_000;

/// Similarity of a query row and a map row: higher is more alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Similarity {
    /// −‖q − r‖₂, the paper's equation.
    L2,
    /// −‖q − r‖₂², the authors' code.
    L2Squared,
    /// q·r / (‖q‖ ‖r‖).
    Cosine,
    /// −Σ|q − r|.
    Sad,
}

/// How a member's similarities over time become one score per place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SequenceMethod {
    /// The paper's: z-scored on both axes, summed along the diagonal, over a length that grows to L.
    Paper,
    /// Z-scored along the row only, summed along the diagonal, over a length that grows to L.
    Rows,
    /// `SeqSLAM`: local contrast along the row, summed along lines of several velocities; the best line counts.
    #[serde(rename = "seqslam")]
    SeqSlam(SeqSlam),
    /// A hidden Markov filter over places, after the members' row z-scores are fused. It has no length.
    Filter(Filter),
    /// The similarity of this tick alone.
    None,
}

impl SequenceMethod {
    /// Its name in configurations.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Rows => "rows",
            Self::SeqSlam(_) => "seqslam",
            Self::Filter(_) => "filter",
            Self::None => "none",
        }
    }

    /// Whether it has a sequence length L.
    pub fn has_length(&self) -> bool {
        !matches!(self, Self::Filter(_) | Self::None)
    }
}

/// Parameters of the method `seqslam`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SeqSlam {
    /// References that a similarity is compared with for its local contrast; at most a quarter of the map is used.
    pub window: usize,
    /// The least and the greatest velocity, in references per tick.
    pub velocities: [f64; 2],
    /// How many velocities, evenly spaced from the least to the greatest. One is the least alone.
    pub velocity_steps: usize,
}

impl SeqSlam {
    /// The authors' parameters.
    pub const AUTHORS: Self = Self {
        window: 20,
        velocities: [0.8, 1.2],
        velocity_steps: 10,
    };
    /// Windows that can be asked for.
    pub const WINDOWS: RangeInclusive<usize> = 2..=10_000;
    /// Velocities that can be asked for, references per tick.
    pub const VELOCITIES: RangeInclusive<f64> = 0.0..=10.0;
    /// Numbers of velocities that can be asked for.
    pub const VELOCITY_STEPS: RangeInclusive<usize> = 1..=100;

    /// Checks the velocities.
    ///
    /// # Errors
    /// That they are not two numbers in [`SeqSlam::VELOCITIES`], the least first.
    pub fn velocities_from(velocities: &[f64]) -> Result<[f64; 2], String> {
        match *velocities {
            [least, greatest]
                if least <= greatest
                    && Self::VELOCITIES.contains(&least)
                    && Self::VELOCITIES.contains(&greatest) =>
            {
                Ok([least, greatest])
            }
            _ => Err(format!(
                "velocities are the least and the greatest in references per tick, each from {} to {}; write two such \
                 as [0.8, 1.2]",
                Self::VELOCITIES.start(),
                Self::VELOCITIES.end()
            )),
        }
    }
}

/// Parameters of the method `filter`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Filter {
    /// β: how much a z-score of 1 speaks for a place; its probability is multiplied by exp(β·z).
    pub beta: f64,
    /// How far a tick carries along the map.
    pub transition: Transition,
    /// Probability that a tick starts anywhere anew.
    pub restart: f64,
}

impl Filter {
    /// What an unnamed parameter is.
    pub const DEFAULT: Self = Self {
        beta: 1.5,
        transition: Transition {
            weights: [
                0.2, 0.5, 0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            ],
        },
        restart: 0.02,
    };
    /// Values of β that can be asked for.
    pub const BETAS: RangeInclusive<f64> = 0.0..=100.0;
    /// Restarts that can be asked for.
    pub const RESTARTS: RangeInclusive<f64> = 0.0..=1.0;
    /// After so many ticks in a row without any row the filter starts over from everywhere alike.
    pub const FORGETS_AFTER: u64 = 1000;
}

/// Probabilities that the camera moves on by 0, 1, 2, … references in a tick; they add up to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<f64>", into = "Vec<f64>")]
pub struct Transition {
    weights: [f64; Self::MOST],
}

impl Transition {
    /// Most probabilities there may be.
    pub const MOST: usize = 16;

    /// These probabilities.
    ///
    /// # Errors
    /// That there are none or more than [`Transition::MOST`], that one is not from 0 to 1, or that they do not add up
    /// to 1 (within 1e-6).
    pub fn new(probabilities: &[f64]) -> Result<Self, String> {
        let advice = "write one for each number of references that a tick may move on, from 0 up, such as \
                      [0.2, 0.5, 0.2, 0.1]";
        let most = Self::MOST;
        if probabilities.is_empty() || probabilities.len() > most {
            let there = probabilities.len();
            return Err(format!("has {there} probabilities, 1 to {most} can be; {advice}"));
        }
        if let Some(bad) = probabilities.iter().find(|p| !(0.0..=1.0).contains(*p)) {
            return Err(format!("{bad} is not a probability from 0 to 1; {advice}"));
        }
        let sum: f64 = probabilities.iter().sum();
        if (sum - 1.0).abs() > 1e-6 {
            return Err(format!("the probabilities add up to {sum}, not to 1; {advice}"));
        }
        let mut weights = [0.0; Self::MOST];
        weights[..probabilities.len()].copy_from_slice(probabilities);
        Ok(Self { weights })
    }

    /// The probabilities up to the last one that is not 0.
    pub fn probabilities(&self) -> &[f64] {
        let last = self.weights.iter().rposition(|w| *w != 0.0);
        &self.weights[..last.map_or(0, |last| last + 1)]
    }
}

impl TryFrom<Vec<f64>> for Transition {
    type Error = String;

    fn try_from(probabilities: Vec<f64>) -> Result<Self, String> {
        Self::new(&probabilities)
    }
}

impl From<Transition> for Vec<f64> {
    fn from(transition: Transition) -> Self {
        transition.probabilities().to_vec()
    }
}

/// How members' scores become one. A member without a row at this tick, or of weight 0, has no part in any of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Weighted sum, the paper's.
    Sum,
    /// Weighted mean.
    Mean,
    /// The highest score; weights other than 0 are all alike to it.
    Max,
    /// Weighted median.
    Median,
    /// Weighted product of probabilities, as the sum of their logarithms; a member's are the softmax of its scores.
    Product,
    /// Weighted mean without the lowest and the highest scores.
    TrimmedMean {
        /// Share of the members left out at either end, rounded down to whole members.
        trim: f64,
    },
}

impl Rule {
    /// The trim of `trimmed_mean` where none is named: of four members, the lowest and the highest are left out.
    pub const TRIM: f64 = 0.25;
    /// Trims that can be asked for.
    pub const TRIMS: RangeInclusive<f64> = 0.0..=0.49;

    /// Its number, from 1, in [`crate::message::FuseSettings`].
    pub fn code(&self) -> u32 {
        match self {
            Self::Sum => 1,
            Self::Mean => 2,
            Self::Max => 3,
            Self::Median => 4,
            Self::Product => 5,
            Self::TrimmedMean { .. } => 6,
        }
    }

    /// The rule with this number; `trim` is that of `trimmed_mean`.
    pub fn from_code(code: u32, trim: f64) -> Option<Self> {
        let rules = [
            Self::Sum,
            Self::Mean,
            Self::Max,
            Self::Median,
            Self::Product,
            Self::TrimmedMean { trim },
        ];
        rules.into_iter().find(|rule| rule.code() == code)
    }

    /// The rule of this name, with the trim it has where none is named.
    pub fn named(name: &str) -> Option<Self> {
        (1..=6)
            .filter_map(|code| Self::from_code(code, Self::TRIM))
            .find(|rule| rule.name() == name)
    }

    /// Its name in configurations.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Sum => "sum",
            Self::Mean => "mean",
            Self::Max => "max",
            Self::Median => "median",
            Self::Product => "product",
            Self::TrimmedMean { .. } => "trimmed_mean",
        }
    }

    /// The rule of a configuration that names none: the paper's sum, but a mean before the filter, so that its β means
    /// the same with any number of members.
    pub fn default_with(sequence: Option<SequenceMethod>) -> Self {
        match sequence {
            Some(SequenceMethod::Filter(_)) => Self::Mean,
            _ => Self::Sum,
        }
    }
}

/// What the fuser does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fuse {
    /// Similarity.
    pub similarity: Similarity,
    /// Sequence method.
    pub sequence: SequenceMethod,
    /// Sequence length L in ticks; 1 where the method has none.
    pub length: usize,
    /// Fusion rule.
    pub rule: Rule,
    /// Candidates in an answer.
    pub top: usize,
    /// Candidates within so many references of the best do not count as rivals for the confidence.
    pub exclusion: usize,
    /// The least confidence of an answer, 0 to 1: below it there is none.
    #[serde(default)]
    pub min_confidence: f64,
}

impl Fuse {
    /// How many ticks before this one have a say in its answer; `None` when all of them have.
    pub fn history_ticks(&self) -> Option<u64> {
        match self.sequence {
            SequenceMethod::Filter(_) => None,
            SequenceMethod::None => Some(0),
            _ => Some(self.length.saturating_sub(1) as u64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fuse(sequence: SequenceMethod) -> Fuse {
        Fuse {
            similarity: Similarity::L2,
            sequence,
            length: 7,
            rule: Rule::Sum,
            top: 5,
            exclusion: 5,
            min_confidence: 0.0,
        }
    }

    #[test]
    fn the_ticks_that_have_a_say() {
        for sequence in [
            SequenceMethod::Paper,
            SequenceMethod::Rows,
            SequenceMethod::SeqSlam(SeqSlam::AUTHORS),
        ] {
            assert_eq!(fuse(sequence).history_ticks(), Some(6));
        }
        assert_eq!(fuse(SequenceMethod::None).history_ticks(), Some(0));
        assert_eq!(
            fuse(SequenceMethod::Filter(Filter::DEFAULT)).history_ticks(),
            None
        );
    }

    #[test]
    fn parameters_are_checked() {
        assert_eq!(SeqSlam::velocities_from(&[1.0, 1.0]), Ok([1.0, 1.0]));
        for bad in [
            &[1.0][..],
            &[1.2, 0.8],
            &[-0.1, 1.0],
            &[f64::NAN, 1.0],
            &[0.0, 11.0],
        ] {
            assert!(SeqSlam::velocities_from(bad).is_err(), "{bad:?}");
        }
        assert_eq!(
            Transition::new(&[0.0, 1.0, 0.0]).unwrap().probabilities(),
            [0.0, 1.0]
        );
        for bad in [
            &[][..],
            &[0.5, 0.4],
            &[1.5, -0.5],
            &[f64::NAN, 1.0],
            &[1.0 / 17.0; 17],
        ] {
            assert!(Transition::new(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn they_are_handed_over_as_written() {
        let filter = SequenceMethod::Filter(Filter::DEFAULT);
        let text = serde_json::to_string(&filter).unwrap();
        assert_eq!(
            text,
            r#"{"filter":{"beta":1.5,"transition":[0.2,0.5,0.2,0.1],"restart":0.02}}"#
        );
        assert_eq!(serde_json::from_str::<SequenceMethod>(&text).unwrap(), filter);
        let bad = text.replace("0.5", "0.7");
        assert!(serde_json::from_str::<SequenceMethod>(&bad).is_err());
        let trimmed = serde_json::to_string(&Rule::TrimmedMean { trim: 0.1 }).unwrap();
        assert_eq!(trimmed, r#"{"trimmed_mean":{"trim":0.1}}"#);
    }
}
