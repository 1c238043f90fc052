//! A source of frames: pictures of an ordinary camera, or frames that were reconstructed elsewhere.

use super::Sensor;
use serde::{Deserialize, Serialize};

/// The kind of source that has frames and no events, and the kind of reconstruction that hands them on.
pub const FRAMES: &str = "frames";

/// How a source of frames is read.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameSource {
    /// What a tick is.
    pub ticks: FrameTicks,
    /// What to do with a frame of another size than `size`, or than the first one.
    pub on_other_size: OnOtherSize,
    /// Order of the channels in a stack (`.npy`) of colour frames.
    pub stack_order: StackOrder,
    /// The size that the configuration gives; else the first frame's counts.
    pub size: Option<Sensor>,
}

/// What a tick is when there are frames and no events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameTicks {
    /// Frame k is tick k.
    #[default]
    Frame,
    /// Ticks are as long as the slicing says; each has one of its frames, or none.
    Time,
}

/// What to do with a frame of another size.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnOtherSize {
    /// Stop with an error that names it.
    #[default]
    Error,
    /// Resize it: the mean over the area of each pixel.
    Resize,
}

/// Order of the channels in a stack of colour frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StackOrder {
    /// Blue, green, red: what `evpr events reconstruct` and OpenCV write.
    #[default]
    Bgr,
    /// Red, green, blue.
    Rgb,
}
