//! Networks: what the registry of models says of each, and how a process runs one.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Height and width that a network works on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InputSize {
    /// As the frame is.
    Native,
    /// This size, pixels; the frame's aspect is not kept.
    Fixed {
        /// Rows.
        height: usize,
        /// Columns.
        width: usize,
    },
    /// The frame's height and width, each rounded to the nearest multiple.
    Multiple(usize),
}

impl InputSize {
    /// The size for a frame of this one, pixels. A multiple is rounded half up, and is at least one.
    pub fn of(self, height: usize, width: usize) -> (usize, usize) {
        let round = |side: usize, to: usize| ((side + to / 2) / to).max(1) * to;
        match self {
            InputSize::Native => (height, width),
            InputSize::Fixed { height, width } => (height, width),
            InputSize::Multiple(of) => (round(height, of), round(width, of)),
        }
    }
}

impl std::str::FromStr for InputSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| {
            text.parse::<usize>()
                .ok()
                .filter(|side| (1..=8192).contains(side))
        };
        let parsed = if text == "native" {
            Some(InputSize::Native)
        } else if let Some(multiple) = text.strip_prefix("multiple:") {
            side(multiple).map(InputSize::Multiple)
        } else {
            let sides = text.split_once('x').map(|(h, w)| (side(h), side(w)));
            match sides {
                Some((Some(height), Some(width))) => Some(InputSize::Fixed { height, width }),
                _ => None,
            }
        };
        parsed.ok_or_else(|| {
            format!(
                "\"{text}\" is no input size; write \"native\", HEIGHTxWIDTH such as \"320x320\", or \"multiple:14\""
            )
        })
    }
}

impl std::fmt::Display for InputSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            InputSize::Native => f.write_str("native"),
            InputSize::Fixed { height, width } => write!(f, "{height}x{width}"),
            InputSize::Multiple(of) => write!(f, "multiple:{of}"),
        }
    }
}

impl Serialize for InputSize {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for InputSize {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

/// Who brings a frame to the input size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Resize {
    /// Nobody, or the network itself.
    None,
    /// We do: bilinear with a filter as wide as the scale, as torchvision's `resize(antialias=True)`.
    AntialiasedBilinear,
}

/// Channels that a network takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Color {
    /// Red, green, blue; a grey frame three times.
    Rgb,
    /// Blue, green, red; a grey frame three times.
    Bgr,
    /// One: 0.299 R + 0.587 G + 0.114 B.
    Grey,
}

impl Color {
    /// Channels: 1 or 3.
    pub fn channels(self) -> usize {
        if self == Color::Grey { 1 } else { 3 }
    }

    /// As in the registry.
    pub fn name(self) -> &'static str {
        match self {
            Color::Rgb => "rgb",
            Color::Bgr => "bgr",
            Color::Grey => "grey",
        }
    }
}

/// How a frame becomes the input of an extractor's network: `(level / 255 × range − mean) / std` per channel, after
/// resizing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Preprocessing {
    /// Size of the input.
    pub input: InputSize,
    /// Who brings the frame to that size.
    pub resize: Resize,
    /// Channels.
    pub color: Color,
    /// What level 255 becomes before the mean is subtracted.
    pub range: f64,
    /// Mean per channel, in units of `range`.
    pub mean: Vec<f64>,
    /// Standard deviation per channel, in units of `range`.
    pub std: Vec<f64>,
}

/// What a network is for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// Turns frames into descriptors.
    Extractor {
        /// How a frame becomes its input.
        preprocessing: Preprocessing,
        /// Length of a descriptor.
        dimension: usize,
    },
    /// Turns voxel grids of events into grey frames.
    Reconstruction {
        /// Temporal bins of the voxel grid.
        bins: usize,
        /// Height and width are padded to a multiple of this, pixels.
        multiple: usize,
        /// Inputs that carry state from frame to frame; the output of each is its name and `_out`. None: a network
        /// without a memory.
        states: Vec<String>,
    },
}

/// A network as the registry of models describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// Its name: the id or kind of a stage.
    pub id: String,
    /// The ONNX file.
    pub file: PathBuf,
    /// SHA-256 of the file, 64 hexadecimal digits.
    pub sha256: String,
    /// Name of the output that counts.
    pub output: String,
    /// What it is for.
    pub kind: ModelKind,
    /// Licence of the weights.
    pub licence: String,
    /// Where the weights come from.
    pub source: String,
}

