//! Opens a finished traverse and shows its rows.

use crate::difference;
use crate::error::StoreError;
use crate::layout::{self, TICKS, final_path, is_partial, partial_path};
use crate::manifest::{Manifest, MemberEntry};
use crate::mapped::MappedRows;
use crate::npy::NpyHeader;
use crate::ticks::{self, TickRecord};
use evpr_core::Plan;
use evpr_core::plan::RowType;
use half::f16;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A finished traverse. All its files were compared with its manifest when it was opened; rows are mapped, not read.
///
/// Its files must not be cut while it is open: reading a mapped row that is no longer in its file ends the process
/// (SIGBUS).
#[derive(Debug)]
pub struct Traverse {
    path: PathBuf,
    manifest: Manifest,
    ticks: Vec<TickRecord>,
    members: Vec<MemberRows>,
}

impl Traverse {
    /// Opens the traverse in this folder.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Unfinished`], [`StoreError::Foreign`], [`StoreError::NewerVersion`], and
    /// [`StoreError::Damaged`] with the file at fault and what is wrong with it.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let (manifest, ticks) = read_head(path)?;
        check_tick_count(path, &manifest, &ticks)?;
        let members = manifest.members.iter();
        let members = members.map(|m| MemberRows::open(path, m, manifest.ticks));
        Ok(Self {
            path: path.to_owned(),
            members: members.collect::<Result<_, _>>()?,
            manifest,
            ticks,
        })
    }

    /// Its folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Its ticks; the index of a tick is its number.
    pub fn ticks(&self) -> &[TickRecord] {
        &self.ticks
    }

    /// Number of ticks R, at least 1.
    pub fn len(&self) -> usize {
        self.ticks.len()
    }

    /// False: a traverse has at least one tick.
    pub fn is_empty(&self) -> bool {
        self.ticks.is_empty()
    }

    /// The rows of this member.
    ///
    /// # Errors
    /// [`StoreError::NoMember`], which names those that there are.
    pub fn member(&self, name: &str) -> Result<MemberRows, StoreError> {
        let entries = self.manifest.members.iter();
        let mut found = entries.zip(&self.members).filter(|(entry, _)| entry.name == name);
        if let Some((_, rows)) = found.next() {
            return Ok(rows.clone());
        }
        let have: Vec<&str> = self.manifest.members.iter().map(|m| m.name.as_str()).collect();
        Err(StoreError::NoMember {
            path: self.path.clone(),
            member: name.to_owned(),
            have: have.join(", "),
        })
    }

    /// Checks that queries of this plan can be compared with this map: every member of the plan must be there, with an
    /// equal fingerprint. The map may have more.
    ///
    /// # Errors
    /// [`StoreError::Mismatch`], which names every difference: member, key, the map's value and the plan's.
    pub fn check_against(&self, plan: &Plan) -> Result<(), StoreError> {
        let mut differences = Vec::new();
        for (index, member) in plan.members.iter().enumerate() {
            match difference::find(&self.manifest.members, &member.name) {
                None => differences.push(difference::missing(&member.name)),
                Some(entry) => differences.extend(difference::of_fingerprints(
                    &member.name,
                    &entry.fingerprint,
                    &plan.fingerprint(index),
                )),
            }
        }
        if differences.is_empty() {
            return Ok(());
        }
        Err(StoreError::Mismatch {
            path: self.path.clone(),
            differences,
        })
    }
}

/// Reads the manifest and the ticks of a finished traverse.
pub(crate) fn read_head(path: &Path) -> Result<(Manifest, Vec<TickRecord>), StoreError> {
    let exists = |path: &Path| path.try_exists().map_err(StoreError::io("look at", path));
    if !exists(path)? {
        let is_unfinished = exists(&partial_path(path)?)?;
        let path = path.to_owned();
        return Err(if is_unfinished {
            StoreError::Unfinished(path)
        } else {
            StoreError::Missing(path)
        });
    }
    if is_partial(path) {
        return Err(StoreError::Unfinished(final_path(path)));
    }
    if !path.is_dir() {
        return Err(StoreError::Foreign {
            path: path.to_owned(),
            reason: "it is a file",
        });
    }
    let manifest = Manifest::read(path)?;
    if !manifest.complete {
        let file = path.join(layout::MANIFEST);
        return Err(StoreError::damaged(
            &file,
            "it says that the recording was not closed",
        ));
    }
    let ticks = ticks::read(&path.join(TICKS))?;
    Ok((manifest, ticks))
}

/// Checks that `ticks.csv` has as many ticks as the manifest says.
pub(crate) fn check_tick_count(
    path: &Path,
    manifest: &Manifest,
    ticks: &[TickRecord],
) -> Result<(), StoreError> {
    let (expected, found) = (manifest.ticks, ticks.len() as u64);
    if expected != found {
        let reason = format!("it has {found} ticks, the manifest says {expected}");
        return Err(StoreError::damaged(&path.join(TICKS), reason));
    }
    if expected == 0 {
        return Err(StoreError::damaged(
            &path.join(layout::MANIFEST),
            "it has no ticks",
        ));
    }
    Ok(())
}

