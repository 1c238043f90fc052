//! Frames without a graph: ingest and reconstructions chained in this process.

use crate::failure::Failure;
use evpr_core::Plan;
use evpr_core::message::{ChunkHeader, Event, Frames, TickHeader, TickKind};
use evpr_core::stage::{IngestPort, Outlet, Settings, Stage, StageError};
use evpr_ingest::Ingest;
use evpr_reconstruct::Reconstruct;
use evpr_runtime::{Progress, Stop};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// What came of a chain.
#[derive(Debug)]
pub(crate) struct Chained {
    /// Whole ticks that the source has, as far as it was read.
    pub(crate) ticks: u64,
    /// Why it was not read to its end, or what is missing.
    pub(crate) outcome: Result<(), StageError>,
}

/// Sends the plan's source through these of its reconstructions into `out`, until it ends, `out` stops it, or `stop` is
/// set.
///
/// # Errors
/// When the source cannot be opened, or the plan not be used.
pub(crate) fn run(
    plan: &Plan,
    which: Range<usize>,
    out: &mut dyn Outlet<Frames>,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Chained, Failure> {
    let stages = which.map(|index| evpr_reconstruct::build(plan, index));
    let raised = Stop::new();
    let ingest = Ingest::new(plan, 0, 1, raised.signal().clone())?;
    let mut chain = Chain {
        stages: stages.collect::<Result<_, _>>()?,
        out,
        stop,
        progress,
        events: Vec::new(),
        seq: 0,
        end: None,
    };
    let outcome = ingest.run(&mut chain).map(|_| ());
    Ok(Chained {
        ticks: chain.end.unwrap_or(0),
        outcome,
    })
}

/// The port that ingest sends to.
struct Chain<'a> {
    stages: Vec<Reconstruct>,
    out: &'a mut dyn Outlet<Frames>,
    stop: &'a AtomicBool,
    progress: &'a mut dyn FnMut(&Progress),
    events: Vec<Event>,
    seq: u64,
    /// The tick at which the source ended, once it has.
    end: Option<u64>,
}

impl IngestPort for Chain<'_> {
    fn now_ns(&self) -> u64 {
        evpr_runtime::now_ns()
    }

    fn chunk(
        &mut self,
        mut header: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(StageError::Stopped);
        }
        self.events.clear();
        self.events.resize(len, Event::default());
        fill(&mut self.events);
        header.stamp.seq = self.seq;
        self.seq += 1;
        for stage in &mut self.stages {
            stage.process(&header, &self.events, self.out)?;
        }
        Ok(())
    }

    fn tick(&mut self, header: TickHeader, _weights: &[f64]) -> Result<(), StageError> {
        if header.kind == TickKind::End as u32 {
            self.end = Some(header.tick);
        }
        Ok(())
    }

    fn control(&mut self, _tick: u64) -> Option<Settings> {
        None
    }

    fn wait_until(&mut self, _ns: u64) -> Result<(), StageError> {
        Ok(())
    }

    fn progress(&mut self, permille: u64, next_tick: u64, events: u64, _skipped: u64) {
        (self.progress)(&Progress {
            permille,
            events,
            answers: next_tick,
            recorded: 0,
        });
    }
}
