//! Files of positions of every kind, good and bad, through the public interface.
#![allow(clippy::unwrap_used)] // helpers of tests are not seen as tests

use evpr_core::plan::{Crop, PositionClock, PositionCompat, PositionKind, Positions, UtmZone};
use evpr_events::Trajectory;
use evpr_events::positions::{Track, TrackInfo, open};
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> Positions {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    Positions::file(folder.join(name))
}

/// A file with this text in a folder that is kept.
struct Written {
    _folder: tempfile::TempDir,
    options: Positions,
}

fn written(name: &str, text: &str) -> Written {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    Written {
        _folder: folder,
        options: Positions::file(path),
    }
}

fn read(options: &Positions) -> (Track, TrackInfo) {
    open(options).unwrap()
}

fn refused(options: &Positions) -> String {
    let error = open(options).unwrap_err().to_string();
    assert_eq!(error.lines().count(), 1, "{error}");
    assert!(error.starts_with(&options.path.display().to_string()), "{error}");
    error
}

fn near(found: Option<[f64; 2]>, expected: [f64; 2]) {
    let found = found.unwrap();
    assert!(
        std::iter::zip(found, expected).all(|(a, b)| (a - b).abs() < 1e-3),
        "{found:?} {expected:?}"
    );
}

/// Pose 0 and the distance between poses, ns.
const FIRST_NS: u64 = 1_658_700_000_000_000_000;
const STEP_NS: u64 = 5_000_000;
const POSE_0: (u64, [f64; 2]) = (0, [274_068.920_67, 4_684_500.906_99]);
const POSE_100: (u64, [f64; 2]) = (100, [273_907.573_41, 4_684_617.265_61]);
const POSE_299: (u64, [f64; 2]) = (299, [273_586.508_02, 4_684_848.830_94]);
/// Earth-centred x and y of pose 100.
const XY_100: [f64; 2] = [515_187.982_41, -4_698_086.273_55];

#[test]
fn poses_become_metres_of_utm() {
    let (mut track, info) = read(&fixture("poses.h5"));
    assert_eq!(
        (info.format, info.positions, info.zone.as_deref()),
        ("HDF5 (NSAVP poses)", 300, Some("17N"))
    );
    // By pyproj, EPSG:32617, from the latitudes and longitudes that the poses were made of.
    for (pose, place) in [POSE_0, POSE_100, POSE_299] {
        near(track.position(FIRST_NS + pose * STEP_NS), place);
    }
    // Half-way between two poses.
    let [a, b] = [100, 101].map(|i| track.position(FIRST_NS + i * STEP_NS).unwrap());
    near(
        track.position(FIRST_NS + 100 * STEP_NS + STEP_NS / 2),
        [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0],
    );
    assert_eq!(track.position(FIRST_NS - 1), None);
    assert_eq!(track.position(FIRST_NS + 299 * STEP_NS + 1), None);
    assert!((info.length_m - 595.0).abs() < 1.0, "{}", info.length_m);
}

#[test]
fn as_in_the_paper_poses_stay_earth_centred() {
    let options = Positions {
        compat: PositionCompat::Paper,
        ..fixture("poses.h5")
    };
    let (mut track, info) = read(&options);
    assert_eq!(info.zone, None);
    near(track.position(FIRST_NS + 100 * STEP_NS), XY_100);
}

#[test]
fn a_drive_north_and_south_of_the_equator_has_one_frame_when_the_zone_is_given() {
    let text = "lat,lon,t\n-0.0001,2.99999,10\n0.0001,3.0,11\n";
    let file = written("equator.csv", text);
    let north = Positions {
        zone: Some(UtmZone {
            number: 31,
            south: false,
        }),
        ..file.options.clone()
    };
    let (track, info) = read(&north);
    assert_eq!(info.zone.as_deref(), Some("31N"));
    assert!(track.positions()[0].place[1] < 0.0 && track.positions()[1].place[1] > 0.0);
    let (track, info) = read(&file.options);
    assert_eq!(info.zone.as_deref(), Some("31S"));
    assert!((track.positions()[1].place[1] - 10_000_011.05).abs() < 0.01);
}

const DRIVE: &str = "lat,lon,t\n-27.5,152.95,100.5\n-27.5001,152.95,101.5\n-27.5002,152.95,102.5\n";

#[test]
fn the_clock_is_shifted_as_asked() {
    let file = written("drive.csv", DRIVE);
    let first = |clock| {
        let options = Positions {
            clock,
            ..file.options.clone()
        };
        open(&options).map(|(_, info)| info.first_ns)
    };
    assert_eq!(first(PositionClock::Offset(0)).unwrap(), 100_500_000_000);
    assert_eq!(
        first(PositionClock::Offset(-101_000_000_000)).unwrap(),
        -500_000_000
    );
    assert_eq!(first(PositionClock::FirstAt(7)).unwrap(), 7);
    let error = first(PositionClock::Offset(i64::MAX)).unwrap_err().to_string();
    assert!(error.contains("beyond the year 2262"), "{error}");
}

#[test]
fn the_first_record_counts_for_the_clock_even_without_a_fix() {
    let text = "$GPRMC,100000,V,,,,,,,210420,,\n$GPRMC,100003,A,2730.000,S,15257.000,E,,,210420,,\n";
    let file = written("drive.nmea", text);
    let options = Positions {
        clock: PositionClock::FirstAt(1_587_452_582_350_000_000),
        ..file.options.clone()
    };
    let (track, info) = read(&options);
    assert_eq!(
        (info.format, info.first_ns),
        ("NMEA 0183", 1_587_452_585_350_000_000)
    );
    near(track.at(info.first_ns), [495_061.368_99, 6_958_182.188_92]);
    // 2020-04-21 10:00:03 UTC.
    assert_eq!(read(&file.options).1.first_ns, 1_587_463_203_000_000_000);
}

