//! What a method of reconstruction is to the driver.

use evpr_core::message::Event;
use evpr_core::plan::{Params, Pixel, Sensor};

/// A method: keeps a fixed number of slots, each with the events of one segment, in whatever form it needs.
pub(crate) trait Method: Send {
    /// Is told once, before the first event, which pixels it has to leave out by itself. Only where its kind says
    /// [`masks_hot_pixels`](evpr_core::plan::ReconstructionKind::masks_hot_pixels) and `source.hot_pixels.apply` asks
    /// the reconstructions to; otherwise ingest has left their events out, or nobody does.
    fn mask(&mut self, pixels: &[Pixel]) {
        let _ = pixels;
    }

    /// Enters events into a slot, in stream order; their times count from `base_us`. Events outside the sensor are
    /// left out. Returns how many were entered.
    fn accumulate(&mut self, slot: usize, events: &[Event], base_us: u64) -> usize;

    /// Empties a slot.
    fn clear(&mut self, slot: usize);

    /// Does beforehand what [`Method::render`] of these slots cannot fail at any more; a window of the plan, and the
    /// tick with which it closes. Most methods have nothing to do.
    ///
    /// # Errors
    /// One line: why there is no image of this window.
    fn prepare(&mut self, window: usize, tick: u64, slots: &[usize]) -> Result<(), String> {
        let _ = (window, tick, slots);
        Ok(())
    }

    /// Forgets what it carries from window to window: what comes next is from elsewhere in the recording.
    fn forget(&mut self) {}

    /// Gives memory back that [`Method::prepare`] gets again by itself; true when there was some.
    fn unload(&mut self) -> bool {
        false
    }

    /// Renders the events of these slots, given in stream order, as one image of the sensor's size. Writes every
    /// byte of `out` (height × width × channels, row-major, channels interleaved). At least one event is in them.
    fn render(&mut self, slots: &[usize], out: &mut [u8]);
}

/// Makes a method for this sensor with so many slots. Parameters are within their ranges; the error is one line
/// saying what is wrong with their combination.
pub(crate) type Make = fn(Sensor, usize, &Params) -> Result<Box<dyn Method>, String>;
