//! `evpr events render`: frames of a recording as pictures.

use super::chain::{Chain, offline_plan};
use super::convert::{check_target, interrupted};
use super::pictures::Pictures;
use crate::args::{AlignArg, ReconstructArgs, RenderArgs};
use crate::commands::run::EXIT_INTERRUPTED;
use crate::failure::Failure;
use evpr_core::message::{ChannelOrder, FrameHeader, Frames};
use evpr_core::plan::{Origin, Sensor};
use evpr_core::stage::{Outlet, StageError};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Ticks in order, those without events black.
struct Render {
    pictures: Pictures,
    order: ChannelOrder,
    frame: Vec<u8>,
    next: u64,
    most: u64,
    stop: Arc<AtomicBool>,
}

impl Render {
    fn full(&self) -> bool {
        self.next >= self.most
    }
}

impl Outlet<Frames> for Render {
    fn emit(
        &mut self,
        header: FrameHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), StageError> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(StageError::Stopped);
        }
        if header.reason != 0 {
            return Ok(());
        }
        let failed = |e| StageError::Fatal(format!("cannot write the pictures: {e}"));
        self.frame.clear();
        self.frame.resize(len, 0);
        while self.next < header.tick && !self.full() {
            self.pictures
                .add(self.next, self.order, &self.frame)
                .map_err(failed)?;
            self.next += 1;
        }
        if self.full() {
            return Err(StageError::Stopped);
        }
        fill(&mut self.frame);
        self.next = header.tick + 1;
        self.pictures
            .add(header.tick, self.order, &self.frame)
            .map_err(failed)
    }
}

pub(super) fn render(args: &RenderArgs) -> Result<ExitCode, Failure> {
    check_target(&args.out, args.force)?;
    if args.out.is_dir() {
        return Err(Failure::new(format!(
            "{} is a folder that exists already; name a new one, or a .gif",
            args.out.display()
        )));
    }
    let plan = offline_plan(&ReconstructArgs {
        input: args.input.clone(),
        method: args.method.clone(),
        window: args.window,
        tick: args.tick.unwrap_or(args.window),
        align: AlignArg::Start,
        origin: Origin::FirstEvent,
        param: args.param.clone(),
        sensor: args.sensor.clone(),
        out: args.out.clone(),
    })?;
    let failed = |e| Failure::new(format!("{}: cannot be written: {e}", args.out.display()));
    let Sensor { height, width } = plan.sensor;
    let side = |n: usize| u16::try_from(n).map_err(|_| Failure::new("the sensor is too large for a picture"));
    let order = evpr_reconstruct::KINDS
        .iter()
        .find(|kind| kind.name == args.method)
        .map_or(ChannelOrder::Grey, |kind| kind.channel_order);
    let step = args.tick.unwrap_or(args.window);
    let stop = interrupted()?;
    let out = Render {
        pictures: Pictures::create(&args.out, side(height)?, side(width)?, order, step).map_err(failed)?,
        order,
        frame: Vec::new(),
        next: 0,
        most: args.frames.unwrap_or(u64::MAX),
        stop: stop.clone(),
    };
    let mut chain = Chain::new(&plan, out, "rendering")?;
    let raised = evpr_runtime::Stop::new();
    let ingest = evpr_ingest::Ingest::new(&plan, 0, 1, raised.signal().clone())?;
    let outcome = ingest.run(&mut chain);
    chain.bar.finish_and_clear();
    if stop.load(Ordering::Relaxed) {
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    }
    if !chain.out.full() {
        outcome?;
    }
    let pictures = chain.out.pictures;
    let count = pictures.count();
    if count == 0 {
        return Err(Failure::new(format!(
            "{} is shorter than one tick; there is nothing to show",
            args.input.display()
        )));
    }
    pictures.finish().map_err(failed)?;
    eprintln!("{count} pictures written to {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}
