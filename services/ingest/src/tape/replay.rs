//! Replaying: sends what stands on a tape again. Ticks that are missing on it, because ingest died or the disk was too
//! slow, are sent as lost, so that every tick is answered.

use super::{Chunk, Entry, Lines, Opened, TapeError};
use crate::pace::Pace;
use crate::slicer::MAX_GAP_TICKS;
use crate::{RawEvent, SourceError};
use crossbeam::channel::{Receiver, TryRecvError};
use evpr_core::message::{ChunkHeader, Event, TickHeader, TickKind};
use evpr_core::plan::{self, Plan, SegmentPlan, SliceMode};
use evpr_core::stage::{IngestPort, StageError};
use evpr_core::{MemberSet, Reason};
use evpr_events::{ReadOptions, Recording};
use std::path::PathBuf;

/// Epochs that a tape may have; those of the replay's own ingest count above them.
const EPOCH_BITS: u32 = 16;

/// Sends a tape. See the module.
pub struct TapeIngest {
    path: PathBuf,
    lines: Lines,
    events: Events,
    plan: PlanPart,
    first_tick: u64,
    epoch: u32,
    factor: Option<f64>,
    pace: Option<Pace>,
    stop: Receiver<()>,
    tick: Option<Tick>,
    sent: u64,
    closed_ns: u64,
}

/// What is to be known of the plan.
struct PlanPart {
    segments: SegmentPlan,
    tick_us: u64,
    members: usize,
    chunk_events: usize,
}

/// The tick under way.
struct Tick {
    opened: Opened,
    members: MemberSet,
    /// The first segment that is not closed.
    segment: usize,
    closed: bool,
}

/// The file of events.
struct Events {
    recording: Box<dyn Recording>,
    batch: Vec<RawEvent>,
    /// How many of the batch are taken.
    taken: usize,
    left: u64,
}

impl Events {
    /// The next `n` events, after `base_us`; an error says what is wrong.
    fn take(&mut self, n: usize, base_us: u64, out: &mut Vec<Event>) -> Result<(), String> {
        out.clear();
        if n as u64 > self.left {
            return Err("names more events than were written".to_owned());
        }
        self.left -= n as u64;
        while out.len() < n {
            if self.taken == self.batch.len() {
                self.taken = 0;
                let more = self.recording.next_batch(&mut self.batch);
                if !more.map_err(|e| format!("cannot have its events: {e}"))? {
                    return Err("names more events than there are in the file of events".to_owned());
                }
            }
            let upto = self.batch.len().min(self.taken + n - out.len());
            for event in &self.batch[self.taken..upto] {
                let after_base = (event.t_ns / 1_000).checked_sub(base_us);
                let t_us = after_base.and_then(|t| u32::try_from(t).ok());
                let (Some(t_us), true) = (t_us, event.y <= Event::Y_MAX) else {
                    return Err("has other events than the file of events".to_owned());
                };
                out.push(Event::new(t_us, event.x, event.y, event.on));
            }
            self.taken = upto;
        }
        Ok(())
    }
}

impl std::fmt::Debug for TapeIngest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TapeIngest")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

impl TapeIngest {
    /// Opens the plan's tape. `first_tick`, `epoch` and `stop` as for [`crate::Ingest::new`].
    ///
    /// # Errors
    /// When it cannot be read, or is no tape.
    pub fn new(plan: &Plan, first_tick: u64, epoch: u32, stop: Receiver<()>) -> Result<Self, SourceError> {
        let path = plan.source.path.clone();
        let lines = Lines::open(&path).map_err(|e| SourceError::Setup(e.to_string()))?;
        let (_, whole) = lines.whole();
        let options = ReadOptions {
            sensor: Some(plan.sensor),
            ..ReadOptions::default()
        };
        let recording = evpr_events::open(&path, &options)?;
        tracing::info!(path = %path.display(), events = whole.events, by = lines.head().evpr, "tape opened");
        Ok(Self {
            path,
            lines,
            events: Events {
                recording,
                batch: Vec::new(),
                taken: 0,
                left: whole.events,
            },
            plan: PlanPart {
                segments: plan.slicing.segments(),
                tick_us: match plan.slicing.mode {
                    SliceMode::Time => plan.slicing.tick / 1_000,
                    SliceMode::Count => 0,
                },
                members: plan.members.len(),
                chunk_events: plan.chunk_events(),
            },
            first_tick,
            epoch,
            factor: match plan.source.pace {
                plan::Pace::Unpaced => None,
                plan::Pace::Factor(factor) => Some(factor),
            },
            pace: None,
            stop,
            tick: None,
            sent: 0,
            closed_ns: 0,
        })
    }

