//! Records a traverse, tick by tick.

use crate::commit::{Commit, RECORD_BYTES, TickSum};
use crate::difference;
use crate::disk;
use crate::error::StoreError;
use crate::files::{Failed, Files, present_offset, sync_folder};
use crate::layout::{self, COMMITS, MANIFEST, NEW, ROWS, TICKS, partial_path};
use crate::manifest::{Manifest, NewTraverse};
use crate::recover::{Check, recover};
use crate::sync::{PERIOD, Syncer};
use crate::ticks::{HEADER, TickRecord};
use crate::traverse::Traverse;
use evpr_core::plan::RowType;
use half::f16;
use half::slice::HalfFloatSliceExt;
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Writes `<path>.partial`, which closing turns into the traverse `path`.
///
/// Per tick it writes first the rows and marks of all members and the line of `ticks.csv`, then a record that the tick
/// is whole, with a checksum over it all. Once per second, when a tick is appended, it asks for everything to be brought
/// to the disk. Dropping the writer without closing it leaves the recording as a crash would: [`TraverseWriter::resume`]
/// goes on with it, [`crate::repair`] closes it.
///
/// Keeps two files open per member.
#[derive(Debug)]
pub struct TraverseWriter {
    path: PathBuf,
    files: Files,
    manifest: Manifest,
    ticks: u64,
    csv_end: u64,
    syncer: Syncer,
    broken: bool,
    /// A row of zeros as long as the longest.
    zeros: Vec<f32>,
    /// A row as it is kept, where that is not as it is.
    narrow: Vec<f16>,
    line: String,
}

impl TraverseWriter {
    /// Starts a new recording. Makes the folders above it where need be.
    ///
    /// # Errors
    /// [`StoreError::Exists`] and [`StoreError::PartialExists`]: nothing is overwritten; [`StoreError::BadHeader`];
    /// [`StoreError::Io`].
    pub fn create(path: &Path, header: NewTraverse) -> Result<Self, StoreError> {
        let folder = partial_path(path)?;
        let manifest = header.draft()?;
        refuse_existing(path)?;
        let parent = layout::parent(path);
        disk::create_dir_all(parent).map_err(StoreError::io("create", parent))?;
        match disk::create_dir(&folder) {
            Err(e) if e.kind() == ErrorKind::AlreadyExists => {
                return Err(StoreError::PartialExists(path.to_owned()));
            }
            made => made.map_err(StoreError::io("create", &folder))?,
        }
        Self::fill(path, &folder, manifest).inspect_err(|_| {
            // Made a moment ago and empty of ticks. What cannot be removed stays, and says so at the next attempt.
            let _ = disk::remove_dir_all(&folder);
        })
    }

    /// Makes the files; the manifest last, so that where there is one all the files are.
    fn fill(path: &Path, folder: &Path, manifest: Manifest) -> Result<Self, StoreError> {
        let files = Files::create(folder, &manifest.members)?;
        let written = manifest.write(folder);
        written.map_err(StoreError::io("write", &folder.join(MANIFEST)))?;
        sync_folder(layout::parent(path))?;
        Self::with(path, files, manifest, 0, HEADER.len() as u64, 0)
    }

