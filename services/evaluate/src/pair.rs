//! A reference map, a query traverse, and which places are right.

use crate::error::EvaluateError;
use crate::pair_spec::{PairSpec, Truth};
use evpr_core::plan::{SequenceMethod, Slicing};
use evpr_store::{GroundTruth, Manifest, MemberRows, Traverse};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// A member of both traverses.
#[derive(Debug, Clone)]
pub(crate) struct PairMember {
    pub(crate) reference: MemberRows,
    pub(crate) query: MemberRows,
}

/// A pair that is ready to be evaluated: everything that could be wrong with it was looked at.
#[derive(Debug)]
pub struct Pair {
    pub(crate) name: String,
    pub(crate) members: Vec<String>,
    pub(crate) rows: Vec<PairMember>,
    pub(crate) truth: GroundTruth,
    /// Start and end of each query tick, µs.
    pub(crate) times_us: Vec<(u64, u64)>,
    pub(crate) query_positions: Vec<Option<[f64; 2]>>,
    pub(crate) reference_positions: Vec<Option<[f64; 2]>>,
    /// How far the nearest place is from each query, metres, where that is known.
    pub(crate) nearest_m: Vec<Option<f64>>,
    /// Start of each tick of the map, µs.
    pub(crate) reference_starts_us: Vec<u64>,
    pub(crate) slicing: Slicing,
    /// What the reference and the query were recorded from.
    sources: [String; 2],
    condition: Option<String>,
    /// What decides whether two results are of the same pair.
    pub(crate) identity: BTreeMap<String, String>,
}

