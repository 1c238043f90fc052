//! `ticks.csv`: when each tick was, and where.

use crate::error::StoreError;
use std::fmt::Write;
use std::path::Path;

/// First line of the file.
pub(crate) const HEADER: &str = "tick,start_us,end_us,east_m,north_m\n";

/// One tick of a traverse.
#[derive(Debug, Clone, PartialEq)]
pub struct TickRecord {
    /// The tick, counted from 0; also the index of its rows.
    pub tick: u64,
    /// Sensor time of its start, µs.
    pub start_us: u64,
    /// Sensor time of its end, µs.
    pub end_us: u64,
    /// Where the camera was at its start: metres east and north; `None` where not known.
    pub position: Option<[f64; 2]>,
}

impl TickRecord {
    /// Appends the tick's line.
    pub(crate) fn write_line(&self, out: &mut String) {
        let (tick, start, end) = (self.tick, self.start_us, self.end_us);
        // Writing into a string cannot fail. `{}` of f64 is the shortest text that reads back to the same number.
        let _ = match self.position {
            Some([east, north]) => writeln!(out, "{tick},{start},{end},{east},{north}"),
            None => writeln!(out, "{tick},{start},{end},,"),
        };
    }

    /// Reads a line, which must be of tick `tick`.
    pub(crate) fn read_line(line: &str, tick: u64) -> Result<Self, String> {
        let fields: Vec<&str> = line.trim_end().split(',').map(str::trim).collect();
        let [number, start, end, east, north] = fields.as_slice() else {
            return Err(format!("{} fields where there must be 5", fields.len()));
        };
        let integer = |name: &str, text: &str| {
            text.parse::<u64>()
                .map_err(|_| format!("{name} is \"{text}\", not a whole number"))
        };
        let metres = |name: &str, text: &str| match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("{name} is \"{text}\", not a finite number")),
        };
        let found = integer("tick", number)?;
        if found != tick {
            return Err(format!("tick {found} where tick {tick} must be"));
        }
        let position = match (*east, *north) {
            ("", "") => None,
            (east, north) => Some([metres("east_m", east)?, metres("north_m", north)?]),
        };
        Ok(Self {
            tick,
            start_us: integer("start_us", start)?,
            end_us: integer("end_us", end)?,
            position,
        })
    }
}

/// Reads the whole file.
///
/// # Errors
/// [`StoreError::Damaged`] with the line at fault.
pub(crate) fn read(file: &Path) -> Result<Vec<TickRecord>, StoreError> {
    let text = std::fs::read(file).map_err(StoreError::io("read", file))?;
    let text =
        String::from_utf8(text).map_err(|_| StoreError::damaged(file, "it holds bytes that are not text"))?;
    let mut lines = text.lines();
    if lines.next().map(str::trim_end) != Some(HEADER.trim_end()) {
        let reason = format!("its first line must be \"{}\"", HEADER.trim_end());
        return Err(StoreError::damaged(file, reason));
    }
    lines
        .zip(0..)
        .map(|(line, tick)| {
            TickRecord::read_line(line, tick)
                .map_err(|reason| StoreError::damaged(file, format!("line {}: {reason}", tick + 2)))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn lines_are_read_as_written(tick: u64, start_us: u64, end_us: u64, position: Option<[f64; 2]>) {
            let finite = |p: &[f64; 2]| p.iter().all(|v| v.is_finite());
            let record = TickRecord { tick, start_us, end_us, position: position.filter(finite) };
            let mut line = String::new();
            record.write_line(&mut line);
            prop_assert_eq!(TickRecord::read_line(&line, tick), Ok(record));
        }
    }

    #[test]
    fn wrong_lines_are_refused_with_the_reason() {
        for (line, words) in [
            ("0,1,2,", "4 fields"),
            ("1,1,2,,", "tick 1 where tick 0"),
            ("0,x,2,,", "start_us is \"x\""),
            ("0,1,-2,,", "end_us is \"-2\""),
            ("0,1,2,3,", "north_m is \"\""),
            ("0,1,2,NaN,0", "east_m is \"NaN\""),
        ] {
            let message = TickRecord::read_line(line, 0).unwrap_err();
            assert!(message.contains(words), "{line}: {message}");
        }
    }

    #[test]
    fn files_name_the_line_at_fault() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("ticks.csv");
        std::fs::write(&file, format!("{HEADER}0,1,2,,\r\n1,2,3,4.5,6\n")).unwrap();
        let ticks = read(&file).unwrap();
        assert_eq!((ticks.len(), ticks[1].position), (2, Some([4.5, 6.0])));
        std::fs::write(&file, format!("{HEADER}0,1,2,,\n2,2,3,,\n")).unwrap();
        let message = read(&file).unwrap_err().to_string();
        assert!(message.contains("line 3: tick 2 where tick 1"), "{message}");
        std::fs::write(&file, "0,1,2,,\n").unwrap();
        assert!(read(&file).unwrap_err().to_string().contains("first line"));
    }
}
