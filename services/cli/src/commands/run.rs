//! `evpr run`, and what it shares with `evpr map build`.

use crate::args::{DeliveryArg, GraphRunArgs, RunArgs};
use crate::catalog;
use crate::comparison::{Comparison, Verdict};
use crate::dashboard::DashboardSocket;
use crate::failure::Failure;
use crate::kept::{self, KeptRun};
use crate::matches::{self, MatchWriter};
use crate::output::{refuse_input, say};
use crate::profile::metrics::MetricsServer;
use crate::profile::trace::TraceWriter;
use crate::progress;
use crate::{LOG_VARIABLE, QUIET_LOG};
use evpr_core::Plan;
use evpr_core::config::Overrides;
use evpr_core::message::{Candidate, MatchHeader, Span};
use evpr_core::plan::{Delivery, Service, ServiceKind};
use evpr_ingest::tape;
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
    for out in &args.out {
        let positions = plan.source.positions.as_ref().map(|p| p.path.as_path());
        let read = [Some(plan.source.path.as_path()), positions, plan.map.as_deref()];
        refuse_input(out, &read.into_iter().flatten().collect::<Vec<_>>())?;
    }
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
    let dashboard = DashboardSocket::open(args)?;
    let (plan, kept) = keep(plan, args)?;
    let plan = Plan {
        dashboard: dashboard.is_some(),
        ..plan
    };
    let outputs = open_matches(&plan, args, kept.as_ref()).map(|writers| Outputs {
        writers,
        trace,
        stats: args.graph.stats.clone(),
        quiet: args.graph.quiet,
        ..Outputs::default()
    });
    match outputs {
        Ok(outputs) => {
            let outputs = Outputs {
                kept,
                dashboard,
                ..outputs
            };
            supervise(plan, outputs, "matching")
        }
        Err(e) => {
            discard(&plan, kept);
            Err(e)
        }
    }
}

/// Begins what is kept of the run: its folder, and the tape of its events.
fn keep(mut plan: Plan, args: &RunArgs) -> Result<(Plan, Option<KeptRun>), Failure> {
    plan.record_events = match (&args.record_events, &args.keep) {
        (None, _) => None,
        (Some(Some(file)), _) => Some(file.clone()),
        (Some(None), Some(folder)) => Some(folder.join(kept::EVENTS)),
        (Some(None), None) => {
            return Err(Failure::usage(
                "--record-events: name the file, such as events.aedat4, or give --keep DIR too",
            ));
        }
    };
    if plan.record_events.is_some() && plan.source.frames.is_some() {
        return Err(Failure::new(format!(
            "{}: frames are no events; leave --record-events out",
            plan.source.path.display()
        )));
    }
    let config = &args.graph.config.config;
    let kept = args
        .keep
        .as_ref()
        .map(|path| KeptRun::create(path, config, &plan));
    let kept = kept.transpose()?;
    if let Some(events) = plan.record_events.clone() {
        let began = kept::absolute(&plan).and_then(|plan| Ok(tape::create(&events, &plan)?));
        if let Err(e) = began {
            kept.into_iter().for_each(KeptRun::discard);
            return Err(e);
        }
        plan.record_events = Some(std::path::absolute(events)?);
    }
    Ok((plan, kept))
}

/// Removes what was begun of a run that did not come to anything.
fn discard(plan: &Plan, kept: Option<KeptRun>) {
    if let Some(events) = &plan.record_events {
        tape::discard(events);
    }
    kept.into_iter().for_each(KeptRun::discard);
}

