//! `commits.bin`: the ticks of an unfinished recording that are whole. One record per tick, written after everything
//! else of that tick.

use crc32fast::Hasher;

/// Length of a record, bytes.
pub(crate) const RECORD_BYTES: usize = 32;

/// The record of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Commit {
    /// The tick.
    pub(crate) tick: u64,
    /// The ticks before this one were on the disk when the record was written.
    pub(crate) synced: u64,
    /// Length of `ticks.csv` with this tick, bytes.
    pub(crate) csv_end: u64,
    /// Checksum of the tick's data, from [`TickSum`]: after a power failure the record may be on the disk and the data
    /// not.
    pub(crate) data: u32,
}

impl Commit {
    pub(crate) fn encode(&self) -> [u8; RECORD_BYTES] {
        let mut bytes = [0; RECORD_BYTES];
        bytes[..8].copy_from_slice(&self.tick.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.synced.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.csv_end.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.data.to_le_bytes());
        let own = crc32fast::hash(&bytes[..28]);
        bytes[28..].copy_from_slice(&own.to_le_bytes());
        bytes
    }

    fn decode(bytes: &[u8; RECORD_BYTES]) -> Option<Self> {
        let (words, own) = bytes.split_at(28);
        if crc32fast::hash(words).to_le_bytes() != own {
            return None;
        }
        let u64_at = |at: usize| {
            let word = words.get(at..at + 8)?.try_into().ok()?;
            Some(u64::from_le_bytes(word))
        };
        Some(Self {
            tick: u64_at(0)?,
            synced: u64_at(8)?,
            csv_end: u64_at(16)?,
            data: u32::from_le_bytes(words.get(24..28)?.try_into().ok()?),
        })
    }
}

/// The records at the start of the file that are whole and in order. Whatever follows is what was under way.
pub(crate) fn decode_all(bytes: &[u8]) -> Vec<Commit> {
    let (records, _torn) = bytes.as_chunks::<RECORD_BYTES>();
    let mut all: Vec<Commit> = Vec::with_capacity(records.len());
    for record in records {
        let in_order = |c: &Commit| {
            c.tick == all.len() as u64
                && c.synced <= c.tick
                && all.last().is_none_or(|last| last.csv_end < c.csv_end)
        };
        match Commit::decode(record).filter(in_order) {
            Some(commit) => all.push(commit),
            None => break,
        }
    }
    all
}

/// Checksum (CRC-32) of a tick's data: its line of `ticks.csv`, then per member whether it has a row, and the row.
#[derive(Debug)]
pub(crate) struct TickSum(Hasher);

impl TickSum {
    pub(crate) fn new(line: &[u8]) -> Self {
        let mut hasher = Hasher::new();
        hasher.update(line);
        Self(hasher)
    }

    pub(crate) fn member(&mut self, present: u8, row: &[u8]) {
        self.0.update(&[present]);
        self.0.update(row);
    }

    pub(crate) fn finish(self) -> u32 {
        self.0.finalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(ticks: u64) -> Vec<u8> {
        let commit = |tick| Commit {
            tick,
            synced: tick / 2,
            csv_end: 100 + 10 * tick,
            data: tick as u32 ^ 0xdead_beef,
        };
        (0..ticks).flat_map(|tick| commit(tick).encode()).collect()
    }

    #[test]
    fn every_prefix_gives_the_whole_records() {
        let bytes = file(4);
        let all = decode_all(&bytes);
        assert_eq!(all.len(), 4);
        assert_eq!((all[3].synced, all[3].csv_end), (1, 130));
        for len in 0..bytes.len() {
            assert_eq!(decode_all(&bytes[..len]), all[..len / RECORD_BYTES]);
        }
    }

    #[test]
    fn a_flipped_bit_ends_the_list() {
        for at in 0..4 * RECORD_BYTES {
            let mut bytes = file(4);
            bytes[at] ^= 4;
            assert_eq!(decode_all(&bytes).len(), at / RECORD_BYTES, "byte {at}");
        }
        assert!(
            decode_all(&[0; 3 * RECORD_BYTES]).is_empty(),
            "a hole is no record"
        );
    }

    #[test]
    fn records_out_of_order_end_the_list() {
        let mut bytes = file(1);
        bytes.extend(file(3));
        assert_eq!(decode_all(&bytes).len(), 1);
    }
}
