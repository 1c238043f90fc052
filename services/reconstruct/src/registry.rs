//! The methods there are: one row each.

use crate::event_count::EventCount;
use crate::event_count_no_polarity::EventCountNoPolarity;
use crate::method::Make;
use crate::time_surface::TimeSurface;
use evpr_core::message::ChannelOrder;
use evpr_core::plan::{ParamInfo, ParamKind, ReconstructionKind};

/// A method with its description.
pub(crate) struct Row {
    /// What the configuration and a person need to know.
    pub(crate) kind: ReconstructionKind,
    /// How to make one.
    pub(crate) make: Make,
}

const ROWS: [Row; 3] = [
    Row {
        kind: ReconstructionKind {
            name: "event_count",
            doc: "events per pixel and polarity, through tanh, scaled by the largest (channels OFF, ON, 0)",
            channel_order: ChannelOrder::OffOnZero,
            params: &[],
            masks_hot_pixels: false,
        },
        make: |sensor, slots, _| Ok(Box::new(EventCount::new(sensor, slots))),
    },
    Row {
        kind: ReconstructionKind {
            name: "event_count_no_polarity",
            doc: "events per pixel of both polarities, through tanh, not scaled (one channel)",
            channel_order: ChannelOrder::Grey,
            params: &[],
            masks_hot_pixels: false,
        },
        make: |sensor, slots, _| Ok(Box::new(EventCountNoPolarity::new(sensor, slots))),
    },
    Row {
        kind: ReconstructionKind {
            name: "time_surface",
            doc: "how recent the last event per pixel and polarity is, decaying exponentially (channels ON, OFF, 0)",
            channel_order: ChannelOrder::OnOffZero,
            params: &[ParamInfo {
                name: "tau",
                kind: ParamKind::Duration {
                    default_ns: 100_000_000,
                },
                doc: "time constant of the decay, at most 100s",
            }],
            masks_hot_pixels: false,
        },
        make: |sensor, slots, params| Ok(Box::new(TimeSurface::new(sensor, slots, params)?)),
    },
];

/// The methods that this crate knows, as the configuration and `--help` show them.
pub static KINDS: [ReconstructionKind; ROWS.len()] = {
    let mut kinds = [ROWS[0].kind; ROWS.len()];
    let mut row = 1;
    while row < ROWS.len() {
        kinds[row] = ROWS[row].kind;
        row += 1;
    }
    kinds
};

/// [`KINDS`] and `frames`, whose frames are not made of events.
pub static ALL_KINDS: [ReconstructionKind; ROWS.len() + 1] = {
    let mut kinds = [crate::frames::KIND; ROWS.len() + 1];
    let mut row = 0;
    while row < ROWS.len() {
        kinds[row] = ROWS[row].kind;
        row += 1;
    }
    kinds
};

/// The methods that this crate knows: [`KINDS`] as a slice.
pub fn kinds() -> &'static [ReconstructionKind] {
    &KINDS
}

/// The row of the method of this name.
pub(crate) fn find(name: &str) -> Option<Row> {
    ROWS.into_iter().find(|row| row.kind.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_found() {
        for kind in kinds() {
            assert_eq!(find(kind.name).map(|row| row.kind.name), Some(kind.name));
            assert_eq!(kinds().iter().filter(|k| k.name == kind.name).count(), 1);
        }
        assert!(find("no_such_method").is_none());
    }
}
