//! `evpr run`, and what it shares with `evpr map build`.

use crate::args::{DeliveryArg, GraphRunArgs, RunArgs};
use crate::catalog;
use crate::failure::Failure;
use crate::matches::MatchWriter;
use crate::output::refuse_input;
use crate::profile::metrics::MetricsServer;
use crate::profile::trace::TraceWriter;
use crate::progress;
use crate::{LOG_VARIABLE, QUIET_LOG};
use evpr_core::Plan;
use evpr_core::config::Overrides;
use evpr_core::message::{Candidate, MatchHeader, Span};
use evpr_core::plan::{Delivery, Service, ServiceKind};
use evpr_runtime::{Hooks, Outcome, Progress, RunFolder, RunSummary, Spawn, Supervisor};
use indicatif::ProgressBar;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use tracing::warn;

/// Ctrl-C.
pub(crate) const EXIT_INTERRUPTED: u8 = 130;

/// `evpr run`.
pub(crate) fn run(args: &RunArgs) -> Result<ExitCode, Failure> {
    if args.map.is_none() && args.record.is_none() {
        return Err(Failure::usage(
            "there is nothing to do: give --map DIR to match against a map, or --record DIR to record rows (a map is \
             built by `evpr map build`)",
        ));
    }
    let plan = catalog::plan(
        &args.graph.config.config,
        &overrides(&args.graph, &args.map, &args.record),
    )?;
    if let Some(map) = &plan.map {
        // The fuser checks again; here a wrong map is refused before anything is started.
        evpr_store::Traverse::open(map)?.check_against(&plan)?;
    }
    if let Some(out) = &args.out {
        let positions = plan.source.positions.as_ref().map(|p| p.path.as_path());
        let read = [Some(plan.source.path.as_path()), positions, plan.map.as_deref()];
        refuse_input(out, &read.into_iter().flatten().collect::<Vec<_>>())?;
    }
    let writer = match &plan.map {
        Some(_) => Some(MatchWriter::open(args.out.as_deref()).map_err(Failure::new)?),
        None => None,
    };
    let trace = match &args.trace {
        Some(path) => {
            let read = [Some(plan.source.path.as_path()), plan.map.as_deref()];
            refuse_input(path, &read.into_iter().flatten().collect::<Vec<_>>())?;
            Some(TraceWriter::create(path, &plan).map_err(Failure::new)?)
        }
        None => None,
    };
    let metrics = args
        .metrics
        .map(|address| MetricsServer::start(address, &plan.name));
    let metrics = metrics.transpose()?;
    if let Some(server) = &metrics {
        tracing::info!("metrics at http://{}/metrics", server.address());
    }
    supervise(plan, writer, trace, &args.graph, "matching")
}

/// The command line's part of the plan.
pub(crate) fn overrides(args: &GraphRunArgs, map: &Option<PathBuf>, record: &Option<PathBuf>) -> Overrides {
    Overrides {
        name: args.name.clone(),
        input: args.input.clone(),
        positions: args.positions.clone(),
        pace: args.pace,
        delivery: args.delivery.map(|d| match d {
            DeliveryArg::Lossless => Delivery::Lossless,
            DeliveryArg::Latest => Delivery::Latest,
        }),
        map: map.clone(),
        record: record.clone(),
    }
}

struct CliHooks {
    plan: Plan,
    writer: Option<MatchWriter>,
    trace: Option<TraceWriter>,
    bar: ProgressBar,
}

impl Hooks for CliHooks {
    fn answer(&mut self, header: &MatchHeader, candidates: &[Candidate]) -> Result<(), String> {
        match &mut self.writer {
            Some(writer) => writer.write(&self.plan, header, candidates),
            None => Ok(()),
        }
    }

    fn progress(&mut self, progress: &Progress) {
        progress::show(&self.bar, progress);
    }

    fn wants_spans(&self) -> bool {
        self.trace.is_some()
    }

