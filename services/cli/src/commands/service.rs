//! `evpr service`: one process of a running graph.

use crate::args::ServiceArgs;
use crate::dashboard;
use crate::failure::Failure;
use evpr_core::Plan;
use evpr_core::plan::{Delivery, ServiceKind, Topic};
use evpr_core::stage::{IngestPort, StageError};
use evpr_ingest::tape::{Recorder, TapeIngest, Taped};
use evpr_runtime::{RunFolder, ServiceContext, run_ingest, run_sink, run_stage};
use std::process::ExitCode;

/// Joins the run and works until it is told to stop.
pub(crate) fn service(args: &ServiceArgs) -> Result<ExitCode, Failure> {
    let ctx = ServiceContext::join(RunFolder::at(&args.run_folder), args.service, args.incarnation)?;
    evpr_runtime::use_processors(&ctx.plan, &ctx.service)?;
    work(ctx, args)?;
    Ok(ExitCode::SUCCESS)
}

/// The same work; what it sends is recorded where the plan wants that.
fn taped<W>(
    plan: &Plan,
    work: W,
) -> Result<impl FnOnce(&mut dyn IngestPort) -> Result<(), StageError> + use<W>, Failure>
where
    W: FnOnce(&mut dyn IngestPort) -> Result<(), StageError>,
{
    let recorder = Recorder::resume(plan)?;
    Ok(move |port: &mut dyn IngestPort| match &recorder {
        Some(recorder) => work(&mut Taped::new(port, recorder)),
        None => work(port),
    })
}

fn work(ctx: ServiceContext, args: &ServiceArgs) -> Result<(), Failure> {
    let plan = ctx.plan.clone();
    let index = ctx.service.index;
    match ctx.service.kind {
        ServiceKind::Ingest if plan.source.is_tape() => {
            let stop = ctx.stop().signal().clone();
            let tape = TapeIngest::new(&plan, args.first_tick, args.epoch, stop)?;
            run_ingest(ctx, args.end_tick, |port| tape.run(port))?;
        }
        ServiceKind::Ingest if plan.source.frames.is_some() => {
            let stop = ctx.stop().signal().clone();
            let ingest = evpr_ingest::FrameIngest::new(&plan, args.first_tick, args.epoch, stop)?;
            run_ingest(ctx, args.end_tick, |port| ingest.run(port))?;
        }
        ServiceKind::Ingest => {
            if plan.source.live.is_some() {
                let stop = ctx.stop().signal().clone();
                // Killed by the very request to end, before it could hear it.
                if plan.source.is_stdin() && args.epoch > 1 && args.end_tick.is_some() {
                    let end = |port: &mut dyn IngestPort| {
                        evpr_ingest::Live::end_at(&plan, args.first_tick, args.epoch, port).map(|_| ())
                    };
                    return Ok(run_ingest(ctx, args.end_tick, end)?);
                }
                let live = evpr_ingest::Live::new(&plan, args.first_tick, args.epoch, stop)?;
                let work = |port: &mut dyn IngestPort| live.run(port).map(|_| ());
                return Ok(run_ingest(ctx, args.end_tick, taped(&plan, work)?)?);
            }
            let ingest =
                evpr_ingest::Ingest::new(&plan, args.first_tick, args.epoch, ctx.stop().signal().clone())?;
            let work = |port: &mut dyn IngestPort| ingest.run(port).map(|_| ());
            run_ingest(ctx, args.end_tick, taped(&plan, work)?)?;
        }
        ServiceKind::Reconstruct => {
            let output = Topic::Frames(plan.reconstructions[index].id.clone());
            if plan.source.frames.is_some() {
                let mut stage = evpr_reconstruct::build_frames(&plan, index)?;
                run_stage(ctx, &[Topic::Events], &output, &mut stage)?;
            } else {
                let mut stage = evpr_reconstruct::build(&plan, index)?;
                run_stage(ctx, &[Topic::Events], &output, &mut stage)?;
            }
        }
        ServiceKind::Extract => {
            let mut stage = evpr_extract::build(&plan, index)?;
            let inputs: Vec<_> = plan
                .reconstructions
                .iter()
                .map(|r| Topic::Frames(r.id.clone()))
                .collect();
            let output = Topic::Descriptors(plan.extractors[index].id.clone());
            run_stage(ctx, &inputs, &output, &mut stage)?;
        }
        ServiceKind::Fuse => {
            let map = evpr_fuse::Map::open(&plan)?;
            let references = map.references;
            let clock = Box::new(evpr_runtime::now_ns);
            let mut fuser = evpr_fuse::Fuser::new(&plan, map, args.first_tick, args.answer_from, clock)?;
            // In lossless delivery ingest goes back for what a new fuser has to see.
            if plan.delivery == Delivery::Latest {
                let (path, run_id) = (ctx.kept_file(), ctx.identity.run_id);
                let history = evpr_fuse::History::open(&path, &plan, references, run_id)?;
                fuser = fuser.with_history(&plan, history);
            }
            if let Some(scores) = ctx.scores()? {
                fuser.observe(dashboard::observer(scores, plan.members.len()));
            }
            run_sink(ctx, &mut fuser, true)?;
        }
        ServiceKind::Record => {
            let mut recorder = evpr_record::Recorder::new(&plan, args.incarnation > 1)?;
            run_sink(ctx, &mut recorder, false)?;
        }
        ServiceKind::Dashboard => dashboard::work(ctx)?,
    }
    Ok(())
}
