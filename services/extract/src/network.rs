//! Extractors that are networks: frames wait for one another as long as others are in the channel, and are computed
//! at once, as many as the network takes.

use crate::kind::FrameView;
use crate::preprocess::Preprocess;
use evpr_core::message::FrameHeader;
use evpr_core::plan::{ModelKind, Plan};
use evpr_onnx::{DescriptorNetwork, Descriptors, OnnxError, Recipe};

/// Descriptors of this length or shorter have no direction.
const NO_LENGTH: f64 = 1e-12;

/// A network with the frames that wait for it.
#[derive(Debug)]
pub(crate) struct NetworkExtractor {
    /// None while it is unloaded.
    network: Option<DescriptorNetwork>,
    recipe: Recipe,
    /// Most frames of one tick.
    most: usize,
    dimension: usize,
    batch: usize,
    preprocess: Preprocess,
    /// Inputs, one after the other; as many as the network takes at once.
    inputs: Vec<f32>,
    /// Numbers in one input.
    input: usize,
    waiting: Vec<(FrameHeader, u32)>,
}

impl NetworkExtractor {
    /// Loads the network of the plan's extractor `extractor`; none when it is no network.
    pub(crate) fn load(plan: &Plan, extractor: usize) -> Result<Option<Self>, OnnxError> {
        let Some(network) = &plan.extractors[extractor].network else {
            return Ok(None);
        };
        let ModelKind::Extractor { preprocessing, .. } = &network.model.kind else {
            return Ok(None);
        };
        let recipe = Recipe::new(plan, network)?;
        let most = plan.members.iter().filter(|m| m.extractor == extractor).count();
        let network = recipe.descriptor_network(most)?;
        let (channels, height, width) = network.input_shape();
        let input = channels * height * width;
        Ok(Some(Self {
            preprocess: Preprocess::new(plan.sensor, preprocessing),
            inputs: vec![0.0; input * network.batch()],
            input,
            waiting: Vec::with_capacity(network.batch()),
            dimension: network.dimension(),
            batch: network.batch(),
            network: Some(network),
            recipe,
            most,
        }))
    }

    /// Length of its descriptors.
    pub(crate) fn dimension(&self) -> usize {
        self.dimension
    }

    /// Takes a frame of a member. True when no more fit: [`NetworkExtractor::run`] is next.
    pub(crate) fn push(&mut self, header: FrameHeader, member: u32, frame: FrameView<'_>) -> bool {
        let start = self.waiting.len() * self.input;
        if let Some(input) = self.inputs.get_mut(start..start + self.input) {
            self.preprocess.apply(frame, input);
            self.waiting.push((header, member));
        }
        self.waiting.len() == self.batch
    }

    /// Computes what waits: each frame's header and member, and the descriptors in the same order.
    pub(crate) fn run(&mut self) -> (Vec<(FrameHeader, u32)>, Result<Descriptors, OnnxError>) {
        let count = self.waiting.len();
        let inputs = &self.inputs[..count * self.input];
        let descriptors = match &mut self.network {
            Some(network) => network.run(inputs, count),
            None => self
                .recipe
                .descriptor_network(self.most)
                .and_then(|network| self.network.insert(network).run(inputs, count)),
        };
        let batch = Vec::with_capacity(self.batch);
        (std::mem::replace(&mut self.waiting, batch), descriptors)
    }

    /// Frees the network, until the next frame; true when it was there.
    pub(crate) fn unload(&mut self) -> bool {
        self.network.take().is_some()
    }

    /// Whether frames wait.
    pub(crate) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }
}

/// The Euclidean length of a descriptor; or that it has none, or the first of its numbers that is not finite.
pub(crate) fn length(descriptor: &[f32]) -> Result<f64, String> {
    let sum: f64 = descriptor.iter().map(|v| f64::from(*v).powi(2)).sum();
    if sum.sqrt() <= NO_LENGTH {
        return Err("its row is all 0".to_owned());
    }
    if sum.is_finite() {
        return Ok(sum.sqrt());
    }
    let at = descriptor.iter().position(|v| !v.is_finite());
    Err(match at {
        Some(at) => format!("number {at} of its row is {}", descriptor[at]),
        None => "its row is too long".to_owned(),
    })
}

/// Writes a descriptor over its length.
pub(crate) fn write_unit(descriptor: &[f32], length: f64, row: &mut [f32]) {
    let scale = 1.0 / length;
    for (out, value) in row.iter_mut().zip(descriptor) {
        *out = (f64::from(*value) * scale) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptors_get_length_one() {
        let descriptor = [3.0, -4.0];
        let length = length(&descriptor).unwrap();
        assert_eq!(length, 5.0);
        let mut row = [9.0; 2];
        write_unit(&descriptor, length, &mut row);
        assert_eq!(row, [0.6, -0.8]);
    }

    #[test]
    fn numbers_that_are_none_are_named() {
        assert_eq!(
            length(&[1.0, f32::NAN]),
            Err("number 1 of its row is NaN".to_owned())
        );
        assert!(length(&[f32::INFINITY]).is_err());
        assert!(length(&[f32::MAX; 4]).is_ok());
        assert_eq!(length(&[0.0, 0.0]), Err("its row is all 0".to_owned()));
    }
}
