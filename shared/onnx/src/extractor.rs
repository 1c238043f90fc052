//! A network that turns images into descriptors.

use crate::error::{OnnxError, one_line};
use crate::library::Library;
use crate::session::{Loaded, Opened, Tensor, open, pattern, wrong_model};
use evpr_core::plan::{Inference, ModelKind, Network, Sensor};
use ort::session::Session;
use ort::value::{DynValue, TensorRef};

/// A network from images to descriptors, loaded and checked for one size of frame.
#[derive(Debug)]
pub struct DescriptorNetwork {
    session: Session,
    input: String,
    output: String,
    channels: usize,
    height: usize,
    width: usize,
    dimension: usize,
    batch: usize,
    loaded: Loaded,
}

/// The descriptors of a batch, as the network gave them: not normalised.
pub struct Descriptors {
    value: DynValue,
    dimension: usize,
}

impl std::fmt::Debug for Descriptors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Descriptors")
            .field("dimension", &self.dimension)
            .finish_non_exhaustive()
    }
}

impl Descriptors {
    /// The descriptor of image `index` of the batch; empty when there is none.
    pub fn get(&self, index: usize) -> &[f32] {
        let values = self
            .value
            .try_extract_tensor::<f32>()
            .map_or(&[][..], |(_, values)| values);
        let start = index * self.dimension;
        values.get(start..start + self.dimension).unwrap_or(&[])
    }
}

impl DescriptorNetwork {
    /// Loads the network for frames of the sensor's size, or of the size that its file fixes. `most` is the most frames
    /// that one tick has for it.
    ///
    /// # Errors
    /// When its file is not the registry's, contradicts it, has other inputs or outputs than it says, or no provider
    /// starts.
    pub fn load(
        library: &Library,
        network: &Network,
        inference: &Inference,
        sensor: Option<Sensor>,
        most: usize,
    ) -> Result<Self, OnnxError> {
        let model = &network.model;
        let wrong = |problem: String| wrong_model(model, problem);
        let ModelKind::Extractor {
            preprocessing,
            dimension,
        } = &model.kind
        else {
            return Err(wrong("is a reconstruction, and no extractor".to_owned()));
        };
        let channels = preprocessing.color.channels();
        let opened = open(library, network, inference)?;
        let frame = opened.frame(sensor);
        let (height, width) = preprocessing.input.of(frame.height, frame.width);
        let input = check_input(&opened, channels, height, width).map_err(wrong)?;
        let free_batch = check_output(&opened, input, &model.output, *dimension).map_err(wrong)?;
        let batch = match (network.batch, free_batch) {
            (Some(batch), false) if batch > 1 => {
                return Err(wrong(format!(
                    "it takes one image at a time ({input}), and batch = {batch}; export it with a free batch, or \
                     leave batch out"
                )));
            }
            (Some(batch), _) => batch,
            (None, true) if opened.loaded.provider.gains_from_batches() => most.max(1),
            (None, _) => 1,
        };
        let mut network = Self {
            input: input.name.clone(),
            output: model.output.clone(),
            channels,
            height,
            width,
            dimension: *dimension,
            batch,
            loaded: opened.loaded,
            session: opened.session,
        };
        network.try_out().map_err(wrong)?;
        Ok(network)
    }

    /// Computes a first batch, so that what cannot work is found out now, and the first frame is no slower than others.
    fn try_out(&mut self) -> Result<(), String> {
        let images = pattern(self.batch * self.channels * self.height * self.width);
        let descriptors = self.run(&images, self.batch).map_err(|e| e.to_string())?;
        match (0..self.batch)
            .flat_map(|i| descriptors.get(i))
            .position(|v| !v.is_finite())
        {
            Some(at) => Err(format!(
                "number {} of its descriptor is none ({}); export it again from sound weights",
                at % self.dimension,
                descriptors.get(at / self.dimension)[at % self.dimension]
            )),
            None => Ok(()),
        }
    }

    /// Channels, height and width of its input.
    pub fn input_shape(&self) -> (usize, usize, usize) {
        (self.channels, self.height, self.width)
    }

    /// The most images that it is given at once.
    pub fn batch(&self) -> usize {
        self.batch
    }

    /// Length of a descriptor.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// What loading it came to.
    pub fn loaded(&self) -> &Loaded {
        &self.loaded
    }

    /// Computes the descriptors of `count` images: `images` is count × channels × height × width numbers.
    ///
    /// # Errors
    /// When the network fails, or gives another number of values than it should.
    pub fn run(&mut self, images: &[f32], count: usize) -> Result<Descriptors, OnnxError> {
        let failed = OnnxError::Run;
        let shape = [count, self.channels, self.height, self.width];
        let input = TensorRef::from_array_view((shape, images)).map_err(|e| failed(one_line(&e)))?;
        let run = self.session.run(vec![(self.input.as_str(), input)]);
        let mut outputs = run.map_err(|e| failed(one_line(&e)))?;
        let value = outputs.remove(&self.output);
        let value = value.ok_or_else(|| failed(format!("has no output \"{}\"", self.output)))?;
        let (_, values) = value
            .try_extract_tensor::<f32>()
            .map_err(|e| failed(one_line(&e)))?;
        if values.len() != count * self.dimension {
            let got = values.len();
            return Err(failed(format!(
                "gave {got} numbers, not {count} × {}",
                self.dimension
            )));
        }
        let dimension = self.dimension;
        Ok(Descriptors { value, dimension })
    }
}

/// The one input, if it takes images of this shape.
fn check_input(opened: &Opened, channels: usize, height: usize, width: usize) -> Result<&Tensor, String> {
    let [input] = opened.inputs.as_slice() else {
        let all: Vec<String> = opened.inputs.iter().map(Tensor::to_string).collect();
        return Err(format!(
            "it takes {}, not one image; export it anew",
            all.join(", ")
        ));
    };
    let fits = match input.dims.as_deref() {
        Some([batch, c, h, w]) => {
            batch.allows(1) && c.allows(channels) && h.allows(height) && w.allows(width)
        }
        _ => false,
    };
    if fits {
        Ok(input)
    } else {
        Err(format!(
            "it takes {input}, and here images are [1, {channels}, {height}, {width}]; export it for this size, or \
             correct its input in the registry"
        ))
    }
}

/// Checks the output that counts; true when input and output take any number of images.
fn check_output(opened: &Opened, input: &Tensor, name: &str, dimension: usize) -> Result<bool, String> {
    let Some(output) = opened.outputs.iter().find(|output| output.name == name) else {
        let all: Vec<&str> = opened.outputs.iter().map(|output| output.name.as_str()).collect();
        return Err(format!(
            "it has no output \"{name}\", but {}; write one of them as output in the registry",
            all.join(", ")
        ));
    };
    let fits = match output.dims.as_deref() {
        Some([batch, length]) => batch.allows(1) && length.allows(dimension),
        _ => false,
    };
    if !fits {
        return Err(format!(
            "it gives {output}, and the registry says [1, {dimension}]; correct the registry's dimension, or export it \
             anew"
        ));
    }
    let free = |tensor: &Tensor| tensor.dims.as_ref().is_some_and(|dims| dims[0].allows(2));
    Ok(free(input) && free(output))
}
