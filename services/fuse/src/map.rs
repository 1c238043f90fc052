//! The reference map: per member of the plan the rows of a traverse, and which of its ticks have one.

use crate::FuseError;
use evpr_core::Plan;
use evpr_store::{MemberRows, Traverse};
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// Values that a thread reads through at a time: 256 KiB.
const READ_VALUES: usize = 1 << 16;

/// Where rows come from: a memory-mapped traverse, or plain memory in tests.
pub trait Rows: Send + Sync {
    /// All rows, row-major (ticks × D). A tick without a row takes up its place; what stands there is not read.
    fn values(&self) -> &[f32];
}

impl Rows for Vec<f32> {
    fn values(&self) -> &[f32] {
        self
    }
}

impl Rows for MemberRows {
    fn values(&self) -> &[f32] {
        self.rows()
    }
}

/// One member's rows of a traverse.
#[derive(Clone)]
pub struct MapMember {
    /// The rows.
    pub rows: Arc<dyn Rows>,
    /// D, values per row.
    pub dim: usize,
    /// Per tick of the traverse: whether the member has a row there.
    pub valid: Vec<bool>,
}

impl MapMember {
    /// A member from memory: `values` is row-major, one row of `dim` values per entry of `valid`.
    pub fn new(values: Vec<f32>, dim: usize, valid: Vec<bool>) -> Self {
        Self {
            rows: Arc::new(values),
            dim,
            valid,
        }
    }

    /// The row of tick `index`, which must be below the number of ticks; `None` where there is none.
    pub fn row(&self, index: usize) -> Option<&[f32]> {
        let there = self.valid.get(index).copied().unwrap_or(false);
        there
            .then(|| self.rows.values().get(index * self.dim..(index + 1) * self.dim))
            .flatten()
    }

    /// Reads all rows that are there, once, and gives the first tick whose row holds a value that is not finite.
    ///
    /// On a memory-mapped traverse this brings the rows into memory, as far as they have room there: the first query
    /// need not wait for the disk. The rows must have passed [`MapMember::check`].
    pub(crate) fn first_not_finite(&self) -> Option<usize> {
        let rows = self.rows.values().par_chunks(self.dim).zip(&self.valid);
        rows.with_min_len((READ_VALUES / self.dim).max(1))
            .position_first(|(row, valid)| *valid && !row.iter().fold(true, |ok, v| ok & v.is_finite()))
    }

    /// Checks that there are `ticks` rows and flags, so that everything after this may index freely.
    pub(crate) fn check(&self, name: &str, ticks: usize) -> Result<(), FuseError> {
        let values = self.rows.values().len();
        if self.dim == 0 || self.valid.len() != ticks || Some(values) != ticks.checked_mul(self.dim) {
            return Err(FuseError::Shape {
                member: name.to_owned(),
                values,
                flags: self.valid.len(),
                references: ticks,
                dim: self.dim,
            });
        }
        Ok(())
    }
}

impl std::fmt::Debug for MapMember {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let valid = self.valid.iter().filter(|v| **v).count();
        write!(
            f,
            "MapMember {{ {} × {}, {valid} valid }}",
            self.valid.len(),
            self.dim
        )
    }
}

/// The map that queries are compared with. A place is a tick of the map's traverse, and is named by its number.
#[derive(Debug, Clone)]
pub struct Map {
    /// R, ticks of the map.
    pub references: usize,
    /// Per reference (east, north) in metres; empty when the map has no positions.
    pub positions: Vec<Option<[f64; 2]>>,
    /// Per member of the plan, in the plan's order.
    pub members: Vec<MapMember>,
}

impl Map {
    /// Opens the plan's map: its rows are memory-mapped, not read. [`Fuser::new`](crate::Fuser::new) reads them through
    /// once; a map may be larger than the memory, and is then read from the disk as queries need it.
    ///
    /// # Errors
    /// [`FuseError::NoMap`]; [`FuseError::Store`] when the traverse cannot be opened, or was made by other parameters
    /// than the plan's, with every difference.
    pub fn open(plan: &Plan) -> Result<Self, FuseError> {
        let path = plan.map.as_deref().ok_or(FuseError::NoMap)?;
        let (traverse, members) = open_members(plan, path)?;
        Ok(Self {
            references: traverse.len(),
            positions: traverse.ticks().iter().map(|t| t.position).collect(),
            members,
        })
    }

    /// The position of a reference, (east, north) in metres.
    pub fn position(&self, reference: usize) -> Option<[f64; 2]> {
        self.positions.get(reference).copied().flatten()
    }
}

/// Opens a traverse and the rows of all members of the plan in it, in the plan's order.
pub(crate) fn open_members(plan: &Plan, path: &Path) -> Result<(Traverse, Vec<MapMember>), FuseError> {
    let traverse = Traverse::open(path)?;
    traverse.check_against(plan)?;
    let members = plan.members.iter().map(|member| {
        let rows = traverse.member(&member.name)?;
        Ok(MapMember {
            dim: rows.dim(),
            valid: rows.present().to_vec(),
            rows: Arc::new(rows),
        })
    });
    let members = members.collect::<Result<_, FuseError>>()?;
    Ok((traverse, members))
}
