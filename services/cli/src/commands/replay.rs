//! `evpr replay`: a recorded run once more, and whether it gives the same answers.

use super::run::{Outputs, supervise};
use crate::args::ReplayArgs;
use crate::comparison::Comparison;
use crate::failure::Failure;
use crate::kept;
use crate::matches::MatchWriter;
use crate::output::refuse_input;
use evpr_store::Traverse;
use std::path::Path;
use std::process::ExitCode;

/// `evpr replay`.
pub(crate) fn replay(args: &ReplayArgs) -> Result<ExitCode, Failure> {
    let kept::Replayable { mut plan, matches } = kept::open(&args.path, args.map.as_deref())?;
    if let Some(name) = &args.name {
        plan.name.clone_from(name);
    }
    if let Some(pace) = args.pace {
        plan.source.pace = pace;
    }
    let Some(map) = &plan.map else {
        return Err(Failure::new(format!(
            "{}: the run matched against no map, so there are no answers to give again; name a map with --map",
            args.path.display()
        )));
    };
    Traverse::open(map)?.check_against(&plan)?;
    for out in &args.out {
        refuse_input(out, &[&args.path, plan.source.path.as_path(), map])?;
    }
    let comparison = match &args.check {
        None => None,
        Some(Some(path)) => Some(path.clone()),
        Some(None) => Some(matches.ok_or_else(|| {
            Failure::usage(format!(
                "{}: there are no answers of the run with it; name them, as in --check=matches.jsonl",
                args.path.display()
            ))
        })?),
    };
    let history = plan.fuse.history_ticks();
    let comparison = comparison.map(|path| Comparison::open(&path, history));
    let comparison = comparison.transpose().map_err(Failure::new)?;
    let outs: Vec<Option<&Path>> = match (&args.out[..], &comparison) {
        ([], None) => vec![None],
        (outs, _) => outs.iter().map(|out| Some(out.as_path())).collect(),
    };
    let writers = outs.into_iter().map(MatchWriter::open);
    let outputs = Outputs {
        writers: writers.collect::<Result<_, _>>().map_err(Failure::new)?,
        comparison,
        stats: args.stats.clone(),
        quiet: args.quiet,
        ..Outputs::default()
    };
    supervise(plan, outputs, "replaying")
}
