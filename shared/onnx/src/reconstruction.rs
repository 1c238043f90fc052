//! A network that turns voxel grids of events into grey frames, with a memory or without.

use crate::error::{OnnxError, one_line};
use crate::library::Library;
use crate::session::{Dim, Loaded, Opened, Tensor, open, pattern, wrong_model};
use evpr_core::plan::{Inference, ModelKind, Network, Sensor};
use ort::session::{Session, SessionInputValue};
use ort::value::{DynValue, TensorRef};
use std::borrow::Cow;

/// A network from voxel grids to frames, loaded and checked for one size of frame.
#[derive(Debug)]
pub struct FrameNetwork {
    session: Session,
    input: String,
    output: String,
    bins: usize,
    height: usize,
    width: usize,
    /// Inputs that carry state.
    states: Vec<StateInput>,
    loaded: Loaded,
}

#[derive(Debug)]
struct StateInput {
    name: String,
    output: String,
    shape: Vec<usize>,
    zeros: Vec<f32>,
}

/// The network's memory after a frame; new it is empty, which is a memory of zeros.
#[derive(Default)]
pub struct State(Vec<DynValue>);

impl std::fmt::Debug for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "State({} tensors)", self.0.len())
    }
}

impl State {
    /// Forgets everything.
    pub fn reset(&mut self) {
        self.0.clear();
    }
}

impl FrameNetwork {
    /// Loads the network for frames of the sensor's size, or of the size that its file fixes.
    ///
    /// # Errors
    /// When its file is not the registry's, contradicts it, has other inputs or outputs than it says, or no provider
    /// starts.
    pub fn load(
        library: &Library,
        network: &Network,
        inference: &Inference,
        sensor: Option<Sensor>,
    ) -> Result<Self, OnnxError> {
        let model = &network.model;
        let wrong = |problem: String| wrong_model(model, problem);
        let ModelKind::Reconstruction {
            bins,
            multiple,
            states,
        } = &model.kind
        else {
            return Err(wrong("is an extractor, and no reconstruction".to_owned()));
        };
        let padded = |side: usize| side.div_ceil(*multiple) * multiple;
        let opened = open(library, network, inference)?;
        let frame = opened.frame(sensor);
        let (height, width) = (padded(frame.height), padded(frame.width));
        let input = check_input(&opened, states, [1, *bins, height, width]).map_err(wrong)?;
        let states = states
            .iter()
            .map(|name| state(&opened, input, name, [1, *bins, height, width]))
            .collect::<Result<_, _>>()
            .map_err(wrong)?;
        check_output(&opened, &model.output, height, width).map_err(wrong)?;
        let mut network = Self {
            input: input.name.clone(),
            output: model.output.clone(),
            bins: *bins,
            height,
            width,
            states,
            loaded: opened.loaded,
            session: opened.session,
        };
        network.try_out().map_err(wrong)?;
        Ok(network)
    }

    /// Computes two frames, the second from the memory of the first, so that what cannot work is found out now, and the
    /// first frame is no slower than others.
    fn try_out(&mut self) -> Result<(), String> {
        let voxels = pattern(self.bins * self.height * self.width);
        let mut state = State::default();
        for _ in 0..if self.has_memory() { 2 } else { 1 } {
            self.run(&voxels, &mut state, &mut |_| {})
                .map_err(|e| e.to_string())?;
        }
        Ok(())
    }

    /// Bins, height and width of its voxel grid, padding included.
    pub fn input_shape(&self) -> (usize, usize, usize) {
        (self.bins, self.height, self.width)
    }

    /// Whether it has a memory.
    pub fn has_memory(&self) -> bool {
        !self.states.is_empty()
    }

    /// What loading it came to.
    pub fn loaded(&self) -> &Loaded {
        &self.loaded
    }

