//! Order statistics over the members, place by place: the weighted median and the trimmed mean.
//!
//! Where all members weigh alike, which is the rule, the scores of a block of places are sorted by a network of
//! comparisons (K. E. Batcher, "Sorting Networks and Their Applications", 1968) that is the same for all places, so
//! that several places are compared at a time.

use crate::ensemble::Part;
use crate::simd::{Kernel, run_widest};

/// Places sorted together: with 64 members they take 32 KiB.
const BLOCK: usize = 64;
/// Shares of the weight that differ by less than this are equal: they are sums of rounded numbers.
const EQUAL: f64 = 1e-12;

/// A statistic of the members' scores.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Statistic {
    /// The score at which half the weight is reached; the midpoint with the next one where it is reached exactly.
    Median,
    /// The mean without this share of the members at either end.
    TrimmedMean(f64),
}

/// Memory of a thread.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    /// One row of places per member.
    scores: Vec<f64>,
    /// Members that have the place.
    there: Vec<usize>,
    /// Scores of a place with their weights.
    weighted: Vec<(f64, f64)>,
    /// The network, for as many members.
    network: (usize, Vec<(usize, usize)>),
}

/// Applies a statistic to the places from `start` on. Members that do not have a place have no say there; a place that
/// nobody has is 0.
pub(crate) fn by_place(
    parts: &[Part<'_>],
    start: usize,
    out: &mut [f64],
    memory: &mut Memory,
    statistic: Statistic,
) {
    let alike = parts.windows(2).all(|pair| pair[0].weight == pair[1].weight);
    if !alike {
        return by_weight(parts, start, out, &mut memory.weighted, statistic);
    }
    if memory.network.0 != parts.len() {
        memory.network = (parts.len(), network(parts.len()));
    }
    for (index, out) in out.chunks_mut(BLOCK).enumerate() {
        let start = start + index * BLOCK;
        gather(parts, start, out.len(), memory);
        run_widest(Sort {
            network: &memory.network.1,
            scores: &mut memory.scores,
            places: out.len(),
        });
        for (place, (out, n)) in out.iter_mut().zip(&memory.there).enumerate() {
            let ranked = |rank: usize| memory.scores[rank * memory.there.len() + place];
            *out = match (statistic, *n) {
                (_, 0) => 0.0,
                (Statistic::Median, n) => ranked((n - 1) / 2) / 2.0 + ranked(n / 2) / 2.0,
                (Statistic::TrimmedMean(trim), n) => {
                    let cut = cut(trim, n);
                    (cut..n - cut).map(ranked).sum::<f64>() / (n - 2 * cut) as f64
                }
            };
        }
    }
}

/// Scores of a block, what is not there above all others.
fn gather(parts: &[Part<'_>], start: usize, places: usize, memory: &mut Memory) {
    let Memory { scores, there, .. } = memory;
    scores.clear();
    there.clear();
    there.resize(places, 0);
    for part in parts {
        let block = start..start + places;
        let of_part = part.scores[block.clone()].iter().zip(&part.valid[block]);
        scores.extend(of_part.zip(&mut *there).map(|((score, valid), there)| {
            *there += usize::from(*valid);
            if *valid { *score } else { f64::INFINITY }
        }));
    }
}

/// Members left out at either end.
fn cut(trim: f64, n: usize) -> usize {
    ((trim * n as f64) as usize).min((n - 1) / 2)
}

/// Batcher's odd-even merge sort: pairs of rows to be put in order, one after the other.
fn network(n: usize) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    let mut sorted = 1;
    while sorted < n {
        let mut apart = sorted;
        while apart > 0 {
            for first in (apart % sorted..n - apart).step_by(2 * apart) {
                for low in first..(first + apart).min(n - apart) {
                    if low / (2 * sorted) == (low + apart) / (2 * sorted) {
                        pairs.push((low, low + apart));
                    }
                }
            }
            apart /= 2;
        }
        sorted *= 2;
    }
    pairs
}

/// Sorts the columns of a block.
struct Sort<'a> {
    network: &'a [(usize, usize)],
    scores: &'a mut [f64],
    places: usize,
}

