//! A frame becomes the input of a network: its channels in the network's order, resized where that is ours to do, and
//! normalised.

use crate::antialias::AntialiasedResize;
use crate::kind::FrameView;
use evpr_core::message::ChannelOrder;
use evpr_core::plan::{Color, Preprocessing, Resize, Sensor};

/// Levels of a pixel.
const LEVELS: usize = 256;
/// Parts of blue, green and red in grey: ITU-R BT.601, as PIL's `convert("L")`.
const GREY: [f32; 3] = [0.114, 0.587, 0.299];

/// Turns frames of one size into inputs: `channels × height × width` numbers, each
/// `(level / 255 × range − mean) / std`.
#[derive(Debug)]
pub(crate) struct Preprocess {
    color: Color,
    scaling: Scaling,
}

#[derive(Debug)]
enum Scaling {
    /// The frame's own size: the value of every level, per channel.
    Tables(Vec<[f32; LEVELS]>),
    Resize {
        resize: AntialiasedResize,
        /// A channel of the frame, as levels × range / 255.
        plane: Vec<f32>,
        unit: f32,
        /// Mean and standard deviation per channel.
        normal: Vec<(f32, f32)>,
    },
}

impl Preprocess {
    /// For frames of the sensor's size.
    pub(crate) fn new(sensor: Sensor, preprocessing: &Preprocessing) -> Self {
        let p = preprocessing;
        let normal: Vec<(f32, f32)> = p
            .mean
            .iter()
            .zip(&p.std)
            .map(|(m, s)| (*m as f32, *s as f32))
            .collect();
        let unit = p.range as f32;
        let scaling = match p.resize {
            // In f32 and in this order, as torchvision's ToTensor and Normalize.
            Resize::None => Scaling::Tables(
                normal
                    .iter()
                    .map(|(mean, std)| {
                        std::array::from_fn(|level| (level as f32 / 255.0 * unit - mean) / std)
                    })
                    .collect(),
            ),
            Resize::AntialiasedBilinear => Scaling::Resize {
                resize: AntialiasedResize::new(
                    (sensor.height, sensor.width),
                    p.input.of(sensor.height, sensor.width),
                ),
                plane: vec![0.0; sensor.pixels()],
                unit,
                normal,
            },
        };
        Self {
            color: p.color,
            scaling,
        }
    }

    /// Writes the input of a frame; `out` has channels × height × width numbers.
    pub(crate) fn apply(&mut self, frame: FrameView<'_>, out: &mut [f32]) {
        let channels = self.color.channels();
        let size = out.len() / channels;
        for (channel, out) in out.chunks_exact_mut(size).enumerate() {
            let from = source(self.color, channel);
            match &mut self.scaling {
                Scaling::Tables(tables) => {
                    let table = &tables[channel];
                    each(
                        frame,
                        from,
                        out,
                        |level| table[usize::from(level)],
                        |level| {
                            // Grey of three colours is no whole level.
                            let below = level as usize;
                            let (low, high) = (table[below], table[(below + 1).min(LEVELS - 1)]);
                            low + (high - low) * (level - below as f32)
                        },
                    );
                }
                Scaling::Resize {
                    resize,
                    plane,
                    unit,
                    normal,
                } => {
                    let value = |level: f32| level / 255.0 * *unit;
                    each(frame, from, plane, |level| value(f32::from(level)), value);
                    resize.apply(plane, out);
                    let (mean, std) = normal[channel];
                    out.iter_mut().for_each(|v| *v = (*v - mean) / std);
                }
            }
        }
    }
}

/// Where a channel of the input comes from.
#[derive(Debug, Clone, Copy)]
enum From {
    /// This channel of a frame in the order blue, green, red.
    Channel(usize),
    /// All of them, as grey.
    Grey,
}

fn source(color: Color, channel: usize) -> From {
    match color {
        Color::Rgb => From::Channel(2 - channel),
        Color::Bgr => From::Channel(channel),
        Color::Grey => From::Grey,
    }
}

