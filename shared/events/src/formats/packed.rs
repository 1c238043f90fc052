//! Recordings inside gzip or zip, unpacked as they are read.
//!
//! A zip archive is looked at by its directory, so it must be a file. If it holds `.npy` arrays it is an `.npz`.
//! Otherwise the member that [`ReadOptions::stream`] names is read, or the only one whose ending is that of a format
//! that can be read in order, or the one called `events.…` among several.

use super::{FORMATS, Open, Opened, Place, ReadOptions, numpy, open_known};
use crate::zip::{self, Member};
use crate::{Input, SourceError};
use flate2::read::MultiGzDecoder;
use std::path::Path;

pub(super) const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
/// Most names that an error tells.
const MAX_NAMES: usize = 6;

/// A gzip file or stream; the name without `.gz` is that of the recording.
pub(super) fn gzip(input: Input, options: &ReadOptions) -> Opened {
    let name = input.path().with_extension("");
    inside(input.map(MultiGzDecoder::new), &name, options)
}

/// A zip archive.
pub(super) fn zip(path: &Path, options: &ReadOptions) -> Opened {
    let hidden = |m: &Member| m.file_name().starts_with('.') || m.name.starts_with("__MACOSX/");
    let mut members = zip::members(path)?;
    members.retain(|member| !hidden(member));
    if let Some(wanted) = &options.stream {
        let found = members
            .iter()
            .find(|m| m.name == *wanted || m.file_name() == wanted);
        let member = found.ok_or_else(|| {
            SourceError::malformed(path, format!("holds no {wanted}, but {}", names(&members)))
        })?;
        let options = ReadOptions {
            stream: None,
            ..options.clone()
        };
        return inside(member.open()?, Path::new(&member.name), &options);
    }
    if members.iter().any(|m| ends(m, &["npy"])) {
        return Ok(Box::new(numpy::Numpy::open_archive(
            path,
            &members,
            options.time_unit,
        )?));
    }
    let in_order = |m: &&Member| {
        let mut formats = FORMATS.iter().filter(|f| matches!(f.open, Open::Stream(_)));
        formats.any(|f| ends(m, f.extensions))
    };
    let candidates: Vec<&Member> = members.iter().filter(in_order).collect();
    let member = match (candidates.as_slice(), members.as_slice()) {
        ([one], _) => *one,
        ([], [one]) => one,
        ([], _) => {
            let what = format!(
                "holds no recording that can be read in order, but {}",
                names(&members)
            );
            return Err(SourceError::malformed(path, what));
        }
        (several, _) => {
            let mut called = several.iter().filter(|m| {
                Path::new(m.file_name())
                    .file_stem()
                    .is_some_and(|s| s == "events")
            });
            match (called.next(), called.next()) {
                (Some(one), None) => *one,
                _ => {
                    let what = format!(
                        "holds several files that may be the recording ({}); unpack the one that is wanted",
                        names(&members)
                    );
                    return Err(SourceError::malformed(path, what));
                }
            }
        }
    };
    inside(member.open()?, Path::new(&member.name), options)
}

fn inside(mut input: Input, name: &Path, options: &ReadOptions) -> Opened {
    let head = input.peek(zip::MAGIC.len())?;
    if head.starts_with(GZIP_MAGIC) || head.starts_with(zip::MAGIC) {
        return Err(SourceError::malformed(
            input.path(),
            "is packed twice; unpack it once",
        ));
    }
    open_known(input, name, Place::Packed, options)
}

fn ends(member: &Member, extensions: &[&str]) -> bool {
    let extension = Path::new(member.file_name()).extension();
    extension.is_some_and(|e| extensions.iter().any(|known| e.eq_ignore_ascii_case(known)))
}

fn names(members: &[Member]) -> String {
    if members.is_empty() {
        return "nothing at all".to_owned();
    }
    let mut names: Vec<&str> = members.iter().take(MAX_NAMES).map(|m| m.name.as_str()).collect();
    if members.len() > MAX_NAMES {
        names.push("…");
    }
    // Names of files may hold anything.
    names.join(", ").escape_debug().to_string()
}
