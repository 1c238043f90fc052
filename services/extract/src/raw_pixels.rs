//! `raw_pixels`: a small image, normalised as a whole.

use crate::kind::{FrameView, Kind};
use crate::normalise::{standardise, write_unit};
use crate::resize::AreaResize;
use evpr_core::plan::{Params, Sensor};

/// Grey, area-resized to height × width; each value v to log(1 + v) where `transform` is `log1p`; the whole to mean 0
/// and standard deviation 1 (population, + 1e-6), row-major, then to length 1. Dimension height · width.
#[derive(Debug)]
pub(crate) struct RawPixels {
    log1p: bool,
    resize: AreaResize,
    small: Vec<f64>,
}

impl RawPixels {
    /// Length of a row, or what is wrong with the parameters together.
    pub(crate) fn dim(params: &Params) -> Result<usize, String> {
        let (height, width) = (params.integer("height"), params.integer("width"));
        if height < 1 || width < 1 {
            return Err(format!("height {height} and width {width} must be 1 or more"));
        }
        Ok((height * width) as usize)
    }

    /// For this sensor. The parameters have passed [`RawPixels::dim`].
    pub(crate) fn new(sensor: Sensor, params: &Params) -> Self {
        let (height, width) = (
            params.integer("height") as usize,
            params.integer("width") as usize,
        );
        Self {
            log1p: params.text("transform") == "log1p",
            resize: AreaResize::new((sensor.height, sensor.width), (height, width)),
            small: vec![0.0; height * width],
        }
    }
}

impl Kind for RawPixels {
    fn extract(&mut self, frame: FrameView<'_>, row: &mut [f32]) {
        self.resize.apply(frame, &mut self.small);
        if self.log1p {
            self.small.iter_mut().for_each(|v| *v = v.ln_1p());
        }
        let all = 0..self.small.len();
        standardise(&mut self.small, all);
        write_unit(&self.small, row);
    }
}
