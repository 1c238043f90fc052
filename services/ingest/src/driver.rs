//! The driver: recording, screen, slicer and pace, run as one.

use crate::noise::Memory;
use crate::pace::Pace;
use crate::placed::Placed;
use crate::reader::{Reader, next_screened};
use crate::span::Span;
use crate::{Noise, NoiseTally, RawEvent, Screen, ScreenTally, SliceTally, Slicer, SourceError, source};
use crossbeam::channel::{Receiver, TryRecvError};
use evpr_core::plan::{self, OnBadEvent, Plan};
use evpr_core::stage::{IngestPort, StageError};
use evpr_events::positions::Track;
use evpr_events::{Recording, Trajectory, positions, seconds};

/// What a run of ingest came to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct IngestSummary {
    /// The tick that the stream ends at: the first that is not whole.
    pub end_tick: u64,
    /// What the screen left out or changed.
    pub screened: ScreenTally,
    /// What was left out as noise.
    pub noise: NoiseTally,
    /// What became of the events that passed it.
    pub sliced: SliceTally,
    /// True when it was asked to stop before the recording ended.
    pub stopped: bool,
}

/// Reads a recording and sends its chunks and ticks.
///
/// Unpaced, it goes as fast as the port takes chunks, and two runs send the same but for the times of the host.
/// Paced, no chunk leaves before its last event is due, a chunk holds at most 10 ms of wall time, and windows close
/// when they are due even if no event comes; a port that blocks makes it late, and it then catches up.
pub struct Ingest {
    recording: Box<dyn Recording>,
    screen: Screen,
    noise: Noise,
    /// Read before the start, to find the origin.
    first: Option<Vec<RawEvent>>,
    /// Where the camera was, when the plan names a file that says it.
    track: Option<Track>,
    replay: Replay,
}

/// What becomes of the events once they are decoded.
struct Replay {
    slicer: Slicer,
    factor: Option<f64>,
    pace: Option<Pace>,
    chunk_events: usize,
    stop: Receiver<()>,
    described: String,
    screened: ScreenTally,
    noise: NoiseTally,
    progress_permille: u64,
}

impl std::fmt::Debug for Ingest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ingest")
            .field("recording", &self.replay.described)
            .finish_non_exhaustive()
    }
}

impl Ingest {
    /// Opens the plan's recording. With `resume_tick` above 0 the stream begins at that tick: the origin is found as
    /// always, earlier events are left out, and windows that reach back beyond it come out incomplete. `epoch` counts
    /// the starts of ingest, from 1. `stop` becomes ready, or disconnects, when ingest is to stop.
    ///
    /// # Errors
    /// When the recording cannot be opened, or with `resume_tick` above 0 its first events cannot be read.
    pub fn new(plan: &Plan, resume_tick: u64, epoch: u32, stop: Receiver<()>) -> Result<Self, SourceError> {
        let recording = source::open(&plan.source)?;
        let about = recording.describe();
        tracing::info!(
            format = about.format,
            path = %about.path.display(),
            time_unit = about.time_unit,
            time_unit_from = about.time_unit_from,
            events = about.events,
            resume_tick,
            "recording opened"
        );
        let track = track(plan)?;
        let replay = Replay {
            slicer: Slicer::new(plan, resume_tick, epoch),
            factor: match plan.source.pace {
                plan::Pace::Unpaced => None,
                plan::Pace::Factor(factor) => Some(factor),
            },
            pace: None,
            chunk_events: plan.chunk_events(),
            stop,
            described: about.path.display().to_string(),
            screened: ScreenTally::default(),
            noise: NoiseTally::default(),
            progress_permille: 0,
        };
        let mut ingest = Self {
            recording,
            screen: Screen::new(plan).within(Span::new(plan, track.as_ref())),
            noise: Noise::new(plan)?,
            first: None,
            track,
            replay,
        };
        if resume_tick > 0 {
            // Only where times are known not to go back may the recording be searched by time.
            ingest.find_resume(plan.source.on_backward_time == OnBadEvent::Error)?;
        }
        Ok(ingest)
    }

