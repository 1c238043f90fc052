//! One event of the sensor.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// One event, 8 bytes: time in µs from its chunk's base, column, and row with polarity.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, ZeroCopySend)]
#[type_name("evpr.Event.1")]
pub struct Event {
    /// Time in µs after the chunk's `base_us`.
    pub t_us: u32,
    /// Column, from 0.
    pub x: u16,
    /// Row and polarity: `y << 1 | p`, with p = 1 for ON (brighter), 0 for OFF.
    pub y_polarity: u16,
}

impl Event {
    /// The largest row that fits beside the polarity bit.
    pub const Y_MAX: u16 = u16::MAX >> 1;

    /// Packs an event. `y` must be at most [`Event::Y_MAX`].
    #[inline]
    pub fn new(t_us: u32, x: u16, y: u16, on: bool) -> Self {
        debug_assert!(y <= Self::Y_MAX);
        Self {
            t_us,
            x,
            y_polarity: y << 1 | u16::from(on),
        }
    }

    /// Row, from 0.
    #[inline]
    pub fn y(self) -> u16 {
        self.y_polarity >> 1
    }

    /// True for an ON event.
    #[inline]
    pub fn on(self) -> bool {
        self.y_polarity & 1 == 1
    }
}
