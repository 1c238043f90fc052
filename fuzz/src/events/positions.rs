//! Files of positions, read as what they look like and as what they are said to be; lists of pixels.

use super::Written;
use evpr_core::plan::{Crop, PositionCompat, PositionKind, Positions, Sensor};
use evpr_events::{Trajectory, positions, read_pixel_list};

/// Sentences of a GNSS receiver. With the day given, as a file without one needs it.
pub fn nmea(data: &[u8]) {
    read(data, "nmea", &[PositionKind::Auto, PositionKind::Nmea]);
}

/// Columns of text.
pub fn positions_csv(data: &[u8]) {
    read(data, "csv", &[PositionKind::Auto, PositionKind::Csv]);
}

/// NSAVP's poses, in HDF5.
pub fn applanix(data: &[u8]) {
    read(data, "h5", &[PositionKind::Auto, PositionKind::Applanix]);
}

/// A list of pixels.
pub fn pixels(data: &[u8]) {
    let file = Written::new(data, "txt");
    let (height, width) = (260, 346);
    match read_pixel_list(&file.0, Sensor { height, width }) {
        Ok(pixels) => {
            assert!(
                pixels
                    .iter()
                    .all(|p| usize::from(p.x) < width && usize::from(p.y) < height)
            );
            assert!(pixels.is_sorted_by(|a, b| (a.y, a.x) < (b.y, b.x)));
        }
        Err(e) => assert!(
            e.errors
                .iter()
                .all(|e| !e.to_string().contains(['\n', '\r', '\u{1b}']))
        ),
    }
}

fn read(data: &[u8], extension: &str, kinds: &[PositionKind]) {
    let file = Written::new(data, extension);
    for &kind in kinds {
        for (crop, compat, date) in [
            (Crop::None, PositionCompat::None, None),
            (Crop::FirstLoop, PositionCompat::None, Some(18_373)),
            (Crop::FirstMotion, PositionCompat::Paper, Some(18_373)),
        ] {
            let options = Positions {
                kind,
                crop,
                compat,
                date,
                ..Positions::file(&file.0)
            };
            track(&options);
        }
    }
}

fn track(options: &Positions) {
    match positions::open(options) {
        Ok((mut track, info)) => {
            let all = track.positions();
            assert!(!all.is_empty() && all.len() == info.positions && info.first_ns <= info.last_ns);
            assert!(all.is_sorted_by_key(|p| p.t_ns));
            for t_ns in [info.first_ns, info.first_ns.midpoint(info.last_ns), info.last_ns] {
                let place = track.position(t_ns.max(0).cast_unsigned());
                assert!(place.is_none_or(|place| place.iter().all(|metres| metres.is_finite())));
            }
        }
        Err(e) => assert!(!e.to_string().contains('\n'), "{e}"),
    }
}
