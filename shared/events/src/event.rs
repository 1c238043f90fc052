//! One event as a recording has it.

/// Most events in a batch that a recording decodes at once.
pub const BATCH_EVENTS: usize = 1 << 16;

/// Times reach up to here (the year 2262 after 1970), ns: so sums of a time and a length cannot overflow unseen.
pub const MAX_TIME_NS: u64 = i64::MAX as u64;

/// An event in the recording's own resolution of time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RawEvent {
    /// Sensor time, ns.
    pub t_ns: u64,
    /// Column, from 0. A column beyond `u16` counts as `u16::MAX`, which no sensor has.
    pub x: u16,
    /// Row, from 0; as `x`.
    pub y: u16,
    /// True for an ON event (brighter).
    pub on: bool,
}

/// A time for a person: seconds with all nine digits.
pub fn seconds(t_ns: u64) -> String {
    format!("{}.{:09} s", t_ns / 1_000_000_000, t_ns % 1_000_000_000)
}

/// A length of time for a person, to the millisecond.
pub fn rough_seconds(t_ns: u64) -> String {
    format!("{}.{:03} s", t_ns / 1_000_000_000, t_ns / 1_000_000 % 1_000)
}
