//! Recording: a port that keeps what passes it, and the thread that writes it. Nobody waits for the disk but a replay in
//! lossless delivery; what the disk is too slow for is left out of the tape, and said.

use super::{Chunk, Entry, Lines, Opened, TapeError, line, ticks_path};
use crate::RawEvent;
use evpr_core::message::{ChunkHeader, Event, LiveStats, TickHeader, TickKind};
use evpr_core::plan::{Delivery, Plan};
use evpr_core::stage::{IngestPort, OpenedTick, Settings, StageError};
use evpr_events::writers::{AppendedAedat4, WriteError};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Events that may wait for the disk: 64 MiB of them.
const MAX_EVENTS: usize = 8 << 20;
/// Entries that may wait for the disk.
const MAX_ENTRIES: usize = 1 << 16;
/// What is written is committed at the latest after so many events.
const COMMIT_EVENTS: usize = 1 << 17;
/// How often what is committed is brought to the disk.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// What waits to be written.
#[derive(Debug)]
struct Piece {
    entry: Entry,
    events: Vec<Event>,
}

#[derive(Debug, Default)]
struct Waiting {
    pieces: VecDeque<Piece>,
    events: usize,
    /// Nothing more comes.
    closed: bool,
    /// Nothing more is written.
    failed: bool,
    lost_events: u64,
    lost_chunks: u64,
}

#[derive(Debug, Default)]
struct Shared {
    waiting: Mutex<Waiting>,
    came: Condvar,
    room: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Writes a tape while ingest works. See the module.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    waits: bool,
}

impl Recorder {
    /// Goes on with the tape that the plan names, if it names one; see [`super::create`].
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn resume(plan: &Plan) -> Result<Option<Self>, TapeError> {
        let Some(path) = &plan.record_events else {
            return Ok(None);
        };
        let tape = Tape::resume(path)?;
        let shared = Arc::<Shared>::default();
        let theirs = shared.clone();
        let thread = std::thread::Builder::new()
            .name("tape".to_owned())
            .spawn(move || write_all(tape, &theirs))
            .map_err(|e| TapeError::about(path, format!("cannot start the thread that writes it: {e}")))?;
        Ok(Some(Self {
            path: path.clone(),
            shared,
            thread: Some(thread),
            waits: plan.delivery == Delivery::Lossless && !plan.is_live(),
        }))
    }

    /// Whether this many events more would be written. Says so when that changes for the worse.
    fn has_room(&self, events: usize) -> bool {
        let mut waiting = self.shared.lock();
        if waiting.failed {
            return false;
        }
        let full = |w: &mut Waiting| {
            !w.failed && (w.events + events > MAX_EVENTS.max(events) || w.pieces.len() >= MAX_ENTRIES)
        };
        if self.waits {
            let wait = self.shared.room.wait_while(waiting, full);
            waiting = wait.unwrap_or_else(PoisonError::into_inner);
        }
        if !full(&mut waiting) {
            return !waiting.failed;
        }
        let first = waiting.lost_chunks == 0;
        waiting.lost_chunks += 1;
        waiting.lost_events += events as u64;
        drop(waiting);
        if first {
            tracing::warn!(
                "{}: the disk is too slow for the events; some are left out of the tape, and their ticks are missing in it",
                self.path.display()
            );
        }
        false
    }

    fn keep(&self, entry: Entry, events: Vec<Event>) {
        let mut waiting = self.shared.lock();
        if waiting.failed {
            return;
        }
        if waiting.pieces.len() >= 2 * MAX_ENTRIES {
            waiting.failed = true;
            drop(waiting);
            tracing::error!(
                "{}: the disk takes nothing any more; events are no longer recorded, and the run goes on",
                self.path.display()
            );
            return;
        }
        waiting.events += events.len();
        waiting.pieces.push_back(Piece { entry, events });
        drop(waiting);
        self.shared.came.notify_one();
    }
}

impl Drop for Recorder {
    /// Waits until everything is written, and says what is not.
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.came.notify_one();
        let panicked = self.thread.take().is_some_and(|thread| thread.join().is_err());
        let waiting = self.shared.lock();
        if panicked {
            tracing::error!("{}: writing it panicked", self.path.display());
        }
        if waiting.lost_chunks > 0 {
            tracing::warn!(
                "{}: {} events in {} chunks are not in the tape, as the disk was too slow for them",
                self.path.display(),
                waiting.lost_events,
                waiting.lost_chunks
            );
        }
    }
}

/// Both files.
#[derive(Debug)]
struct Tape {
    path: PathBuf,
    events: AppendedAedat4,
    ticks: File,
    /// Where the part of `ticks` that counts ends.
    ticks_end: u64,
    /// Lines since then.
    lines: String,
    pending: usize,
    synced: Instant,
    /// Events in the form that is written.
    raw: Vec<RawEvent>,
}

impl Tape {
    fn resume(path: &Path) -> Result<Self, TapeError> {
        let (ticks_end, committed) = Lines::open(path)?.whole();
        let ticks_path = ticks_path(path);
        let failed = |e: std::io::Error| TapeError::about(&ticks_path, format!("cannot be written: {e}"));
        let mut ticks = File::options().write(true).open(&ticks_path).map_err(failed)?;
        ticks.set_len(ticks_end).map_err(failed)?;
        ticks.seek(SeekFrom::End(0)).map_err(failed)?;
        Ok(Self {
            path: path.to_owned(),
            events: AppendedAedat4::resume(path, committed)?,
            ticks,
            ticks_end,
            lines: String::new(),
            pending: 0,
            synced: Instant::now(),
            raw: Vec::new(),
        })
    }

