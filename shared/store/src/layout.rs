//! Where everything lies in a traverse's folder.

use crate::error::StoreError;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

pub(crate) const MANIFEST: &str = "traverse.json";
pub(crate) const TICKS: &str = "ticks.csv";
pub(crate) const ROWS: &str = "rows";
pub(crate) const COMMITS: &str = "commits.bin";
/// Ending of files that replace others by renaming.
pub(crate) const NEW: &str = ".new";
const PARTIAL: &str = ".partial";

/// The folder in which the traverse `path` is while it is recorded: `<path>.partial`.
///
/// # Errors
/// [`StoreError::BadPath`] when the path does not end in a name.
pub fn partial_path(path: &Path) -> Result<PathBuf, StoreError> {
    let name = path
        .file_name()
        .ok_or_else(|| StoreError::BadPath(path.to_owned()))?;
    let mut name: OsString = name.to_owned();
    name.push(PARTIAL);
    Ok(path.with_file_name(name))
}

/// The final path of a traverse, given that or its `.partial`.
pub(crate) fn final_path(path: &Path) -> PathBuf {
    let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    match name.strip_suffix(PARTIAL) {
        Some(stem) if !stem.is_empty() => path.with_file_name(stem),
        _ => path.to_owned(),
    }
}

/// Whether the path is named as an unfinished recording.
pub(crate) fn is_partial(path: &Path) -> bool {
    final_path(path) != path
}

/// The folder in which `path` lies.
pub(crate) fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

pub(crate) fn rows_file(folder: &Path, member: &str) -> PathBuf {
    folder.join(ROWS).join(format!("{member}.npy"))
}

pub(crate) fn present_file(folder: &Path, member: &str) -> PathBuf {
    folder.join(ROWS).join(format!("{member}.present.npy"))
}

/// Checks that a member's name can be made into file names that stay inside the folder and clash with no others.
pub(crate) fn check_member_name(name: &str) -> Result<(), String> {
    let odd = |part: &str| part.is_empty() || part == "." || part == "..";
    let bad_char = |c: char| c.is_control() || c == '\\';
    if name.split('/').any(odd) || name.contains(bad_char) {
        return Err(format!(
            "\"{}\" cannot name a member's files",
            name.escape_debug()
        ));
    }
    if name.ends_with(".present") || name.split('/').rev().skip(1).any(|part| part.ends_with(".npy")) {
        return Err(format!("member name \"{name}\" clashes with the names of files"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partial_and_final_names_belong_together() {
        for (path, partial) in [
            ("a", "a.partial"),
            ("x/b.c", "x/b.c.partial"),
            ("/m/", "/m.partial"),
        ] {
            let made = partial_path(Path::new(path)).unwrap();
            assert_eq!(made, Path::new(partial));
            assert_eq!(final_path(&made), Path::new(path.trim_end_matches('/')));
            assert!(is_partial(&made) && !is_partial(Path::new(path)));
        }
        assert!(partial_path(Path::new("/")).is_err());
        assert!(partial_path(Path::new("..")).is_err());
        assert_eq!(final_path(Path::new(".partial")), Path::new(".partial"));
    }

    #[test]
    fn member_names_stay_inside() {
        for good in ["a", "event_count@250ms/mixvpr", "a/b/c", "ä b"] {
            assert_eq!(check_member_name(good), Ok(()), "{good}");
        }
        for bad in [
            "",
            "/a",
            "a/",
            "../a",
            "a/../b",
            "a//b",
            "a\\b",
            "a\0",
            "a\n",
            "a.present",
            "a.npy/b",
        ] {
            assert!(check_member_name(bad).is_err(), "{bad:?}");
        }
    }
}
