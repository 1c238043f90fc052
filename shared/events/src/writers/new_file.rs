//! A file that gets its name when it is whole.

use super::WriteError;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Held back before the system is asked to write, bytes.
const BUFFER_BYTES: usize = 256 << 10;

/// Stands as `<name>.partial` until [`NewFile::commit`]; dropped before, it is removed.
#[derive(Debug)]
pub(super) struct NewFile {
    file: BufWriter<File>,
    name: Name,
}

/// The two names; its drop removes the partial file.
#[derive(Debug)]
struct Name {
    path: PathBuf,
    partial: PathBuf,
    kept: bool,
}

impl NewFile {
    /// Begins the file. What an interrupted run left under the partial name is overwritten.
    pub(super) fn create(path: &Path) -> Result<Self, WriteError> {
        let mut partial = path.as_os_str().to_owned();
        partial.push(".partial");
        let partial = PathBuf::from(partial);
        let file = File::create(&partial).map_err(|e| WriteError::write(path, e))?;
        Ok(Self {
            file: BufWriter::with_capacity(BUFFER_BYTES, file),
            name: Name {
                path: path.to_owned(),
                partial,
                kept: false,
            },
        })
    }

    /// The name that it will have.
    pub(super) fn path(&self) -> &Path {
        &self.name.path
    }

    /// An error of the system as one about this file.
    pub(super) fn failed(&self, error: std::io::Error) -> WriteError {
        WriteError::write(self.path(), error)
    }

    /// Makes the file durable under its real name.
    pub(super) fn commit(mut self) -> Result<(), WriteError> {
        let written = self.file.flush().and_then(|()| self.file.get_ref().sync_all());
        written.map_err(|e| self.failed(e))?;
        std::fs::rename(&self.name.partial, &self.name.path).map_err(|e| self.failed(e))?;
        self.name.kept = true;
        Ok(())
    }
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn write_all(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.file.write_all(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// For what is known at the end only, such as counts in a header.
impl Seek for NewFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

impl Drop for Name {
    fn drop(&mut self) {
        if !self.kept {
            // Nothing can be done about a failure here, and the partial name says what the file is.
            let _ = std::fs::remove_file(&self.partial);
        }
    }
}
