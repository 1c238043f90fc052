//! Durations as people write them: `250ms`, `1s`, `1.5s`, `10us`, `2min`.

/// Parses a duration into nanoseconds. Units: `ns`, `us`, `µs`, `ms`, `s`, `min`, `h`; a decimal fraction is allowed
/// as long as it comes to whole nanoseconds.
///
/// # Errors
/// What is wrong and what to write instead.
pub fn parse_duration_ns(text: &str) -> Result<u64, String> {
    let help =
        || format!("\"{text}\" is not a duration; write a number with a unit, such as \"250ms\" or \"1s\"");
    let text_trimmed = text.trim();
    let split = text_trimmed
        .find(|c: char| c.is_alphabetic() || c == 'µ')
        .ok_or_else(help)?;
    let (number, unit) = text_trimmed.split_at(split);
    let scale: u64 = match unit {
        "ns" => 1,
        "us" | "µs" => 1_000,
        "ms" => 1_000_000,
        "s" => 1_000_000_000,
        "min" => 60_000_000_000,
        "h" => 3_600_000_000_000,
        _ => return Err(help()),
    };
    let number = number.trim();
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    if whole.is_empty() || !number.bytes().all(|b| b.is_ascii_digit() || b == b'.') || fraction.contains('.')
    {
        return Err(help());
    }
    let too_long = || format!("\"{text}\" is too long a duration; the longest is about 500 years");
    let mut ns = whole
        .parse::<u64>()
        .ok()
        .and_then(|w| w.checked_mul(scale))
        .ok_or_else(too_long)?;
    let mut digit_scale = scale;
    for digit in fraction.bytes().map(|b| u64::from(b - b'0')) {
        if !digit_scale.is_multiple_of(10) && digit != 0 {
            return Err(format!("\"{text}\" is finer than a nanosecond"));
        }
        digit_scale /= 10;
        ns = ns.checked_add(digit * digit_scale).ok_or_else(too_long)?;
    }
    Ok(ns)
}

/// Writes a duration with the largest unit that keeps it whole: `250ms`, `1s`, `1500us`.
pub fn format_duration(ns: u64) -> String {
    const UNITS: [(u64, &str); 4] = [(1_000_000_000, "s"), (1_000_000, "ms"), (1_000, "us"), (1, "ns")];
    for (scale, unit) in UNITS {
        if ns.is_multiple_of(scale) {
            return format!("{}{unit}", ns / scale);
        }
    }
    format!("{ns}ns")
}

/// Days from 1970-01-01 to a date of the Gregorian calendar, years 1 to 9999; `None` when there is no such day.
pub fn days_since_1970(year: i64, month: i64, day: i64) -> Option<i64> {
    let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let february = if leap { 29 } else { 28 };
    let lengths = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let before = usize::try_from(month.checked_sub(1)?).ok()?;
    if !(1..=9999).contains(&year) || !(1..=*lengths.get(before)?).contains(&day) {
        return None;
    }
    let leaps_before = |year: i64| (year - 1) / 4 - (year - 1) / 100 + (year - 1) / 400;
    let years = (year - 1970) * 365 + leaps_before(year) - leaps_before(1970);
    Some(years + lengths.iter().take(before).sum::<i64>() + day - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_what_people_write() {
        for (text, ns) in [
            ("250ms", 250_000_000),
            ("1s", 1_000_000_000),
            ("1.5s", 1_500_000_000),
            ("0.1 s", 100_000_000),
            ("10us", 10_000),
            ("10µs", 10_000),
            ("7ns", 7),
            ("2min", 120_000_000_000),
        ] {
            assert_eq!(parse_duration_ns(text), Ok(ns), "{text}");
        }
    }

    #[test]
    fn refuses_the_rest() {
        for text in [
            "",
            "1",
            "s",
            "1.2.3s",
            "-1s",
            "1e3s",
            "1 day",
            "1.5ns",
            "99999999999999h",
            ".5s",
        ] {
            assert!(parse_duration_ns(text).is_err(), "{text}");
        }
    }

    #[test]
    fn writes_back() {
        for ns in [
            0,
            1,
            999,
            1_000,
            250_000_000,
            1_000_000_000,
            1_500_000_000,
            u64::MAX,
        ] {
            assert_eq!(parse_duration_ns(&format_duration(ns)), Ok(ns));
        }
        assert_eq!(format_duration(250_000_000), "250ms");
    }

    #[test]
    fn counts_days() {
        // `date -u -d 2020-04-21 +%s` and so on, divided by 86400.
        for (date, days) in [
            ((1970, 1, 1), 0),
            ((1969, 12, 31), -1),
            ((1994, 3, 23), 8_847),
            ((2000, 2, 29), 11_016),
            ((2000, 3, 1), 11_017),
            ((2020, 4, 21), 18_373),
            ((2262, 4, 11), 106_751),
            ((1600, 1, 1), -135_140),
        ] {
            assert_eq!(days_since_1970(date.0, date.1, date.2), Some(days), "{date:?}");
        }
        for (year, month, day) in [
            (2021, 2, 29),
            (1900, 2, 29),
            (2020, 13, 1),
            (2020, 0, 1),
            (2020, 4, 31),
            (0, 1, 1),
        ] {
            assert_eq!(days_since_1970(year, month, day), None);
        }
    }
}