#[test]
fn kinds_are_known_by_content_or_as_asked() {
    let file = written("drive.txt", "-27.5 152.95 1\n-27.5 152.96 2\n");
    assert_eq!(read(&file.options).1.format, "CSV");
    let nmea = Positions {
        kind: PositionKind::Nmea,
        ..file.options.clone()
    };
    assert!(refused(&nmea).contains("no valid position (2 lines are broken)"));
    let applanix = Positions {
        kind: PositionKind::Applanix,
        ..file.options.clone()
    };
    assert!(refused(&applanix).contains("HDF5 structure"));
}

#[test]
fn gaps_are_not_bridged_but_in_the_paper() {
    let file = written("gap.csv", "east,north,t\n0,0,0\n10,0,1\n100,0,10\n");
    let (track, _) = read(&file.options);
    assert_eq!(
        (track.at(500_000_000), track.at(5_000_000_000)),
        (Some([5.0, 0.0]), None)
    );
    let long = Positions {
        max_gap_ns: 9_000_000_000,
        ..file.options.clone()
    };
    assert_eq!(read(&long).0.at(5_500_000_000), Some([55.0, 0.0]));
    let paper = Positions {
        compat: PositionCompat::Paper,
        ..file.options.clone()
    };
    assert_eq!(read(&paper).0.at(5_500_000_000), Some([55.0, 0.0]));
}

#[test]
fn what_is_cropped_is_not_known() {
    let mut text = "east,north,t\n".to_owned();
    for i in 0..80 {
        // 20 m apart on a square of 300 m a side, after 5 positions on the way to it.
        let (side, along) = ((i - 5) / 15 % 4, f64::from((i - 5) % 15) * 20.0);
        let [x, y] = match (i, side) {
            (0..5, _) => [-20.0 * f64::from(5 - i), 0.0],
            (_, 0) => [along, 0.0],
            (_, 1) => [300.0, along],
            (_, 2) => [300.0 - along, 300.0],
            _ => [0.0, 300.0 - along],
        };
        text += &format!("{x},{y},{i}\n");
    }
    let file = written("square.csv", &text);
    let options = Positions {
        crop: Crop::FirstLoop,
        ..file.options.clone()
    };
    let (track, info) = read(&options);
    assert_eq!(
        (info.first_ns, info.last_ns, info.positions),
        (5_000_000_000, 65_000_000_000, 61)
    );
    assert_eq!(track.at(4_500_000_000), None);
    assert!((info.length_m - 1200.0).abs() < 1e-9);
    let straight = Positions {
        crop: Crop::FirstLoop,
        ..fixture("poses.h5")
    };
    assert!(refused(&straight).contains("has no loop"));
}

#[test]
fn bad_files_are_refused_in_one_line() {
    for (name, text, words) in [
        ("empty.csv", "", "is empty (0 bytes)"),
        ("header.csv", "lat,lon,t\n", "holds no valid position"),
        ("pole.csv", "lat,lon,t\n89,0,0\n", "outside of UTM"),
        (
            "back.csv",
            "lat,lon,t\n1,2,9\n1,2,8\n1,2,7\n",
            "times go back 2 times in 3 positions",
        ),
        (
            "sentences.nmea",
            "$GPGSV,3,1,11\n$GPGSV,3,2,11\n",
            "holds no valid position",
        ),
        (
            "time_only.nmea",
            "$GPGGA,100003,2730.0,S,15257.0,E,1\n",
            "no date",
        ),
        ("binary.csv", "\0\u{1}\u{2}\n", "line 1"),
    ] {
        let file = written(name, text);
        let error = refused(&file.options);
        assert!(error.contains(words), "{name}: {error}");
    }
    for (name, words) in [
        ("valid.h5", "has no group /pose_base_link"),
        ("poses_unequal_lengths.h5", "[299] and positions [300, 3]"),
        ("poses_not_on_earth.h5", "pose 299 (from 0) is at"),
        ("no_such_file.nmea", "there is no such file"),
    ] {
        let error = refused(&fixture(name));
        assert!(error.contains(words), "{name}: {error}");
    }
    let elsewhere = Positions {
        zone: Some(UtmZone {
            number: 56,
            south: true,
        }),
        ..fixture("poses.h5")
    };
    assert!(refused(&elsewhere).contains("too far from UTM zone 56S"));
    let folder = Positions::file(PathBuf::from(env!("CARGO_MANIFEST_DIR")));
    assert!(refused(&folder).contains("is a directory"));
}

#[test]
fn every_truncation_and_many_damages_of_poses_are_errors_or_whole() {
    let whole = std::fs::read(&fixture("poses.h5").path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let options = Positions::file(folder.path().join("poses.h5"));
    for cut in (0..whole.len()).step_by(97) {
        std::fs::write(&options.path, &whole[..cut]).unwrap();
        let _ = open(&options).map(|(_, info)| assert_eq!(info.positions, 300));
        let mut damaged = whole.clone();
        damaged[cut] ^= 0x5a;
        std::fs::write(&options.path, damaged).unwrap();
        let _ = open(&options);
    }
}