    /// Goes on with `<path>.partial` after the process that recorded it died, behind its last whole tick. One that died
    /// before its files were there is begun again.
    ///
    /// # Errors
    /// [`StoreError::Missing`] without one; [`StoreError::ResumeMismatch`] when it was made with another header (the
    /// notes may differ); [`StoreError::ResumeComplete`]; [`StoreError::InUse`] when its process lives;
    /// [`StoreError::Exists`]; [`StoreError::Io`].
    pub fn resume(path: &Path, header: NewTraverse) -> Result<Self, StoreError> {
        let folder = partial_path(path)?;
        refuse_existing(path)?;
        if !folder.is_dir() {
            return Err(StoreError::Missing(folder));
        }
        if was_just_begun(&folder)? {
            disk::remove_dir_all(&folder).map_err(StoreError::io("remove", &folder))?;
            return Self::create(path, header);
        }
        let mut manifest = Manifest::read(&folder)?;
        if manifest.complete {
            return Err(StoreError::ResumeComplete(path.to_owned()));
        }
        let differences = difference::of_headers(&manifest, &header);
        if !differences.is_empty() {
            return Err(StoreError::ResumeMismatch {
                path: path.to_owned(),
                differences,
            });
        }
        let files = Files::open(&folder, &manifest.members)?;
        let found = recover(&files, Check::SinceSync)?;
        let cut = files.truncate(found.ticks, found.csv_end);
        cut.map_err(|failed| broke(path, found.ticks, failed))?;
        for (member, present) in manifest.members.iter_mut().zip(found.present) {
            member.present = present;
        }
        Self::with(path, files, manifest, found.ticks, found.csv_end, found.synced)
    }

    fn with(
        path: &Path,
        files: Files,
        manifest: Manifest,
        ticks: u64,
        csv_end: u64,
        synced: u64,
    ) -> Result<Self, StoreError> {
        let folder = &files.folder;
        let opened = File::open(folder).map_err(StoreError::io("open", folder))?;
        let syncer = Syncer::start(opened, synced, PERIOD);
        let longest = manifest.members.iter().map(|m| m.dim).max().unwrap_or(0);
        Ok(Self {
            path: path.to_owned(),
            syncer: syncer.map_err(StoreError::io("start a thread to synchronise", folder))?,
            files,
            manifest,
            ticks,
            csv_end,
            broken: false,
            zeros: vec![0.0; longest],
            narrow: Vec::new(),
            line: String::new(),
        })
    }

    /// The path that the traverse will have.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The tick that is to be appended next; also how many there are.
    pub fn next_tick(&self) -> u64 {
        self.ticks
    }

    /// Appends a tick: per member of the header its row, or `None` where it has none.
    ///
    /// # Errors
    /// [`StoreError::BadTick`] when it is not the next one, or a row has the wrong length or a number that is not
    /// finite: nothing is written, and the writer can go on. [`StoreError::Broke`] when the disk is full or fails: the
    /// ticks so far are kept, and the writer is of no further use.
    pub fn append(&mut self, tick: &TickRecord, rows: &[Option<&[f32]>]) -> Result<(), StoreError> {
        self.refuse_broken()?;
        self.check(tick, rows).map_err(|reason| StoreError::BadTick {
            path: self.path.clone(),
            tick: tick.tick,
            reason,
        })?;
        if let Some(error) = self.syncer.take_error() {
            return Err(self.fail((self.files.folder.clone(), error)));
        }
        self.line.clear();
        tick.write_line(&mut self.line);
        self.write(rows).map_err(|failed| self.fail(failed))?;
        for (member, row) in self.manifest.members.iter_mut().zip(rows) {
            member.present += u64::from(row.is_some());
        }
        self.csv_end += self.line.len() as u64;
        self.ticks += 1;
        self.syncer.request(self.ticks);
        Ok(())
    }

    /// What is wrong with a tick.
    fn check(&self, tick: &TickRecord, rows: &[Option<&[f32]>]) -> Result<(), String> {
        if tick.tick != self.ticks {
            return Err(format!("tick {} comes next", self.ticks));
        }
        if tick.end_us < tick.start_us {
            return Err(format!(
                "it ends at {} µs, before its start at {} µs",
                tick.end_us, tick.start_us
            ));
        }
        if tick.position.is_some_and(|p| p.iter().any(|v| !v.is_finite())) {
            return Err("its position is not finite".to_owned());
        }
        let members = &self.manifest.members;
        if rows.len() != members.len() {
            return Err(format!("{} rows for {} members", rows.len(), members.len()));
        }
        for (member, row) in members.iter().zip(rows) {
            let Some(row) = row else { continue };
            if row.len() != member.dim {
                let (name, dim, len) = (&member.name, member.dim, row.len());
                return Err(format!(
                    "the row of member {name} has {len} numbers, it must have {dim}"
                ));
            }
            let largest = match member.dtype {
                RowType::F32 => f32::MAX,
                RowType::F16 => f16::MAX.to_f32(),
            };
            if let Some(at) = row.iter().position(|v| v.is_finite() && v.abs() > largest) {
                return Err(format!(
                    "number {at} of the row of member {} is {}, too large for {}",
                    member.name,
                    row[at],
                    member.dtype.name()
                ));
            }
            if let Some(at) = row.iter().position(|v| !v.is_finite()) {
                return Err(format!(
                    "number {at} of the row of member {} is {}",
                    member.name, row[at]
                ));
            }
        }
        Ok(())
    }

