//! What a kind of extractor is to the driver.

use evpr_core::message::ChannelOrder;
use evpr_core::plan::{Params, Sensor};

/// An image of the sensor's size: row-major, channels interleaved.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrameView<'a> {
    /// What the channels mean.
    pub(crate) channel_order: ChannelOrder,
    /// height × width × channels bytes.
    pub(crate) pixels: &'a [u8],
}

/// A kind of extractor, made for one sensor and one set of parameters.
pub(crate) trait Kind: Send {
    /// Computes the row of an image. Writes every number of `row`, which has the kind's dimension.
    fn extract(&mut self, frame: FrameView<'_>, row: &mut [f32]);
}

/// Makes a kind. The parameters are checked: within their ranges, and the kind's `dim` accepts them together.
pub(crate) type Make = fn(Sensor, &Params) -> Box<dyn Kind>;
