//! Looks at every byte of a traverse.

use crate::error::StoreError;
use crate::layout::{self, COMMITS, TICKS};
use crate::traverse::{MemberRows, check_tick_count, read_head};
use std::path::Path;

/// Rows whose L2 norm is this close to 1 count as normalised.
const UNIT_TOLERANCE: f64 = 1e-3;

/// What a traverse holds and what is wrong with it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct VerifySummary {
    /// Ticks.
    pub ticks: u64,
    /// Ticks with a position.
    pub positions: u64,
    /// The members whose files could be opened.
    pub members: Vec<MemberSummary>,
    /// Everything that is wrong, one line each; empty for a sound traverse.
    pub problems: Vec<String>,
}

/// What a member's rows are like.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct MemberSummary {
    /// Its name.
    pub name: String,
    /// Length of a row.
    pub dim: usize,
    /// Ticks with a row.
    pub present: u64,
    /// Least L2 norm of a row; 0 when there is none.
    pub min_norm: f64,
    /// Greatest L2 norm of a row; 0 when there is none.
    pub max_norm: f64,
}

/// Checks a finished traverse: sizes, headers, counts, order and times of ticks, that all numbers are finite, that ticks
/// without a row are zero rows, and that where nearly all rows of a member have length 1 (L2) all have.
///
/// # Errors
/// When it cannot be read so far that there is anything to check: what [`crate::Traverse::open`] says of path, manifest
/// and `ticks.csv`.
pub fn verify(path: &Path) -> Result<VerifySummary, StoreError> {
    let (manifest, ticks) = read_head(path)?;
    let mut problems = Vec::new();
    if let Err(e) = check_tick_count(path, &manifest, &ticks) {
        problems.push(e.to_string());
    }
    let csv = path.join(TICKS);
    let csv = csv.display();
    for tick in ticks.iter().filter(|t| t.end_us < t.start_us) {
        problems.push(format!("{csv}: tick {} ends before it starts", tick.tick));
    }
    for pair in ticks.windows(2) {
        if let [before, after] = pair
            && after.start_us < before.start_us
        {
            problems.push(format!(
                "{csv}: tick {} starts before the one before it",
                after.tick
            ));
        }
    }
    if path.join(COMMITS).exists() {
        problems.push(format!(
            "{}: it holds a {COMMITS}, which is of unfinished recordings",
            path.display()
        ));
    }
    let mut members = Vec::new();
    for entry in &manifest.members {
        match MemberRows::open(path, entry, manifest.ticks) {
            Ok(rows) => members.push(look_at(path, &entry.name, &rows, &mut problems)),
            Err(e) => problems.push(e.to_string()),
        }
    }
    Ok(VerifySummary {
        ticks: manifest.ticks,
        positions: ticks.iter().filter(|t| t.position.is_some()).count() as u64,
        members,
        problems,
    })
}

/// Looks at all rows of a member.
fn look_at(path: &Path, name: &str, rows: &MemberRows, problems: &mut Vec<String>) -> MemberSummary {
    let mut norms: Vec<(usize, f64)> = Vec::new();
    let (mut not_finite, mut not_zero) = (Vec::new(), Vec::new());
    let each = rows.rows().chunks_exact(rows.dim().max(1)).zip(rows.present());
    for (tick, (row, present)) in each.enumerate() {
        if row.iter().any(|v| !v.is_finite()) {
            not_finite.push(tick);
        } else if *present {
            norms.push((tick, l2(row)));
        } else if row.iter().any(|v| *v != 0.0) {
            not_zero.push(tick);
        }
    }
    let is_unit = |norm: f64| (norm - 1.0).abs() <= UNIT_TOLERANCE;
    let unit = norms.iter().filter(|(_, norm)| is_unit(*norm)).count();
    let mut not_unit = Vec::new();
    if unit * 10 >= norms.len() * 9 {
        not_unit.extend(norms.iter().filter(|(_, norm)| !is_unit(*norm)).map(|(t, _)| *t));
    }
    for (ticks, what) in [
        (not_finite, "rows have numbers that are not finite"),
        (not_zero, "rows are not zero though they are marked absent"),
        (not_unit, "rows do not have length 1 (L2), unlike the others"),
    ] {
        if let Some(first) = ticks.first() {
            problems.push(format!(
                "{}: {} {what}, the first at tick {first}",
                layout::rows_file(path, name).display(),
                ticks.len()
            ));
        }
    }
    let least = norms.iter().map(|(_, n)| *n).reduce(f64::min);
    let most = norms.iter().map(|(_, n)| *n).reduce(f64::max);
    MemberSummary {
        name: name.to_owned(),
        dim: rows.dim(),
        present: rows.present().iter().filter(|p| **p).count() as u64,
        min_norm: least.unwrap_or(0.0),
        max_norm: most.unwrap_or(0.0),
    }
}

fn l2(row: &[f32]) -> f64 {
    row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}