/// The rows of one member. Cheap to clone: clones share the mapping.
#[derive(Debug, Clone)]
pub struct MemberRows {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    dim: usize,
    rows: Rows,
    present: Vec<bool>,
}

/// Where a member's rows are.
#[derive(Debug)]
enum Rows {
    Mapped(MappedRows),
    /// Read, as they are kept in another type.
    Widened(Vec<f32>),
}

impl MemberRows {
    /// Opens a member's files and compares them with the manifest.
    pub(crate) fn open(folder: &Path, member: &MemberEntry, ticks: u64) -> Result<Self, StoreError> {
        let file = layout::rows_file(folder, &member.name);
        let row_bytes = (member.dim * member.dtype.bytes()) as u64;
        let header = NpyHeader::rows(ticks, member.dim, member.dtype);
        let (opened, offset) = open_npy(&file, &header, row_bytes * ticks)?;
        let rows = match member.dtype {
            RowType::F32 => {
                Rows::Mapped(MappedRows::new(&opened, offset).map_err(StoreError::io("map", &file))?)
            }
            RowType::F16 => Rows::Widened(widened(opened, offset).map_err(StoreError::io("read", &file))?),
        };

        let file = layout::present_file(folder, &member.name);
        let (mut opened, offset) = open_npy(&file, &NpyHeader::present(ticks), ticks)?;
        let mut bytes = Vec::new();
        let read = opened.read_to_end(&mut bytes);
        read.map_err(StoreError::io("read", &file))?;
        let marks = bytes.get(offset..).unwrap_or_default();
        if let Some(at) = marks.iter().position(|mark| *mark > 1) {
            let reason = format!("its entry {at} is {}, neither 0 nor 1", marks[at]);
            return Err(StoreError::damaged(&file, reason));
        }
        let present: Vec<bool> = marks.iter().map(|mark| *mark == 1).collect();
        let found = present.iter().filter(|p| **p).count() as u64;
        if found != member.present {
            let reason = format!("it marks {found} rows, the manifest says {}", member.present);
            return Err(StoreError::damaged(&file, reason));
        }
        let dim = member.dim;
        Ok(Self {
            shared: Arc::new(Shared { dim, rows, present }),
        })
    }

    /// Length of a row, D.
    pub fn dim(&self) -> usize {
        self.shared.dim
    }

    /// Number of ticks, R.
    pub fn len(&self) -> usize {
        self.shared.present.len()
    }

    /// False: a traverse has at least one tick.
    pub fn is_empty(&self) -> bool {
        self.shared.present.is_empty()
    }

    /// All rows, R×D, one after the other. Ticks without a row are zero.
    pub fn rows(&self) -> &[f32] {
        match &self.shared.rows {
            Rows::Mapped(rows) => rows.as_slice(),
            Rows::Widened(rows) => rows,
        }
    }

    /// The row of this tick, D numbers; zeros where it has none, empty when there is no such tick.
    pub fn row(&self, tick: usize) -> &[f32] {
        let start = tick.saturating_mul(self.shared.dim);
        let end = start.saturating_add(self.shared.dim);
        self.rows().get(start..end).unwrap_or_default()
    }

    /// Which ticks have a row, R entries.
    pub fn present(&self) -> &[bool] {
        &self.shared.present
    }
}

/// The numbers of 16 bits that begin at this byte of a file.
fn widened(mut file: File, offset: usize) -> std::io::Result<Vec<f32>> {
    const AT_ONCE: usize = 1 << 20;
    file.seek(SeekFrom::Start(offset as u64))?;
    let mut values = Vec::new();
    let mut bytes = vec![0; AT_ONCE];
    let mut held = 0;
    loop {
        let read = file.read(&mut bytes[held..])?;
        held += read;
        if read == 0 {
            return Ok(values);
        }
        let whole = held - held % 2;
        let numbers = bytes[..whole].chunks_exact(2);
        values.extend(numbers.map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()));
        bytes.copy_within(whole..held, 0);
        held -= whole;
    }
}

/// Opens a `.npy` file that must have this header and `data` bytes behind it: the file, at its start, and where the data
/// begin.
fn open_npy(path: &Path, expected: &NpyHeader, data: u64) -> Result<(File, usize), StoreError> {
    /// As much as a header of one or two axes can sensibly take.
    const MOST: u64 = 4096;
    let mut file = File::open(path).map_err(StoreError::io("open", path))?;
    let mut head = Vec::new();
    let read = Read::by_ref(&mut file).take(MOST).read_to_end(&mut head);
    read.map_err(StoreError::io("read", path))?;
    let found_bytes = file.metadata().map_err(StoreError::io("look at", path))?.len();
    let damaged = |reason: String| StoreError::damaged(path, reason);
    let (found, offset) = NpyHeader::decode(&head).map_err(damaged)?;
    if found != *expected {
        return Err(damaged(format!(
            "its header says {found}, the manifest says {expected}"
        )));
    }
    let expected_bytes = offset as u64 + data;
    if found_bytes != expected_bytes {
        return Err(damaged(format!(
            "it has {found_bytes} bytes, it must have {expected_bytes}"
        )));
    }
    std::io::Seek::rewind(&mut file).map_err(StoreError::io("read", path))?;
    Ok((file, offset))
}