    fn find_resume(&mut self, ordered: bool) -> Result<(), SourceError> {
        // The filters have to see again what they remember of the time before.
        let seen_before_ns = match self.noise.memory() {
            Memory::Ns(ns) => Some(ns),
            Memory::All => None,
        };
        let mut first = Vec::new();
        loop {
            let more = next_screened(self.recording.as_mut(), &mut self.screen, &mut first)?;
            let Some(event) = first.first() else {
                if more {
                    continue;
                }
                break;
            };
            self.replay.slicer.anchor(event.t_ns);
            if ordered
                && let Some(start) = self.replay.slicer.start_ns()
                && let Some(before_ns) = seen_before_ns
                && let Some(index) = self.recording.seek_before(start.saturating_sub(before_ns))?
            {
                self.screen.restart(index);
            } else {
                self.first = Some(first);
            }
            break;
        }
        Ok(())
    }

    /// Runs until the recording ends, it fails, or the stop signal comes; then says where the stream ends.
    ///
    /// # Errors
    /// [`StageError::Fatal`] when the recording could not be read to its end, or the port broke. Everything before
    /// that has been sent, the end included.
    pub fn run(self, port: &mut dyn IngestPort) -> Result<IngestSummary, StageError> {
        let Self {
            recording,
            screen,
            noise,
            first,
            track,
            mut replay,
        } = self;
        let trajectory = match track {
            Some(track) => Some(Box::new(track) as Box<dyn Trajectory>),
            None => recording.trajectory(),
        };
        let port = &mut Placed { port, trajectory };
        let reader = match Reader::spawn(recording, screen, noise, first) {
            Ok(reader) => reader,
            Err(e) => return replay.end(Err(fatal(&e)), port),
        };
        let outcome = replay.follow(&reader, port);
        let outcome = match (reader.join(), outcome) {
            (false, Ok(false)) => Err(StageError::Fatal(format!(
                "{}: decoding it panicked",
                replay.described
            ))),
            (_, outcome) => outcome,
        };
        replay.end(outcome, port)
    }
}

impl Replay {
    /// Sends all batches. True when it was stopped.
    fn follow(&mut self, reader: &Reader, port: &mut dyn IngestPort) -> Result<bool, StageError> {
        let stop = self.stop.clone();
        loop {
            // A full channel must not outshout the request to stop.
            if stop.try_recv() != Err(TryRecvError::Empty) {
                return Ok(true);
            }
            let received = crossbeam::select! {
                recv(stop) -> _ => return Ok(true),
                recv(reader.batches) -> batch => batch,
            };
            let Ok(batch) = received else { return Ok(false) };
            let batch = batch.map_err(|e| fatal(&e))?;
            (self.screened, self.noise) = (batch.screened, batch.noise);
            self.progress_permille = batch.progress_permille;
            // Noise or not: it says when the recording begins, and how far it has come.
            if let Some(first_ns) = batch.first_ns {
                self.slicer.anchor(first_ns);
            }
            match self.factor {
                None => self.slicer.push(&batch.events, port)?,
                Some(factor) => self.push_paced(&batch.events, factor, port)?,
            }
            if let Some(last) = batch.last {
                self.close_before(&last, port)?;
            }
            reader.recycle(batch.events);
            self.report(port);
        }
    }

    fn push_paced(
        &mut self,
        events: &[RawEvent],
        factor: f64,
        port: &mut dyn IngestPort,
    ) -> Result<(), StageError> {
        let mut rest = self.slicer.skip(events);
        while let Some(first) = rest.first() {
            let anchor_ns = self.slicer.start_ns().unwrap_or(first.t_ns);
            let pace = *self
                .pace
                .get_or_insert_with(|| Pace::new(anchor_ns, port.now_ns(), factor));
            self.close_paced(first, pace, port)?;
            let edge = self.slicer.next_edge_ns().unwrap_or(u64::MAX);
            let end = edge.min(pace.slot_end_ns(first.t_ns));
            let n = rest.partition_point(|e| e.t_ns < end).clamp(1, self.chunk_events);
            let (part, after) = rest.split_at(n);
            // With the next event known to lie beyond the edge, events and closing leave together.
            let closes = end == edge && after.first().is_some_and(|e| e.t_ns >= edge);
            let due_ns = if closes {
                edge
            } else {
                part.last().map_or(end, |e| e.t_ns)
            };
            port.wait_until(pace.wall_ns(due_ns))?;
            self.slicer.push(part, port)?;
            if closes {
                self.slicer.watermark(edge, port)?;
            } else {
                self.slicer.flush(port)?;
            }
            rest = after;
            self.report(port);
        }
        Ok(())
    }

