//! What it takes to load a network, as often as that is wanted: a process may unload it meanwhile.

use crate::error::OnnxError;
use crate::extractor::DescriptorNetwork;
use crate::library::Library;
use crate::reconstruction::FrameNetwork;
use evpr_core::plan::{Inference, Network, Plan, Sensor};

/// A network of a plan, ready to be loaded for frames of the plan's sensor.
#[derive(Debug)]
pub struct Recipe {
    /// Stays: a process has one environment of ONNX Runtime.
    library: Library,
    network: Network,
    inference: Inference,
    sensor: Sensor,
}

impl Recipe {
    /// For a network of this plan.
    ///
    /// # Errors
    /// When the library of ONNX Runtime cannot be loaded.
    pub fn new(plan: &Plan, network: &Network) -> Result<Self, OnnxError> {
        Ok(Self {
            library: Library::load(plan.inference.library.as_deref())?,
            network: network.clone(),
            inference: plan.inference.clone(),
            sensor: plan.sensor,
        })
    }

    /// Loads it as an extractor for `most` frames of one tick.
    ///
    /// # Errors
    /// As [`DescriptorNetwork::load`].
    pub fn descriptor_network(&self, most: usize) -> Result<DescriptorNetwork, OnnxError> {
        let (library, sensor) = (&self.library, Some(self.sensor));
        DescriptorNetwork::load(library, &self.network, &self.inference, sensor, most)
    }

    /// Loads it as a reconstruction.
    ///
    /// # Errors
    /// As [`FrameNetwork::load`].
    pub fn frame_network(&self) -> Result<FrameNetwork, OnnxError> {
        FrameNetwork::load(&self.library, &self.network, &self.inference, Some(self.sensor))
    }
}
