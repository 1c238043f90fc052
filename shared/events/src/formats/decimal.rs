//! Times as decimals, read exactly: no floating point on the way.

/// Why a text is not a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum DecimalError {
    /// Not a decimal number.
    Garbage,
    /// Below zero.
    Negative,
    /// More nanoseconds than [`crate::MAX_TIME_NS`].
    TooLarge,
}

/// Largest exponent that is read.
const MAX_EXPONENT: i32 = 40;

/// Reads a decimal, with or without a point and an exponent, in a unit of `10^unit_digits` ns. What is finer than
/// a nanosecond is cut off.
pub(crate) fn parse_ns(text: &[u8], unit_digits: u32) -> Result<u64, DecimalError> {
    let (negative, digits) = match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, text),
    };
    let ns = if digits.len() <= 18 && digits.iter().all(u8::is_ascii_digit) && !digits.is_empty() {
        let whole = digits.iter().fold(0u64, |n, d| n * 10 + u64::from(d - b'0'));
        whole
            .checked_mul(10u64.pow(unit_digits))
            .ok_or(DecimalError::TooLarge)
    } else {
        parse_general(digits, unit_digits)
    }?;
    match (negative, ns) {
        (true, 1..) => Err(DecimalError::Negative),
        (_, ns) if ns > crate::MAX_TIME_NS => Err(DecimalError::TooLarge),
        (_, ns) => Ok(ns),
    }
}

fn parse_general(text: &[u8], unit_digits: u32) -> Result<u64, DecimalError> {
    let (mut mantissa, mut digits, mut fraction, mut dropped) = (0u128, 0u32, 0i32, 0i32);
    let mut point = false;
    let mut exponent = 0;
    let mut rest = text.iter().enumerate();
    for (at, byte) in rest.by_ref() {
        match byte {
            b'0'..=b'9' => {
                digits += 1;
                fraction += i32::from(point);
                // 36 digits hold every time there is; further ones can only be fractions of a nanosecond or too large.
                if mantissa < 10u128.pow(36) {
                    mantissa = mantissa * 10 + u128::from(byte - b'0');
                } else {
                    dropped += 1;
                }
            }
            b'.' if !point => point = true,
            b'e' | b'E' => {
                let text = std::str::from_utf8(&text[at + 1..]).map_err(|_| DecimalError::Garbage)?;
                exponent = text.parse().map_err(|_| DecimalError::Garbage)?;
                break;
            }
            _ => return Err(DecimalError::Garbage),
        }
    }
    if digits == 0 || !(-MAX_EXPONENT..=MAX_EXPONENT).contains(&exponent) || digits > 1000 {
        return Err(DecimalError::Garbage);
    }
    let power = exponent - fraction + dropped + unit_digits as i32;
    let ns = if mantissa == 0 {
        0
    } else if power >= 0 {
        10u128
            .checked_pow(power.unsigned_abs())
            .and_then(|scale| mantissa.checked_mul(scale))
            .ok_or(DecimalError::TooLarge)?
    } else {
        10u128
            .checked_pow(power.unsigned_abs())
            .map_or(0, |scale| mantissa / scale)
    };
    u64::try_from(ns).map_err(|_| DecimalError::TooLarge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn decimals_are_read_exactly() {
        for (text, unit, ns) in [
            ("0", 9, 0),
            ("-0.0", 9, 0),
            ("1587452582.350000123", 9, 1_587_452_582_350_000_123),
            ("1587452582.3500001239", 9, 1_587_452_582_350_000_123),
            ("0.1", 9, 100_000_000),
            (".5", 9, 500_000_000),
            ("7.", 9, 7_000_000_000),
            ("12", 3, 12_000),
            ("12.5", 3, 12_500),
            ("12.5", 0, 12),
            ("1.5e3", 9, 1_500_000_000_000),
            ("1.5874525823500000e+09", 9, 1_587_452_582_350_000_000),
            ("2500E-3", 9, 2_500_000_000),
            ("1700000000000000001", 0, 1_700_000_000_000_000_001),
            ("00000000000000000000000000000000000000000005", 0, 5),
            ("0.0000000000000000000000000000000000000000000000009", 9, 0),
        ] {
            assert_eq!(parse_ns(text.as_bytes(), unit), Ok(ns), "{text}");
        }
    }

    #[test]
    fn the_rest_is_refused() {
        for text in [
            "", ".", "-", "nan", "inf", "1..2", "1e", "1e99", "0x1", "1_000", "1 2", "--1", "e5",
        ] {
            assert_eq!(parse_ns(text.as_bytes(), 9), Err(DecimalError::Garbage), "{text}");
        }
        assert_eq!(parse_ns(b"-1", 9), Err(DecimalError::Negative));
        assert_eq!(parse_ns(b"-0.000000001", 9), Err(DecimalError::Negative));
        for text in [
            "9223372036.854775808",
            "99999999999999999999",
            "1e40",
            "123456789012345678",
        ] {
            assert_eq!(
                parse_ns(text.as_bytes(), 9),
                Err(DecimalError::TooLarge),
                "{text}"
            );
        }
        assert_eq!(parse_ns(b"9223372036.854775807", 9), Ok(crate::MAX_TIME_NS));
    }

    proptest! {
        #[test]
        fn seconds_written_out_come_back(ns in 0..crate::MAX_TIME_NS) {
            let text = format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000);
            prop_assert_eq!(parse_ns(text.as_bytes(), 9), Ok(ns));
            prop_assert_eq!(parse_ns(ns.to_string().as_bytes(), 0), Ok(ns));
        }

        #[test]
        fn any_bytes_are_taken_without_a_panic(text in proptest::collection::vec(any::<u8>(), 0..60)) {
            let _ = parse_ns(&text, 9);
        }
    }
}
