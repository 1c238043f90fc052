//! The unit that times are in, where the format does not say it, and the usual names of the columns of an event.

use crate::MAX_TIME_NS;
use evpr_core::plan::TimeUnit;

/// Usual names of the columns t, x, y and p, in lower case.
pub(super) const NAMES: [(&str, &[&str]); 4] = [
    ("t", &["t", "timestamp", "timestamps", "ts", "time", "times"]),
    ("x", &["x", "xs", "x_coordinates"]),
    ("y", &["y", "ys", "y_coordinates"]),
    ("p", &["p", "pol", "polarity", "polarities", "ps", "on"]),
];

/// Which of the columns t, x, y and p has this name (0 to 3), and the unit of times that it says, as in `t_ns`.
pub(super) fn column(name: &str) -> Option<(usize, Option<TimeUnit>)> {
    let is = |name: &str, names: &[&str]| names.iter().any(|n| name.eq_ignore_ascii_case(n));
    if let Some(column) = NAMES.iter().position(|(_, names)| is(name, names)) {
        return Some((column, None));
    }
    let (name, suffix) = name.rsplit_once('_')?;
    let units = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
    let unit = units.into_iter().find(|unit| self::name(*unit) == suffix)?;
    is(name, NAMES[0].1).then_some((0, Some(unit)))
}

/// The unit that a first time without a fraction speaks for: from 10^17 on nanoseconds, from 10^14 on microseconds
/// (of the epoch), from 10^12 on milliseconds (of the epoch), below that microseconds.
pub(super) fn by_magnitude(first: u64) -> (TimeUnit, &'static str) {
    let unit = match first {
        100_000_000_000_000_000.. => TimeUnit::Ns,
        100_000_000_000_000.. => TimeUnit::Us,
        1_000_000_000_000.. => TimeUnit::Ms,
        _ => TimeUnit::Us,
    };
    (unit, "magnitude")
}

/// The unit that a first time in floating point speaks for: seconds, unless it is of the epoch in a smaller unit.
pub(super) fn by_float(first: f64) -> (TimeUnit, &'static str) {
    if first >= 1e12 {
        by_magnitude(first as u64)
    } else {
        (TimeUnit::S, "floating point")
    }
}

/// How many decimal digits of the unit come to a nanosecond; `None` while it is open.
pub(super) fn digits(unit: TimeUnit) -> Option<u32> {
    match unit {
        TimeUnit::Auto => None,
        TimeUnit::S => Some(9),
        TimeUnit::Ms => Some(6),
        TimeUnit::Us => Some(3),
        TimeUnit::Ns => Some(0),
    }
}

/// The unit in `SourceInfo::time_unit`.
pub(super) fn name(unit: TimeUnit) -> &'static str {
    match unit {
        TimeUnit::S => "s",
        TimeUnit::Ms => "ms",
        TimeUnit::Us => "us",
        TimeUnit::Ns | TimeUnit::Auto => "ns",
    }
}

/// A whole number of units of `scale` ns each; `None` when it is negative or beyond [`MAX_TIME_NS`].
#[inline]
pub(super) fn whole_ns(time: i64, scale: u64) -> Option<u64> {
    let ns = u64::try_from(time).ok()?.checked_mul(scale)?;
    (ns <= MAX_TIME_NS).then_some(ns)
}

/// A floating-point number of units of `scale` ns each; `None` when it is negative, beyond [`MAX_TIME_NS`] or no number.
///
/// A binary fraction stands for the decimal that it was made of: that of whole microseconds if this gives the same
/// `f64` back, else that of the nearest nanosecond. So 1587452582.35 s is not 95 ns early.
#[inline]
pub(super) fn float_ns(time: f64, scale: u64) -> Option<u64> {
    // Up to here an f64 tells whole numbers apart.
    const WHOLE: f64 = (1u64 << 53) as f64;
    let time = time + 0.0; // -0 becomes 0
    if !(0.0..9.3e18).contains(&time) {
        return None;
    }
    let us_scale = (scale / 1_000) as f64;
    let us = time * us_scale + 0.5;
    if us_scale >= 1.0 && us < WHOLE && (us as u64) as f64 / us_scale == time {
        return (us as u64).checked_mul(1_000).filter(|ns| *ns <= MAX_TIME_NS);
    }
    // The whole part is scaled exactly; the fraction, which is exact too, keeps its digits.
    let whole = (time.trunc() as u64).checked_mul(scale)?;
    let ns = whole.checked_add((time.fract() * scale as f64).round() as u64)?;
    (ns <= MAX_TIME_NS).then_some(ns)
}

