//! DSEC: `/events/{t, x, y, p}` with `t` in µs, to which `/t_offset` (µs) is added; `/ms_to_idx[m]` is the first event
//! that is not earlier than `m` ms. Source: dsec.ifi.uzh.ch/data-format.
//!
//! Without `/t_offset` and `/ms_to_idx` the columns are those of many tools, and the unit is open.

use super::column::value_at;
use super::{Events, Layout, Times, dataset};
use crate::MAX_TIME_NS;
use evpr_core::plan::TimeUnit;
use hdf5_reader::Dataset;

pub(super) const LAYOUT: Layout = Layout {
    format: "HDF5 (DSEC layout)",
    names: ["t", "x", "y", "p"],
    times,
};

fn times(events: &Events) -> Result<Times, String> {
    let offset = dataset(events.file, &events.root, "/", "t_offset")?;
    let index = dataset(events.file, &events.root, "/", "ms_to_idx")?;
    if offset.is_none() && index.is_none() {
        return Ok(Times::plain(events.open_unit()?));
    }
    let offset_ns = match offset {
        Some(offset) => value_at("/t_offset", &offset, 0)?
            .whole
            .and_then(|us| us.checked_mul(1_000))
            .filter(|ns| *ns <= MAX_TIME_NS)
            .ok_or("has a /t_offset that is no time from 0 to the year 2262; the file is damaged")?,
        None => 0,
    };
    Ok(Times {
        unit: (TimeUnit::Us, "format"),
        offset_ns,
        index: index.map(|dataset| Index { dataset, offset_ns }),
    })
}

/// `/ms_to_idx`.
pub(super) struct Index {
    dataset: Dataset,
    offset_ns: u64,
}

impl Index {
    /// The event that the index gives for the millisecond of a time. It is only as right as the file.
    pub(super) fn event(&self, t_ns: u64) -> Result<u64, String> {
        let last = self.dataset.shape().first().copied().unwrap_or(0).checked_sub(1);
        let (Some(last), Some(since)) = (last, t_ns.checked_sub(self.offset_ns)) else {
            return Ok(0);
        };
        let at = (since / 1_000_000).min(last);
        Ok(value_at("/ms_to_idx", &self.dataset, at)?.whole.unwrap_or(0))
    }
}
