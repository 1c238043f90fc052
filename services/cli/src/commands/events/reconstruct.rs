//! `evpr events reconstruct`.

use super::plan::offline_plan;
use super::{interrupted, kept};
use crate::args::ReconstructArgs;
use crate::chain;
use crate::commands::run::EXIT_INTERRUPTED;
use crate::failure::Failure;
use crate::frames_npy::FramesWriter;
use crate::output::refuse_input;
use crate::progress;
use evpr_core::message::{FrameHeader, Frames};
use evpr_core::plan::Sensor;
use evpr_core::stage::{Outlet, StageError};
use std::io;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

struct WriteFrames {
    writer: FramesWriter,
    frame: Vec<u8>,
    failed: Option<io::Error>,
}

impl Outlet<Frames> for WriteFrames {
    fn emit(
        &mut self,
        header: FrameHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), StageError> {
        if header.reason != 0 {
            return Ok(());
        }
        self.frame.clear();
        self.frame.resize(len, 0);
        fill(&mut self.frame);
        self.writer.write(header.tick, &self.frame).map_err(|e| {
            self.failed.get_or_insert(e);
            StageError::Stopped
        })
    }
}

pub(super) fn reconstruct(args: &ReconstructArgs) -> Result<ExitCode, Failure> {
    refuse_input(&args.out, &[&args.input])?;
    let plan = offline_plan(args)?;
    let Sensor { height, width } = plan.sensor;
    let failed = |e| Failure::new(format!("cannot write {}: {e}", args.out.display()));
    // From before the file begins: whoever sees it may interrupt.
    let stop = interrupted()?;
    let writer =
        FramesWriter::create(&args.out, height, width, plan.reconstructions[0].channels).map_err(failed)?;
    let mut out = WriteFrames {
        writer,
        frame: Vec::new(),
        failed: None,
    };
    let bar = progress::bar(false, "reconstructing");
    let chained = chain::run(&plan, 0..plan.reconstructions.len(), &mut out, &stop, &mut |p| {
        progress::show(&bar, p)
    });
    bar.finish_and_clear();
    let chained = chained?;
    if stop.load(Ordering::Relaxed) {
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    }
    if let Some(e) = out.failed {
        return Err(failed(e));
    }
    let ticks = chained.ticks;
    if ticks > 0 {
        out.writer.finish(ticks).map_err(failed)?;
    }
    chained.outcome.map_err(|e| kept(e, ticks, "frames", &args.out))?;
    if ticks == 0 {
        return Err(Failure::new(format!(
            "{} is shorter than one tick of {}; there is no frame to write",
            args.input.display(),
            plan.slicing.tick_id()
        )));
    }
    eprintln!("{ticks} frames written to {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}
