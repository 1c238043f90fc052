//! What the tools around E2VID write: `/events/{ts, xs, ys, ps}`, times in seconds in floating point, polarities as
//! truth values, attribute `sensor_resolution` (height, width) on the root.
//! Source: `hdf5_packager` of github.com/TimoStoff/events_contrast_maximization.

use super::{Events, Layout, Times};

pub(super) const LAYOUT: Layout = Layout {
    format: "HDF5 (E2VID layout)",
    names: ["ts", "xs", "ys", "ps"],
    times,
};

fn times(events: &Events) -> Result<Times, String> {
    Ok(Times::plain(events.open_unit()?))
}
