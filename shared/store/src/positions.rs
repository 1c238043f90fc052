//! Gives the ticks of a finished traverse their positions.

use crate::disk;
use crate::error::StoreError;
use crate::files::sync_folder;
use crate::layout::{NEW, TICKS};
use crate::ticks::{HEADER, TickRecord};
use crate::traverse::{check_tick_count, read_head};
use std::path::Path;

/// Replaces the positions of the traverse in this folder: per tick metres east and north at its start, or `None` where
/// not known. `ticks.csv` is replaced whole or not at all; a traverse that is open keeps what it had read.
///
/// # Errors
/// [`StoreError::BadTick`] when there are not as many positions as ticks or one is not finite, [`StoreError::Io`], and
/// what [`crate::Traverse::open`] says of path, manifest and ticks.
pub fn set_positions(path: &Path, positions: &[Option<[f64; 2]>]) -> Result<(), StoreError> {
    let (manifest, ticks) = read_head(path)?;
    check_tick_count(path, &manifest, &ticks)?;
    let bad = |tick: u64, reason: String| StoreError::BadTick {
        path: path.to_owned(),
        tick,
        reason,
    };
    if positions.len() != ticks.len() {
        let least = positions.len().min(ticks.len()) as u64;
        let reason = format!("{} positions for {} ticks", positions.len(), ticks.len());
        return Err(bad(least, reason));
    }
    let mut text = HEADER.to_owned();
    for (tick, position) in ticks.into_iter().zip(positions) {
        if position.is_some_and(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(bad(tick.tick, "its position is not finite".to_owned()));
        }
        let position = *position;
        TickRecord { position, ..tick }.write_line(&mut text);
    }
    let (file, new) = (path.join(TICKS), path.join(format!("{TICKS}{NEW}")));
    let written = disk::write_new(&new, text.as_bytes()).and_then(|out| disk::sync(&out));
    written.map_err(StoreError::io("write", &new))?;
    disk::rename(&new, &file).map_err(StoreError::io("replace", &file))?;
    sync_folder(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::recording;
    use crate::{Traverse, verify};
    use std::fs;

    #[test]
    fn positions_are_replaced_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        let before = recording(&path, &[3], 3).close().unwrap();
        let positions = [Some([0.1, -2.5e-7]), None, Some([500_000.25, 7.0])];
        set_positions(&path, &positions).unwrap();
        let after = Traverse::open(&path).unwrap();
        assert_eq!(after.manifest(), before.manifest());
        for ((old, new), position) in before.ticks().iter().zip(after.ticks()).zip(positions) {
            let expected = TickRecord {
                position,
                ..old.clone()
            };
            assert_eq!(*new, expected);
        }
        assert_eq!(verify(&path).unwrap().positions, 2);
    }

    #[test]
    fn wrong_positions_change_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        recording(&path, &[3], 2).close().unwrap();
        let before = fs::read(path.join(TICKS)).unwrap();
        let few = set_positions(&path, &[None]).unwrap_err().to_string();
        assert!(few.contains("1 positions for 2 ticks"), "{few}");
        assert!(set_positions(&path, &[None, Some([f64::INFINITY, 0.0])]).is_err());
        assert_eq!(fs::read(path.join(TICKS)).unwrap(), before);
    }
}