/// Writes one value per pixel: of a whole level, or of a level between two.
fn each(
    frame: FrameView<'_>,
    from: From,
    out: &mut [f32],
    whole: impl Fn(u8) -> f32,
    between: impl Fn(f32) -> f32,
) {
    if frame.channel_order == ChannelOrder::Grey {
        out.iter_mut()
            .zip(frame.pixels)
            .for_each(|(out, level)| *out = whole(*level));
        return;
    }
    let pixels = frame.pixels.chunks_exact(3);
    match from {
        From::Channel(channel) => out
            .iter_mut()
            .zip(pixels)
            .for_each(|(out, p)| *out = whole(p[channel])),
        From::Grey => out.iter_mut().zip(pixels).for_each(|(out, p)| {
            let level: f32 = p
                .iter()
                .zip(GREY)
                .map(|(level, part)| f32::from(*level) * part)
                .sum();
            *out = between(level.min(255.0));
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::InputSize;

    const SENSOR: Sensor = Sensor { height: 1, width: 2 };

    fn imagenet(color: Color) -> Preprocessing {
        let channels = color.channels();
        Preprocessing {
            input: InputSize::Native,
            resize: Resize::None,
            color,
            range: 1.0,
            mean: [0.485, 0.456, 0.406][..channels].to_vec(),
            std: [0.229, 0.224, 0.225][..channels].to_vec(),
        }
    }

    fn applied(p: &Preprocessing, order: ChannelOrder, pixels: &[u8], numbers: usize) -> Vec<f32> {
        let mut out = vec![f32::NAN; numbers];
        let frame = FrameView {
            channel_order: order,
            pixels,
        };
        Preprocess::new(SENSOR, p).apply(frame, &mut out);
        out
    }

    fn normal(level: f32, channel: usize) -> f32 {
        let (mean, std) = ([0.485, 0.456, 0.406][channel], [0.229, 0.224, 0.225][channel]);
        (level / 255.0 - mean) / std
    }

    #[test]
    fn blue_green_red_becomes_red_green_blue() {
        let out = applied(
            &imagenet(Color::Rgb),
            ChannelOrder::OffOnZero,
            &[10, 20, 0, 30, 40, 0],
            6,
        );
        assert_eq!(
            out,
            [
                normal(0.0, 0),
                normal(0.0, 0),
                normal(20.0, 1),
                normal(40.0, 1),
                normal(10.0, 2),
                normal(30.0, 2)
            ]
        );
        let bgr = applied(
            &imagenet(Color::Bgr),
            ChannelOrder::BlueGreenRed,
            &[10, 20, 0, 30, 40, 0],
            6,
        );
        assert_eq!(bgr[0], normal(10.0, 0));
    }

    #[test]
    fn grey_is_repeated() {
        let out = applied(&imagenet(Color::Rgb), ChannelOrder::Grey, &[10, 255], 6);
        let expected: Vec<f32> = (0..3).flat_map(|c| [normal(10.0, c), normal(255.0, c)]).collect();
        assert_eq!(out, expected);
    }

    #[test]
    fn colours_become_grey() {
        let out = applied(
            &imagenet(Color::Grey),
            ChannelOrder::BlueGreenRed,
            &[10, 20, 30, 255, 255, 255],
            2,
        );
        let level = 10.0 * 0.114 + 20.0 * 0.587 + 30.0 * 0.299;
        assert!((out[0] - normal(level, 0)).abs() < 1e-5, "{out:?}");
        assert!((out[1] - normal(255.0, 0)).abs() < 1e-5, "{out:?}");
    }

    #[test]
    fn a_range_of_255_keeps_levels() {
        let p = Preprocessing {
            range: 255.0,
            mean: vec![100.0; 3],
            std: vec![1.0; 3],
            ..imagenet(Color::Rgb)
        };
        let out = applied(&p, ChannelOrder::Grey, &[100, 103], 6);
        assert!((out[0]).abs() < 1e-4 && (out[1] - 3.0).abs() < 1e-4, "{out:?}");
    }

    /// What PIL and torchvision make of the same frames (`tests/models/golden/preprocess`).
    #[test]
    fn inputs_are_those_of_torchvision() {
        use ndarray::ArrayD;
        let folder =
            std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/models/golden/preprocess");
        let caffe = (Color::Bgr, 255.0, vec![103.939, 116.779, 123.68], vec![1.0; 3]);
        let grey = (Color::Grey, 1.0, vec![0.5], vec![0.25]);
        let imagenet = (
            Color::Rgb,
            1.0,
            vec![0.485, 0.456, 0.406],
            vec![0.229, 0.224, 0.225],
        );
        // A thousandth of a level, in units of the standard deviation; of grey half a level more, which PIL rounds away.
        let tolerance = |levels: f64, range: f64, std: &[f64]| {
            let narrowest = std.iter().copied().fold(f64::INFINITY, f64::min);
            (levels / 255.0 * range / narrowest) as f32
        };
        for (file, frame, (color, range, mean, std), levels) in [
            ("imagenet_bgr", "frame_bgr", &imagenet, 0.0001),
            ("imagenet_one_channel", "frame_one_channel", &imagenet, 0.0001),
            ("imagenet_bgr_32x20", "frame_bgr", &imagenet, 0.001),
            (
                "imagenet_one_channel_14x14",
                "frame_one_channel",
                &imagenet,
                0.001,
            ),
            ("imagenet_large_28x42", "frame_large", &imagenet, 0.001),
            ("caffe_bgr", "frame_bgr", &caffe, 0.0001),
            ("caffe_large_20x31", "frame_large", &caffe, 0.001),
            ("grey_bgr", "frame_bgr", &grey, 0.501),
            ("grey_one_channel_13x40", "frame_one_channel", &grey, 0.001),
        ] {
            let pixels: ArrayD<u8> = ndarray_npy::read_npy(folder.join(format!("{frame}.npy"))).unwrap();
            let expected: ArrayD<f32> = ndarray_npy::read_npy(folder.join(format!("{file}.npy"))).unwrap();
            let sensor = Sensor {
                height: pixels.shape()[0],
                width: pixels.shape()[1],
            };
            let (height, width) = (expected.shape()[1], expected.shape()[2]);
            let native = (height, width) == (sensor.height, sensor.width);
            let p = Preprocessing {
                input: if native {
                    InputSize::Native
                } else {
                    InputSize::Fixed { height, width }
                },
                resize: if native {
                    Resize::None
                } else {
                    Resize::AntialiasedBilinear
                },
                color: *color,
                range: *range,
                mean: mean.clone(),
                std: std.clone(),
            };
            let view = FrameView {
                channel_order: if pixels.ndim() == 3 {
                    ChannelOrder::BlueGreenRed
                } else {
                    ChannelOrder::Grey
                },
                pixels: pixels.as_slice().unwrap(),
            };
            let mut out = vec![f32::NAN; expected.len()];
            Preprocess::new(sensor, &p).apply(view, &mut out);
            let worst = out
                .iter()
                .zip(expected.iter())
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            let most = tolerance(levels, *range, std);
            assert!(worst <= most, "{file}: they differ by {worst}, more than {most}");
        }
    }

    #[test]
    fn resizing_comes_before_normalising() {
        let p = Preprocessing {
            input: InputSize::Fixed { height: 2, width: 1 },
            resize: Resize::AntialiasedBilinear,
            ..imagenet(Color::Rgb)
        };
        let out = applied(&p, ChannelOrder::Grey, &[10, 20], 6);
        for (channel, pair) in out.chunks_exact(2).enumerate() {
            assert!(
                pair.iter().all(|v| (v - normal(15.0, channel)).abs() < 1e-6),
                "{out:?}"
            );
        }
    }
}