/// As [`float_ns`] for units of `us_scale` µs each, and whether that is right: it is for whole microseconds below 2^51,
/// of units that are whole microseconds themselves.
#[inline]
pub(super) fn quick_float_ns(time: f64, us_scale: f64) -> (u64, bool) {
    // Added to a smaller number it leaves the nearest whole number in the lowest bits.
    const ROUNDER: f64 = (1u64 << 52) as f64;
    const MOST: f64 = (1u64 << 51) as f64;
    let us = time * us_scale;
    let rounded = us + ROUNDER;
    let whole = rounded.to_bits() & ((1 << 52) - 1);
    let good = ((rounded - ROUNDER) / us_scale == time) & (0.0..MOST).contains(&us) & (us_scale >= 1.0);
    (whole.wrapping_mul(1000), good)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn floats_come_to_the_nearest_nanosecond() {
        for (time, scale, ns) in [
            (0.1, 1_000_000_000, Some(100_000_000)),
            (-0.0, 1_000_000_000, Some(0)),
            (1.000_000_001, 1_000_000_000, Some(1_000_000_001)),
            (1_587_452_582.35, 1_000_000_000, Some(1_587_452_582_350_000_000)),
            (
                1_587_452_582.350_001,
                1_000_000_000,
                Some(1_587_452_582_350_001_000),
            ),
            (0.25, 1_000_000, Some(250_000)),
            (1_587_452_582.5, 1_000_000_000, Some(1_587_452_582_500_000_000)),
            (1e15, 1000, Some(1_000_000_000_000_000_000)),
            (9_223_372_036.9, 1_000_000_000, None),
            (1e300, 1, None),
            (-1e-9, 1_000_000_000, None),
            (f64::NAN, 1, None),
        ] {
            assert_eq!(float_ns(time, scale), ns, "{time} of {scale} ns");
        }
        assert_eq!(whole_ns(i64::MAX, 1), Some(MAX_TIME_NS));
        assert_eq!(whole_ns(i64::MAX, 1000), None);
        assert_eq!(whole_ns(-1, 1), None);
    }

    proptest! {
        #[test]
        fn quick_times_are_those_of_the_exact_way(
            us in 0u64..1 << 53,
            other in any::<f64>(),
            unit in proptest::sample::select(vec![1u64, 1_000, 1_000_000, 1_000_000_000]),
        ) {
            let us_scale = unit as f64 / 1e3;
            let mut quick = 0;
            for time in [us as f64 / us_scale, us as f64 / us_scale + 1e-7, -(us as f64), 0.0, -0.0, us as f64 + 0.5, other] {
                let (ns, good) = quick_float_ns(time, us_scale);
                if good {
                    prop_assert_eq!(Some(ns), float_ns(time, unit), "{} of {} ns", time, unit);
                    quick += 1;
                }
            }
            // Zeros always; whole microseconds as far as it goes.
            let wanted = if us < 1 << 51 { 3 } else { 2 };
            prop_assert!(unit == 1 || quick >= wanted, "{} of {} ns: {}", us, unit, quick);
        }
    }

    #[test]
    fn the_first_time_tells_the_unit() {
        assert_eq!(by_magnitude(1_700_000_000_000_000_000).0, TimeUnit::Ns);
        assert_eq!(by_magnitude(1_700_000_000_000_000).0, TimeUnit::Us);
        assert_eq!(by_magnitude(1_700_000_000_000).0, TimeUnit::Ms);
        assert_eq!(by_magnitude(99).0, TimeUnit::Us);
        assert_eq!(by_float(1_700_000_000.25), (TimeUnit::S, "floating point"));
        assert_eq!(by_float(1.7e15), (TimeUnit::Us, "magnitude"));
    }
}
