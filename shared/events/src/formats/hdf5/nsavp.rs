//! NSAVP: `/events/{timestamps u64 ns, x_coordinates u16, y_coordinates u16, polarities u8}`, with attributes `height`
//! and `width`. Times in floating point are seconds.

use super::{Events, Layout, Times};
use evpr_core::plan::TimeUnit;

pub(super) const LAYOUT: Layout = Layout {
    format: "HDF5 (NSAVP layout)",
    names: ["timestamps", "x_coordinates", "y_coordinates", "polarities"],
    times,
};

fn times(events: &Events) -> Result<Times, String> {
    let float = matches!(events.first_time()?, Some(first) if first.float);
    let unit = if float { TimeUnit::S } else { TimeUnit::Ns };
    Ok(Times::plain((unit, "format")))
}
