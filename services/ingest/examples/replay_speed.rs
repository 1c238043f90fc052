//! Replays a recording into nothing and says how fast: `cargo run --release -p evpr-ingest --example replay_speed -- FILE`.

use evpr_core::message::{ChunkHeader, Event, TickHeader};
use evpr_core::plan::test_plan;
use evpr_core::stage::{IngestPort, Settings, StageError};
use evpr_ingest::Ingest;
use std::time::Instant;

/// Copies each chunk once, as the runtime does, and forgets it.
struct Nowhere {
    started: Instant,
    slots: Vec<Event>,
    chunks: u64,
    ticks: u64,
}

impl IngestPort for Nowhere {
    fn now_ns(&self) -> u64 {
        self.started.elapsed().as_nanos() as u64
    }

    fn chunk(
        &mut self,
        _: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError> {
        self.slots.resize(len.max(self.slots.len()), Event::default());
        fill(&mut self.slots[..len]);
        self.chunks += 1;
        Ok(())
    }

    fn tick(&mut self, _: TickHeader, _: &[f64]) -> Result<(), StageError> {
        self.ticks += 1;
        Ok(())
    }

    fn control(&mut self, _tick: u64) -> Option<Settings> {
        None
    }

    fn wait_until(&mut self, _: u64) -> Result<(), StageError> {
        Ok(())
    }

    fn progress(&mut self, _: u64, _: u64, _: u64, _: u64) {}
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args_os().nth(1).ok_or("name a recording")?;
    let mut plan = test_plan();
    plan.source.path = path.into();
    plan.sensor = evpr_ingest::probe(&plan.source)?.unwrap_or(evpr_core::plan::Sensor {
        height: 1 << 13,
        width: 1 << 13,
    });
    (plan.slicing.tick, plan.slicing.windows) = (500_000_000, vec![100_000_000, 250_000_000, 500_000_000]);
    for _ in 0..5 {
        let mut port = Nowhere {
            started: Instant::now(),
            slots: Vec::new(),
            chunks: 0,
            ticks: 0,
        };
        let (_keep, stop) = crossbeam::channel::bounded(0);
        let summary = Ingest::new(&plan, 0, 1, stop)?.run(&mut port)?;
        let seconds = port.started.elapsed().as_secs_f64();
        println!(
            "{} events in {seconds:.3} s: {:.1} M/s, {} chunks, {} tick messages",
            summary.sliced.sent,
            summary.sliced.sent as f64 / seconds / 1e6,
            port.chunks,
            port.ticks
        );
    }
    Ok(())
}
