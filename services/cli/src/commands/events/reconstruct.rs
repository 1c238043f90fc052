//! `evpr events reconstruct`.

use super::chain::{Chain, offline_plan};
use crate::args::ReconstructArgs;
use crate::failure::Failure;
use crate::frames_npy::FramesWriter;
use crate::output::refuse_input;
use evpr_core::message::{FrameHeader, Frames};
use evpr_core::plan::Sensor;
use evpr_core::stage::{Outlet, StageError};
use std::path::Path;
use std::process::ExitCode;

struct WriteFrames<'a> {
    writer: FramesWriter,
    path: &'a Path,
    frame: Vec<u8>,
}

impl Outlet<Frames> for WriteFrames<'_> {
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
        self.writer
            .write(header.tick, &self.frame)
            .map_err(|e| StageError::Fatal(format!("cannot write {}: {e}", self.path.display())))
    }
}

pub(super) fn reconstruct(args: &ReconstructArgs) -> Result<ExitCode, Failure> {
    refuse_input(&args.out, &[&args.input])?;
    let plan = offline_plan(args)?;
    let Sensor { height, width } = plan.sensor;
    let writer = FramesWriter::create(&args.out, height, width, plan.reconstructions[0].channels)
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", args.out.display())))?;
    let out = WriteFrames {
        writer,
        path: &args.out,
        frame: Vec::new(),
    };
    let mut chain = Chain::new(&plan, out, "reconstructing")?;
    let stop = evpr_runtime::Stop::new();
    let ingest = evpr_ingest::Ingest::new(&plan, 0, 1, stop.signal().clone())?;
    let outcome = ingest.run(&mut chain);
    chain.bar.finish_and_clear();
    // A recording that fails in its middle has an end too: the array then holds the ticks before.
    let ticks = chain.end.unwrap_or(0);
    chain
        .out
        .writer
        .finish(ticks)
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", args.out.display())))?;
    outcome?;
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
