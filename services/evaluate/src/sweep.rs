//! All configurations of a pair with one similarity, in one pass over the queries.
//!
//! What is held at once, for M members, R references, Q queries, blocks of T ticks (so that T·M·R ≤ 16 Mi, T ≥ 1), and per
//! pass the sequences (method, length L) with their configurations C:
//!
//! 16·M·R·T + Σ over sequences (8·M·R·(L + 8)) + C·(25·R + 40·Q) bytes
//!
//! besides the rows themselves, which are mapped from the disk. Sequences that do not fit together under the limit are
//! computed in passes after one another, each of which computes the similarities again.

use crate::error::EvaluateError;
use crate::fusion::{FUSION_BYTES, Fusion, Lane, Matched, Scored, matcher_bytes};
use crate::outcome::Outcome;
use crate::pair::Pair;
use crate::spec::{Configuration, Spec};
use evpr_core::MemberSet;
use evpr_core::plan::{SequenceMethod, Similarity};
use evpr_fuse::similarity::{PASS, similarities};
use rayon::prelude::*;

/// Most similarities in a block.
const BLOCK_VALUES: usize = 16 << 20;
/// Most ticks in a block.
const BLOCK_TICKS: usize = 2 * PASS;

/// Ticks per block.
fn block_ticks(members: usize, references: usize) -> usize {
    let ticks = (BLOCK_VALUES / (members * references).max(1)).clamp(1, BLOCK_TICKS);
    // The rows of a pass go over the map together.
    if ticks > PASS { ticks / PASS * PASS } else { ticks }
}

/// Bytes of similarities and scores of a block.
fn block_bytes(members: usize, references: usize) -> u64 {
    16 * (members * references * block_ticks(members, references)) as u64
}

/// Bytes of one sequence (method and length) with so many configurations.
fn sequence_bytes(pair: &Pair, length: usize, configurations: usize) -> u64 {
    let (m, r, q) = (
        pair.members.len() as u64,
        pair.references() as u64,
        pair.queries() as u64,
    );
    matcher_bytes(length) * m * r + configurations as u64 * (FUSION_BYTES * r + 40 * q)
}

/// Bytes that a pass over this pair holds, for sequences of these lengths with so many configurations each.
pub fn bytes_needed(pair: &Pair, sequences: &[(usize, usize)]) -> u64 {
    let each = sequences
        .iter()
        .map(|(length, count)| sequence_bytes(pair, *length, *count));
    block_bytes(pair.members.len(), pair.references()) + each.sum::<u64>()
}

/// The most configurations of one sequence that fit the memory; 0 when none does.
pub(crate) fn most_configurations(pair: &Pair, length: usize, allowed: u64) -> usize {
    let fixed = bytes_needed(pair, &[(length, 0)]);
    let each = sequence_bytes(pair, length, 1) - sequence_bytes(pair, length, 0);
    (allowed.saturating_sub(fixed) / each.max(1)) as usize
}

/// One method and length, with everything that is fused from its scores.
struct Sequence<'a> {
    method: SequenceMethod,
    length: usize,
    configurations: Vec<&'a Configuration>,
}