/// Where the matches go.
fn open_matches(plan: &Plan, args: &RunArgs, kept: Option<&KeptRun>) -> Result<Vec<MatchWriter>, Failure> {
    if plan.map.is_none() {
        return Ok(Vec::new());
    }
    let kept = kept.map(|kept| kept.file("matches.jsonl"));
    let mut outs: Vec<Option<&Path>> = args.out.iter().map(|out| Some(out.as_path())).collect();
    outs.extend(kept.as_deref().map(Some));
    if outs.is_empty() {
        outs.push(None);
    }
    let writers = outs.into_iter().map(MatchWriter::open);
    writers.collect::<Result<_, _>>().map_err(Failure::new)
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

/// What a run gives, beside what its graph does.
#[derive(Default)]
pub(crate) struct Outputs {
    pub(crate) writers: Vec<MatchWriter>,
    pub(crate) trace: Option<TraceWriter>,
    pub(crate) comparison: Option<Comparison>,
    pub(crate) kept: Option<KeptRun>,
    /// What the plan's dashboard serves at.
    pub(crate) dashboard: Option<DashboardSocket>,
    /// Where to write what each process took.
    pub(crate) stats: Option<PathBuf>,
    pub(crate) quiet: bool,
}

struct CliHooks {
    plan: Plan,
    outputs: Outputs,
    bar: ProgressBar,
}

impl Hooks for CliHooks {
    fn answer(&mut self, header: &MatchHeader, candidates: &[Candidate]) -> Result<(), String> {
        let line = matches::line(&self.plan, header, candidates);
        for writer in &mut self.outputs.writers {
            writer.write(&line)?;
        }
        match &mut self.outputs.comparison {
            Some(comparison) => comparison.answer(&line.to_json()?),
            None => Ok(()),
        }
    }

    fn progress(&mut self, progress: &Progress) {
        progress::show(&self.bar, progress);
    }

    fn wants_spans(&self) -> bool {
        self.outputs.trace.is_some()
    }

    fn spans(&mut self, service: usize, spans: &[Span]) {
        if let Some(trace) = &mut self.outputs.trace {
            trace.write(service, spans);
        }
    }
}

/// Runs a plan to its end, with a progress bar, and says what came of it.
pub(crate) fn supervise(plan: Plan, mut outputs: Outputs, what: &str) -> Result<ExitCode, Failure> {
    let quiet = outputs.quiet;
    let dashboard = outputs.dashboard.take();
    let mut hooks = CliHooks {
        plan: plan.clone(),
        outputs,
        bar: progress::bar(quiet, what),
    };
    let summary = run_graph(&plan, quiet, dashboard, &mut hooks);
    hooks.bar.finish_and_clear();
    let Outputs {
        writers,
        trace,
        comparison,
        kept,
        stats,
        ..
    } = hooks.outputs;
    let traced = trace.map(TraceWriter::finish).transpose();
    // Of a run that failed at its start there is nothing to tell.
    let failed_at_start = summary.as_ref().map_or(true, |summary| {
        summary.outcome == Outcome::Failed && summary.answers.max(recorded(summary)) == 0
    });
    let kept = match kept {
        kept if failed_at_start => {
            discard(&plan, kept);
            None
        }
        kept => kept,
    };
    let summary = summary?;
    traced.map_err(Failure::new)?;
    let written = writers.into_iter().try_for_each(MatchWriter::finish);
    written.map_err(Failure::new)?;
    if !quiet && !failed_at_start {
        summarise(&summary);
    }
    let kept_stats = kept.as_ref().map(|kept| kept.file("stats.json"));
    for path in stats.iter().chain(&kept_stats) {
        write_stats(&summary, path)?;
    }
    if let Some(kept) = kept {
        kept.finish(outcome_text(summary.outcome), summary.answers)?;
    }
    let verdict = comparison
        .map(Comparison::finish)
        .transpose()
        .map_err(Failure::new)?;
    let code = conclude(&plan, summary)?;
    verdict.map_or(Ok(code), |verdict| judge(&verdict).map(|()| code))
}

fn outcome_text(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Finished => "finished",
        Outcome::Stopped => "stopped",
        Outcome::Interrupted => "interrupted",
        Outcome::Failed => "failed",
    }
}

/// Says whether a replay gave the answers of its run.
fn judge(verdict: &Verdict) -> Result<(), Failure> {
    if let Some(difference) = &verdict.difference {
        return Err(Failure::new(difference));
    }
    if verdict.same == 0 {
        return Err(Failure::new(format!(
            "no answer could be compared: {} ticks have something missing in one of the two, {} are only in the run, {} only \
             in the replay",
            verdict.excused, verdict.only_run, verdict.only_replay
        )));
    }
    let mut line = format!("the same answers in {} ticks", verdict.same);
    for (count, what) in [
        (
            verdict.excused,
            "not compared, as something was dropped in them or in their history",
        ),
        (verdict.only_run, "only in the run"),
        (verdict.only_replay, "only in the replay"),
    ] {
        if count > 0 {
            line += &format!("; {count} {what}");
        }
    }
    say!("{line}");
    Ok(())
}

/// Runs the processes of a plan until all have ended. With `quiet_logs` they log only what is degraded or wrong.
/// `dashboard` is what the plan's dashboard serves at.
pub(crate) fn run_graph(
    plan: &Plan,
    quiet_logs: bool,
    dashboard: Option<DashboardSocket>,
    hooks: &mut dyn Hooks,
) -> Result<RunSummary, Failure> {
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
        if let (ServiceKind::Dashboard, Some(socket)) = (service.kind, &dashboard) {
            socket.hand_over(&mut command);
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
