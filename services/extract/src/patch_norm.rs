//! `patch_norm`: a small image, normalised patch by patch.

use crate::kind::{FrameView, Kind};
use crate::normalise::{standardise, write_unit};
use crate::resize::AreaResize;
use evpr_core::plan::{Params, Sensor};

/// Grey, area-resized to side × side; each patch × patch block to mean 0 and standard deviation 1 (population, + 1e-6);
/// row-major; the whole to length 1. Dimension side².
#[derive(Debug)]
pub(crate) struct PatchNorm {
    side: usize,
    patch: usize,
    resize: AreaResize,
    small: Vec<f64>,
}

impl PatchNorm {
    /// Length of a row, or what is wrong with the parameters together.
    pub(crate) fn dim(params: &Params) -> Result<usize, String> {
        let (side, patch) = (params.integer("side"), params.integer("patch"));
        if side < 1 || patch < 1 || side % patch != 0 {
            return Err(format!(
                "patch {patch} does not divide side {side}; choose a patch that does, such as 8 for side 32"
            ));
        }
        Ok((side * side) as usize)
    }

    /// For this sensor. The parameters have passed [`PatchNorm::dim`].
    pub(crate) fn new(sensor: Sensor, params: &Params) -> Self {
        let (side, patch) = (params.integer("side") as usize, params.integer("patch") as usize);
        Self {
            side,
            patch,
            resize: AreaResize::new((sensor.height, sensor.width), (side, side)),
            small: vec![0.0; side * side],
        }
    }
}

impl Kind for PatchNorm {
    fn extract(&mut self, frame: FrameView<'_>, row: &mut [f32]) {
        let (side, patch) = (self.side, self.patch);
        self.resize.apply(frame, &mut self.small);
        for top in (0..side).step_by(patch) {
            for left in (0..side).step_by(patch) {
                let block = (top..top + patch).flat_map(|y| (left..left + patch).map(move |x| y * side + x));
                standardise(&mut self.small, block);
            }
        }
        write_unit(&self.small, row);
    }
}
