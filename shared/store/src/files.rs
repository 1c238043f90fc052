//! The files of an unfinished recording. Data are written at the place that their tick gives them, so that whatever a
//! failed attempt left is overwritten by the next.

use crate::commit::RECORD_BYTES;
use crate::disk;
use crate::error::StoreError;
use crate::layout::{self, COMMITS, ROWS, TICKS};
use crate::manifest::{Manifest, MemberEntry};
use crate::npy::{HEADER_BYTES, NpyHeader};
use crate::ticks::HEADER;
use evpr_core::plan::RowType;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Something that could not be written, and why.
pub(crate) type Failed = (PathBuf, io::Error);

/// A file with its name, for error messages.
#[derive(Debug)]
pub(crate) struct NamedFile {
    pub(crate) path: PathBuf,
    pub(crate) file: File,
}

impl NamedFile {
    fn open(path: PathBuf, create: bool) -> Result<Self, StoreError> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(create);
        let action = if create { "create" } else { "open" };
        let opened = if create {
            disk::open(&path, &options)
        } else {
            options.open(&path)
        };
        match opened {
            Ok(file) => Ok(Self { path, file }),
            Err(e) => Err(StoreError::io(action, &path)(e)),
        }
    }

    pub(crate) fn write_at(&self, bytes: &[u8], offset: u64) -> Result<(), Failed> {
        let written = disk::write_at(&self.file, bytes, offset);
        written.map_err(|e| (self.path.clone(), e))
    }

    pub(crate) fn set_len(&self, bytes: u64) -> Result<(), Failed> {
        disk::set_len(&self.file, bytes).map_err(|e| (self.path.clone(), e))
    }

    fn sync(&self) -> Result<(), Failed> {
        disk::sync(&self.file).map_err(|e| (self.path.clone(), e))
    }

    pub(crate) fn len(&self) -> Result<u64, StoreError> {
        let meta = self.file.metadata();
        Ok(meta.map_err(StoreError::io("look at", &self.path))?.len())
    }

    pub(crate) fn read_at(&self, bytes: &mut [u8], offset: u64) -> Result<(), StoreError> {
        let read = self.file.read_exact_at(bytes, offset);
        read.map_err(StoreError::io("read", &self.path))
    }
}

/// The two files of a member.
#[derive(Debug)]
pub(crate) struct MemberFiles {
    pub(crate) rows: NamedFile,
    pub(crate) present: NamedFile,
    pub(crate) dim: usize,
    pub(crate) row_type: RowType,
}

impl MemberFiles {
    pub(crate) fn row_bytes(&self) -> u64 {
        (self.dim * self.row_type.bytes()) as u64
    }

    /// Where the tick's row begins.
    pub(crate) fn row_offset(&self, tick: u64) -> u64 {
        HEADER_BYTES as u64 + tick * self.row_bytes()
    }
}

/// Where a tick's mark in a `.present.npy` lies.
pub(crate) fn present_offset(tick: u64) -> u64 {
    HEADER_BYTES as u64 + tick
}

/// All files that grow while a recording goes on. Holds a lock, so that no two processes write the same recording.
#[derive(Debug)]
pub(crate) struct Files {
    pub(crate) folder: PathBuf,
    pub(crate) commits: NamedFile,
    pub(crate) csv: NamedFile,
    pub(crate) members: Vec<MemberFiles>,
}

impl Files {
    /// Makes the files in a fresh folder.
    pub(crate) fn create(folder: &Path, members: &[MemberEntry]) -> Result<Self, StoreError> {
        for member in members {
            if let Some(inside) = layout::rows_file(folder, &member.name).parent() {
                disk::create_dir_all(inside).map_err(StoreError::io("create", inside))?;
            }
        }
        let files = Self::with(folder, members, true)?;
        let room = [0; HEADER_BYTES];
        let written = (|| {
            files.csv.write_at(HEADER.as_bytes(), 0)?;
            for m in &files.members {
                m.rows.write_at(&room, 0)?;
                m.present.write_at(&room, 0)?;
            }
            files.sync()
        })();
        written.map_err(|(file, e)| StoreError::io("write", &file)(e))?;
        for member in members {
            let rows = folder.join(ROWS);
            let file = layout::rows_file(folder, &member.name);
            let inside = file.ancestors().skip(1).take_while(|dir| dir.starts_with(&rows));
            for dir in inside.chain([folder]) {
                sync_folder(dir)?;
            }
        }
        Ok(files)
    }

