//! The ellipsoid WGS 84 (NIMA TR8350.2, table 3.1), and earth-centred coordinates on it.

/// Semi-major axis, metres.
pub(super) const A: f64 = 6_378_137.0;
/// Flattening.
pub(super) const F: f64 = 1.0 / 298.257_223_563;

/// Earth-centred, earth-fixed coordinates in metres as latitude and longitude in degrees and height in metres. `None`
/// when they are further than 100 km from the ground.
///
/// Formulas: B. R. Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23 (1976),
/// repeated until it stands; EPSG guidance note 7-2, method 9602, gives the same and an example.
pub(super) fn geodetic([x, y, z]: [f64; 3]) -> Option<[f64; 3]> {
    let b = A * (1.0 - F);
    let e2 = F * (2.0 - F);
    let second_e2 = e2 / (1.0 - e2);
    let p = x.hypot(y);
    if !(b - 1e5..=A + 1e5).contains(&p.hypot(z)) {
        return None;
    }
    let mut reduced = (z * A).atan2(p * b);
    let mut latitude = 0.0f64;
    // At heights of cars and aeroplanes one step is right to 1e-11 rad; three are to the last digit.
    for _ in 0..3 {
        let (sin, cos) = reduced.sin_cos();
        latitude = (z + second_e2 * b * sin.powi(3)).atan2(p - e2 * A * cos.powi(3));
        reduced = ((1.0 - F) * latitude.sin()).atan2(latitude.cos());
    }
    let (sin, cos) = latitude.sin_cos();
    // This form holds at the poles too.
    let height = p * cos + z * sin - A * (1.0 - e2 * sin * sin).sqrt();
    Some([latitude.to_degrees(), y.atan2(x).to_degrees(), height])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The other way: EPSG guidance note 7-2, method 9602.
    fn earth_centred([latitude, longitude, height]: [f64; 3]) -> [f64; 3] {
        let (sin, cos) = latitude.to_radians().sin_cos();
        let e2 = F * (2.0 - F);
        let normal = A / (1.0 - e2 * sin * sin).sqrt();
        let (east, north) = longitude.to_radians().sin_cos();
        [
            (normal + height) * cos * north,
            (normal + height) * cos * east,
            ((1.0 - e2) * normal + height) * sin,
        ]
    }

    #[test]
    fn published_and_independent_values() {
        for (xyz, expected) in [
            // The example of EPSG guidance note 7-2: 53°48'33.820" N, 2°07'46.380" E, 73.0 m.
            (
                [3_771_793.968, 140_253.342, 5_124_304.349],
                [53.809_394_444_444, 2.129_55, 73.0],
            ),
            // PROJ 9.
            (
                [515_360.125_10, -4_698_142.574_10, 4_268_840.565_43],
                [42.28, -83.74, 260.0],
            ),
            (
                [-5_042_228.673_64, 2_574_688.829_49, -2_927_484.141_55],
                [-27.5, 152.95, 30.0],
            ),
            ([1_099.988_15, 193.957_59, 6_356_852.216_77], [89.99, 10.0, 100.0]),
            ([A, 0.0, 0.0], [0.0, 0.0, 0.0]),
            ([0.0, 0.0, -6_356_752.314_245], [-90.0, 0.0, 0.0]),
        ] {
            let found = geodetic(xyz).unwrap();
            for (found, (expected, within)) in found.iter().zip(expected.iter().zip([1e-8, 1e-7, 1e-3])) {
                assert!((found - expected).abs() < within, "{xyz:?}: {found} {expected}");
            }
        }
    }

    #[test]
    fn what_is_not_on_the_ground_is_refused() {
        for xyz in [
            [0.0; 3],
            [42.28, -83.74, 260.0],
            [1e9, 0.0, 0.0],
            [f64::NAN, 0.0, 0.0],
        ] {
            assert_eq!(geodetic(xyz), None);
        }
    }

    proptest! {
        #[test]
        fn there_and_back(latitude in -90.0..90.0f64, longitude in -180.0..180.0f64, height in -1e3..2e4f64) {
            let xyz = earth_centred([latitude, longitude, height]);
            let again = earth_centred(geodetic(xyz).unwrap());
            for (a, b) in xyz.iter().zip(again) {
                prop_assert!((a - b).abs() < 1e-6, "{:?} {:?}", xyz, again);
            }
        }
    }
}
