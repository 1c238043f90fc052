//! Rules other than the sum by which the members' scores become one.
//!
//! At each place j, over the members m that have a row at this tick, a weight w above 0 and a map row for j:
//!
//! | rule | E\[j\] |
//! |---|---|
//! | `mean` | Σ w·S̃ / Σ w |
//! | `max` | max S̃; weights do not enter |
//! | `median` | the weighted median of S̃: half the weight lies below, half above; between two members their midpoint |
//! | `trimmed_mean` | Σ w·S̃ / Σ w, of n members without the ⌊trim·n⌋ lowest and the ⌊trim·n⌋ highest |
//! | `product` | Σ w·ln P, where P\[j\] = exp S̃\[j\] / Σ exp S̃ over all places that the member has a map row for |
//!
//! With equal weights these are NumPy's `mean`, `max` and `median` over the members, and SciPy's `trim_mean`.
//!
//! Scores are signed, so their own product would mean nothing: two members that both speak against a place would speak
//! for it. The softmax makes them positive: a member's probability of each place, if its scores are taken for log
//! odds. Their product is that of independent witnesses, and its logarithm, a sum, does not underflow. The softmax
//! divides a member's scores by one number for all places, so where all members have the same places, `product`
//! ranks them as `sum` does; what differs is the scale of the score.
//!
//! A member that has no map row for a place has no say there; to `product` it then finds all its n places alike,
//! P = 1/n. A place for which nobody has one is 0, and never the answer.

use crate::ensemble::Part;
use crate::order::{Memory, Statistic, by_place};
use evpr_core::plan::Rule;
use rayon::prelude::*;

/// Places per block: a block of every member's scores is worked on in turn.
const BLOCK: usize = 256;
/// From so many scores on, work is shared out among threads.
const PARALLEL_SCORES: usize = 1 << 14;

/// Writes E of every place. [`Rule::Sum`] has its own way in [`Ensemble`](crate::ensemble::Ensemble).
pub(crate) fn combine(rule: Rule, parts: &[Part<'_>], out: &mut [f64]) {
    let least = if parts.len() * out.len() < PARALLEL_SCORES {
        usize::MAX
    } else {
        1
    };
    let logs: Vec<LogSoftmax> = match rule {
        Rule::Product => parts.par_iter().with_min_len(least).map(LogSoftmax::of).collect(),
        _ => Vec::new(),
    };
    let blocks = out.par_chunks_mut(BLOCK).enumerate().with_min_len(least);
    blocks.for_each_init(Memory::default, |memory, (index, out)| {
        let start = index * BLOCK;
        match rule {
            Rule::Sum => sum(parts, start, out),
            Rule::Mean => mean(parts, start, out),
            Rule::Max => max(parts, start, out),
            Rule::Product => product(parts, &logs, start, out),
            Rule::Median => by_place(parts, start, out, memory, Statistic::Median),
            Rule::TrimmedMean { trim } => {
                by_place(parts, start, out, memory, Statistic::TrimmedMean(trim));
            }
        }
    });
}

/// Scores and flags of a block of places, and the weight.
fn block<'a>(
    parts: &'a [Part<'_>],
    start: usize,
    places: usize,
) -> impl Iterator<Item = (&'a [f64], &'a [bool], f64)> {
    parts.iter().map(move |part| {
        let block = start..start + places;
        (&part.scores[block.clone()], &part.valid[block], part.weight)
    })
}