impl Kernel for Sort<'_> {
    #[inline(always)]
    fn run(self) {
        for (low, high) in self.network {
            let (before, after) = self.scores.split_at_mut(high * self.places);
            put_in_order(
                &mut before[low * self.places..][..self.places],
                &mut after[..self.places],
            );
        }
    }
}

#[inline(always)]
fn put_in_order(low: &mut [f64], high: &mut [f64]) {
    for (low, high) in low.iter_mut().zip(high) {
        let (a, b) = (*low, *high);
        *low = if a < b { a } else { b };
        *high = if a < b { b } else { a };
    }
}

/// The same for members of different weights, one place at a time.
fn by_weight(
    parts: &[Part<'_>],
    start: usize,
    out: &mut [f64],
    memory: &mut Vec<(f64, f64)>,
    statistic: Statistic,
) {
    for (place, out) in (start..).zip(out) {
        memory.clear();
        let there = parts.iter().filter(|part| part.valid[place]);
        memory.extend(there.map(|part| (part.scores[place], part.weight)));
        memory.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        *out = match (statistic, memory.len()) {
            (_, 0) => 0.0,
            (Statistic::Median, _) => weighted_median(memory),
            (Statistic::TrimmedMean(trim), n) => {
                let cut = cut(trim, n);
                weighted_mean(&memory[cut..n - cut])
            }
        };
    }
}

/// Of ascending scores with their weights.
fn weighted_median(scores: &[(f64, f64)]) -> f64 {
    let total: f64 = scores.iter().map(|(_, weight)| weight).sum();
    let mut below = 0.0;
    for (index, (score, weight)) in scores.iter().enumerate() {
        below += weight;
        let past_half = below - total / 2.0;
        if past_half.abs() <= EQUAL * total {
            let next = scores.get(index + 1).map_or(*score, |(next, _)| *next);
            return score / 2.0 + next / 2.0;
        }
        if past_half > 0.0 {
            return *score;
        }
    }
    scores.last().map_or(0.0, |(score, _)| *score)
}

fn weighted_mean(scores: &[(f64, f64)]) -> f64 {
    let total: f64 = scores.iter().map(|(_, weight)| weight).sum();
    let sum: f64 = scores.iter().map(|(score, weight)| score * weight).sum();
    if total > 0.0 { sum / total } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::tests::with_baseline;
    use proptest::prelude::*;

    #[test]
    fn the_network_sorts_any_number_of_members() {
        // What sorts all sequences of 0 and 1 sorts everything.
        for n in 0..13usize {
            let pairs = network(n);
            for bits in 0u32..1 << n {
                let mut values: Vec<u32> = (0..n).map(|i| bits >> i & 1).collect();
                for (low, high) in &pairs {
                    if values[*low] > values[*high] {
                        values.swap(*low, *high);
                    }
                }
                assert!(values.is_sorted(), "{n} {bits:b}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn the_network_and_one_place_at_a_time_agree(
            places in 1usize..200, members in 1usize..70, seed in 0usize..1000, median in any::<bool>(),
        ) {
            let value = |i: usize| ((i * 7919 + seed) as f64).sin();
            let rows: Vec<Vec<f64>> =
                (0..members).map(|m| (0..places).map(|j| value(m * places + j)).collect()).collect();
            let valid: Vec<Vec<bool>> =
                (0..members).map(|m| (0..places).map(|j| (m * 3 + j + seed) % 5 != 0).collect()).collect();
            let parts: Vec<Part<'_>> = rows
                .iter()
                .zip(&valid)
                .map(|(scores, valid)| Part { scores, valid, weight: 0.3 })
                .collect();
            let statistic = if median { Statistic::Median } else { Statistic::TrimmedMean(0.2) };
            let mut one = vec![7.0; places];
            by_weight(&parts, 0, &mut one, &mut Vec::new(), statistic);
            let network = || {
                let mut out = vec![7.0; places];
                by_place(&parts, 0, &mut out, &mut Memory::default(), statistic);
                out
            };
            let fast = network();
            for (a, b) in fast.iter().zip(&one) {
                prop_assert!((a - b).abs() <= 1e-12, "{} {}", a, b);
            }
            prop_assert_eq!(fast, with_baseline(network));
        }
    }
}