/// Hands every configuration, which must all be of one similarity, to `done` with the outcomes of all queries; tells
/// `advanced` of each query of each configuration that was answered.
///
/// # Errors
/// A configuration needs more memory than allowed; and whatever `done` gives.
pub(crate) fn sweep<'a>(
    pair: &Pair,
    spec: &Spec,
    configurations: &[&'a Configuration],
    advanced: &(dyn Fn(u64) + Sync),
    done: &mut dyn FnMut(&'a Configuration, Vec<Outcome>) -> Result<(), EvaluateError>,
) -> Result<(), EvaluateError> {
    let Some(first) = configurations.first() else {
        return Ok(());
    };
    let mut sequences: Vec<Sequence<'a>> = Vec::new();
    for c in configurations {
        match sequences
            .iter_mut()
            .find(|s| (s.method, s.length) == (c.method, c.length))
        {
            Some(sequence) => sequence.configurations.push(c),
            None => sequences.push(Sequence {
                method: c.method,
                length: c.length,
                configurations: vec![c],
            }),
        }
    }
    for pass in passes(pair, sequences, spec.memory_bytes)? {
        for (configuration, outcomes) in run(pair, spec, first.similarity, pass, advanced) {
            done(configuration, outcomes)?;
        }
    }
    Ok(())
}

/// Puts sequences together as far as they fit.
fn passes<'a>(
    pair: &Pair,
    sequences: Vec<Sequence<'a>>,
    allowed: u64,
) -> Result<Vec<Vec<Sequence<'a>>>, EvaluateError> {
    let fixed = block_bytes(pair.members.len(), pair.references());
    let mut passes: Vec<(u64, Vec<Sequence<'a>>)> = Vec::new();
    for sequence in sequences {
        let bytes = sequence_bytes(pair, sequence.length, sequence.configurations.len());
        if fixed + bytes > allowed {
            return Err(EvaluateError::Memory {
                pair: pair.name.clone(),
                length: sequence.length,
                needed_mib: (fixed + bytes).div_ceil(1 << 20),
                allowed_mib: allowed >> 20,
            });
        }
        match passes.last_mut() {
            Some((taken, pass)) if *taken + bytes <= allowed => {
                *taken += bytes;
                pass.push(sequence);
            }
            _ => passes.push((fixed + bytes, vec![sequence])),
        }
    }
    Ok(passes.into_iter().map(|(_, pass)| pass).collect())
}

/// The scores of all queries with one similarity, method and length, to be fused again and again.
pub(crate) struct Kept {
    /// Per member, query after query.
    scores: Vec<Vec<f64>>,
    matched: Vec<Vec<Matched>>,
}

impl Kept {
    /// Bytes of the scores of a pair.
    pub(crate) fn bytes(pair: &Pair) -> u64 {
        let values = pair
            .members
            .len()
            .saturating_mul(pair.queries())
            .saturating_mul(pair.references());
        values.saturating_mul(8) as u64
    }

    /// Computes them.
    pub(crate) fn new(pair: &Pair, kind: Similarity, method: SequenceMethod, length: usize) -> Self {
        let member = |m: usize| {
            let mut block = Block::new(m, pair, PASS);
            let mut lane = Lane::new(method, length, pair.rows[m].reference.present());
            let mut scores = Vec::with_capacity(pair.queries() * pair.references());
            let mut matched = Vec::with_capacity(pair.queries());
            for start in (0..pair.queries()).step_by(PASS) {
                let count = PASS.min(pair.queries() - start);
                block.compare(pair, kind, start, count);
                block.score(pair, &mut lane, start, count);
                scores.extend_from_slice(&block.scores[..count * pair.references()]);
                matched.extend_from_slice(&block.matched[..count]);
            }
            (scores, matched)
        };
        let (scores, matched) = (0..pair.members.len()).into_par_iter().map(member).unzip();
        Self { scores, matched }
    }

    /// What comes of fusing them; one entry per configuration.
    pub(crate) fn fuse(
        &self,
        pair: &Pair,
        spec: &Spec,
        configurations: &[&Configuration],
        advanced: &(dyn Fn(u64) + Sync),
    ) -> Vec<Vec<Outcome>> {
        let weights = spec.weights_of(pair);
        let references = pair.references();
        let one = |c: &&Configuration| {
            let mut fusion = Fusion::new(pair, c, spec.exclusion, |m| weights[m]);
            for query in 0..pair.queries() {
                let scored = |m: usize| Scored {
                    matched: self.matched[m][query],
                    scores: &self.scores[m][query * references..(query + 1) * references],
                    valid: pair.rows[m].reference.present(),
                };
                fusion.advance(scored, pair.truth.matches(query));
            }
            advanced(pair.queries() as u64);
            fusion.outcomes
        };
        configurations.par_iter().map(one).collect()
    }
}

/// One member's block.
struct Block {
    member: usize,
    /// T·R similarities.
    similarities: Vec<f64>,
    /// T·R scores of the sequence at hand.
    scores: Vec<f64>,
    matched: Vec<Matched>,
}

