//! `traverse.json`: what a traverse is.

use crate::disk;
use crate::error::StoreError;
use crate::layout::{self, MANIFEST, NEW};
use evpr_core::Plan;
use evpr_core::plan::{RowType, Sensor, Slicing};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

/// What the manifest of every traverse says it is.
pub const FORMAT: &str = "evpr-traverse";
/// Version of the format that this release writes, and the newest that it reads.
pub const VERSION: u64 = 1;

/// The manifest of a traverse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`] of the release that wrote it.
    pub version: u64,
    /// Name and version of the program that wrote it.
    pub created_by: String,
    /// False until the recording is closed.
    pub complete: bool,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// How the events were cut.
    pub slicing: Slicing,
    /// The members with rows, in the order of the plan.
    pub members: Vec<MemberEntry>,
    /// Number of ticks R; 0 until the recording is closed.
    pub ticks: u64,
    /// Where the events came from.
    pub source: String,
    /// Whatever its maker wants to say of it.
    #[serde(default)]
    pub notes: String,
}

/// A member in a manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemberEntry {
    /// Its name: `event_count@250ms/mixvpr`. Its files are named by it.
    pub name: String,
    /// Length D of its rows.
    pub dim: usize,
    /// Type of their numbers on disk.
    pub dtype: RowType,
    /// How many ticks have a row; 0 until the recording is closed.
    pub present: u64,
    /// Everything that shapes a row, from [`Plan::fingerprint`]: rows of equal fingerprints can be compared.
    pub fingerprint: BTreeMap<String, String>,
}

/// What a traverse that is about to be recorded will be.
#[derive(Debug, Clone, PartialEq)]
pub struct NewTraverse {
    /// Size of the sensor.
    pub sensor: Sensor,
    /// How the events are cut.
    pub slicing: Slicing,
    /// The members, in the order in which [`crate::TraverseWriter::append`] takes their rows.
    pub members: Vec<NewMember>,
    /// Where the events come from.
    pub source: String,
    /// Whatever its maker wants to say of it.
    pub notes: String,
    /// How its rows are kept.
    pub rows: RowType,
}

/// A member of a traverse that is about to be recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewMember {
    /// Its name, which also names its files.
    pub name: String,
    /// Length of its rows, at least 1.
    pub dim: usize,
    /// Everything that shapes a row.
    pub fingerprint: BTreeMap<String, String>,
}

impl NewTraverse {
    /// All members of the plan, those that start disabled too.
    pub fn from_plan(plan: &Plan) -> Self {
        let members = plan.members.iter().enumerate().map(|(index, member)| NewMember {
            name: member.name.clone(),
            dim: plan.extractors.get(member.extractor).map_or(0, |e| e.dim),
            fingerprint: plan.fingerprint(index),
        });
        Self {
            sensor: plan.sensor,
            slicing: plan.slicing.clone(),
            members: members.collect(),
            source: plan.source.path.display().to_string(),
            notes: String::new(),
            rows: plan.record_rows,
        }
    }

    /// The manifest while the recording goes on.
    ///
    /// # Errors
    /// [`StoreError::BadHeader`] when names or dimensions cannot be those of a traverse.
    pub(crate) fn draft(&self) -> Result<Manifest, StoreError> {
        let members = self.members.iter().map(|m| MemberEntry {
            name: m.name.clone(),
            dim: m.dim,
            dtype: self.rows,
            present: 0,
            fingerprint: m.fingerprint.clone(),
        });
        let draft = Manifest {
            format: FORMAT.to_owned(),
            version: VERSION,
            created_by: concat!("evpr ", env!("CARGO_PKG_VERSION")).to_owned(),
            complete: false,
            sensor: self.sensor,
            slicing: self.slicing.clone(),
            members: members.collect(),
            ticks: 0,
            source: self.source.clone(),
            notes: self.notes.clone(),
        };
        draft.check().map_err(StoreError::BadHeader)?;
        Ok(draft)
    }
}

/// The part of a manifest that every version has.
#[derive(Deserialize)]
struct Preamble {
    format: String,
    version: u64,
}

