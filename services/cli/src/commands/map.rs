//! `evpr map`: reference traverses.

use super::run::{Outputs, overrides, supervise};
use crate::args::{MapArgs, MapBuildArgs, MapCommand};
use crate::catalog;
use crate::failure::Failure;
use crate::output::say;
use evpr_store::Traverse;
use std::process::ExitCode;

/// `evpr map …`.
pub(crate) fn map(command: MapCommand) -> Result<ExitCode, Failure> {
    match command {
        MapCommand::Build(args) => build(&args),
        MapCommand::Info(args) => info(&args),
        MapCommand::Verify(args) => verify(&args),
        MapCommand::Repair(args) => repair(&args),
    }
}

fn build(args: &MapBuildArgs) -> Result<ExitCode, Failure> {
    if args.out.exists() {
        return Err(Failure::new(format!(
            "{} exists already; choose another name or remove it",
            args.out.display()
        )));
    }
    let plan = catalog::plan(
        &args.graph.config.config,
        &overrides(&args.graph, &None, &Some(args.out.clone())),
    )?;
    let code = supervise(
        plan,
        Outputs {
            stats: args.graph.stats.clone(),
            quiet: args.graph.quiet,
            ..Outputs::default()
        },
        "mapping",
    )?;
    if !args.out.exists() {
        eprintln!(
            "{}: stopped before the first tick was complete; there is no map",
            args.out.display()
        );
        return Ok(code);
    }
    let map = Traverse::open(&args.out)?;
    let members = &map.manifest().members;
    let empty: Vec<&str> = members
        .iter()
        .filter(|m| m.present == 0)
        .map(|m| m.name.as_str())
        .collect();
    if empty.len() == members.len() {
        return Err(Failure::new(format!(
            "{}: no member has a row in any of its {} ticks; nothing can be recognised with it",
            args.out.display(),
            map.len()
        )));
    }
    if !empty.is_empty() {
        tracing::warn!("members without a row in any tick: {}", empty.join(", "));
    }
    if !args.graph.quiet {
        eprintln!(
            "{}: {} ticks, {} members",
            args.out.display(),
            map.len(),
            map.manifest().members.len()
        );
    }
    Ok(code)
}

fn info(args: &MapArgs) -> Result<ExitCode, Failure> {
    let map = Traverse::open(&args.path)?;
    let manifest = map.manifest();
    if args.json {
        say!("{}", serde_json::to_string_pretty(manifest)?);
        return Ok(ExitCode::SUCCESS);
    }
    let positions = map.ticks().iter().filter(|t| t.position.is_some()).count();
    say!("sensor     {}", manifest.sensor);
    say!(
        "tick       {}, align {}",
        manifest.slicing.tick_id(),
        manifest.slicing.align.name()
    );
    say!("source     {}", manifest.source);
    say!("ticks      {}, {positions} with a position", map.len());
    if let (Some(first), Some(last)) = (map.ticks().first(), map.ticks().last()) {
        say!(
            "time       {} µs to {} µs ({:.1} s)",
            first.start_us,
            last.end_us,
            (last.end_us - first.start_us) as f64 / 1e6
        );
    }
    let width = manifest.members.iter().map(|m| m.name.len()).max().unwrap_or(6);
    say!("\n{:<width$}  {:>6}  {:>9}", "member", "dim", "with row");
    for m in &manifest.members {
        say!("{:<width$}  {:>6}  {:>9}", m.name, m.dim, m.present);
    }
    Ok(ExitCode::SUCCESS)
}

fn verify(args: &MapArgs) -> Result<ExitCode, Failure> {
    let summary = evpr_store::verify(&args.path)?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&summary)?);
    } else if summary.problems.is_empty() {
        say!("{}: ok, {} ticks", args.path.display(), summary.ticks);
    }
    if summary.problems.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    Err(Failure::new(summary.problems.join("\n")))
}

fn repair(args: &MapArgs) -> Result<ExitCode, Failure> {
    let summary = evpr_store::repair(&args.path)?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        say!("{}: closed with {} ticks", summary.path.display(), summary.ticks);
    }
    Ok(ExitCode::SUCCESS)
}
