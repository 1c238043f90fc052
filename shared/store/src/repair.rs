//! Closes a recording that its process could not.

use crate::error::StoreError;
use crate::files::{Files, name_finished};
use crate::layout::{final_path, partial_path};
use crate::manifest::Manifest;
use crate::recover::{Check, recover};
use crate::writer::{broke, was_just_begun};
use std::fs;
use std::path::{Path, PathBuf};

/// What became of a repaired recording.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct RepairSummary {
    /// The finished traverse.
    pub path: PathBuf,
    /// Its ticks.
    pub ticks: u64,
    /// Ticks that had been recorded but were not whole on the disk, and everything behind the first of them.
    pub lost: u64,
}

/// Turns `<path>.partial` into the finished traverse `path`, with the ticks from the first to the last whole one. Every
/// tick is compared with its checksum. The path may be given with or without `.partial`.
///
/// # Errors
/// [`StoreError::Missing`], [`StoreError::Finished`] when there is only the finished one, [`StoreError::Exists`] when
/// there are both, [`StoreError::InUse`] while it is being recorded, [`StoreError::Empty`] without a whole tick,
/// [`StoreError::Broke`] when the disk is full, and what is wrong with its manifest.
pub fn repair(path: &Path) -> Result<RepairSummary, StoreError> {
    let path = final_path(path);
    let folder = partial_path(&path)?;
    let finished = fs::symlink_metadata(&path).is_ok();
    match (folder.is_dir(), finished) {
        (false, true) => return Err(StoreError::Finished(path)),
        (false, false) => return Err(StoreError::Missing(folder)),
        (true, true) => return Err(StoreError::Exists(path)),
        (true, false) => {}
    }
    if was_just_begun(&folder)? {
        return Err(StoreError::Empty(folder));
    }
    let mut manifest = Manifest::read(&folder)?;
    if manifest.complete {
        let ticks = manifest.ticks;
        name_finished(&folder, &path).map_err(|failed| broke(&path, ticks, failed))?;
        return Ok(RepairSummary { path, ticks, lost: 0 });
    }
    let files = Files::open(&folder, &manifest.members)?;
    let found = recover(&files, Check::All)?;
    if found.ticks == 0 {
        return Err(StoreError::Empty(folder));
    }
    for (member, present) in manifest.members.iter_mut().zip(found.present) {
        member.present = present;
    }
    manifest.ticks = found.ticks;
    manifest.complete = true;
    let closed = files.finish(&path, &manifest, found.csv_end);
    closed.map_err(|failed| broke(&path, found.ticks, failed))?;
    Ok(RepairSummary {
        path,
        ticks: found.ticks,
        lost: found.committed - found.ticks,
    })
}