    fn spans(&mut self, service: usize, spans: &[Span]) {
        if let Some(trace) = &mut self.trace {
            trace.write(service, spans);
        }
    }
}

/// Runs a plan to its end, with a progress bar, and says what came of it.
pub(crate) fn supervise(
    plan: Plan,
    writer: Option<MatchWriter>,
    trace: Option<TraceWriter>,
    args: &GraphRunArgs,
    what: &str,
) -> Result<ExitCode, Failure> {
    let quiet = args.quiet;
    let mut hooks = CliHooks {
        plan: plan.clone(),
        writer,
        trace,
        bar: progress::bar(quiet, what),
    };
    let summary = run_graph(&plan, quiet, &mut hooks);
    hooks.bar.finish_and_clear();
    let traced = hooks.trace.take().map(TraceWriter::finish).transpose();
    let summary = summary?;
    traced.map_err(Failure::new)?;
    // Of a run that failed at its start there is nothing to tell.
    let failed_at_start = summary.outcome == Outcome::Failed && summary.answers.max(recorded(&summary)) == 0;
    if !quiet && !failed_at_start {
        summarise(&summary);
    }
    if let Some(path) = &args.stats {
        write_stats(&summary, path)?;
    }
    conclude(&plan, summary)
}

/// Runs the processes of a plan until all have ended. With `quiet_logs` they log only what is degraded or wrong.
pub(crate) fn run_graph(plan: &Plan, quiet_logs: bool, hooks: &mut dyn Hooks) -> Result<RunSummary, Failure> {
    let folder = RunFolder::of_instance(&plan.name);
    let executable = std::env::current_exe()?;
    let run_folder = folder.path().to_owned();
    let reads_stdin = plan.source.is_stdin();
    let placements = plan.clone();
    let command = move |service: &Service, spawn: &Spawn| {
        let launcher = placements.placement_of(service).map_or(&[][..], |p| &p.launcher);
        let mut command = service_command(&executable, launcher, &run_folder, service, spawn);
        if reads_stdin && service.kind == ServiceKind::Ingest {
            command.stdin(Stdio::inherit());
        }
        if quiet_logs && std::env::var_os(LOG_VARIABLE).is_none() {
            command.env(LOG_VARIABLE, QUIET_LOG);
        }
        command
    };
    let supervisor = Supervisor::new(plan.clone(), folder, Box::new(command))?;
    Ok(supervisor.run(hooks)?)
}

/// Ticks recorded.
fn recorded(summary: &RunSummary) -> u64 {
    let mut services = summary.services.iter();
    let recorder = services.find(|s| s.kind == ServiceKind::Record);
    recorder.map_or(0, |s| s.stats.next_tick)
}

/// What the run's end means for who started it.
fn conclude(plan: &Plan, summary: RunSummary) -> Result<ExitCode, Failure> {
    let recorded = recorded(&summary);
    match summary.outcome {
        Outcome::Finished if summary.answers.max(recorded) == 0 => Err(Failure::new(format!(
            "{}: no tick ({}) is complete, so there is nothing to {}; use a longer recording, or a shorter tick",
            plan.source.path.display(),
            plan.slicing.tick_id(),
            if plan.map.is_some() { "match" } else { "record" }
        ))),
        Outcome::Finished | Outcome::Stopped => Ok(ExitCode::SUCCESS),
        Outcome::Interrupted => Ok(ExitCode::from(EXIT_INTERRUPTED)),
        Outcome::Failed => {
            if let Some(path) = plan.record.as_ref().filter(|path| recorded > 0 && path.exists()) {
                warn!(
                    "{}: the {recorded} ticks before the failure are kept",
                    path.display()
                );
            }
            Err(summary.failure.map_or_else(Failure::said_already, Failure::new))
        }
    }
}

