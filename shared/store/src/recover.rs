//! Finds out which ticks of an unfinished recording are whole.

use crate::commit::{self, Commit, RECORD_BYTES, TickSum};
use crate::error::StoreError;
use crate::files::{Files, MemberFiles, present_offset};
use crate::ticks::{self, TickRecord};

/// How closely the data are compared with their checksums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Check {
    /// Every tick.
    All,
    /// Only ticks that may not have been on the disk when the machine died: quick, however long the recording.
    SinceSync,
}

/// What is whole.
#[derive(Debug)]
pub(crate) struct Recovered {
    /// Number of ticks, from the first.
    pub(crate) ticks: u64,
    /// Ticks that had been committed.
    pub(crate) committed: u64,
    /// Ticks that are known to be on the disk.
    pub(crate) synced: u64,
    /// Length of `ticks.csv`, bytes.
    pub(crate) csv_end: u64,
    /// Rows per member.
    pub(crate) present: Vec<u64>,
}

/// Looks through the files. Changes nothing.
///
/// # Errors
/// [`StoreError::Io`] when a file cannot be read.
pub(crate) fn recover(files: &Files, check: Check) -> Result<Recovered, StoreError> {
    let mut records = vec![0; files.commits.len()? as usize / RECORD_BYTES * RECORD_BYTES];
    files.commits.read_at(&mut records, 0)?;
    let mut commits = commit::decode_all(&records);
    let committed = commits.len() as u64;
    let mut csv = vec![0; files.csv.len()? as usize];
    files.csv.read_at(&mut csv, 0)?;

    let lines = whole_lines(&commits, &csv);
    commits.truncate(lines.len());
    for m in &files.members {
        let rows = m.rows.len()?.saturating_sub(m.row_offset(0)) / m.row_bytes().max(1);
        let present = m.present.len()?.saturating_sub(present_offset(0));
        commits.truncate(usize::try_from(rows.min(present)).unwrap_or(usize::MAX));
    }
    let marks = read_marks(&files.members, commits.len())?;
    let is_mark = |tick: usize| marks.iter().all(|m| m[tick] <= 1);
    let synced = commits.last().map_or(0, |c| c.synced);
    let first = if check == Check::All { 0 } else { synced };
    let mut whole = 0;
    let mut row = Vec::new();
    for ((commit, line), tick) in commits.iter().zip(&lines).zip(0..) {
        if !is_mark(tick) {
            break;
        }
        if commit.tick >= first && sum(files, &marks, line, commit.tick, &mut row)? != commit.data {
            break;
        }
        whole = commit.tick + 1;
    }
    let count = |m: &Vec<u8>| m.iter().zip(0..whole).filter(|(mark, _)| **mark == 1).count() as u64;
    let last = usize::try_from(whole)
        .ok()
        .and_then(|n| n.checked_sub(1))
        .and_then(|n| commits.get(n));
    Ok(Recovered {
        ticks: whole,
        committed,
        synced: synced.min(whole),
        csv_end: last.map_or(ticks::HEADER.len() as u64, |c| c.csv_end),
        present: marks.iter().map(count).collect(),
    })
}

/// The lines of the committed ticks, up to the first that is not whole.
fn whole_lines<'a>(commits: &[Commit], csv: &'a [u8]) -> Vec<&'a [u8]> {
    if !csv.starts_with(ticks::HEADER.as_bytes()) {
        return Vec::new();
    }
    let mut start = ticks::HEADER.len();
    let mut lines = Vec::with_capacity(commits.len());
    for commit in commits {
        let Some(line) = usize::try_from(commit.csv_end)
            .ok()
            .and_then(|end| csv.get(start..end))
        else {
            break;
        };
        let text = std::str::from_utf8(line).ok().filter(|text| text.ends_with('\n'));
        if text.is_none_or(|text| TickRecord::read_line(text, commit.tick).is_err()) {
            break;
        }
        start += line.len();
        lines.push(line);
    }
    lines
}

/// Per member, its first `ticks` marks.
fn read_marks(members: &[MemberFiles], ticks: usize) -> Result<Vec<Vec<u8>>, StoreError> {
    let marks = members.iter().map(|m| {
        let mut marks = vec![0; ticks];
        m.present.read_at(&mut marks, present_offset(0))?;
        Ok(marks)
    });
    marks.collect()
}

/// The checksum of a tick as it is in the files.
fn sum(
    files: &Files,
    marks: &[Vec<u8>],
    line: &[u8],
    tick: u64,
    row: &mut Vec<u8>,
) -> Result<u32, StoreError> {
    let mut sum = TickSum::new(line);
    for (m, marks) in files.members.iter().zip(marks) {
        row.resize(m.row_bytes() as usize, 0);
        m.rows.read_at(row, m.row_offset(tick))?;
        let mark = usize::try_from(tick).ok().and_then(|t| marks.get(t));
        sum.member(mark.copied().unwrap_or(0), row);
    }
    Ok(sum.finish())
}
