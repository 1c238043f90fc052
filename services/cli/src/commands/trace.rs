//! `evpr trace`: what the processes of a running instance do when.

use crate::args::TraceArgs;
use crate::failure::Failure;
use crate::profile::trace::TraceWriter;
use evpr_runtime::{RunFolder, Stop, TraceReader};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// `evpr trace`.
pub(crate) fn trace(args: &TraceArgs) -> Result<ExitCode, Failure> {
    let reader = TraceReader::join(RunFolder::of_instance(&args.name))?;
    let mut writer = TraceWriter::create(&args.out, reader.plan()).map_err(Failure::new)?;
    let stop = Stop::on_signals()?;
    let ends = Instant::now() + Duration::from_nanos(args.duration);
    let mut there = true;
    while there && !stop.requested() {
        let left = ends.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        there = reader.read(left, &mut |service, spans| writer.write(service, spans))?;
    }
    let events = writer.finish().map_err(Failure::new)?;
    if reader.lost() > 0 {
        eprintln!(
            "{} batches of up to 128 spans came too fast and are not in the trace",
            reader.lost()
        );
    }
    eprintln!(
        "{}: {events} events; open it at https://ui.perfetto.dev or chrome://tracing",
        args.out.display()
    );
    Ok(ExitCode::SUCCESS)
}