    fn write(&mut self, piece: &Piece) -> Result<(), WriteError> {
        self.lines += &line(&piece.entry);
        let base_us = match &piece.entry {
            Entry::Chunk(chunk) => chunk.base_us,
            Entry::Open(_) | Entry::Whole(_) => return Ok(()),
            Entry::Close { .. } | Entry::End { .. } => return self.commit(),
        };
        self.raw.clear();
        self.raw.extend(piece.events.iter().map(|e| RawEvent {
            t_ns: base_us.saturating_add(u64::from(e.t_us)).saturating_mul(1_000),
            x: e.x,
            y: e.y(),
            on: e.on(),
        }));
        self.events.write(&self.raw)?;
        self.pending += piece.events.len();
        if self.pending >= COMMIT_EVENTS {
            self.commit()?;
        }
        Ok(())
    }

    /// Writes what stands out: from here on it can be read, whatever comes.
    fn commit(&mut self) -> Result<(), WriteError> {
        let committed = self.events.commit()?;
        self.lines += &line(&Entry::Whole(committed));
        let failed = |e| WriteError::write(&ticks_path(&self.path), e);
        self.ticks.write_all(self.lines.as_bytes()).map_err(failed)?;
        self.ticks_end += self.lines.len() as u64;
        self.lines.clear();
        self.pending = 0;
        if self.synced.elapsed() >= SYNC_EVERY {
            self.events.sync()?;
            self.ticks.sync_data().map_err(failed)?;
            self.synced = Instant::now();
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(), WriteError> {
        self.commit()?;
        let failed = |e| WriteError::write(&ticks_path(&self.path), e);
        self.ticks.sync_data().map_err(failed)?;
        self.events.finish().map(drop)
    }

    /// Leaves what is whole.
    fn cut(self) {
        let cut = self.ticks.set_len(self.ticks_end).map_err(|e| e.to_string());
        let cut = cut.and_then(|()| self.events.cut().map_err(|e| e.to_string()));
        if let Err(e) = cut {
            tracing::debug!("what is not whole stays behind what is: {e}");
        }
    }
}

/// The thread: writes until nothing more comes, or writing fails.
fn write_all(mut tape: Tape, shared: &Shared) {
    loop {
        let waiting = shared.lock();
        let idle = |w: &mut Waiting| w.pieces.is_empty() && !w.closed;
        let waiting = shared.came.wait_while(waiting, idle);
        let mut waiting = waiting.unwrap_or_else(PoisonError::into_inner);
        let piece = waiting.pieces.pop_front().filter(|_| !waiting.failed);
        if let Some(piece) = &piece {
            waiting.events -= piece.events.len();
        }
        let given_up = waiting.failed;
        drop(waiting);
        shared.room.notify_one();
        let outcome = match &piece {
            Some(piece) => tape.write(piece),
            None if given_up => return tape.cut(),
            None => return tape.finish().unwrap_or_else(|e| said(&e)),
        };
        if let Err(e) = outcome {
            let mut waiting = shared.lock();
            waiting.failed = true;
            (waiting.pieces, waiting.events) = (VecDeque::new(), 0);
            drop(waiting);
            shared.room.notify_one();
            said(&e);
            return tape.cut();
        }
    }
}

fn said(error: &WriteError) {
    tracing::error!("{error}; events are no longer recorded, the ticks before are kept, and the run goes on");
}

/// A port behind which everything that is sent is recorded.
pub struct Taped<'a> {
    port: &'a mut dyn IngestPort,
    recorder: &'a Recorder,
}

impl std::fmt::Debug for Taped<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Taped")
            .field("recorder", self.recorder)
            .finish_non_exhaustive()
    }
}

impl<'a> Taped<'a> {
    /// Records what passes on to `port`.
    pub fn new(port: &'a mut dyn IngestPort, recorder: &'a Recorder) -> Self {
        Self { port, recorder }
    }
}

impl IngestPort for Taped<'_> {
    fn now_ns(&self) -> u64 {
        self.port.now_ns()
    }

    fn chunk(
        &mut self,
        header: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError> {
        let room = self.recorder.has_room(len);
        let mut events = Vec::new();
        self.port.chunk(header, len, &mut |slots| {
            fill(slots);
            if room {
                events.extend_from_slice(slots);
            }
        })?;
        let chunk = Chunk {
            segment: header.segment,
            flags: header.flags,
            closes: header.closes,
            base_us: header.base_us,
            events: events.len(),
            lost: !room,
        };
        self.recorder.keep(Entry::Chunk(chunk), events);
        Ok(())
    }

    fn tick(&mut self, header: TickHeader, weights: &[f64]) -> Result<(), StageError> {
        self.port.tick(header, weights)?;
        let tick = header.tick;
        let entry = match TickKind::from_code(header.kind) {
            Some(TickKind::Open) => Entry::Open(Opened {
                tick,
                start_us: header.start_us,
                end_us: header.end_us,
                epoch: header.epoch,
                position: header.position(),
                members: header.members.iter().collect(),
                weights: weights.to_vec(),
                fuse: header.fuse,
            }),
            Some(TickKind::Close) => Entry::Close { tick },
            Some(TickKind::End) => Entry::End { tick },
            None => return Ok(()),
        };
        self.recorder.keep(entry, Vec::new());
        Ok(())
    }

    fn control(&mut self, tick: u64) -> Option<Settings> {
        self.port.control(tick)
    }

    fn wait_until(&mut self, ns: u64) -> Result<(), StageError> {
        self.port.wait_until(ns)
    }

    fn progress(&mut self, permille: u64, next_tick: u64, events: u64, skipped: u64) {
        self.port.progress(permille, next_tick, events, skipped);
    }

    fn live(&mut self, stats: LiveStats) {
        self.port.live(stats);
    }

    fn opened_before(&self) -> Option<OpenedTick> {
        self.port.opened_before()
    }
}