impl Pair {
    /// Opens a pair. `members` are names or patterns; empty for all, which then must be the same on both sides.
    ///
    /// # Errors
    /// One line: a traverse or the ground truth cannot be read; sensor, ticks or a member's parameters differ; a member is
    /// missing in one of them; a row holds a number that is not finite; no query has a right answer.
    pub fn open(spec: &PairSpec, members: &[String]) -> Result<Self, EvaluateError> {
        let (reference, query) = (Traverse::open(&spec.reference)?, Traverse::open(&spec.query)?);
        let wrong = |reason: String| EvaluateError::pair(&spec.name, reason);
        check_alike(reference.manifest(), query.manifest()).map_err(wrong)?;
        let names = member_names(reference.manifest(), query.manifest(), members).map_err(wrong)?;
        let rows: Vec<PairMember> = names
            .iter()
            .map(|name| {
                Ok(PairMember {
                    reference: reference.member(name)?,
                    query: query.member(name)?,
                })
            })
            .collect::<Result<_, EvaluateError>>()?;
        for (name, rows) in names.iter().zip(&rows) {
            check_rows(name, rows).map_err(wrong)?;
        }
        let positions = |t: &Traverse| t.ticks().iter().map(|t| t.position).collect::<Vec<_>>();
        let (query_positions, reference_positions) = (positions(&query), positions(&reference));
        let truth = match &spec.truth {
            Truth::Positions { tolerance_m } => {
                for (side, path, known) in [
                    ("reference", &spec.reference, &reference_positions),
                    ("query", &spec.query, &query_positions),
                ] {
                    if known.iter().all(Option::is_none) {
                        return Err(wrong(format!(
                            "the {side} {} has no positions; give a file of right pairs instead",
                            path.display()
                        )));
                    }
                }
                GroundTruth::from_positions(&query_positions, &reference_positions, *tolerance_m)?
            }
            Truth::File {
                path,
                tolerance_frames,
                orientation,
            } => {
                let (q, r) = (query.len(), reference.len());
                let truth = if path.extension().is_some_and(|e| e == "npy") {
                    GroundTruth::from_npy(path, q, r, *orientation)?.0
                } else {
                    GroundTruth::from_pairs(path, q, r)?
                };
                truth.widened(*tolerance_frames)?
            }
        };
        if truth.with_match() == 0 {
            return Err(wrong(
                "no query has a right answer, so there is nothing to measure; check the ground truth and its tolerance"
                    .to_owned(),
            ));
        }
        Ok(Self {
            identity: identity(spec, (&reference, &query), &names, &truth),
            name: spec.name.clone(),
            members: names,
            rows,
            truth,
            nearest_m: nearest_m(&query_positions, &reference_positions),
            times_us: query.ticks().iter().map(|t| (t.start_us, t.end_us)).collect(),
            reference_starts_us: reference.ticks().iter().map(|t| t.start_us).collect(),
            slicing: query.manifest().slicing.clone(),
            sources: [
                reference.manifest().source.clone(),
                query.manifest().source.clone(),
            ],
            condition: None,
            query_positions,
            reference_positions,
        })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its members, in the map's order.
    pub fn members(&self) -> &[String] {
        &self.members
    }

    /// Says what sort of pair it is, such as `day-night`; reports tell conditions apart.
    pub fn with_condition(self, condition: Option<String>) -> Self {
        Self { condition, ..self }
    }

    /// What sort of pair it is, where that was said.
    pub fn condition(&self) -> Option<&str> {
        self.condition.as_deref()
    }

    /// What the reference and the query were recorded from, as their traverses say it.
    pub fn sources(&self) -> [&str; 2] {
        self.sources.each_ref().map(String::as_str)
    }

    /// How its recordings were cut into ticks.
    pub fn slicing(&self) -> &Slicing {
        &self.slicing
    }

    /// Which places are right.
    pub fn truth(&self) -> &GroundTruth {
        &self.truth
    }

    /// Checks that a sequence method can answer at all.
    pub(crate) fn check_length(&self, method: SequenceMethod, length: usize) -> Result<(), EvaluateError> {
        if matches!(method, SequenceMethod::SeqSlam(_)) && self.references() < length {
            return Err(EvaluateError::pair(
                &self.name,
                format!(
                    "its map has {0} ticks, fewer than the {length} of the sequence of seqslam; give a length of {0} or less",
                    self.references()
                ),
            ));
        }
        Ok(())
    }

    /// Ticks of the query traverse.
    pub fn queries(&self) -> usize {
        self.times_us.len()
    }

    /// Ticks of the map.
    pub fn references(&self) -> usize {
        self.reference_positions.len()
    }
}

/// Sensor and ticks of the two must be alike.
fn check_alike(reference: &Manifest, query: &Manifest) -> Result<(), String> {
    if reference.sensor != query.sensor {
        return Err(format!(
            "the sensor is {} in the reference and {} in the query; record both with one sensor",
            reference.sensor, query.sensor
        ));
    }
    let (a, b) = (&reference.slicing, &query.slicing);
    if (a.mode, a.tick) != (b.mode, b.tick) {
        return Err(format!(
            "a tick is {} in the reference and {} in the query; record both with one slicing",
            a.tick_id(),
            b.tick_id()
        ));
    }
    Ok(())
}

/// The members that are evaluated.
fn member_names(reference: &Manifest, query: &Manifest, wanted: &[String]) -> Result<Vec<String>, String> {
    let names = |m: &Manifest| m.members.iter().map(|m| m.name.clone()).collect::<Vec<_>>();
    let (of_reference, of_query) = (names(reference), names(query));
    let chosen = |name: &&String| wanted.is_empty() || wanted.iter().any(|w| crate::spec::matches(w, name));
    for (side, other, these, those) in [
        ("query", "reference", &of_query, &of_reference),
        ("reference", "query", &of_reference, &of_query),
    ] {
        let lacks: Vec<&str> = those
            .iter()
            .filter(chosen)
            .filter(|name| !these.contains(name))
            .map(String::as_str)
            .collect();
        if !lacks.is_empty() {
            return Err(format!(
                "the {side} has no rows of {}, which the {other} has; record it with these members, or name those to \
                 evaluate with --members",
                lacks.join(", ")
            ));
        }
    }
    if let Some(unknown) = wanted
        .iter()
        .find(|w| !of_reference.iter().any(|name| crate::spec::matches(w, name)))
    {
        return Err(format!(
            "no member is {unknown}; there are {}",
            of_reference.join(", ")
        ));
    }
    let found: Vec<String> = of_reference.iter().filter(chosen).cloned().collect();
    if found.len() > evpr_core::member::MAX_MEMBERS {
        return Err(format!(
            "{} members are more than {}; name fewer with --members",
            found.len(),
            evpr_core::member::MAX_MEMBERS
        ));
    }
    for name in &found {
        let entry = |m: &Manifest| {
            m.members
                .iter()
                .find(|e| e.name == *name)
                .map(|e| e.fingerprint.clone())
        };
        let (a, b) = (
            entry(reference).unwrap_or_default(),
            entry(query).unwrap_or_default(),
        );
        let differs = a.keys().chain(b.keys()).find(|key| a.get(*key) != b.get(*key));
        if let Some(key) = differs {
            let value =
                |of: &BTreeMap<String, String>| of.get(key).map_or("(none)", String::as_str).to_owned();
            return Err(format!(
                "{key} of member {name} is {} in the reference and {} in the query; record both with one configuration",
                value(&a),
                value(&b)
            ));
        }
    }
    Ok(found)
}

/// Rows must be finite, of one length, and there at all.
fn check_rows(name: &str, rows: &PairMember) -> Result<(), String> {
    for (side, member) in [("reference", &rows.reference), ("query", &rows.query)] {
        if !member.present().contains(&true) {
            return Err(format!(
                "member {name} has no row in the {side}; leave it out with --members"
            ));
        }
        let each = member
            .rows()
            .par_chunks(member.dim().max(1))
            .zip(member.present());
        let broken = each.position_first(|(row, present)| *present && !row.iter().all(|v| v.is_finite()));
        if let Some(tick) = broken {
            return Err(format!(
                "the {side}'s row of member {name} at tick {tick} is not finite; record it again"
            ));
        }
    }
    if rows.reference.dim() != rows.query.dim() {
        return Err(format!(
            "rows of member {name} have {} values in the reference and {} in the query; record both with one configuration",
            rows.reference.dim(),
            rows.query.dim()
        ));
    }
    Ok(())
}

fn nearest_m(queries: &[Option<[f64; 2]>], references: &[Option<[f64; 2]>]) -> Vec<Option<f64>> {
    let nearest = |query: &Option<[f64; 2]>| {
        let [east, north] = (*query)?;
        let distances = references.iter().flatten();
        distances
            .map(|r| (east - r[0]).hypot(north - r[1]))
            .min_by(f64::total_cmp)
    };
    queries.par_iter().map(nearest).collect()
}

fn identity(
    spec: &PairSpec,
    (reference, query): (&Traverse, &Traverse),
    members: &[String],
    truth: &GroundTruth,
) -> BTreeMap<String, String> {
    let path = |path: &Path| {
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        path.display().to_string()
    };
    let mut right = Digest::default();
    for query in 0..truth.queries() {
        right.add(query as u64 ^ u64::MAX);
        truth.matches(query).iter().for_each(|r| right.add(u64::from(*r)));
    }
    [
        ("reference", path(&spec.reference)),
        ("query", path(&spec.query)),
        ("reference_ticks", reference.len().to_string()),
        ("query_ticks", query.len().to_string()),
        ("ground_truth", format!("{:016x}", right.0)),
        ("members", digest_of(members.iter().map(String::as_str))),
    ]
    .into_iter()
    .map(|(key, value)| (key.to_owned(), value))
    .collect()
}

/// How many names there are, with a digest of them.
pub(crate) fn digest_of<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let (mut digest, mut count) = (Digest::default(), 0);
    for name in names {
        name.bytes().for_each(|byte| digest.add(u64::from(byte)));
        digest.add(u64::MAX);
        count += 1;
    }
    format!("{count}#{:08x}", digest.0 as u32)
}

/// FNV-1a over 64-bit numbers: tells a changed ground truth from the old one.
pub(crate) struct Digest(pub(crate) u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    pub(crate) fn add(&mut self, number: u64) {
        for byte in number.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}
