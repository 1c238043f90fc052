//! Frames of single ticks, made in this process by ingest and the reconstructions themselves.

use crate::chain;
use crate::failure::Failure;
use evpr_core::Plan;
use evpr_core::message::{ChannelOrder, FrameHeader, Frames};
use evpr_core::stage::{Outlet, StageError};
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// A frame.
#[derive(Debug, Clone)]
pub(crate) struct Frame {
    pub(crate) order: ChannelOrder,
    /// `height × width × channels`, row-major, channels interleaved.
    pub(crate) pixels: Vec<u8>,
}

/// The frames of some ticks.
struct Collect<'a> {
    ticks: &'a [u64],
    window: u32,
    /// The first of the reconstructions.
    first: usize,
    /// Per tick and reconstruction: not there yet, or what came of the window (`None`: it had no events).
    found: Vec<Vec<Option<Option<Frame>>>>,
}

impl Collect<'_> {
    fn complete(&self) -> bool {
        self.found.iter().flatten().all(Option::is_some)
    }
}

impl Outlet<Frames> for Collect<'_> {
    fn emit(
        &mut self,
        header: FrameHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), StageError> {
        if header.window != self.window || !self.ticks.contains(&header.tick) {
            return Ok(());
        }
        let order = ChannelOrder::from_code(header.channel_order).filter(|_| header.reason == 0);
        let frame = order.map(|order| {
            let mut pixels = vec![0; len];
            fill(&mut pixels);
            Frame { order, pixels }
        });
        let Some(at) = (header.reconstruction as usize).checked_sub(self.first) else {
            return Ok(());
        };
        // A tick may be asked for more than once.
        for (_, found) in self
            .ticks
            .iter()
            .zip(&mut self.found)
            .filter(|(tick, _)| **tick == header.tick)
        {
            if let Some(found) = found.get_mut(at) {
                *found = Some(frame.clone());
            }
        }
        if self.complete() {
            return Err(StageError::Stopped);
        }
        Ok(())
    }
}

/// Per tick the frames of this window of the plan's source, one per reconstruction in `which`; `None` where the window had
/// no events or the source ends before.
///
/// # Errors
/// When the source cannot be read.
pub(crate) fn frames_of(
    plan: &Plan,
    which: Range<usize>,
    ticks: &[u64],
    window: usize,
) -> Result<Vec<Vec<Option<Frame>>>, Failure> {
    let mut collect = Collect {
        ticks,
        window: window as u32,
        first: which.start,
        found: vec![vec![None; which.len()]; ticks.len()],
    };
    chain::run(plan, which, &mut collect, &AtomicBool::new(false), &mut |_| {})?.outcome?;
    let frames = collect.found.into_iter();
    Ok(frames
        .map(|of_tick| of_tick.into_iter().map(Option::flatten).collect())
        .collect())
}
