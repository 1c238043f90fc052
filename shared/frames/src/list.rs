//! A list of images: `file,t,east_m,north_m`.

use crate::folder::position_of_name;
use crate::{Entry, FrameError, MAX_LIST_BYTES};
use evpr_core::plan::TimeUnit;
use std::io::Read;
use std::path::Path;

/// Latest time, ns: 63 bits.
const MAX_TIME_NS: u64 = i64::MAX as u64;

/// Where each column stands.
struct Columns {
    count: usize,
    file: usize,
    t: Option<usize>,
    position: Option<[usize; 2]>,
}

/// The images of a list, in its order. Times are in this unit; [`TimeUnit::Auto`] means seconds.
///
/// # Errors
/// When it cannot be read, is empty, or a line is not as it should be.
pub(crate) fn read(list: &Path, unit: TimeUnit) -> Result<Vec<Entry>, FrameError> {
    let file = std::fs::File::open(list).map_err(|e| FrameError::read(list, e))?;
    let mut text = String::new();
    file.take(MAX_LIST_BYTES as u64 + 1)
        .read_to_string(&mut text)
        .map_err(|e| FrameError::read(list, e))?;
    if text.len() > MAX_LIST_BYTES {
        let what = format!("is longer than {MAX_LIST_BYTES} bytes; split it");
        return Err(FrameError::new(list, what));
    }
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate();
    let Some((_, first)) = lines.next() else {
        return Err(FrameError::new(
            list,
            "is empty; write a line file,t and a line per frame below",
        ));
    };
    let columns = columns(first).map_err(|what| FrameError::new(list, format!("line 1: {what}")))?;
    let folder = list.parent().unwrap_or(Path::new(""));
    let mut entries: Vec<Entry> = Vec::new();
    let mut bytes = 0usize;
    for (number, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let wrong = |what: String| FrameError::new(list, format!("line {}: {what}", number + 1));
        let mut entry = entry(line, &columns, folder, unit).map_err(wrong)?;
        bytes += entry.path.as_os_str().len() + size_of::<Entry>();
        if bytes > MAX_LIST_BYTES {
            return Err(wrong(format!(
                "more frames than fit {MAX_LIST_BYTES} bytes; split the list"
            )));
        }
        if columns.position.is_none() {
            entry.position = position_of_name(&entry.path)?;
        }
        // Ticks are in whole µs.
        if let (Some(t), Some(Some(before))) = (entry.t_ns, entries.last().map(|e| e.t_ns))
            && t / 1_000 <= before / 1_000
        {
            return Err(wrong(
                "t is not later than in the line before, by 1 µs at least; sort the list".to_owned(),
            ));
        }
        entries.push(entry);
    }
    if entries.is_empty() {
        return Err(FrameError::new(
            list,
            "names no frames; write a line for each below the first",
        ));
    }
    Ok(entries)
}

fn columns(line: &str) -> Result<Columns, String> {
    const HELP: &str = "write file, or file,t or file,t,east_m,north_m";
    let names: Vec<&str> = line.split(',').map(str::trim).collect();
    let place = |name: &str| names.iter().position(|n| *n == name);
    let known = ["file", "t", "east_m", "north_m"];
    for (i, name) in names.iter().enumerate() {
        if !known.contains(name) {
            return Err(format!(
                "there is no column \"{}\"; {HELP}",
                name.escape_default()
            ));
        }
        if names[..i].contains(name) {
            return Err(format!("column \"{name}\" is there twice; {HELP}"));
        }
    }
    let position = match (place("east_m"), place("north_m")) {
        (Some(east), Some(north)) => Some([east, north]),
        (None, None) => None,
        _ => {
            return Err(format!(
                "of a position both columns are needed, east_m and north_m; {HELP}"
            ));
        }
    };
    Ok(Columns {
        count: names.len(),
        file: place("file").ok_or_else(|| format!("there is no column file; {HELP}"))?,
        t: place("t"),
        position,
    })
}

fn entry(line: &str, columns: &Columns, folder: &Path, unit: TimeUnit) -> Result<Entry, String> {
    if line.contains('"') {
        return Err("fields in quotes are not read; write them without".to_owned());
    }
    let fields: Vec<&str> = line.split(',').map(str::trim).collect();
    if fields.len() != columns.count {
        return Err(format!(
            "there are {} fields, not {}",
            fields.len(),
            columns.count
        ));
    }
    let file = fields[columns.file];
    if file.is_empty() || file.contains('\0') {
        return Err("the name of the file is missing".to_owned());
    }
    let t_ns = match columns.t {
        Some(t) => Some(parse_ns(fields[t], unit).ok_or_else(|| {
            format!(
                "t is \"{}\"; write a time of at least 0 as a decimal number, in seconds unless source.time_unit says \
                 otherwise",
                fields[t].escape_default()
            )
        })?),
        None => None,
    };
    let number = |text: &str| text.parse::<f64>().ok().filter(|v| v.is_finite());
    let position = match columns.position.map(|at| at.map(|i| fields[i])) {
        None | Some(["", ""]) => None,
        Some([east, north]) => match (number(east), number(north)) {
            (Some(east), Some(north)) => Some([east, north]),
            _ => {
                return Err(
                    "east_m and north_m are not two numbers; write metres, or leave both empty".to_owned(),
                );
            }
        },
    };
    Ok(Entry {
        path: folder.join(file),
        t_ns,
        position,
    })
}

