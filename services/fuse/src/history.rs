//! What the fuser knows of the last ticks, kept in a file where its next incarnation finds it: its death then costs no
//! history.
//!
//! A ring of slots, one per tick, each written in one go with a checksum before its answer is sent. A slot that was
//! being written when the fuser died is told by its checksum, and is as if it had never been there. The file belongs to
//! one run on one machine; one of another run or of other sizes is begun anew.

use crate::FuseError;
use crate::engine::Input;
use evpr_core::ledger::TickInfo;
use evpr_core::message::FuseSettings;
use evpr_core::{MemberSet, Plan};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

const MAGIC: u64 = u64::from_ne_bytes(*b"evprhis1");
const HEAD_BYTES: usize = 64;
/// Checksum and length of what follows.
const SLOT_HEAD_BYTES: usize = 8;

/// A settled tick as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KeptTick {
    pub(crate) info: TickInfo,
    /// The tick was lost on the way.
    pub(crate) lost: bool,
    /// Per member of the plan: how it ended, as in answers.
    pub(crate) ends: Vec<u8>,
    /// Per member of the plan: its similarity row.
    pub(crate) rows: Vec<Option<Vec<f64>>>,
    /// How the engine stood after the tick.
    pub(crate) standing: Standing,
}

impl KeptTick {
    /// As the engine takes it; `rows` are its own.
    pub(crate) fn input<'a>(&'a self, rows: &'a [Option<&'a [f64]>]) -> Input<'a> {
        Input {
            enabled: &self.info.members,
            weights: &self.info.weights,
            rows,
            lost: self.lost,
        }
    }
}

/// What the engine knows beside the rows of the last ticks.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Standing {
    /// Ticks taken since the first of the run; `None` where that is not known.
    pub(crate) since_start: Option<u64>,
    /// Per member: ticks in a row with a row.
    pub(crate) streaks: Vec<u64>,
    /// The filter's probabilities, empty without one, and its ticks in a row without evidence.
    pub(crate) probabilities: Vec<f64>,
    pub(crate) blind: u64,
}

/// Sizes that decide where things lie in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Geometry {
    run_id: u64,
    members: usize,
    references: usize,
    /// Ticks that are kept.
    slots: u64,
}

impl Geometry {
    fn slot_bytes(self) -> u64 {
        let numbers = self.members as u64 * (self.references as u64 + 4) + self.references as u64 + 32;
        SLOT_HEAD_BYTES as u64 + 8 * numbers
    }

    fn offset(self, tick: u64) -> u64 {
        HEAD_BYTES as u64 + tick % self.slots * self.slot_bytes()
    }

    fn head(self) -> Vec<u8> {
        let mut head = Vec::with_capacity(HEAD_BYTES);
        for number in [
            MAGIC,
            self.run_id,
            self.members as u64,
            self.references as u64,
            self.slots,
        ] {
            head.extend(number.to_ne_bytes());
        }
        head.extend(u64::from(crc32fast::hash(&head)).to_ne_bytes());
        head.resize(HEAD_BYTES, 0);
        head
    }
}

/// See the module.
#[derive(Debug)]
pub struct History {
    path: PathBuf,
    file: File,
    geometry: Geometry,
    buffer: Vec<u8>,
}

