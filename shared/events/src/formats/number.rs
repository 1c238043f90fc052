//! A number as a recording has it, and what it means as a coordinate or a polarity.

/// A number as it stands in the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Number {
    /// A whole number; beyond `i64` counts as its largest.
    Whole(i64),
    Float(f64),
}

impl std::fmt::Display for Number {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Whole(n) => n.fmt(f),
            Self::Float(n) => n.fmt(f),
        }
    }
}

/// A coordinate, beyond `u16` its largest; `None` for what is none.
#[inline]
pub(super) fn coordinate(number: Number) -> Option<u16> {
    match number {
        Number::Whole(v @ 0..) => Some(v.min(i64::from(u16::MAX)) as u16),
        Number::Float(v) if v >= 0.0 && v.fract() == 0.0 => Some(v.min(f64::from(u16::MAX)) as u16),
        _ => None,
    }
}

/// True for 1, false for 0 and -1; `None` for anything else.
#[inline]
pub(super) fn polarity(number: Number) -> Option<bool> {
    match number {
        Number::Whole(1) => Some(true),
        Number::Whole(0 | -1) => Some(false),
        Number::Float(1.0) => Some(true),
        Number::Float(0.0 | -1.0) => Some(false),
        _ => None,
    }
}
