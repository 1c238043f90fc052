//! Resizing by the mean over the area of each output pixel.

use crate::Picture;
use evpr_core::plan::Sensor;

/// Which input pixels make an output pixel along one axis, with weights that sum to 1: output pixel i covers
/// `[i, i+1) · n_in / n_out` of the input, and input pixel j counts with the length of its overlap.
fn weights(n_in: usize, n_out: usize) -> Vec<(usize, Vec<f32>)> {
    let length = n_in as f64 / n_out as f64;
    let cell = |i: usize| {
        let (from, to) = (i as f64 * length, (i + 1) as f64 * length);
        let first = (from.floor() as usize).min(n_in - 1);
        let end = (to.ceil() as usize).clamp(first + 1, n_in);
        let overlap = |j: usize| (to.min((j + 1) as f64) - from.max(j as f64)).max(0.0) / length;
        (first, (first..end).map(|j| overlap(j) as f32).collect())
    };
    (0..n_out).map(cell).collect()
}

/// Resizes a picture in place. Both sizes are above 0.
pub(crate) fn area(picture: &mut Picture, from: Sensor, to: Sensor) {
    let channels = picture.order.channels();
    let (rows, columns) = (weights(from.height, to.height), weights(from.width, to.width));
    let mut out = Vec::with_capacity(to.pixels() * channels);
    let mut sum = vec![0f32; from.width * channels];
    for (first, weights) in &rows {
        sum.fill(0.0);
        for (row, weight) in (*first..).zip(weights) {
            let row = &picture.pixels[row * sum.len()..][..sum.len()];
            for (sum, value) in sum.iter_mut().zip(row) {
                *sum += weight * f32::from(*value);
            }
        }
        for (first, weights) in &columns {
            for channel in 0..channels {
                let values = sum[first * channels + channel..].iter().step_by(channels);
                let mean: f32 = values.zip(weights).map(|(value, weight)| value * weight).sum();
                out.push(mean.round() as u8);
            }
        }
    }
    picture.pixels = out;
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::message::ChannelOrder;

    fn resized(order: ChannelOrder, pixels: &[u8], from: (usize, usize), to: (usize, usize)) -> Vec<u8> {
        let sensor = |(height, width)| Sensor { height, width };
        let mut picture = Picture {
            order,
            pixels: pixels.to_vec(),
        };
        area(&mut picture, sensor(from), sensor(to));
        picture.pixels
    }

    #[test]
    fn pixels_are_means_over_areas() {
        let grey = ChannelOrder::Grey;
        assert_eq!(resized(grey, &[10, 20, 30, 40], (2, 2), (1, 1)), [25]);
        // Thirds: 2/3 of the first with 1/3 of the second, and so on.
        assert_eq!(resized(grey, &[0, 90, 30], (1, 3), (1, 2)), [30, 50]);
        assert_eq!(resized(grey, &[7, 9], (1, 2), (2, 4)), [7, 7, 9, 9, 7, 7, 9, 9]);
        assert_eq!(resized(grey, &[255; 35], (5, 7), (3, 2)), [255; 6]);
        let colour = ChannelOrder::BlueGreenRed;
        assert_eq!(
            resized(colour, &[0, 10, 20, 2, 30, 60], (1, 2), (1, 1)),
            [1, 20, 40]
        );
    }
}