impl History {
    /// Opens the file at `path`, or begins it where there is none of this run with these sizes. `references` is R of the
    /// map.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn open(path: &Path, plan: &Plan, references: usize, run_id: u64) -> Result<Self, FuseError> {
        let geometry = Geometry {
            run_id,
            members: plan.members.len(),
            references,
            slots: slots(plan.fuse.length),
        };
        Self::open_file(path, geometry).map_err(|problem| FuseError::History {
            path: path.to_owned(),
            problem: problem.to_string(),
        })
    }

    fn open_file(path: &Path, mut geometry: Geometry) -> io::Result<Self> {
        let file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)?;
        let mut head = vec![0; HEAD_BYTES];
        let found = file.read_exact_at(&mut head, 0).is_ok();
        let mut there = Reader(&head);
        let slots = (there.u64(), there.u64(), there.u64(), there.u64(), there.u64()).4;
        // It may have grown with the length of the sequence.
        let grown = Geometry {
            slots: slots.unwrap_or(0).max(1),
            ..geometry
        };
        if found && grown.head() == head {
            geometry = grown;
        } else {
            file.set_len(0)?;
            file.write_all_at(&geometry.head(), 0)?;
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            geometry,
            buffer: Vec::new(),
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Ticks that it can hold.
    pub(crate) fn capacity(&self) -> u64 {
        self.geometry.slots
    }

    /// The tick, if it was kept whole and has not been overwritten since.
    pub(crate) fn tick(&self, tick: u64) -> Option<KeptTick> {
        let offset = self.geometry.offset(tick);
        let mut head = [0; SLOT_HEAD_BYTES];
        self.file.read_exact_at(&mut head, offset).ok()?;
        let mut reader = Reader(&head);
        let (checksum, length) = (reader.u32()?, reader.u32()?);
        if u64::from(length) > self.geometry.slot_bytes() - SLOT_HEAD_BYTES as u64 {
            return None;
        }
        let mut content = vec![0; length as usize];
        self.file
            .read_exact_at(&mut content, offset + SLOT_HEAD_BYTES as u64)
            .ok()?;
        if crc32fast::hash(&content) != checksum {
            return None;
        }
        let kept = decode(&content, self.geometry)?;
        (kept.info.tick == tick).then_some(kept)
    }

    /// Keeps a tick, in the place of the oldest.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn keep(&mut self, tick: &Keep<'_>) -> io::Result<()> {
        self.buffer.clear();
        self.buffer.resize(SLOT_HEAD_BYTES, 0);
        encode(tick, &mut self.buffer);
        let (head, content) = self.buffer.split_at_mut(SLOT_HEAD_BYTES);
        head[..4].copy_from_slice(&crc32fast::hash(content).to_ne_bytes());
        head[4..].copy_from_slice(&(content.len() as u32).to_ne_bytes());
        self.file
            .write_all_at(&self.buffer, self.geometry.offset(tick.info.tick))
    }

    /// Keeps more ticks from now on, where the sequence has become longer than the file is; those there are stay.
    ///
    /// # Errors
    /// When the longer file cannot be written.
    pub(crate) fn lengthen(&mut self, length: usize, newest: u64) -> io::Result<()> {
        let wanted = slots(length);
        if wanted <= self.geometry.slots {
            return Ok(());
        }
        let draft = self.path.with_extension("new");
        // What an earlier attempt left is begun anew.
        File::create(&draft)?;
        let geometry = Geometry {
            slots: wanted,
            ..self.geometry
        };
        let mut longer = Self::open_file(&draft, geometry)?;
        let first = newest.saturating_sub(self.geometry.slots);
        for kept in (first..=newest).filter_map(|tick| self.tick(tick)) {
            let rows: Vec<Option<&[f64]>> = kept.rows.iter().map(Option::as_deref).collect();
            longer.keep(&Keep {
                info: &kept.info,
                lost: kept.lost,
                ends: &kept.ends,
                rows: &rows,
                standing: &kept.standing,
            })?;
        }
        std::fs::rename(&draft, &self.path)?;
        longer.path = std::mem::take(&mut self.path);
        *self = longer;
        Ok(())
    }
}

/// Ticks to keep for sequences of this length: those before the next answer, and one that is kept and not yet sent.
fn slots(length: usize) -> u64 {
    length.max(1) as u64 + 1
}

/// A tick that is to be kept.
#[derive(Debug)]
pub(crate) struct Keep<'a> {
    pub(crate) info: &'a TickInfo,
    pub(crate) lost: bool,
    pub(crate) ends: &'a [u8],
    pub(crate) rows: &'a [Option<&'a [f64]>],
    pub(crate) standing: &'a Standing,
}

fn encode(tick: &Keep<'_>, to: &mut Vec<u8>) {
    let (info, standing) = (tick.info, tick.standing);
    let fuse = &info.fuse;
    for number in [
        info.tick,
        info.start_us,
        info.end_us,
        info.control_version,
        u64::from(fuse.length),
        u64::from(fuse.rule),
        fuse.trim.to_bits(),
        fuse.deadline_ns,
        fuse.min_confidence.to_bits(),
        u64::from(fuse.sets_min_confidence),
        u64::from(tick.lost),
        standing.since_start.unwrap_or(u64::MAX),
        standing.blind,
        standing.probabilities.len() as u64,
    ] {
        to.extend(number.to_ne_bytes());
    }
    for (member, row) in tick.rows.iter().enumerate() {
        to.extend(info.weights.get(member).copied().unwrap_or(1.0).to_ne_bytes());
        to.extend(standing.streaks.get(member).copied().unwrap_or(0).to_ne_bytes());
        to.push(u8::from(info.members.contains(member)));
        to.push(tick.ends.get(member).copied().unwrap_or(0));
        to.push(u8::from(row.is_some()));
    }
    for row in tick.rows.iter().flatten() {
        to.extend_from_slice(bytemuck::cast_slice(row));
    }
    to.extend_from_slice(bytemuck::cast_slice(&standing.probabilities));
}

