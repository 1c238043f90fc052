//! Latitude and longitude as metres east and north: the Universal Transverse Mercator projection on WGS 84.
//!
//! Krüger's series to the sixth order in the third flattening, as given by C. F. F. Karney, "Transverse Mercator with an
//! accuracy of a few nanometers", Journal of Geodesy 85 (2011), equations 7 to 11 and 35: within 5 nm anywhere near a
//! zone. Scale, false easting and northing are those of UTM (NGA.SIG.0012).

use super::wgs84::{A, F};
use evpr_core::plan::UtmZone;

/// Scale on the central meridian.
const SCALE: f64 = 0.9996;
const FALSE_EASTING_M: f64 = 500_000.0;
const FALSE_NORTHING_M: f64 = 10_000_000.0;
/// Latitudes that UTM is for, degrees.
const LATITUDES: std::ops::RangeInclusive<f64> = -80.0..=84.0;
/// Furthest from the central meridian that a given zone is taken for, degrees.
const FURTHEST_DEG: f64 = 15.0;

/// Third flattening and the factors of Krüger's series.
const N: f64 = F / (2.0 - F);
const ALPHA: [f64; 6] = {
    let (n2, n3) = (N * N, N * N * N);
    let (n4, n5, n6) = (n2 * n2, n2 * n3, n3 * n3);
    [
        N / 2.0 - n2 * 2.0 / 3.0 + n3 * 5.0 / 16.0 + n4 * 41.0 / 180.0 - n5 * 127.0 / 288.0
            + n6 * 7_891.0 / 37_800.0,
        n2 * 13.0 / 48.0 - n3 * 3.0 / 5.0 + n4 * 557.0 / 1_440.0 + n5 * 281.0 / 630.0
            - n6 * 1_983_433.0 / 1_935_360.0,
        n3 * 61.0 / 240.0 - n4 * 103.0 / 140.0 + n5 * 15_061.0 / 26_880.0 + n6 * 167_603.0 / 181_440.0,
        n4 * 49_561.0 / 161_280.0 - n5 * 179.0 / 168.0 + n6 * 6_601_661.0 / 7_257_600.0,
        n5 * 34_729.0 / 80_640.0 - n6 * 3_418_889.0 / 1_995_840.0,
        n6 * 212_378_941.0 / 319_334_400.0,
    ]
};
/// The meridian's radius: Karney's A, metres.
const RADIUS_M: f64 =
    A / (1.0 + N) * (1.0 + N * N / 4.0 + N * N * N * N / 64.0 + N * N * N * N * N * N / 256.0);

/// The zone of a point: six degrees each from 180° west, without the exceptions around Norway and Svalbard, as the
/// authors' code has it. `None` outside the latitudes of UTM.
pub(super) fn zone_of(latitude: f64, longitude: f64) -> Option<UtmZone> {
    if !LATITUDES.contains(&latitude) || !(-180.0..=180.0).contains(&longitude) {
        return None;
    }
    let number = ((longitude + 180.0) / 6.0).floor() as u8 + 1;
    Some(UtmZone {
        number: number.min(60),
        south: latitude < 0.0,
    })
}

