//! What the tests of this crate share: a plan of any size, a map of noise, and messages for a fuser.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used, clippy::panic)]

use evpr_core::message::{DescriptorHeader, Life, Matches, Stamp, TickHeader, TickKind};
use evpr_core::plan::{Extractor, Member, Params, test_plan};
use evpr_core::stage::{Kept, Sink, StageError};
use evpr_core::{MemberSet, Plan, Reason};
use evpr_fuse::{Fuser, Map, MapMember};
use ndarray::ArrayD;
use std::path::PathBuf;

/// A plan of `dims.len()` members, each with an extractor of its own.
pub fn plan(dims: &[usize], length: usize) -> Plan {
    let mut plan = test_plan();
    plan.extractors = dims
        .iter()
        .enumerate()
        .map(|(i, dim)| Extractor {
            id: format!("x{i}"),
            kind: "raw_pixels".into(),
            dim: *dim,
            params: Params::default(),
            optional: false,
            network: None,
        })
        .collect();
    plan.members = (0..dims.len())
        .map(|i| Member {
            name: format!("a@1ms/x{i}"),
            reconstruction: 0,
            window: 0,
            extractor: i,
            enabled: true,
            weight: 1.0,
        })
        .collect();
    plan.fuse.length = length;
    plan.fuse.exclusion = 1;
    plan
}

/// Noise in −1…1 that is the same every time.
pub fn noise(seed: usize, len: usize) -> Vec<f32> {
    let mut state = (seed as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1);
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..16).for_each(|_| {
        next();
    });
    (0..len).map(|_| next()).collect()
}

/// A map of noise; `valid(member, reference)` says where it has rows.
pub fn map(plan: &Plan, references: usize, valid: impl Fn(usize, usize) -> bool) -> Map {
    let member = |m: usize| {
        let dim = plan.extractors[plan.members[m].extractor].dim;
        MapMember::new(
            noise(100 + m, references * dim),
            dim,
            (0..references).map(|j| valid(m, j)).collect(),
        )
    };
    Map {
        references,
        positions: (0..references).map(|j| Some([j as f64, -(j as f64)])).collect(),
        members: (0..plan.members.len()).map(member).collect(),
    }
}

/// A fuser whose clock stands at 5,000 ns.
pub fn fuser(plan: &Plan, map: Map, first_tick: u64, answer_from: u64) -> Fuser {
    Fuser::new(plan, map, first_tick, answer_from, Box::new(|| 5_000)).unwrap()
}

pub fn open(fuser: &mut Fuser, tick: u64, members: MemberSet, weights: &[f64]) -> Result<(), StageError> {
    fuser.tick(&tick_header(tick, members, TickKind::Open), weights)
}

pub fn close(fuser: &mut Fuser, tick: u64, members: MemberSet) {
    fuser
        .tick(&tick_header(tick, members, TickKind::Close), &[])
        .unwrap();
}

pub fn tick_header(tick: u64, members: MemberSet, kind: TickKind) -> TickHeader {
    TickHeader {
        tick,
        start_us: tick * 1000,
        end_us: tick * 1000 + 1000,
        closed_ns: if kind == TickKind::Close { 1_000 } else { 0 },
        control_version: 3,
        members,
        kind: kind as u32,
        ..TickHeader::default()
    }
}

pub fn row_header(tick: u64, member: usize) -> DescriptorHeader {
    DescriptorHeader {
        stamp: Stamp {
            incarnation: 1,
            ..Stamp::default()
        },
        tick,
        member: member as u32,
        reconstruct_incarnation: 1,
        life: Life {
            reconstructed_ns: 2_000,
            extracted_ns: 3_000,
            ..Life::default()
        },
        ..DescriptorHeader::default()
    }
}

/// Feeds one whole tick: the members in `enabled` are on; `rows` has the row of each member of the plan, or `None`
/// for an empty window.
pub fn feed(fuser: &mut Fuser, tick: u64, enabled: MemberSet, weights: &[f64], rows: &[Option<Vec<f32>>]) {
    open(fuser, tick, enabled, weights).unwrap();
    for (member, row) in rows.iter().enumerate().filter(|(m, _)| enabled.contains(*m)) {
        let mut header = row_header(tick, member);
        match row {
            Some(row) => fuser.descriptor(&header, row).unwrap(),
            None => {
                header.reason = Reason::EmptyWindow.code();
                fuser.descriptor(&header, &[]).unwrap();
            }
        }
    }
    close(fuser, tick, enabled);
}

/// Settles what can be settled and gives the answers.
pub fn settle(fuser: &mut Fuser) -> Kept<Matches> {
    let mut kept = Kept::default();
    fuser.settle(4_000, &mut kept).unwrap();
    kept
}

pub fn all(plan: &Plan) -> MemberSet {
    (0..plan.members.len()).collect()
}

/// A golden array of this crate.
pub fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden_fuse")
        .join(format!("{name}.npy"))
}

/// A path in the folder of shared data; `None`, said on stderr, where it is absent.
pub fn shared(test: &str, path: &str) -> Option<PathBuf> {
    let full = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared")
        .join(path);
    if full.exists() {
        return Some(full);
    }
    eprintln!("skipped: {test}: {} is absent", full.display());
    None
}

/// Equal to 1e-9, relatively above 1; NaN equals NaN.
pub fn assert_close(got: &ArrayD<f64>, want: &ArrayD<f64>, what: &str) {
    assert_eq!(got.shape(), want.shape(), "{what}");
    for ((index, g), w) in got.indexed_iter().zip(want) {
        let close = (g - w).abs() <= 1e-9 * w.abs().max(1.0) || (g.is_nan() && w.is_nan());
        assert!(close, "{what} at {index:?}: {g} instead of {w}");
    }
}
