//! Mean, standard deviation and length.

/// Values whose range is below this part of the largest are equal but for rounding.
const ROUNDING: f64 = 1e-11;

/// Shifts and scales the values at these indices to mean 0 and standard deviation 1:
/// `(v − mean) / (population std + 1e-6)`.
///
/// Where all values are equal the result is 0, as in exact arithmetic; the rounding errors of a resize would else be
/// blown up into a row of noise.
pub(crate) fn standardise(values: &mut [f64], indices: impl Iterator<Item = usize> + Clone) {
    let (mut count, mut sum) = (0.0, 0.0);
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for i in indices.clone() {
        let v = values[i];
        count += 1.0;
        sum += v;
        least = least.min(v);
        most = most.max(v);
    }
    let mean = sum / count;
    if most - least <= ROUNDING * most.abs().max(least.abs()) {
        indices.for_each(|i| values[i] = 0.0);
        return;
    }
    let squares: f64 = indices.clone().map(|i| (values[i] - mean).powi(2)).sum();
    let scale = (squares / count).sqrt() + 1e-6;
    indices.for_each(|i| values[i] = (values[i] - mean) / scale);
}

/// Writes the values over their Euclidean length; all 0 where that is 1e-12 or less.
pub(crate) fn write_unit(values: &[f64], row: &mut [f32]) {
    let length = values.iter().map(|v| v * v).sum::<f64>().sqrt();
    let scale = if length > 1e-12 { length } else { f64::INFINITY };
    for (out, value) in row.iter_mut().zip(values) {
        *out = (value / scale) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standardises_a_part() {
        let mut v = [5.0, 1.0, 9.0, 3.0];
        standardise(&mut v, [1, 3].into_iter());
        let z = 1.0 / (1.0 + 1e-6);
        assert_eq!(v, [5.0, -z, 9.0, z]);
    }

    #[test]
    fn equal_but_for_rounding_is_zero() {
        let mut v = [127.0, 127.0 + 1e-13, 127.0 - 1e-13];
        standardise(&mut v, 0..3);
        assert_eq!(v, [0.0; 3]);
    }

    #[test]
    fn a_row_has_length_one_or_is_zero() {
        let mut row = [9.0; 2];
        write_unit(&[3.0, -4.0], &mut row);
        assert_eq!(row, [0.6, -0.8]);
        write_unit(&[1e-13, 0.0], &mut row);
        assert_eq!(row, [0.0, 0.0]);
    }
}