    /// Sends the tape until its end, or the stop signal; then says where the stream ends.
    ///
    /// # Errors
    /// When the tape is damaged, or the port broke. Every tick before that has been sent, and the end.
    pub fn run(mut self, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let mut end = None;
        let outcome = self.follow(&mut end, port);
        let end_tick = match (&outcome, end) {
            (Ok(false), Some(end)) => self.complete_before(end, port).map(|()| end),
            _ => Ok(self.next_tick()),
        };
        let stopped = matches!(outcome, Ok(true) | Err(StageError::Stopped));
        let ended = end_tick.and_then(|tick| {
            tracing::info!(end_tick = tick, sent = self.sent, stopped, "tape done");
            let header = TickHeader {
                tick,
                kind: TickKind::End as u32,
                ..TickHeader::default()
            };
            port.tick(header, &[])
        });
        match (outcome, ended) {
            (Err(e @ (StageError::Fatal(_) | StageError::Skip(_))), _) => Err(e),
            // Asked twice to stop: nobody waits for the end.
            (_, Err(StageError::Stopped)) if stopped => Ok(()),
            (_, ended) => ended,
        }
    }

    /// The first tick that is not closed.
    fn next_tick(&self) -> u64 {
        let tick = self.tick.as_ref();
        tick.map_or(self.first_tick, |t| t.opened.tick + u64::from(t.closed))
    }

    /// Sends all entries but the end, which is put into `end`. True when it was stopped.
    fn follow(&mut self, end: &mut Option<u64>, port: &mut dyn IngestPort) -> Result<bool, StageError> {
        let mut events = Vec::new();
        loop {
            // A full channel must not outshout the request to stop.
            if self.stop.try_recv() != Err(TryRecvError::Empty) {
                return Ok(true);
            }
            let Some(entry) = self.lines.next().map_err(fatal)? else {
                return Ok(false);
            };
            match entry {
                Entry::Open(opened) => {
                    *end = None;
                    self.open(opened, port)?;
                }
                Entry::Chunk(chunk) => self.chunk(&chunk, &mut events, port)?,
                Entry::Close { tick } => self.close(tick, port)?,
                Entry::End { tick } => *end = Some(tick),
                Entry::Whole(_) => {}
            }
            let next = self.next_tick();
            port.progress(self.lines.permille(), next, self.sent, 0);
        }
    }

    fn open(&mut self, opened: Opened, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let members: MemberSet = opened.members.iter().copied().collect();
        if opened.weights.len() > self.plan.members || opened.members.iter().any(|m| *m >= self.plan.members)
        {
            let what = "opens a tick with more members than the plan has";
            return Err(fatal(self.lines.damaged(what)));
        }
        let next = self.tick.as_ref().map_or(0, |t| t.opened.tick + 1);
        if opened.tick > next + MAX_GAP_TICKS {
            let what = format!("opens tick {}, where {next} comes next", opened.tick);
            return Err(fatal(self.lines.damaged(&what)));
        }
        self.complete_like(&opened, members, port)?;
        self.begin(opened, members, port)
    }

    /// Sends as lost what is missing before a tick that opens.
    fn complete_like(
        &mut self,
        opened: &Opened,
        members: MemberSet,
        port: &mut dyn IngestPort,
    ) -> Result<(), StageError> {
        self.complete_before(opened.tick, port)?;
        let next = self.tick.as_ref().map_or(0, |t| t.opened.tick + 1);
        for tick in next..opened.tick {
            let before_us = (opened.tick - tick).saturating_mul(self.plan.tick_us);
            let missing = Opened {
                tick,
                start_us: opened.start_us.saturating_sub(before_us),
                end_us: opened.end_us.saturating_sub(before_us),
                position: None,
                ..opened.clone()
            };
            self.begin(missing, members, port)?;
            self.complete_before(tick + 1, port)?;
        }
        Ok(())
    }

    fn begin(
        &mut self,
        opened: Opened,
        members: MemberSet,
        port: &mut dyn IngestPort,
    ) -> Result<(), StageError> {
        let [east_m, north_m] = opened.position.unwrap_or([f64::NAN; 2]);
        let header = TickHeader {
            east_m,
            north_m,
            fuse: opened.fuse,
            kind: TickKind::Open as u32,
            ..self.tick_header(&opened, members)
        };
        self.wait_for(opened.start_us, port)?;
        if opened.tick >= self.first_tick {
            port.tick(header, &opened.weights)?;
        }
        self.closed_ns = 0;
        self.tick = Some(Tick {
            opened,
            members,
            segment: 0,
            closed: false,
        });
        Ok(())
    }

    fn tick_header(&self, opened: &Opened, members: MemberSet) -> TickHeader {
        TickHeader {
            tick: opened.tick,
            start_us: opened.start_us,
            end_us: opened.end_us,
            members,
            epoch: self.epoch_of(opened),
            ..TickHeader::default()
        }
    }

    fn epoch_of(&self, opened: &Opened) -> u32 {
        let own = self.epoch << EPOCH_BITS;
        own | (opened.epoch & ((1 << EPOCH_BITS) - 1))
    }