impl Manifest {
    /// Reads and checks the manifest of the traverse in `folder`.
    ///
    /// # Errors
    /// [`StoreError::Foreign`] without one, [`StoreError::NewerVersion`], [`StoreError::Damaged`].
    pub(crate) fn read(folder: &Path) -> Result<Self, StoreError> {
        let file = folder.join(MANIFEST);
        let text = match fs::read(&file) {
            Ok(text) => text,
            Err(e) if e.kind() == ErrorKind::NotFound => {
                return Err(StoreError::Foreign {
                    path: folder.to_owned(),
                    reason: "it has no traverse.json",
                });
            }
            Err(e) => return Err(StoreError::io("read", &file)(e)),
        };
        let damaged = |e: serde_json::Error| StoreError::damaged(&file, e.to_string());
        let preamble: Preamble = serde_json::from_slice(&text).map_err(damaged)?;
        if preamble.format != FORMAT {
            return Err(StoreError::Foreign {
                path: folder.to_owned(),
                reason: "its traverse.json is of another format",
            });
        }
        if preamble.version > VERSION {
            return Err(StoreError::NewerVersion {
                path: folder.to_owned(),
                found: preamble.version,
            });
        }
        let manifest: Self = serde_json::from_slice(&text).map_err(damaged)?;
        manifest
            .check()
            .map_err(|reason| StoreError::damaged(&file, reason))?;
        Ok(manifest)
    }

    /// Writes the manifest into `folder`, whole or not at all, and synchronises it with the disk.
    pub(crate) fn write(&self, folder: &Path) -> std::io::Result<()> {
        let new = folder.join(format!("{MANIFEST}{NEW}"));
        let mut text = serde_json::to_vec_pretty(self).map_err(std::io::Error::other)?;
        text.push(b'\n');
        let file = disk::write_new(&new, &text)?;
        disk::sync(&file)?;
        disk::rename(&new, &folder.join(MANIFEST))?;
        disk::sync_folder(folder)
    }

    /// What cannot be, in one line.
    fn check(&self) -> Result<(), String> {
        if self.members.is_empty() {
            return Err("it has no members".to_owned());
        }
        let mut names = BTreeSet::new();
        for m in &self.members {
            layout::check_member_name(&m.name)?;
            if !names.insert(&m.name) {
                return Err(format!("member {} is there twice", m.name));
            }
            if m.dim == 0 {
                return Err(format!("rows of member {} have length 0", m.name));
            }
            if m.present > self.ticks {
                let (present, ticks) = (m.present, self.ticks);
                return Err(format!("member {} has {present} rows in {ticks} ticks", m.name));
            }
            let bytes = (m.dim as u64)
                .checked_mul(m.dtype.bytes() as u64)
                .and_then(|row| row.checked_mul(self.ticks))
                .filter(|bytes| *bytes < i64::MAX as u64 / 2);
            if bytes.is_none() {
                return Err(format!("the rows of member {} are too many", m.name));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::new_traverse;

    #[test]
    fn a_plan_becomes_a_header() {
        let plan = evpr_core::plan::test_plan();
        let new = NewTraverse::from_plan(&plan);
        let names: Vec<_> = new.members.iter().map(|m| (m.name.as_str(), m.dim)).collect();
        assert_eq!(names, [("a@1ms/x", 3), ("b@1ms/x", 3)]);
        assert_eq!(new.members[1].fingerprint, plan.fingerprint(1));
        assert_eq!(new.source, "events.h5");
        assert!(new.draft().is_ok());
    }

    #[test]
    fn impossible_headers_are_refused() {
        type Change = fn(&mut NewTraverse);
        let cases: [(Change, &str); 4] = [
            (|h| h.members.clear(), "no members"),
            (|h| h.members[0].dim = 0, "length 0"),
            (|h| h.members[0].name = "../x".to_owned(), "cannot name"),
            (|h| h.members[1].name = h.members[0].name.clone(), "twice"),
        ];
        for (change, words) in cases {
            let mut header = new_traverse(&[2, 3]);
            change(&mut header);
            let message = header.draft().unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn a_manifest_is_read_as_written() {
        let folder = tempfile::tempdir().unwrap();
        let draft = new_traverse(&[2, 3]).draft().unwrap();
        draft.write(folder.path()).unwrap();
        assert_eq!(Manifest::read(folder.path()).unwrap(), draft);
    }
}