fn sum(parts: &[Part<'_>], start: usize, out: &mut [f64]) {
    out.fill(0.0);
    for (scores, _, weight) in block(parts, start, out.len()) {
        for (sum, score) in out.iter_mut().zip(scores) {
            *sum += weight * score;
        }
    }
}

fn mean(parts: &[Part<'_>], start: usize, out: &mut [f64]) {
    let mut totals = [0.0; BLOCK];
    out.fill(0.0);
    for (scores, valid, weight) in block(parts, start, out.len()) {
        for (((sum, total), score), valid) in out.iter_mut().zip(&mut totals).zip(scores).zip(valid) {
            if *valid {
                *sum += weight * score;
                *total += weight;
            }
        }
    }
    for (sum, total) in out.iter_mut().zip(totals) {
        *sum = if total > 0.0 { *sum / total } else { 0.0 };
    }
}

fn max(parts: &[Part<'_>], start: usize, out: &mut [f64]) {
    let mut there = [false; BLOCK];
    out.fill(f64::NEG_INFINITY);
    for (scores, valid, _) in block(parts, start, out.len()) {
        for (((most, there), score), valid) in out.iter_mut().zip(&mut there).zip(scores).zip(valid) {
            if *valid {
                *most = if *score > *most { *score } else { *most };
                *there = true;
            }
        }
    }
    for (most, there) in out.iter_mut().zip(there) {
        *most = if there { *most } else { 0.0 };
    }
}

/// What turns a member's scores into logarithms of probabilities.
#[derive(Debug, Clone, Copy)]
struct LogSoftmax {
    /// ln Σ exp S̃ over the places it has.
    log_sum: f64,
    /// ln 1/n.
    uniform: f64,
}

impl LogSoftmax {
    fn of(part: &Part<'_>) -> Self {
        let there = || part.scores.iter().zip(part.valid).filter(|(_, valid)| **valid);
        let most = there().fold(f64::NEG_INFINITY, |most, (score, _)| most.max(*score));
        // Nothing but −∞ stays −∞.
        let most = if most > f64::NEG_INFINITY { most } else { 0.0 };
        let sum: f64 = there().map(|(score, _)| (score - most).exp()).sum();
        let n = there().count();
        Self {
            log_sum: if sum > 0.0 { most + sum.ln() } else { 0.0 },
            uniform: -(n.max(1) as f64).ln(),
        }
    }
}

fn product(parts: &[Part<'_>], logs: &[LogSoftmax], start: usize, out: &mut [f64]) {
    out.fill(0.0);
    for ((scores, valid, weight), log) in block(parts, start, out.len()).zip(logs) {
        for ((sum, score), valid) in out.iter_mut().zip(scores).zip(valid) {
            *sum += weight * if *valid { score - log.log_sum } else { log.uniform };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fused(rule: Rule, members: &[(&[f64], &[bool], f64)]) -> Vec<f64> {
        let parts: Vec<Part<'_>> = members
            .iter()
            .map(|(scores, valid, weight)| Part {
                scores,
                valid,
                weight: *weight,
            })
            .collect();
        let mut out = vec![7.0; members[0].0.len()];
        combine(rule, &parts, &mut out);
        out
    }

    const ALL: &[bool] = &[true; 2];

    #[test]
    fn worked_by_hand() {
        let four: [(&[f64], &[bool], f64); 4] = [
            (&[1.0, 9.0], ALL, 1.0),
            (&[2.0, -9.0], ALL, 1.0),
            (&[6.0, 0.0], ALL, 1.0),
            (&[3.0, 4.0], ALL, 1.0),
        ];
        assert_eq!(fused(Rule::Mean, &four), [3.0, 1.0]);
        assert_eq!(fused(Rule::Max, &four), [6.0, 9.0]);
        assert_eq!(fused(Rule::Median, &four), [2.5, 2.0]);
        assert_eq!(fused(Rule::TrimmedMean { trim: 0.25 }, &four), [2.5, 2.0]);
        assert_eq!(fused(Rule::TrimmedMean { trim: 0.24 }, &four), [3.0, 1.0]);
        assert_eq!(fused(Rule::Median, &four[..3]), [2.0, 0.0]);
        let one_third = fused(Rule::Product, &[(&[0.0, 2f64.ln()], ALL, 1.0)]);
        assert!(
            (one_third[0] - (1.0f64 / 3.0).ln()).abs() < 1e-15,
            "{one_third:?}"
        );
    }

    #[test]
    fn weights_count_as_repetitions() {
        let weighed: [(&[f64], &[bool], f64); 3] = [
            (&[1.0, 5.0], ALL, 3.0),
            (&[2.0, 4.0], ALL, 1.0),
            (&[4.0, 1.0], ALL, 2.0),
        ];
        let repeated: Vec<_> = weighed
            .iter()
            .flat_map(|(s, v, w)| vec![(*s, *v, 1.0); *w as usize])
            .collect();
        for rule in [Rule::Mean, Rule::Median, Rule::Product] {
            for (a, b) in fused(rule, &weighed).iter().zip(fused(rule, &repeated)) {
                assert!((a - b).abs() < 1e-12, "{rule:?}: {a} {b}");
            }
        }
        assert_eq!(fused(Rule::Median, &weighed), [1.5, 4.5]);
        assert_eq!(fused(Rule::Max, &weighed), [4.0, 5.0]);
    }

    #[test]
    fn members_without_the_place_have_no_say_there() {
        let members: [(&[f64], &[bool], f64); 3] = [
            (&[-5.0, 1.0, 0.0], &[true, true, false], 1.0),
            (&[0.0, 3.0, 0.0], &[false, true, false], 2.0),
            (&[-1.0, 0.0, 0.0], &[true, false, false], 1.0),
        ];
        let third = 7.0 / 3.0;
        for (rule, expected) in [
            (Rule::Mean, [-3.0, third, 0.0]),
            (Rule::Max, [-1.0, 3.0, 0.0]),
            (Rule::Median, [-3.0, 3.0, 0.0]),
            (Rule::TrimmedMean { trim: 0.4 }, [-3.0, third, 0.0]),
        ] {
            assert_eq!(fused(rule, &members), expected, "{rule:?}");
        }
        // The second knows one place, so it finds nothing else possible, nor likelier than that one.
        let product = fused(Rule::Product, &members);
        let first = -(6f64.exp() + 1.0).ln();
        assert!((product[0] - first).abs() < 1e-12, "{product:?}");
    }

    #[test]
    fn a_place_that_cannot_be_scored_stays_so() {
        let nothing = f64::NEG_INFINITY;
        let members: [(&[f64], &[bool], f64); 2] =
            [(&[nothing, 1.0], ALL, 1.0), (&[nothing, nothing], ALL, 1.0)];
        for rule in [
            Rule::Mean,
            Rule::Median,
            Rule::Product,
            Rule::TrimmedMean { trim: 0.25 },
        ] {
            assert_eq!(fused(rule, &members), [nothing; 2], "{rule:?}");
        }
        assert_eq!(fused(Rule::Max, &members), [nothing, 1.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn product_ranks_as_the_sum_does(
            rows in prop::collection::vec(prop::collection::vec(-30.0f64..30.0, 9), 1..9),
            weights in prop::collection::vec(0.1f64..4.0, 9),
        ) {
            let members: Vec<_> = rows.iter().zip(&weights).map(|(r, w)| (&r[..], &[true; 9][..], *w)).collect();
            let (sum, product) = (fused(Rule::Sum, &members), fused(Rule::Product, &members));
            let offset = sum[0] - product[0];
            for (s, p) in sum.iter().zip(&product) {
                prop_assert!((s - p - offset).abs() <= 1e-9, "{} {}", s - p, offset);
            }
        }

        #[test]
        fn blocks_and_threads_change_nothing(places in 1usize..700, members in 1usize..40, seed in 0usize..100) {
            let value = |i: usize| ((i * 7919 + seed) as f64).sin();
            let rows: Vec<Vec<f64>> =
                (0..members).map(|m| (0..places).map(|j| value(m * places + j)).collect()).collect();
            let valid: Vec<Vec<bool>> =
                (0..members).map(|m| (0..places).map(|j| (m * 3 + j) % 7 != 0).collect()).collect();
            let all: Vec<_> = rows.iter().zip(&valid).map(|(r, v)| (&r[..], &v[..], 1.0)).collect();
            for rule in [Rule::Mean, Rule::Max, Rule::Median, Rule::TrimmedMean { trim: 0.2 }] {
                let whole = fused(rule, &all);
                for j in [0, places / 2, places - 1] {
                    let one: Vec<_> = all.iter().map(|(r, v, w)| (&r[j..=j], &v[j..=j], *w)).collect();
                    prop_assert_eq!(whole[j], fused(rule, &one)[0], "{:?} at {}", rule, j);
                }
            }
        }
    }
}