impl Model {
    /// What decides whether two rows of this network can be compared.
    pub(super) fn fingerprint(&self) -> Vec<(&'static str, String)> {
        let mut print = vec![
            ("network.sha256", self.sha256.clone()),
            ("network.output", self.output.clone()),
        ];
        if let ModelKind::Reconstruction { bins, multiple, .. } = &self.kind {
            print.extend([
                ("network.bins", bins.to_string()),
                ("network.multiple", multiple.to_string()),
            ]);
        }
        if let ModelKind::Extractor { preprocessing: p, .. } = &self.kind {
            let numbers = |values: &[f64]| {
                let values: Vec<String> = values.iter().map(f64::to_string).collect();
                values.join(",")
            };
            print.extend([
                ("network.input", p.input.to_string()),
                ("network.resize", format!("{:?}", p.resize)),
                ("network.color", p.color.name().to_owned()),
                ("network.range", p.range.to_string()),
                ("network.mean", numbers(&p.mean)),
                ("network.std", numbers(&p.std)),
            ]);
        }
        print
    }
}

/// A network in the plan: the model, and how its process runs it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Network {
    /// The model.
    pub model: Model,
    /// Threads that compute it.
    pub threads: usize,
    /// The most frames computed at once; none: as the provider gains from it.
    pub batch: Option<usize>,
}

/// Where ONNX Runtime computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Provider {
    /// NVIDIA TensorRT.
    Tensorrt,
    /// NVIDIA CUDA.
    Cuda,
    /// Intel OpenVINO.
    Openvino,
    /// XNNPACK, on the CPU.
    Xnnpack,
    /// ONNX Runtime's own kernels, on the CPU.
    Cpu,
}

impl Provider {
    /// All, in the order of preference where nothing else is said.
    pub const ALL: [Provider; 5] = [
        Provider::Tensorrt,
        Provider::Cuda,
        Provider::Openvino,
        Provider::Xnnpack,
        Provider::Cpu,
    ];

    /// As in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Provider::Tensorrt => "tensorrt",
            Provider::Cuda => "cuda",
            Provider::Openvino => "openvino",
            Provider::Xnnpack => "xnnpack",
            Provider::Cpu => "cpu",
        }
    }

    /// Whether several frames at once cost less than one after the other.
    pub fn gains_from_batches(self) -> bool {
        matches!(self, Provider::Tensorrt | Provider::Cuda)
    }
}

/// How networks are run, whichever they are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Inference {
    /// The shared library of ONNX Runtime; none: looked for.
    pub library: Option<PathBuf>,
    /// Providers, the first that starts computes.
    pub providers: Vec<Provider>,
    /// Whether the next provider is taken where one cannot start; else that is an error.
    pub fallback: bool,
    /// Whether idle threads of a network spin between its operators: faster, for a core each that does nothing else.
    pub spinning: bool,
}

impl Default for Inference {
    fn default() -> Self {
        Self {
            library: None,
            providers: vec![Provider::Cpu],
            fallback: false,
            spinning: false,
        }
    }
}

/// Divides the cores among networks: each has at least one thread, and the first ones what is over.
pub fn threads_of(network: usize, networks: usize, cores: usize) -> usize {
    let networks = networks.max(1);
    let over = usize::from(network < cores % networks);
    (cores / networks + if cores >= networks { over } else { 0 }).max(1)
}

/// The registry of models: those there are, and the file that says so.
#[derive(Debug, Clone, Copy)]
pub struct Models<'a> {
    /// The models; empty where there is no registry.
    pub models: &'a [Model],
    /// For messages: which registry this is, such as `models/models.toml`, or what became of it.
    pub registry: &'a str,
}

impl Models<'static> {
    /// No registry at all.
    pub const NONE: Self = Self {
        models: &[],
        registry: "no registry",
    };
}

impl Models<'_> {
    /// The model of this name.
    pub fn find(&self, id: &str) -> Option<&Model> {
        self.models.iter().find(|model| model.id == id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_and_written_and_applied() {
        for text in ["native", "320x320", "260x346", "multiple:14"] {
            assert_eq!(
                text.parse::<InputSize>().map(|s| s.to_string()),
                Ok(text.to_owned())
            );
        }
        for text in [
            "",
            "320",
            "0x4",
            "4x0",
            "x",
            "multiple:0",
            "multiple:",
            "9000x1",
            "-1x2",
        ] {
            assert!(text.parse::<InputSize>().is_err(), "{text}");
        }
        assert_eq!(InputSize::Multiple(14).of(260, 346), (266, 350));
        assert_eq!(InputSize::Multiple(14).of(3, 7), (14, 14));
        assert_eq!(InputSize::Native.of(260, 346), (260, 346));
        let fixed = InputSize::Fixed { height: 2, width: 3 };
        assert_eq!(fixed.of(260, 346), (2, 3));
    }

    #[test]
    fn cores_are_divided_whole() {
        let all = |networks, cores| -> Vec<usize> {
            (0..networks).map(|n| threads_of(n, networks, cores)).collect()
        };
        assert_eq!(all(1, 2), [2]);
        assert_eq!(all(5, 2), [1; 5]);
        assert_eq!(all(3, 8), [3, 3, 2]);
        assert_eq!(all(2, 16), [8, 8]);
    }
}
