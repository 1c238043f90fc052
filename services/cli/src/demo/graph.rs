//! One drive through the process graph.

use crate::commands::run::run_graph;
use crate::failure::Failure;
use crate::matches::{self, MatchWriter};
use crate::progress;
use evpr_core::Plan;
use evpr_core::message::{Candidate, MatchHeader};
use evpr_core::plan::ServiceKind;
use evpr_runtime::{Hooks, Outcome, Progress, RunSummary};
use indicatif::ProgressBar;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// What a drive through the graph came to.
#[derive(Debug)]
pub(crate) struct Drive {
    /// The answers, one per tick, in order; none without a map.
    pub(crate) answers: Vec<MatchHeader>,
    /// Counters of the processes.
    pub(crate) summary: RunSummary,
    /// From the start of the first process to the end of the last, seconds.
    pub(crate) took_s: f64,
}

impl Drive {
    /// Events that ingest sent.
    pub(crate) fn events(&self) -> u64 {
        let ingest = self.summary.services.iter();
        let mut ingest = ingest.filter(|s| s.kind == ServiceKind::Ingest);
        ingest.next().map_or(0, |s| s.stats.events)
    }
}

/// How a drive ended.
#[derive(Debug)]
pub(crate) enum Driven {
    /// At the end of the street.
    Whole(Drive),
    /// It was asked to end before: with what the command ends.
    CutShort(ExitCode),
}

struct Watch<'a> {
    plan: &'a Plan,
    writer: Option<MatchWriter>,
    bar: ProgressBar,
    answers: Vec<MatchHeader>,
}

impl Hooks for Watch<'_> {
    fn answer(&mut self, header: &MatchHeader, candidates: &[Candidate]) -> Result<(), String> {
        self.answers.push(*header);
        match &mut self.writer {
            Some(writer) => writer.write(&matches::line(self.plan, header, candidates)),
            None => Ok(()),
        }
    }

    fn progress(&mut self, progress: &Progress) {
        progress::show(&self.bar, progress);
    }
}

/// What Ctrl-C and SIGTERM do. While the graph runs it ends in an orderly way; at all other times the command ends at
/// once, which it would not by itself: who has listened for a signal once has no default any more.
#[derive(Debug)]
pub(crate) struct Signals {
    at_once: Arc<AtomicBool>,
}

impl Signals {
    /// Takes the signals over.
    ///
    /// # Errors
    /// When the system refuses it.
    pub(crate) fn take() -> Result<Self, Failure> {
        let at_once = Arc::new(AtomicBool::new(true));
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register_conditional_default(signal, Arc::clone(&at_once))
                .map_err(|e| Failure::new(format!("cannot listen for signals: {e}")))?;
        }
        Ok(Self { at_once })
    }
}

/// Runs a plan to its end. Answers also go to the file `matches`, where there is one. `what` is the text of the
/// progress bar.
///
/// # Errors
/// When the graph cannot be started or one of its processes fails for good.
pub(crate) fn drive(
    signals: &Signals,
    plan: &Plan,
    matches: Option<&Path>,
    quiet: bool,
    what: &str,
) -> Result<Driven, Failure> {
    let writer = matches.map(|path| MatchWriter::open(Some(path))).transpose();
    let mut watch = Watch {
        plan,
        writer: writer.map_err(Failure::new)?,
        bar: progress::bar(quiet, what),
        answers: Vec::new(),
    };
    let start = Instant::now();
    signals.at_once.store(false, Ordering::Release);
    let summary = run_graph(plan, true, None, &mut watch);
    signals.at_once.store(true, Ordering::Release);
    watch.bar.finish_and_clear();
    let summary = summary?;
    match summary.outcome {
        Outcome::Finished => Ok(Driven::Whole(Drive {
            answers: watch.answers,
            summary,
            took_s: start.elapsed().as_secs_f64(),
        })),
        Outcome::Interrupted => Ok(Driven::CutShort(ExitCode::from(
            crate::commands::run::EXIT_INTERRUPTED,
        ))),
        Outcome::Stopped => Ok(Driven::CutShort(ExitCode::SUCCESS)),
        Outcome::Failed => Err(summary.failure.map_or_else(Failure::said_already, Failure::new)),
    }
}