/// Reads a decimal exactly, in a unit; what is finer than a nanosecond is cut off.
fn parse_ns(text: &str, unit: TimeUnit) -> Option<u64> {
    let digits = match unit {
        TimeUnit::Auto | TimeUnit::S => 9,
        TimeUnit::Ms => 6,
        TimeUnit::Us => 3,
        TimeUnit::Ns => 0,
    };
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let all_digits = |t: &str| t.bytes().all(|b| b.is_ascii_digit());
    if whole.len() + fraction.len() == 0 || !all_digits(whole) || !all_digits(fraction) {
        return None;
    }
    let mut ns = match whole {
        "" => 0,
        whole => whole.parse::<u64>().ok()?.checked_mul(10u64.pow(digits))?,
    };
    for (digit, power) in fraction.bytes().zip((0..digits).rev()) {
        ns = ns.checked_add(u64::from(digit - b'0') * 10u64.pow(power))?;
    }
    (ns <= MAX_TIME_NS).then_some(ns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn listed(text: &str) -> Result<Vec<Entry>, String> {
        let folder = tempfile::tempdir().unwrap();
        let list = folder.path().join("l.csv");
        std::fs::write(&list, text).unwrap();
        read(&list, TimeUnit::Auto).map_err(|e| e.to_string())
    }

    #[test]
    fn columns_are_found_by_name() {
        let entries = listed("t,file,north_m,east_m\n0.5,a.png,2,1\r\n\n 1.25 , b/c.png ,,\n").unwrap();
        let got: Vec<_> = entries.iter().map(|e| (e.t_ns, e.position)).collect();
        assert_eq!(
            got,
            [(Some(500_000_000), Some([1.0, 2.0])), (Some(1_250_000_000), None)]
        );
        assert!(entries[1].path.ends_with("b/c.png"));
        let entries = listed("file\n@3@4@.png\n").unwrap();
        assert_eq!((entries[0].t_ns, entries[0].position), (None, Some([3.0, 4.0])));
    }

    #[test]
    fn a_bad_line_is_named() {
        for (text, what) in [
            ("", "is empty"),
            ("file,t\n", "names no frames"),
            ("name,t\na,1\n", "line 1: there is no column \"name\""),
            ("t\n1\n", "line 1: there is no column file"),
            ("file,file\na,b\n", "line 1: column \"file\" is there twice"),
            ("file,east_m\na,1\n", "line 1: of a position both"),
            ("file,t\na.png\n", "line 2: there are 1 fields, not 2"),
            ("file,t\n,1\n", "line 2: the name of the file is missing"),
            ("file,t\na,-1\n", "line 2: t is \"-1\""),
            ("file,t\na,1587452582350\n", "line 2: t is \"1587452582350\""),
            ("file,t\n\"a\",1\n", "line 2: fields in quotes"),
            ("file,t\na,1\n\nb,1.0000009\n", "line 4: t is not later"),
            ("file,t,east_m,north_m\na,1,2,\n", "line 2: east_m and north_m"),
            ("file,t,east_m,north_m\na,1,2,inf\n", "line 2: east_m and north_m"),
            ("file\n@1.png\n", "@easting@northing@"),
        ] {
            let error = listed(text).unwrap_err();
            assert!(error.contains(what), "{text:?}: {error}");
        }
    }

    #[test]
    fn times_are_read_exactly() {
        assert_eq!(
            parse_ns("1587452582.350000123", TimeUnit::S),
            Some(1_587_452_582_350_000_123)
        );
        assert_eq!(parse_ns(".5", TimeUnit::Ms), Some(500_000));
        assert_eq!(parse_ns("7.9", TimeUnit::Ns), Some(7));
        for bad in [
            "",
            ".",
            "1e3",
            "+1",
            "9223372036.854775808",
            "99999999999999999999",
        ] {
            assert_eq!(parse_ns(bad, TimeUnit::Auto), None, "{bad}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_text_is_taken_without_a_panic(text in "\\PC{0,40}", line in "[a-z0-9,.@\"-]{0,30}") {
            let _ = listed(&format!("{text}\n{line}"));
            let _ = listed(&format!("file,t,east_m,north_m\n{line}\n{text}"));
        }
    }
}