fn service_command(
    executable: &Path,
    launcher: &[String],
    run_folder: &Path,
    service: &Service,
    spawn: &Spawn,
) -> Command {
    let process = service.name.replace('/', "-");
    let mut launcher = launcher.iter().map(|word| word.replace("{process}", &process));
    let mut command = match launcher.next() {
        Some(program) => {
            let mut command = Command::new(program);
            command.args(launcher).arg(executable);
            command
        }
        None => Command::new(executable),
    };
    command
        .arg("service")
        .arg(service.kind.name())
        .arg("--run-folder")
        .arg(run_folder);
    for (name, value) in [
        ("--service", spawn.service.to_string()),
        ("--incarnation", spawn.incarnation.to_string()),
        ("--epoch", spawn.epoch.to_string()),
        ("--first-tick", spawn.first_tick.to_string()),
        ("--answer-from", spawn.answer_from.to_string()),
    ] {
        command.args([name, &value]);
    }
    if let Some(tick) = spawn.end_tick {
        command.args(["--end-tick", &tick.to_string()]);
    }
    // A process group of its own: Ctrl-C reaches the supervisor alone, which ends the graph upstream first.
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .process_group(0);
    command
}

/// Writes what each process took.
fn write_stats(summary: &RunSummary, path: &Path) -> Result<(), Failure> {
    #[derive(serde::Serialize)]
    struct Process {
        process: String,
        messages: u64,
        mean_us: f64,
        p50_us: f64,
        p99_us: f64,
        restarts: u64,
    }
    let us = |ns: u64| ns as f64 / 1e3;
    let process = |s: &evpr_runtime::ServiceReport| Process {
        process: s.name.clone(),
        messages: s.stats.received,
        mean_us: us(s.stats.processing.mean_ns()),
        p50_us: us(s.stats.processing.quantile_ns(0.5)),
        p99_us: us(s.stats.processing.quantile_ns(0.99)),
        restarts: s.restarts,
    };
    let processes: Vec<Process> = summary.services.iter().map(process).collect();
    let ticks = summary.answers.max(recorded(summary));
    let stats = serde_json::json!({ "ticks": ticks, "processes": processes });
    let text = serde_json::to_string_pretty(&stats)? + "\n";
    std::fs::write(path, text)
        .map_err(|e| Failure::new(format!("{}: cannot be written: {e}", path.display())))
}

fn summarise(summary: &RunSummary) {
    let width = summary.services.iter().map(|s| s.name.len()).max().unwrap_or(0);
    let ms = |ns: u64| ns as f64 / 1e6;
    eprintln!(
        "{:<width$}  {:>9}  {:>9}  {:>7}  {:>7}  {:>13}  {:>13}  {:>8}",
        "process", "received", "emitted", "skipped", "dropped", "p50 ms", "p99 ms", "restarts"
    );
    for s in &summary.services {
        let (stats, took) = (&s.stats, &s.stats.processing);
        eprintln!(
            "{:<width$}  {:>9}  {:>9}  {:>7}  {:>7}  {:>13.3}  {:>13.3}  {:>8}",
            s.name,
            stats.received,
            stats.emitted,
            stats.skipped,
            stats.dropped,
            ms(took.quantile_ns(0.5)),
            ms(took.quantile_ns(0.99)),
            s.restarts
        );
    }
    let live = summary.services.iter().map(|s| &s.stats.live);
    for live in live.filter(|live| live.is_live != 0) {
        eprintln!(
            "live: {} ticks dropped, {} missed, {} disconnects, {} events late; delay p50 {:.3} ms, p99 {:.3} ms; clock drift \
             {:+.3} ppm",
            live.dropped_ticks,
            live.missed_ticks,
            live.disconnects,
            live.late_events,
            ms(live.delay_p50_ns),
            ms(live.delay_p99_ns),
            live.drift_ppb as f64 / 1e3
        );
    }
    if summary.answers > 0 {
        eprintln!("{} ticks answered", summary.answers);
    }
}
