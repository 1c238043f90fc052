//! Everything that a recording changes on the disk goes through here, one step at a time, so that tests can let each step
//! be the last.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

#[cfg(test)]
pub(crate) mod fail_points;

/// What may be done of a step.
enum Step {
    Whole,
    /// Only the first half of what is to be written. Tests alone ask for this.
    #[cfg_attr(not(test), expect(dead_code, reason = "asked for by tests"))]
    Half,
}

#[cfg(not(test))]
fn step() -> io::Result<Step> {
    Ok(Step::Whole)
}

#[cfg(test)]
fn step() -> io::Result<Step> {
    fail_points::step()
}

/// Writes these bytes at this place of the file.
pub(crate) fn write_at(file: &File, bytes: &[u8], offset: u64) -> io::Result<()> {
    match step()? {
        Step::Whole => file.write_all_at(bytes, offset),
        Step::Half => file
            .write_all_at(&bytes[..bytes.len() / 2], offset)
            .and_then(|()| torn()),
    }
}

/// Writes a file that is not there, or is to be replaced.
pub(crate) fn write_new(path: &Path, bytes: &[u8]) -> io::Result<File> {
    step()?;
    let mut file = File::create(path)?;
    match step()? {
        Step::Whole => file.write_all(bytes)?,
        Step::Half => file.write_all(&bytes[..bytes.len() / 2]).and_then(|()| torn())?,
    }
    Ok(file)
}

fn torn() -> io::Result<()> {
    Err(io::Error::other("torn"))
}

/// Makes the file so long.
pub(crate) fn set_len(file: &File, bytes: u64) -> io::Result<()> {
    step()?;
    file.set_len(bytes)
}

/// Brings a file to the disk.
pub(crate) fn sync(file: &File) -> io::Result<()> {
    step()?;
    file.sync_all()
}

/// Brings a folder's list of files to the disk.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    sync(&File::open(folder)?)
}

/// Gives a file or folder another name.
pub(crate) fn rename(from: &Path, to: &Path) -> io::Result<()> {
    step()?;
    fs::rename(from, to)
}

/// Makes a folder.
pub(crate) fn create_dir(folder: &Path) -> io::Result<()> {
    step()?;
    fs::create_dir(folder)
}

/// Makes a folder, and those above it where need be.
pub(crate) fn create_dir_all(folder: &Path) -> io::Result<()> {
    step()?;
    fs::create_dir_all(folder)
}

/// Makes or opens a file.
pub(crate) fn open(path: &Path, options: &fs::OpenOptions) -> io::Result<File> {
    step()?;
    options.open(path)
}

/// Removes a file.
pub(crate) fn remove_file(path: &Path) -> io::Result<()> {
    step()?;
    fs::remove_file(path)
}

/// Removes a folder with all that is in it.
pub(crate) fn remove_dir_all(folder: &Path) -> io::Result<()> {
    step()?;
    fs::remove_dir_all(folder)
}