    /// Closes what is over when this event comes, which may itself be noise.
    fn close_before(&mut self, event: &RawEvent, port: &mut dyn IngestPort) -> Result<(), StageError> {
        match self.factor.zip(self.slicer.start_ns()) {
            // Where the run resumes, time begins with the first tick.
            Some((_, start_ns)) if event.t_ns < start_ns => Ok(()),
            Some((factor, start_ns)) => {
                let pace = *self
                    .pace
                    .get_or_insert_with(|| Pace::new(start_ns, port.now_ns(), factor));
                self.close_paced(event, pace, port)
            }
            None => {
                self.slicer.check_gap(event)?;
                self.slicer.watermark(event.t_ns, port)
            }
        }
    }

    fn close_paced(
        &mut self,
        event: &RawEvent,
        pace: Pace,
        port: &mut dyn IngestPort,
    ) -> Result<(), StageError> {
        while let Some(edge) = self.slicer.next_edge_ns().filter(|edge| *edge <= event.t_ns) {
            self.slicer.check_gap(event)?;
            port.wait_until(pace.wall_ns(edge))?;
            self.slicer.watermark(edge, port)?;
            self.report(port);
        }
        Ok(())
    }

    fn report(&self, port: &mut dyn IngestPort) {
        let sliced = self.slicer.tally();
        let skipped = sliced.skipped() + self.screened.dropped() + self.noise.dropped();
        port.progress(
            self.progress_permille,
            self.slicer.next_tick(),
            sliced.sent,
            skipped,
        );
    }

    /// Sends the end of the stream, whatever happened before.
    fn end(
        mut self,
        outcome: Result<bool, StageError>,
        port: &mut dyn IngestPort,
    ) -> Result<IngestSummary, StageError> {
        let ended = self.slicer.finish(port);
        self.report(port);
        let sliced = self.slicer.tally();
        let stopped = match outcome {
            Ok(stopped) => stopped,
            Err(StageError::Stopped) => true,
            Err(e) => return Err(e),
        };
        let end_tick = match ended {
            Ok(tick) => tick,
            // Asked twice to stop: nobody waits for the end.
            Err(StageError::Stopped) if stopped => self.slicer.next_tick(),
            Err(e) => return Err(e),
        };
        let passed = sliced.sent + sliced.unneeded + sliced.before_resume + self.noise.dropped();
        if !stopped && sliced.before_origin > 0 && passed == 0 {
            let origin = self.slicer.origin_ns().map_or_else(String::new, seconds);
            return Err(StageError::Fatal(format!(
                "{}: all {} events are earlier than slicing.origin at {origin}; correct the origin",
                self.described, sliced.before_origin
            )));
        }
        let (screened, noise) = (self.screened, self.noise);
        tracing::info!(
            end_tick,
            sent = sliced.sent,
            skipped = sliced.skipped(),
            stopped,
            "recording done"
        );
        screened.log();
        noise.log();
        Ok(IngestSummary {
            end_tick,
            screened,
            noise,
            sliced,
            stopped,
        })
    }
}

fn fatal(e: &SourceError) -> StageError {
    StageError::Fatal(e.to_string())
}

/// The track that the plan names.
fn track(plan: &Plan) -> Result<Option<Track>, SourceError> {
    let Some(options) = &plan.source.positions else {
        return Ok(None);
    };
    let (track, about) = positions::open(options)?;
    tracing::info!(
        format = about.format,
        path = %about.path.display(),
        positions = about.positions,
        zone = about.zone,
        first_ns = about.first_ns,
        last_ns = about.last_ns,
        length_m = about.length_m.round(),
        "positions read"
    );
    if about.passed_over > 0 || about.out_of_order > 0 {
        tracing::warn!(
            path = %about.path.display(),
            passed_over = about.passed_over,
            out_of_order = about.out_of_order,
            "positions left out: broken lines, or earlier than those before them"
        );
    }
    Ok(Some(track))
}
