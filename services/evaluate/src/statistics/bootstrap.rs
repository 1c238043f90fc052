//! Intervals of recall by the bootstrap over contiguous blocks of queries.
//!
//! Neighbouring queries see the same places and share their sequences, so they are not drawn one by one but in blocks of
//! max(L, ⌈√Q⌉) consecutive queries, from anywhere on the circle of all Q (after Politis and Romano, 1992); as many blocks
//! as fill Q queries. The interval holds the middle 95 % of 1,000 such recalls. The draws are the same for all
//! configurations of a pair with blocks of one length.

use serde::{Deserialize, Serialize};

const DRAWS: usize = 1000;
const SEED: u64 = 0x5eed_0fb1_0cc5;

/// The middle 95 % of what the bootstrap gives.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Recall@1 of all queries: 2.5 % are below.
    pub of_all_low: f64,
    /// 2.5 % are above.
    pub of_all_high: f64,
    /// Recall@1 of the queries that have a right place: 2.5 % are below.
    pub of_matchable_low: f64,
    /// 2.5 % are above.
    pub of_matchable_high: f64,
}

/// The interval of Recall@1, given which queries were answered rightly and which have a right place; `length` is L.
pub fn recall_interval(right: &[bool], matchable: &[bool], length: usize) -> Interval {
    let queries = right.len().min(matchable.len());
    if queries == 0 {
        return Interval::default();
    }
    let block = length
        .max((queries as f64).sqrt().ceil() as usize)
        .clamp(1, queries);
    let (right, matchable) = (sums(&right[..queries]), sums(&matchable[..queries]));
    let mut random = Random(SEED);
    let (mut of_all, mut of_matchable) = (Vec::with_capacity(DRAWS), Vec::with_capacity(DRAWS));
    for _ in 0..DRAWS {
        let (mut left, mut hits, mut matches) = (queries, 0, 0);
        while left > 0 {
            let (start, count) = (random.below(queries), block.min(left));
            hits += within(&right, start, count);
            matches += within(&matchable, start, count);
            left -= count;
        }
        of_all.push(hits as f64 / queries as f64);
        of_matchable.push(hits as f64 / matches.max(1) as f64);
    }
    let (of_all, of_matchable) = (middle(of_all), middle(of_matchable));
    Interval {
        of_all_low: of_all.0,
        of_all_high: of_all.1,
        of_matchable_low: of_matchable.0,
        of_matchable_high: of_matchable.1,
    }
}

/// How many are true before each place.
fn sums(marks: &[bool]) -> Vec<usize> {
    let mut sum = 0;
    let mut all = vec![0];
    all.extend(marks.iter().map(|mark| {
        sum += usize::from(*mark);
        sum
    }));
    all
}

/// How many are true among `count` from `start` on, round the circle.
fn within(sums: &[usize], start: usize, count: usize) -> usize {
    let all = sums.len() - 1;
    let end = start + count;
    if end <= all {
        sums[end] - sums[start]
    } else {
        sums[all] - sums[start] + sums[end - all]
    }
}

fn middle(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let cut = values.len() / 40;
    (values[cut], values[values.len() - 1 - cut])
}

/// SplitMix64: the same numbers on every machine.
struct Random(u64);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((u128::from(z ^ (z >> 31)) * end as u128) >> 64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sure_has_no_width() {
        let all = recall_interval(&[true; 40], &[true; 40], 5);
        assert_eq!((all.of_all_low, all.of_matchable_high), (1.0, 1.0));
        assert_eq!(recall_interval(&[], &[], 5), Interval::default());
    }

    #[test]
    fn independent_queries_have_the_width_of_the_binomial() {
        let mut random = Random(7);
        let right: Vec<bool> = (0..2500).map(|_| random.below(10) < 3).collect();
        let found = recall_interval(&right, &[true; 2500], 1);
        let p = right.iter().filter(|r| **r).count() as f64 / 2500.0;
        let width = 2.0 * 1.96 * (p * (1.0 - p) / 2500.0).sqrt();
        let ratio = (found.of_all_high - found.of_all_low) / width;
        assert!((0.8..1.2).contains(&ratio), "{ratio}");
        assert!(found.of_all_low < p && p < found.of_all_high);
        assert_eq!(found.of_all_low, found.of_matchable_low);
    }

    #[test]
    fn runs_of_right_answers_widen_it() {
        let scattered: Vec<bool> = (0..900).map(|q| q % 2 == 0).collect();
        let in_runs: Vec<bool> = (0..900).map(|q| q / 90 % 2 == 0).collect();
        let width = |right: &[bool]| {
            let found = recall_interval(right, &[true; 900], 10);
            found.of_all_high - found.of_all_low
        };
        assert!(width(&in_runs) > 5.0 * width(&scattered));
    }

    #[test]
    fn blocks_go_round() {
        let sums = sums(&[true, false, true, true]);
        assert_eq!(
            (within(&sums, 3, 2), within(&sums, 2, 4), within(&sums, 1, 2)),
            (2, 3, 1)
        );
    }
}