    /// Opens the files that are there.
    pub(crate) fn open(folder: &Path, members: &[MemberEntry]) -> Result<Self, StoreError> {
        Self::with(folder, members, false)
    }

    fn with(folder: &Path, members: &[MemberEntry], create: bool) -> Result<Self, StoreError> {
        let commits = NamedFile::open(folder.join(COMMITS), create)?;
        lock(&commits.file, folder)?;
        let members = members.iter().map(|member| {
            Ok(MemberFiles {
                rows: NamedFile::open(layout::rows_file(folder, &member.name), create)?,
                present: NamedFile::open(layout::present_file(folder, &member.name), create)?,
                dim: member.dim,
                row_type: member.dtype,
            })
        });
        Ok(Self {
            folder: folder.to_owned(),
            members: members.collect::<Result<_, StoreError>>()?,
            csv: NamedFile::open(folder.join(TICKS), create)?,
            commits,
        })
    }

    /// Cuts off everything behind the first `ticks` ticks. Commit records go first: none may outlive its data.
    pub(crate) fn truncate(&self, ticks: u64, csv_end: u64) -> Result<(), Failed> {
        self.commits.set_len(ticks * RECORD_BYTES as u64)?;
        self.csv.set_len(csv_end)?;
        if ticks == 0 {
            // Its header may have been torn.
            self.csv.write_at(HEADER.as_bytes(), 0)?;
        }
        for m in &self.members {
            m.rows.set_len(m.row_offset(ticks))?;
            m.present.set_len(present_offset(ticks))?;
        }
        Ok(())
    }

    /// Brings all of them to the disk.
    fn sync(&self) -> Result<(), Failed> {
        self.csv.sync()?;
        for m in &self.members {
            m.rows.sync()?;
            m.present.sync()?;
        }
        self.commits.sync()
    }

    /// Turns the folder into the finished traverse `path`: cuts off what is behind the first `manifest.ticks` ticks,
    /// writes the headers and the manifest, and gives the folder its name.
    pub(crate) fn finish(self, path: &Path, manifest: &Manifest, csv_end: u64) -> Result<(), Failed> {
        self.truncate(manifest.ticks, csv_end)?;
        for m in &self.members {
            m.rows
                .write_at(&NpyHeader::rows(manifest.ticks, m.dim, m.row_type).encode(), 0)?;
            m.present
                .write_at(&NpyHeader::present(manifest.ticks).encode(), 0)?;
        }
        self.sync()?;
        let folder = self.folder.as_path();
        manifest.write(folder).map_err(|e| (folder.to_owned(), e))?;
        name_finished(folder, path)
    }
}

/// Removes the commits of a recording that is complete but for its name, and gives it that.
pub(crate) fn name_finished(folder: &Path, path: &Path) -> Result<(), Failed> {
    if fs::symlink_metadata(path).is_ok() {
        return Err((path.to_owned(), ErrorKind::AlreadyExists.into()));
    }
    let commits = folder.join(COMMITS);
    match disk::remove_file(&commits) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err((commits, e)),
        _ => {}
    }
    let sync = |dir: &Path| disk::sync_folder(dir).map_err(|e| (dir.to_owned(), e));
    sync(folder)?;
    disk::rename(folder, path).map_err(|e| (path.to_owned(), e))?;
    sync(layout::parent(path))
}

/// Brings a folder's list of files to the disk.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), StoreError> {
    disk::sync_folder(folder).map_err(StoreError::io("write", folder))
}

/// Locks the recording for as long as the file is open. The system lifts the lock when the process dies. Where the file
/// system has no locks, there is none.
fn lock(file: &File, folder: &Path) -> Result<(), StoreError> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse(folder.to_owned())),
        Err(TryLockError::Error(e)) if e.kind() == ErrorKind::Unsupported => Ok(()),
        Err(TryLockError::Error(e)) => Err(StoreError::io("lock", folder)(e)),
    }
}