/// Metres east and north in this zone. `None` outside the latitudes of UTM and further than 15° from the zone's middle.
pub(super) fn project(latitude: f64, longitude: f64, zone: UtmZone) -> Option<[f64; 2]> {
    let middle = f64::from(zone.number) * 6.0 - 183.0;
    // Shortest way round the globe.
    let away = (longitude - middle + 540.0).rem_euclid(360.0) - 180.0;
    if !LATITUDES.contains(&latitude) || away.abs() > FURTHEST_DEG || !longitude.is_finite() {
        return None;
    }
    let (sin_away, cos_away) = away.to_radians().sin_cos();
    let tau = latitude.to_radians().tan();
    let e = (F * (2.0 - F)).sqrt();
    let secant = 1.0f64.hypot(tau);
    let sigma = (e * (e * tau / secant).atanh()).sinh();
    let conformal = tau * 1.0f64.hypot(sigma) - sigma * secant;
    let xi = conformal.atan2(cos_away);
    let eta = (sin_away / conformal.hypot(cos_away)).asinh();
    let (mut north, mut east) = (xi, eta);
    for (alpha, j) in ALPHA.iter().zip(1..) {
        let times = f64::from(2 * j);
        north += alpha * (times * xi).sin() * (times * eta).cosh();
        east += alpha * (times * xi).cos() * (times * eta).sinh();
    }
    let northing = if zone.south { FALSE_NORTHING_M } else { 0.0 };
    Some([
        FALSE_EASTING_M + SCALE * RADIUS_M * east,
        northing + SCALE * RADIUS_M * north,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn zone(number: u8, south: bool) -> UtmZone {
        UtmZone { number, south }
    }

    /// From PROJ 9 (pyproj 3.7, EPSG 326xx and 327xx), rounded to 0.01 mm.
    const GOLDEN: [(f64, f64, UtmZone, f64, f64); 11] = [
        (-27.5, 152.95, zone(56, true), 495_061.368_99, 6_958_182.188_92),
        (
            -27.4977,
            152.9993,
            zone(56, true),
            499_930.857_73,
            6_958_437.948_05,
        ),
        (42.28, -83.74, zone(17, false), 274_068.920_67, 4_684_500.906_99),
        (
            43.642_566_666_7,
            -79.387_138_888_9,
            zone(17, false),
            630_084.310_51,
            4_833_438.548_83,
        ),
        (0.0, 3.0, zone(31, false), 500_000.0, 0.0),
        (-0.001, -179.9999, zone(1, true), 166_032.586, 9_999_889.317_25),
        (83.9, 177.1, zone(60, false), 501_186.385_21, 9_316_931.183_52),
        (-79.9, -69.5, zone(19, true), 490_211.344_69, 1_129_533.628_41),
        (42.28, -84.2, zone(17, false), 236_135.369_21, 4_685_824.967_91),
        (51.0, 12.5, zone(32, false), 745_561.908_96, 5_655_656.949_68),
        (60.0, 2.0, zone(32, false), 110_043.298_69, 6_672_079.494_15),
    ];

    #[test]
    fn agrees_with_an_independent_implementation() {
        for (latitude, longitude, zone, east, north) in GOLDEN {
            let [e, n] = project(latitude, longitude, zone).unwrap();
            assert!(
                (e - east).abs() < 1e-4 && (n - north).abs() < 1e-4,
                "{latitude} {longitude}: {e} {n}"
            );
        }
    }

    #[test]
    fn agrees_with_a_published_value() {
        // The CN Tower, 43°38'33.24" N, 79°23'13.7" W, is at 17N 630084 m E, 4833438 m N
        // (https://en.wikipedia.org/wiki/Universal_Transverse_Mercator_coordinate_system).
        let (latitude, longitude) = (
            43.0 + 38.0 / 60.0 + 33.24 / 3600.0,
            -(79.0 + 23.0 / 60.0 + 13.7 / 3600.0),
        );
        let zone = zone_of(latitude, longitude).unwrap();
        assert_eq!(zone.to_string(), "17N");
        let [east, north] = project(latitude, longitude, zone).unwrap();
        assert_eq!((east.trunc(), north.trunc()), (630_084.0, 4_833_438.0));
    }

    #[test]
    fn zones_are_six_degrees() {
        for (longitude, number) in [
            (-180.0, 1),
            (-174.1, 1),
            (-174.0, 2),
            (0.0, 31),
            (179.9, 60),
            (180.0, 60),
        ] {
            assert_eq!(zone_of(10.0, longitude).unwrap().number, number, "{longitude}");
        }
        assert!(zone_of(-27.5, 153.0).unwrap().south);
        assert_eq!(zone_of(85.0, 0.0), None);
        assert_eq!(zone_of(0.0, f64::NAN), None);
    }

    #[test]
    fn points_far_from_the_zone_are_refused() {
        assert_eq!(project(-27.5, 153.0, zone(17, false)), None);
        assert!(
            project(10.0, 179.9, zone(1, false)).is_some(),
            "next to it, round the globe"
        );
        assert_eq!(project(f64::NAN, 3.0, zone(31, false)), None);
    }
}