fn run<'a>(
    pair: &Pair,
    spec: &Spec,
    kind: Similarity,
    sequences: Vec<Sequence<'a>>,
    advanced: &(dyn Fn(u64) + Sync),
) -> Vec<(&'a Configuration, Vec<Outcome>)> {
    let references = pair.references();
    let mut wanted = MemberSet::default();
    for c in sequences.iter().flat_map(|s| &s.configurations) {
        c.subset.members.iter().for_each(|m| wanted.set(m, true));
    }
    let wanted: Vec<usize> = wanted.iter().filter(|m| *m < pair.members.len()).collect();
    let ticks = block_ticks(wanted.len(), references).min(pair.queries().max(1));
    let mut blocks: Vec<Block> = wanted.iter().map(|m| Block::new(*m, pair, ticks)).collect();
    let weights = spec.weights_of(pair);
    let mut states: Vec<(Vec<Lane>, Vec<Fusion>)> = sequences
        .iter()
        .map(|s| {
            let lane = |m: &usize| Lane::new(s.method, s.length, pair.rows[*m].reference.present());
            let fusion = |c: &&Configuration| Fusion::new(pair, c, spec.exclusion, |m| weights[m]);
            (
                wanted.iter().map(lane).collect(),
                s.configurations.iter().map(fusion).collect(),
            )
        })
        .collect();
    let mut place = vec![usize::MAX; pair.members.len()];
    wanted.iter().enumerate().for_each(|(at, m)| place[*m] = at);

    for start in (0..pair.queries()).step_by(ticks) {
        let count = ticks.min(pair.queries() - start);
        blocks
            .par_iter_mut()
            .for_each(|block| block.compare(pair, kind, start, count));
        for (lanes, fusions) in &mut states {
            blocks
                .par_iter_mut()
                .zip(lanes)
                .for_each(|(block, lane)| block.score(pair, lane, start, count));
            let blocks = &blocks;
            fusions.par_iter_mut().for_each(|fusion| {
                for at in 0..count {
                    let scored = |m: usize| blocks[place[m]].at(pair, at);
                    fusion.advance(scored, pair.truth.matches(start + at));
                }
            });
            advanced((count * fusions.len()) as u64);
        }
    }
    let all = sequences.into_iter().zip(states);
    all.flat_map(|(s, (_, fusions))| {
        let outcomes = fusions.into_iter().map(|f| f.outcomes);
        s.configurations.into_iter().zip(outcomes)
    })
    .collect()
}

impl Block {
    fn new(member: usize, pair: &Pair, ticks: usize) -> Self {
        Self {
            member,
            similarities: vec![0.0; ticks * pair.references()],
            scores: vec![0.0; ticks * pair.references()],
            matched: vec![Matched::Nothing; ticks],
        }
    }

    /// Similarities of the ticks from `start` on.
    fn compare(&mut self, pair: &Pair, kind: Similarity, start: usize, count: usize) {
        let member = &pair.rows[self.member];
        let present = &member.query.present()[start..start + count];
        let there = (start..start + count)
            .zip(present)
            .filter(|(_, present)| **present);
        let queries: Vec<&[f32]> = there.map(|(query, _)| member.query.row(query)).collect();
        let references = pair.references();
        let (map, valid) = (member.reference.rows(), member.reference.present());
        // The rows of the queries that have one come first, and then go where they belong, the last one first.
        let out = &mut self.similarities[..queries.len() * references];
        similarities(kind, &queries, map, valid, out);
        let mut from = queries.len();
        for (to, _) in present.iter().enumerate().rev().filter(|(_, present)| **present) {
            from -= 1;
            if from == to {
                break;
            }
            let row = from * references..(from + 1) * references;
            self.similarities.copy_within(row, to * references);
        }
    }

    fn score(&mut self, pair: &Pair, lane: &mut Lane, start: usize, count: usize) {
        let present = &pair.rows[self.member].query.present()[start..start + count];
        let rows = self.similarities.chunks_exact(pair.references());
        let scores = self.scores.chunks_exact_mut(pair.references());
        for (((row, scores), present), matched) in rows.zip(scores).zip(present).zip(&mut self.matched) {
            *matched = lane.advance(present.then_some(row), scores);
        }
    }

    fn at<'a>(&'a self, pair: &'a Pair, at: usize) -> Scored<'a> {
        let references = pair.references();
        Scored {
            matched: self.matched[at],
            scores: &self.scores[at * references..(at + 1) * references],
            valid: pair.rows[self.member].reference.present(),
        }
    }
}
