//! A folder of images: which files, in which order, and where they were taken.

use crate::{Entry, FrameError, MAX_LIST_BYTES};
use std::cmp::Ordering;
use std::path::Path;

/// Endings of the files that are frames, in lower case.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The images of a folder, in the order of their names.
///
/// # Errors
/// When it cannot be read, has no images, or a name that begins with `@` gives no position.
pub(crate) fn read(folder: &Path) -> Result<Vec<Entry>, FrameError> {
    let mut files = Vec::new();
    let mut bytes = 0usize;
    for entry in std::fs::read_dir(folder).map_err(|e| FrameError::read(folder, e))? {
        let entry = entry.map_err(|e| FrameError::read(folder, e))?;
        let path = entry.path();
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if !ending.is_some_and(|e| ENDINGS.contains(&e.as_str())) || path.is_dir() {
            continue;
        }
        bytes += path.as_os_str().len() + size_of::<Entry>();
        if bytes > MAX_LIST_BYTES {
            let what = format!("holds more files than fit {MAX_LIST_BYTES} bytes of names; split it");
            return Err(FrameError::new(folder, what));
        }
        let position = position_of_name(&path)?;
        files.push(Entry {
            path,
            t_ns: None,
            position,
        });
    }
    if files.is_empty() {
        let what = "holds no PNG or JPEG files (.png, .jpg, .jpeg); name the folder that has them";
        return Err(FrameError::new(folder, what));
    }
    files.sort_by(|a, b| natural(name(&a.path).as_bytes(), name(&b.path).as_bytes()));
    Ok(files)
}

fn name(path: &Path) -> std::borrow::Cow<'_, str> {
    path.file_name().unwrap_or_default().to_string_lossy()
}

/// The position in a name `@easting@northing@…`, metres; none in any other name.
pub(crate) fn position_of_name(path: &Path) -> Result<Option<[f64; 2]>, FrameError> {
    let name = name(path);
    let Some(fields) = name.strip_prefix('@') else {
        return Ok(None);
    };
    let mut fields = fields.split('@');
    let mut number = || fields.next()?.parse::<f64>().ok().filter(|v| v.is_finite());
    match (number(), number()) {
        (Some(east), Some(north)) => Ok(Some([east, north])),
        _ => {
            let what = "has a name that begins with @ but not as @easting@northing@ in metres; rename it";
            Err(FrameError::new(path, what))
        }
    }
}

/// Compares names with runs of digits as numbers; names equal in that are compared by byte.
fn natural(a: &[u8], b: &[u8]) -> Ordering {
    let (mut x, mut y) = (a, b);
    loop {
        match (x, y) {
            ([], []) => return a.cmp(b),
            ([], _) => return Ordering::Less,
            (_, []) => return Ordering::Greater,
            ([p, ..], [q, ..]) if p.is_ascii_digit() && q.is_ascii_digit() => {
                let (m, n);
                (m, x) = digits(x);
                (n, y) = digits(y);
                match m.len().cmp(&n.len()).then(m.cmp(n)) {
                    Ordering::Equal => {}
                    other => return other,
                }
            }
            ([p, rest @ ..], [q, others @ ..]) => match p.cmp(q) {
                Ordering::Equal => (x, y) = (rest, others),
                other => return other,
            },
        }
    }
}

/// The run of digits at the start, without leading zeros, and the rest.
fn digits(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text
        .iter()
        .position(|c| !c.is_ascii_digit())
        .unwrap_or(text.len());
    let (run, rest) = text.split_at(end);
    let zeros = run.iter().position(|c| *c != b'0').unwrap_or(run.len());
    (&run[zeros..], rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_count_as_numbers() {
        let mut names = [
            "f10.png", "f9.png", "g1.png", "f9b.png", "f009.png", "f.png", "F1.png",
        ];
        names.sort_by(|a, b| natural(a.as_bytes(), b.as_bytes()));
        assert_eq!(
            names,
            [
                "F1.png", "f.png", "f009.png", "f9.png", "f9b.png", "f10.png", "g1.png"
            ]
        );
    }

    #[test]
    fn names_give_positions() {
        let position = |name: &str| position_of_name(Path::new(name));
        assert_eq!(
            position("/a/@0543256.96@4178906.70@10@S@37.7@-122.5@pano@@@@@@201311@@.jpg"),
            Ok(Some([543_256.96, 4_178_906.7]))
        );
        assert_eq!(position("@-3@5e2@.png"), Ok(Some([-3.0, 500.0])));
        assert_eq!(position("a@1@2@.png"), Ok(None));
        for bad in ["@1@.png", "@x@2@.png", "@nan@2@.png", "@.png", "@1@inf@.png"] {
            assert!(
                position(bad)
                    .unwrap_err()
                    .to_string()
                    .contains("@easting@northing@"),
                "{bad}"
            );
        }
    }
}
