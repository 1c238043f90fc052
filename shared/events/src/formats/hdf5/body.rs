//! Where the events of a file come from.

use super::column::Column;
use super::dsec;
use crate::{BATCH_EVENTS, RawEvent};

/// Four columns of one length.
pub(super) struct Columns {
    pub(super) t: Column<u64>,
    pub(super) x: Column<u16>,
    pub(super) y: Column<u16>,
    pub(super) p: Column<bool>,
    pub(super) index: Option<dsec::Index>,
}

pub(super) enum Body {
    Columns(Box<Columns>),
    Compound(Box<Column<RawEvent>>),
}

impl Body {
    fn time_at(&mut self, at: u64) -> Result<Option<u64>, String> {
        match self {
            Self::Columns(columns) => Ok(columns.t.from(at)?.first().copied()),
            Self::Compound(events) => Ok(events.from(at)?.first().map(|e| e.t_ns)),
        }
    }

    fn block_len(&self) -> u64 {
        match self {
            Self::Columns(columns) => columns.t.block_len(),
            Self::Compound(events) => events.block_len(),
        }
    }

    /// Appends the events from `at`, as far as all that is in memory reaches.
    pub(super) fn decode(&mut self, at: u64, out: &mut Vec<RawEvent>) -> Result<(), String> {
        match self {
            Self::Columns(columns) => {
                let Columns { t, x, y, p, .. } = &mut **columns;
                let (t, x, y, p) = (t.from(at)?, x.from(at)?, y.from(at)?, p.from(at)?);
                let columns = t.iter().zip(x).zip(y).zip(p).take(BATCH_EVENTS);
                out.extend(columns.map(|(((t_ns, x), y), on)| RawEvent {
                    t_ns: *t_ns,
                    x: *x,
                    y: *y,
                    on: *on,
                }));
            }
            Self::Compound(events) => {
                let rest = events.from(at)?;
                out.extend_from_slice(&rest[..rest.len().min(BATCH_EVENTS)]);
            }
        }
        Ok(())
    }

    /// An event, of `len`, before which every one is earlier than `t_ns`, where times do not go back.
    pub(super) fn seek(&mut self, t_ns: u64, len: u64) -> Result<u64, String> {
        if let Self::Columns(columns) = self
            && let Some(index) = &columns.index
        {
            let event = index.event(t_ns)?.min(len);
            let before = match event.checked_sub(1) {
                Some(before) => columns.t.from(before)?.first().is_some_and(|t| *t < t_ns),
                None => true,
            };
            // An index that is wrong is not followed.
            if before {
                return Ok(event);
            }
        }
        search(len, self.block_len(), t_ns, |at| self.time_at(at))
    }
}

/// An index, at most `block_len` before the first time that is not below `t_ns`, or 0; `time_at` does not decrease.
fn search(
    len: u64,
    block_len: u64,
    t_ns: u64,
    mut time_at: impl FnMut(u64) -> Result<Option<u64>, String>,
) -> Result<u64, String> {
    // `before` is 0 or earlier than `t_ns`; `after` is the end or not. Finer than a block need not be told apart.
    let (mut before, mut after) = (0, len);
    while after - before > block_len {
        let middle = before + (after - before) / 2;
        if time_at(middle)?.is_some_and(|t| t < t_ns) {
            before = middle;
        } else {
            after = middle;
        }
    }
    Ok(before)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn search_stops_shortly_before_the_time(
            mut times in proptest::collection::vec(0u64..100, 1..200),
            block_len in 1u64..20,
            t_ns in 0u64..110,
        ) {
            times.sort_unstable();
            let found = search(times.len() as u64, block_len, t_ns, |at| Ok(times.get(at as usize).copied()));
            let found = found.unwrap();
            let first = times.partition_point(|t| *t < t_ns) as u64;
            prop_assert!(found <= first && first - found <= block_len);
        }
    }
}