    /// Writes the data of the next tick, then its commit record.
    fn write(&mut self, rows: &[Option<&[f32]>]) -> Result<(), Failed> {
        let line = self.line.as_bytes();
        let mut sum = TickSum::new(line);
        self.files.csv.write_at(line, self.csv_end)?;
        for (m, row) in self.files.members.iter().zip(rows) {
            let mark = u8::from(row.is_some());
            let row = row.unwrap_or_else(|| self.zeros.get(..m.dim).unwrap_or_default());
            let bytes = match m.row_type {
                RowType::F32 => bytemuck::cast_slice(row),
                RowType::F16 => {
                    self.narrow.clear();
                    self.narrow.extend(row.iter().map(|v| f16::from_f32(*v)));
                    bytemuck::cast_slice(self.narrow.reinterpret_cast())
                }
            };
            m.rows.write_at(bytes, m.row_offset(self.ticks))?;
            m.present.write_at(&[mark], present_offset(self.ticks))?;
            sum.member(mark, bytes);
        }
        let commit = Commit {
            tick: self.ticks,
            synced: self.syncer.synced(),
            csv_end: self.csv_end + line.len() as u64,
            data: sum.finish(),
        };
        let offset = self.ticks * RECORD_BYTES as u64;
        self.files.commits.write_at(&commit.encode(), offset)
    }

    /// Completes the recording and gives it its final name.
    ///
    /// # Errors
    /// [`StoreError::Empty`] without a single tick (see [`TraverseWriter::discard`]), [`StoreError::Broke`] when the
    /// disk is full or fails or something has taken the name, and what [`Traverse::open`] finds wrong.
    pub fn close(mut self) -> Result<Traverse, StoreError> {
        self.refuse_broken()?;
        if self.ticks == 0 {
            return Err(StoreError::Empty(self.files.folder.clone()));
        }
        self.syncer.stop();
        if let Some(error) = self.syncer.take_error() {
            return Err(self.fail((self.files.folder.clone(), error)));
        }
        self.manifest.ticks = self.ticks;
        self.manifest.complete = true;
        let finished = self.files.finish(&self.path, &self.manifest, self.csv_end);
        finished.map_err(|failed| broke(&self.path, self.ticks, failed))?;
        Traverse::open(&self.path)
    }

    /// Removes the recording, with all that is in it.
    ///
    /// # Errors
    /// [`StoreError::Io`] when it cannot be removed.
    pub fn discard(mut self) -> Result<(), StoreError> {
        self.syncer.stop();
        let folder = &self.files.folder;
        disk::remove_dir_all(folder).map_err(StoreError::io("remove", folder))
    }

    fn refuse_broken(&self) -> Result<(), StoreError> {
        if self.broken {
            return Err(StoreError::Broken {
                path: self.path.clone(),
                ticks: self.ticks,
            });
        }
        Ok(())
    }

    fn fail(&mut self, failed: Failed) -> StoreError {
        self.broken = true;
        broke(&self.path, self.ticks, failed)
    }
}