fn decode(content: &[u8], geometry: Geometry) -> Option<KeptTick> {
    let mut from = Reader(content);
    let (tick, start_us, end_us, control_version) = (from.u64()?, from.u64()?, from.u64()?, from.u64()?);
    let fuse = FuseSettings {
        length: from.u64()? as u32,
        rule: from.u64()? as u32,
        trim: f64::from_bits(from.u64()?),
        deadline_ns: from.u64()?,
        min_confidence: f64::from_bits(from.u64()?),
        sets_min_confidence: from.u64()? as u32,
        _pad: 0,
    };
    let lost = from.u64()? != 0;
    let since_start = Some(from.u64()?).filter(|ticks| *ticks != u64::MAX);
    let (blind, probabilities) = (from.u64()?, from.u64()? as usize);
    let mut info = TickInfo {
        tick,
        start_us,
        end_us,
        position: None,
        control_version,
        members: MemberSet::default(),
        weights: Vec::new(),
        fuse,
    };
    let (mut streaks, mut ends, mut present) = (Vec::new(), Vec::new(), Vec::new());
    for member in 0..geometry.members {
        info.weights.push(f64::from_bits(from.u64()?));
        streaks.push(from.u64()?);
        info.members.set(member, from.u8()? != 0);
        ends.push(from.u8()?);
        present.push(from.u8()? != 0);
    }
    let mut rows = Vec::with_capacity(geometry.members);
    for present in present {
        rows.push(if present {
            Some(from.f64s(geometry.references)?)
        } else {
            None
        });
    }
    let probabilities = match probabilities {
        0 => Vec::new(),
        n if n == geometry.references => from.f64s(n)?,
        _ => return None,
    };
    Some(KeptTick {
        info,
        lost,
        ends,
        rows,
        standing: Standing {
            since_start,
            streaks,
            probabilities,
            blind,
        },
    })
}

/// Takes numbers off the front of some bytes.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (front, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*front)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take::<1>().map(|[byte]| byte)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_ne_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_ne_bytes)
    }

    fn f64s(&mut self, count: usize) -> Option<Vec<f64>> {
        (0..count).map(|_| self.take().map(f64::from_ne_bytes)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::test_plan;

    const REFERENCES: usize = 5;

    fn kept(tick: u64) -> KeptTick {
        KeptTick {
            info: TickInfo {
                tick,
                start_us: tick * 10,
                end_us: tick * 10 + 9,
                position: None,
                control_version: 3,
                members: [0, 1].into_iter().collect(),
                weights: vec![1.0, 0.25],
                fuse: FuseSettings {
                    length: 4,
                    rule: 2,
                    trim: 0.1,
                    deadline_ns: 7,
                    min_confidence: 0.25,
                    sets_min_confidence: 1,
                    _pad: 0,
                },
            },
            lost: false,
            ends: vec![1, 6],
            rows: vec![
                Some((0..REFERENCES).map(|r| r as f64 - tick as f64).collect()),
                None,
            ],
            standing: Standing {
                since_start: Some(tick + 1),
                streaks: vec![tick + 1, 0],
                probabilities: vec![0.2; REFERENCES],
                blind: 0,
            },
        }
    }

    fn keep(history: &mut History, tick: &KeptTick) {
        let rows: Vec<Option<&[f64]>> = tick.rows.iter().map(Option::as_deref).collect();
        let keep = Keep {
            info: &tick.info,
            lost: tick.lost,
            ends: &tick.ends,
            rows: &rows,
            standing: &tick.standing,
        };
        history.keep(&keep).unwrap();
    }

    fn open(path: &Path, run_id: u64) -> History {
        let mut plan = test_plan();
        plan.fuse.length = 3;
        History::open(path, &plan, REFERENCES, run_id).unwrap()
    }

    #[test]
    fn the_last_ticks_are_found_again_and_older_ones_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fuse");
        let mut history = open(&path, 1);
        (0..10).for_each(|tick| keep(&mut history, &kept(tick)));
        drop(history);
        let history = open(&path, 1);
        for tick in 0..12 {
            let wanted = (6..10).contains(&tick).then(|| kept(tick));
            assert_eq!(history.tick(tick), wanted, "tick {tick}");
        }
        assert_eq!(open(&path, 2).tick(9), None, "of another run");
    }

    #[test]
    fn a_torn_slot_is_as_if_it_had_never_been_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fuse");
        let mut history = open(&path, 1);
        (0..4).for_each(|tick| keep(&mut history, &kept(tick)));
        let whole = std::fs::read(&path).unwrap();
        keep(&mut history, &kept(4));
        let next = std::fs::read(&path).unwrap();
        drop(history);
        // Killed after so many bytes of the slot were written.
        let changed: Vec<usize> = (0..next.len())
            .filter(|i| whole.get(*i) != Some(&next[*i]))
            .collect();
        let (first, last) = (changed[0], *changed.last().unwrap());
        for cut in first + 1..=last {
            let mut torn = whole.clone();
            torn[first..cut].copy_from_slice(&next[first..cut]);
            std::fs::write(&path, &torn).unwrap();
            let history = open(&path, 1);
            assert_eq!((history.tick(0), history.tick(4)), (None, None), "cut at {cut}");
            assert_eq!(history.tick(3), Some(kept(3)));
        }
    }

    #[test]
    fn a_longer_sequence_keeps_what_there_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fuse");
        let mut history = open(&path, 1);
        (0..6).for_each(|tick| keep(&mut history, &kept(tick)));
        history.lengthen(9, 5).unwrap();
        (6..12).for_each(|tick| keep(&mut history, &kept(tick)));
        let history = open(&path, 1);
        for tick in 2..12 {
            assert_eq!(history.tick(tick), Some(kept(tick)), "tick {tick}");
        }
        assert_eq!(history.tick(1), None);
    }
}
