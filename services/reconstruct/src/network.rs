//! Reconstructions by a network: E2VID and its like, whichever the registry of models names.

use crate::method::Method;
use crate::voxels::{KeptEvents, VoxelGrid};
use evpr_core::message::Event;
use evpr_core::plan::{CARRY, Pixel, Plan, Sensor};
use evpr_onnx::{FrameNetwork, OnnxError, Recipe, State};

/// A network that sees the voxel grid of each window.
pub(crate) struct NetworkMethod {
    sensor: Sensor,
    /// None while it is unloaded.
    network: Option<FrameNetwork>,
    recipe: Recipe,
    grid: VoxelGrid,
    slots: Vec<KeptEvents>,
    /// Per window: the memory, and the tick after which it is.
    memories: Vec<Memory>,
    carry: bool,
    /// The frame that was prepared.
    levels: Vec<u8>,
}

#[derive(Debug, Default)]
struct Memory {
    state: State,
    tick: Option<u64>,
}

/// Whether a memory of one tick is that of the tick before.
fn follows(before: Option<u64>, tick: u64) -> bool {
    before.is_some_and(|before| before.checked_add(1) == Some(tick))
}

impl Memory {
    /// The memory for the frame of this tick: empty unless it is carried, and the tick before was seen.
    fn for_tick(&mut self, tick: u64, carry: bool) -> &mut State {
        if !carry || !follows(self.tick, tick) {
            self.state.reset();
        }
        self.tick = Some(tick);
        &mut self.state
    }
}

/// Why there is no such method.
pub(crate) enum LoadError {
    /// The network cannot be used.
    Network(OnnxError),
    /// Its parameters or the sensor do not go with it.
    Params(String),
}

impl NetworkMethod {
    /// Loads the network of the plan's reconstruction; none when it is no network.
    pub(crate) fn load(plan: &Plan, reconstruction: usize, slots: usize) -> Result<Option<Self>, LoadError> {
        let r = &plan.reconstructions[reconstruction];
        let Some(network) = &r.network else {
            return Ok(None);
        };
        let recipe = Recipe::new(plan, network).map_err(LoadError::Network)?;
        let network = recipe.frame_network().map_err(LoadError::Network)?;
        let carry = r.params.text("state") == CARRY;
        if carry && !network.has_memory() {
            return Err(LoadError::Params(format!(
                "state = \"{CARRY}\" has no effect: the network \"{}\" has no memory; remove it, or take one that has",
                r.kind
            )));
        }
        let (bins, height, width) = network.input_shape();
        let grid = VoxelGrid::new(plan.sensor, bins, Sensor { height, width }).map_err(LoadError::Params)?;
        let windows = plan.slicing.windows.len();
        Ok(Some(Self {
            sensor: plan.sensor,
            network: Some(network),
            recipe,
            grid,
            slots: vec![KeptEvents::default(); slots],
            memories: (0..windows).map(|_| Memory::default()).collect(),
            carry,
            levels: vec![0; plan.sensor.pixels()],
        }))
    }
}

impl Method for NetworkMethod {
    fn mask(&mut self, pixels: &[Pixel]) {
        self.grid.mask(pixels);
    }

    fn accumulate(&mut self, slot: usize, events: &[Event], base_us: u64) -> usize {
        self.slots[slot].keep(events, base_us, self.sensor)
    }

    fn clear(&mut self, slot: usize) {
        self.slots[slot].clear();
    }

    fn forget(&mut self) {
        self.memories
            .iter_mut()
            .for_each(|memory| *memory = Memory::default());
    }

    fn prepare(&mut self, window: usize, tick: u64, slots: &[usize]) -> Result<(), String> {
        let segments = slots.iter().map(|slot| &self.slots[*slot]);
        self.grid.fill(segments)?;
        let state = self.memories[window].for_tick(tick, self.carry);
        let (grid, levels) = (&self.grid, &mut self.levels);
        let network = match &mut self.network {
            Some(network) => network,
            none => none.insert(self.recipe.frame_network().map_err(|e| e.to_string())?),
        };
        let run = network.run(grid.values(), state, &mut |frame| grid.crop(frame, levels));
        run.map_err(|e| e.to_string())
    }

    fn unload(&mut self) -> bool {
        // Events and memories stay: a window may be under way.
        self.network.take().is_some()
    }

    fn render(&mut self, _slots: &[usize], out: &mut [u8]) {
        out.copy_from_slice(&self.levels);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_memory_lives_from_a_tick_to_the_next() {
        assert!(follows(Some(3), 4));
        for (before, tick) in [
            (None, 0),
            (Some(3), 3),
            (Some(3), 5),
            (Some(3), 2),
            (Some(u64::MAX), 0),
        ] {
            assert!(!follows(before, tick), "{before:?} {tick}");
        }
    }
}
