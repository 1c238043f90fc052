//! Numbers of a column of rows into events.

use super::header::{Class, Scalar};
use crate::RawEvent;
use crate::formats::number::{Number, coordinate, polarity};
use crate::formats::unit::{float_ns, whole_ns};

/// Where a column stands in rows of `row_bytes` bytes; it lies wholly within them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    pub(super) offset: usize,
    pub(super) row_bytes: usize,
    pub(super) scalar: Scalar,
}

/// Calls `each` for every row; false when it said so for one of them.
#[inline]
fn rows<const N: usize>(
    rows: &[u8],
    column: Column,
    events: &mut [RawEvent],
    mut each: impl FnMut(&mut RawEvent, [u8; N]) -> bool,
) -> bool {
    let mut good = true;
    for (row, event) in rows.chunks_exact(column.row_bytes).zip(events) {
        let bytes = row.get(column.offset..).and_then(|r| r.first_chunk());
        good &= bytes.is_some_and(|bytes| each(event, *bytes));
    }
    good
}

/// An IEEE 754 half, exactly.
fn half(bits: u16) -> f64 {
    let magnitude = match (bits >> 10 & 0x1f, f64::from(bits & 0x3ff)) {
        (0, m) => m * 2f64.powi(-24),
        (0x1f, 0.0) => f64::INFINITY,
        (0x1f, _) => f64::NAN,
        (e, m) => (1024.0 + m) * 2f64.powi(i32::from(e) - 25),
    };
    if bits >> 15 == 1 { -magnitude } else { magnitude }
}

/// Calls `whole` or `float` for every row with its number; false when that said so for one of them.
#[inline]
fn numbers(
    bytes: &[u8],
    column: Column,
    events: &mut [RawEvent],
    whole: impl Fn(&mut RawEvent, i64) -> bool + Copy,
    float: impl Fn(&mut RawEvent, f64) -> bool + Copy,
) -> bool {
    macro_rules! read {
        ($type:ty, $each:expr) => {
            if column.scalar.big_endian {
                rows(bytes, column, events, |e, b| {
                    $each(e, <$type>::from_be_bytes(b))
                })
            } else {
                rows(bytes, column, events, |e, b| {
                    $each(e, <$type>::from_le_bytes(b))
                })
            }
        };
    }
    match (column.scalar.class, column.scalar.bytes) {
        (Class::Bool, _) => rows(bytes, column, events, |e, b: [u8; 1]| {
            whole(e, i64::from(b != [0]))
        }),
        (Class::Signed, 1) => read!(i8, |e, v| whole(e, i64::from(v))),
        (Class::Signed, 2) => read!(i16, |e, v| whole(e, i64::from(v))),
        (Class::Signed, 4) => read!(i32, |e, v| whole(e, i64::from(v))),
        (Class::Signed, _) => read!(i64, whole),
        (Class::Unsigned, 1) => read!(u8, |e, v| whole(e, i64::from(v))),
        (Class::Unsigned, 2) => read!(u16, |e, v| whole(e, i64::from(v))),
        (Class::Unsigned, 4) => read!(u32, |e, v| whole(e, i64::from(v))),
        (Class::Unsigned, _) => read!(u64, |e, v| whole(e, i64::try_from(v).unwrap_or(i64::MAX))),
        (Class::Float, 2) => read!(u16, |e, v| float(e, half(v))),
        (Class::Float, 4) => read!(f32, |e, v| float(e, f64::from(v))),
        (Class::Float, _) => read!(f64, float),
    }
}

/// The number in the first of `rows`.
pub(super) fn number(rows: &[u8], column: Column) -> Option<Number> {
    let found = std::cell::Cell::new(None);
    let mut event = [RawEvent::default()];
    numbers(
        rows,
        column,
        &mut event,
        |_, v| {
            found.set(Some(Number::Whole(v)));
            true
        },
        |_, v| {
            found.set(Some(Number::Float(v)));
            true
        },
    );
    found.get()
}

/// Sets the times, in units of `scale` ns. False when one of them is none.
pub(super) fn times(rows: &[u8], column: Column, scale: u64, events: &mut [RawEvent]) -> bool {
    let set = |e: &mut RawEvent, ns: Option<u64>| {
        e.t_ns = ns.unwrap_or(0);
        ns.is_some()
    };
    numbers(
        rows,
        column,
        events,
        |e, v| set(e, whole_ns(v, scale)),
        |e, v| set(e, float_ns(v, scale)),
    )
}

/// Sets columns or rows with `place`. False when one of them is none.
pub(super) fn coordinates(
    rows: &[u8],
    column: Column,
    events: &mut [RawEvent],
    place: impl Fn(&mut RawEvent, u16) + Copy,
) -> bool {
    let set = |e: &mut RawEvent, v: Option<u16>| {
        place(e, v.unwrap_or(0));
        v.is_some()
    };
    numbers(
        rows,
        column,
        events,
        |e, v| set(e, coordinate(Number::Whole(v))),
        |e, v| set(e, coordinate(Number::Float(v))),
    )
}

/// Sets the polarities. False when one of them is none.
pub(super) fn polarities(rows: &[u8], column: Column, events: &mut [RawEvent]) -> bool {
    let set = |e: &mut RawEvent, v: Option<bool>| {
        e.on = v.unwrap_or(false);
        v.is_some()
    };
    numbers(
        rows,
        column,
        events,
        |e, v| set(e, polarity(Number::Whole(v))),
        |e, v| set(e, polarity(Number::Float(v))),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_exact() {
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xbc00, -1.0),
            (0x0001, 2f64.powi(-24)),
            (0x7bff, 65504.0),
            (0x0400, 2f64.powi(-14)),
            (0x0000, 0.0),
        ] {
            assert_eq!(half(bits), value);
        }
        assert!(half(0x7c01).is_nan() && half(0x7c00).is_infinite());
    }
}