/// The recording `path` broke off with `ticks` ticks.
pub(crate) fn broke(path: &Path, ticks: u64, (file, source): Failed) -> StoreError {
    StoreError::Broke {
        file,
        path: path.to_owned(),
        ticks,
        source,
    }
}

/// Refuses a final path that is taken.
fn refuse_existing(path: &Path) -> Result<(), StoreError> {
    match fs::symlink_metadata(path) {
        Ok(_) => Err(StoreError::Exists(path.to_owned())),
        Err(_) => Ok(()),
    }
}

/// Whether the folder is one whose process died before its manifest was there: it holds nothing but what
/// [`TraverseWriter::create`] makes before that.
pub(crate) fn was_just_begun(folder: &Path) -> Result<bool, StoreError> {
    let new = format!("{MANIFEST}{NEW}");
    let entries = fs::read_dir(folder).map_err(StoreError::io("list", folder))?;
    for entry in entries {
        let name = entry.map_err(StoreError::io("list", folder))?.file_name();
        let name = name.to_string_lossy();
        if ![COMMITS, TICKS, ROWS, new.as_str()].contains(&name.as_ref()) {
            return Ok(false);
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{append, assert_is_prefix, has_row, new_traverse, recording};

    const DIMS: [usize; 2] = [3, 5];

    #[test]
    fn a_full_disk_keeps_what_was_recorded() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        let mut writer = recording(&path, &DIMS, 5);
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        writer.files.members[1].rows.file = full;
        let row = [0.0; 5];
        let message = writer
            .append(&crate::test_support::record(5), &[None, Some(&row)])
            .unwrap_err()
            .to_string();
        let (path_text, words) = (path.display(), "No space left on device (os error 28)");
        let expected = format!(
            "{path_text}.partial/rows/m1/x.npy: cannot be written: {words}; what was recorded up to tick 4 is kept \
             in {path_text}.partial; free some space, then run `evpr map repair {path_text}`"
        );
        assert_eq!(message, expected);
        let again = writer.append(&crate::test_support::record(5), &[None, None]);
        assert!(matches!(again, Err(StoreError::Broken { ticks: 5, .. })));
        assert!(matches!(writer.close(), Err(StoreError::Broken { .. })));
        assert_eq!(crate::repair(&path).unwrap().ticks, 5);
        assert_is_prefix(&Traverse::open(&path).unwrap(), &DIMS, 5);
    }

    #[test]
    fn a_failed_synchronisation_ends_the_recording() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = recording(&dir.path().join("map"), &DIMS, 1);
        writer
            .syncer
            .break_with(std::io::Error::other("the disk is gone"));
        let error = writer
            .append(&crate::test_support::record(1), &[None, None])
            .unwrap_err();
        assert!(matches!(error, StoreError::Broke { ticks: 1, .. }), "{error}");
        assert!(error.to_string().contains("the disk is gone"), "{error}");
    }

    #[test]
    fn resuming_counts_rows_of_both_lives_and_trusts_the_disk() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        let mut writer = TraverseWriter::create(&path, new_traverse(&DIMS)).unwrap();
        for tick in 0..4 {
            append(&mut writer, &DIMS, &[has_row(0, tick), has_row(1, tick)]);
        }
        // The next commit says that four ticks are on the disk.
        let folder = File::open(&writer.files.folder).unwrap();
        writer.syncer = Syncer::start(folder, 4, PERIOD).unwrap();
        append(&mut writer, &DIMS, &[has_row(0, 4), has_row(1, 4)]);
        drop(writer);
        let writer = TraverseWriter::resume(&path, new_traverse(&DIMS)).unwrap();
        assert_eq!((writer.next_tick(), writer.syncer.synced()), (5, 4));
        let traverse = writer.close().unwrap();
        assert_is_prefix(&traverse, &DIMS, 5);
        assert_eq!(
            traverse
                .manifest()
                .members
                .iter()
                .map(|m| m.present)
                .collect::<Vec<_>>(),
            [4, 3]
        );
    }
}