    /// Computes the frame of a voxel grid of bins × height × width numbers, from the memory `state`, which then is the
    /// memory after this frame. `take` gets height × width values, row-major, 0 is black and 1 white.
    ///
    /// # Errors
    /// When the network fails, or gives another number of values than it should, or one that is not finite; `state` is
    /// then empty. A number of the state that is not finite is found by the frame that it spoils, the next one: looking
    /// through a state takes milliseconds.
    pub fn run(
        &mut self,
        voxels: &[f32],
        state: &mut State,
        take: &mut dyn FnMut(&[f32]),
    ) -> Result<(), OnnxError> {
        let before = std::mem::take(&mut state.0);
        let failed = OnnxError::Run;
        let failed_in = |e: &dyn std::fmt::Display| failed(one_line(e));
        let shape = [1, self.bins, self.height, self.width];
        let grid = TensorRef::from_array_view((shape, voxels)).map_err(|e| failed_in(&e))?;
        let mut inputs: Vec<(Cow<'_, str>, SessionInputValue<'_>)> =
            Vec::with_capacity(1 + self.states.len());
        inputs.push((self.input.as_str().into(), grid.into()));
        for (index, input) in self.states.iter().enumerate() {
            let value: SessionInputValue<'_> = match before.get(index) {
                Some(value) => value.into(),
                None => {
                    let zeros = TensorRef::from_array_view((input.shape.clone(), input.zeros.as_slice()));
                    zeros.map_err(|e| failed_in(&e))?.into()
                }
            };
            inputs.push((input.name.as_str().into(), value));
        }
        let mut outputs = self.session.run(inputs).map_err(|e| failed_in(&e))?;
        let image = outputs.get(&self.output);
        let image = image.ok_or_else(|| failed(format!("has no output \"{}\"", self.output)))?;
        let (_, values) = image.try_extract_tensor::<f32>().map_err(|e| failed_in(&e))?;
        if values.len() != self.height * self.width {
            let (got, height, width) = (values.len(), self.height, self.width);
            return Err(failed(format!("gave {got} values, not {height} × {width}")));
        }
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            return Err(failed(format!("value {at} of its frame is {}", values[at])));
        }
        take(values);
        let mut after = Vec::with_capacity(self.states.len());
        for input in &self.states {
            let value = outputs.remove(&input.output);
            let value = value.ok_or_else(|| failed(format!("has no output \"{}\"", input.output)))?;
            let (shape, _) = value.try_extract_tensor::<f32>().map_err(|e| failed_in(&e))?;
            if !shape
                .iter()
                .copied()
                .eq(input.shape.iter().map(|length| *length as i64))
            {
                return Err(failed(format!(
                    "its state {} is {:?} before a frame and {:?} after it; export it anew",
                    input.name,
                    input.shape,
                    &shape[..]
                )));
            }
            after.push(value);
        }
        state.0 = after;
        Ok(())
    }
}

/// The input that is no state, if it takes voxel grids of this shape.
fn check_input<'o>(opened: &'o Opened, states: &[String], shape: [usize; 4]) -> Result<&'o Tensor, String> {
    let others: Vec<&Tensor> = opened
        .inputs
        .iter()
        .filter(|input| !states.contains(&input.name))
        .collect();
    let [input] = others.as_slice() else {
        let all: Vec<String> = opened.inputs.iter().map(Tensor::to_string).collect();
        return Err(format!(
            "it takes {}; write all but the voxel grid as states in the registry",
            all.join(", ")
        ));
    };
    if fits(input, &shape) {
        Ok(input)
    } else {
        let [_, bins, height, width] = shape;
        Err(format!(
            "it takes {input}, and here voxel grids are [1, {bins}, {height}, {width}]; export it for this size, or \
             correct bins and multiple in the registry"
        ))
    }
}

fn fits(tensor: &Tensor, shape: &[usize]) -> bool {
    let dims = tensor.dims.as_deref().unwrap_or(&[]);
    dims.len() == shape.len() && dims.iter().zip(shape).all(|(dim, length)| dim.allows(*length))
}

/// A state, with its shape: fixed, or named like lengths of the voxel grid.
fn state(opened: &Opened, grid: &Tensor, name: &str, shape: [usize; 4]) -> Result<StateInput, String> {
    let named = |tensors: &[Tensor], name: &str| tensors.iter().find(|t| t.name == name).cloned();
    let input = named(&opened.inputs, name)
        .ok_or_else(|| format!("it has no input \"{name}\"; correct states in the registry"))?;
    let output = format!("{name}_out");
    if named(&opened.outputs, &output).is_none() {
        return Err(format!(
            "it has no output \"{output}\" for its state \"{name}\"; export it anew"
        ));
    }
    let grid_dims = grid.dims.as_deref().unwrap_or(&[]);
    let length = |dim: &Dim| match dim {
        Dim::Fixed(length) => Some(*length),
        Dim::Free(_) => grid_dims
            .iter()
            .zip(shape)
            .find(|(of_grid, _)| *of_grid == dim)
            .map(|(_, length)| length),
    };
    let dims = input.dims.as_deref().unwrap_or(&[]);
    let shape: Option<Vec<usize>> = dims.iter().map(length).collect();
    match shape {
        Some(shape) if !shape.is_empty() => Ok(StateInput {
            zeros: vec![0.0; shape.iter().product()],
            name: name.to_owned(),
            output,
            shape,
        }),
        _ => Err(format!(
            "its state {input} has lengths that nothing tells; export it for a fixed size"
        )),
    }
}

fn check_output(opened: &Opened, name: &str, height: usize, width: usize) -> Result<(), String> {
    let Some(output) = opened.outputs.iter().find(|output| output.name == name) else {
        let all: Vec<&str> = opened.outputs.iter().map(|output| output.name.as_str()).collect();
        return Err(format!(
            "it has no output \"{name}\", but {}; write one of them as output in the registry",
            all.join(", ")
        ));
    };
    if fits(output, &[1, 1, height, width]) {
        Ok(())
    } else {
        Err(format!(
            "it gives {output}, and not [1, 1, {height}, {width}]; export it anew"
        ))
    }
}