    fn chunk(
        &mut self,
        chunk: &Chunk,
        events: &mut Vec<Event>,
        port: &mut dyn IngestPort,
    ) -> Result<(), StageError> {
        let segments = self.plan.segments.per_tick();
        let damaged = |lines: &Lines, what: &str| Err(fatal(lines.damaged(what)));
        if self.tick.is_none() || chunk.segment as usize >= segments || chunk.events > self.plan.chunk_events
        {
            return damaged(&self.lines, "has a chunk that the plan cannot have");
        }
        if let Err(what) = self.events.take(chunk.events, chunk.base_us, events) {
            return damaged(&self.lines, &what);
        }
        let loss = chunk.lost.then_some(Reason::Lost);
        let already = ChunkHeader {
            flags: chunk.flags,
            ..ChunkHeader::default()
        };
        let flags = match already.loss() {
            Some(_) => chunk.flags,
            None => ChunkHeader::with_loss(chunk.flags, loss),
        };
        self.send_chunk(chunk, flags, events, port)
    }

    fn send_chunk(
        &mut self,
        chunk: &Chunk,
        flags: u32,
        events: &[Event],
        port: &mut dyn IngestPort,
    ) -> Result<(), StageError> {
        let Some(tick) = &self.tick else { return Ok(()) };
        let (number, start_us) = (tick.opened.tick, tick.opened.start_us);
        let edge = self.plan.segments.edges.get(chunk.segment as usize + 1);
        let due_us = match (edge, events.last()) {
            (Some(edge), _) if chunk.closes != 0 && self.plan.tick_us > 0 => {
                start_us.saturating_add(edge / 1_000)
            }
            (_, Some(last)) => chunk.base_us.saturating_add(u64::from(last.t_us)),
            _ => start_us,
        };
        let header = ChunkHeader {
            tick: number,
            base_us: chunk.base_us,
            epoch: self.epoch_of(&tick.opened),
            segment: chunk.segment,
            flags,
            closes: chunk.closes,
            members: tick.members,
            ..ChunkHeader::default()
        };
        self.wait_for(due_us, port)?;
        if number >= self.first_tick {
            let closed_ns = if chunk.closes == 0 { 0 } else { port.now_ns() };
            let header = ChunkHeader { closed_ns, ..header };
            port.chunk(header, events.len(), &mut |slots| slots.copy_from_slice(events))?;
            self.sent += events.len() as u64;
            self.closed_ns = self.closed_ns.max(closed_ns);
        }
        if let Some(tick) = self.tick.as_mut().filter(|_| header.closes_segment()) {
            tick.segment = tick.segment.max(chunk.segment as usize + 1);
        }
        Ok(())
    }

    fn close(&mut self, tick: u64, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let under_way = self.tick.as_mut().filter(|t| t.opened.tick == tick);
        let Some(under_way) = under_way else {
            let what = "closes another tick than the one under way";
            return Err(fatal(self.lines.damaged(what)));
        };
        under_way.closed = true;
        let (opened, members) = (under_way.opened.clone(), under_way.members);
        let closed_ns = match self.closed_ns {
            0 => port.now_ns(),
            ns => ns,
        };
        let header = TickHeader {
            kind: TickKind::Close as u32,
            closed_ns,
            ..self.tick_header(&opened, members)
        };
        if tick < self.first_tick {
            return Ok(());
        }
        port.tick(header, &[])
    }

    /// Ends the tick under way, if it is before `end` and did not end by itself: what is missing of it is lost.
    fn complete_before(&mut self, end: u64, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let unfinished = self.tick.as_ref().filter(|t| !t.closed && t.opened.tick < end);
        let Some((from, tick, base_us)) = unfinished.map(|t| (t.segment, t.opened.tick, t.opened.start_us))
        else {
            return Ok(());
        };
        for segment in from..self.plan.segments.per_tick() {
            if !self.plan.segments.needed[segment] {
                continue;
            }
            let whole = ChunkHeader::OPENS_SEGMENT | ChunkHeader::CLOSES_SEGMENT;
            let chunk = Chunk {
                segment: segment as u32,
                flags: whole,
                closes: self.plan.segments.closes(segment),
                base_us,
                events: 0,
                lost: true,
            };
            let flags = ChunkHeader::with_loss(whole, Some(Reason::Lost));
            self.send_chunk(&chunk, flags, &[], port)?;
        }
        self.close(tick, port)
    }

    /// Waits until this sensor time, where the replay is paced.
    fn wait_for(&mut self, t_us: u64, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let Some(factor) = self.factor else { return Ok(()) };
        let t_ns = t_us.saturating_mul(1_000);
        let now_ns = port.now_ns();
        let pace = self.pace.get_or_insert_with(|| Pace::new(t_ns, now_ns, factor));
        port.wait_until(pace.wall_ns(t_ns))
    }
}

fn fatal(error: TapeError) -> StageError {
    StageError::Fatal(error.to_string())
}
