//! The slicer: puts events into ticks and segments, and says when these begin and end.
//!
//! Tick k is `[t0 + k·tick, t0 + (k+1)·tick)` in nanoseconds (or events `[k·N, (k+1)·N)`), half-open on an integer
//! grid; the edges of all windows cut it into segments. An event belongs to exactly one segment, decided in
//! nanoseconds. Chunks do not cross segments; where they are cut within one does not depend on how the events were
//! handed in, but for [`Slicer::flush`].

use crate::enabled::Enabled;
use crate::{MAX_TIME_NS, RawEvent};
use evpr_core::Reason;
use evpr_core::message::{ChunkHeader, Event, TickHeader, TickKind};
use evpr_core::plan::{Delivery, Origin, Plan, SegmentPlan, SliceMode};
use evpr_core::stage::{IngestPort, StageError};
use evpr_events::{rough_seconds, seconds};

/// Most ticks that time may jump ahead by, from one event to the next: more is taken for a damaged time.
pub const MAX_GAP_TICKS: u64 = 100_000;

/// Longest time that an event can have after its chunk's base, µs.
const MAX_EVENT_US: u64 = u32::MAX as u64;

/// What became of the events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SliceTally {
    /// Sent in chunks.
    pub sent: u64,
    /// Not sent, because no window covers their segment, or only those of members that are off.
    pub unneeded: u64,
    /// Earlier than the origin.
    pub before_origin: u64,
    /// Earlier than the tick that the run resumes at.
    pub before_resume: u64,
    /// Of ticks that are not whole: thrown away.
    pub lost: u64,
    /// Ticks that are not whole because ingest fell behind.
    pub dropped_ticks: u64,
    /// Ticks that are not whole because the source, or ingest, was away.
    pub missed_ticks: u64,
}

impl SliceTally {
    /// Events left out by decision.
    pub fn skipped(&self) -> u64 {
        self.unneeded + self.before_origin + self.before_resume + self.lost
    }
}

/// Whether events of the segment under way are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Loss {
    None,
    /// Yes, and until an event comes nobody knows for how long.
    Open(Reason),
    /// Yes, as of the rest of its tick.
    Tick(Reason),
}

/// See the module. Expects what [`crate::Screen`] lets pass: rows up to [`Event::Y_MAX`], times that do not go back.
#[derive(Debug)]
pub struct Slicer {
    mode: SliceMode,
    tick_len: u64,
    origin: Origin,
    segments: SegmentPlan,
    chunk_events: usize,
    lossless: bool,
    epoch: u32,
    first_tick: u64,
    /// Start of tick 0, ns; known from the first event on.
    t0_ns: Option<u64>,
    /// The tick under way, and the segment of it.
    tick: u64,
    segment: usize,
    tick_opened: bool,
    tick_closed: bool,
    segment_opened: bool,
    /// Count mode: events of the tick so far, and events still to leave out before the first tick.
    in_tick: u64,
    to_skip: u64,
    /// Time of the tick's first event (count mode), and of the latest event or watermark.
    tick_first_ns: u64,
    latest_ns: u64,
    received: u64,
    closed_ns: u64,
    base_us: u64,
    pending: Vec<Event>,
    enabled: Enabled,
    loss: Loss,
    /// Why the tick under way is not whole, if it is not.
    tick_lost: Option<Reason>,
    tally: SliceTally,
}

impl Slicer {
    /// A slicer whose first tick is `first_tick`; events before it are left out. Windows that reach back beyond it
    /// come out incomplete.
    pub fn new(plan: &Plan, first_tick: u64, epoch: u32) -> Self {
        let slicing = &plan.slicing;
        Self {
            mode: slicing.mode,
            tick_len: slicing.tick.max(1),
            origin: slicing.origin,
            segments: slicing.segments(),
            chunk_events: plan.chunk_events(),
            lossless: plan.delivery == Delivery::Lossless,
            epoch,
            first_tick,
            t0_ns: None,
            tick: first_tick,
            segment: 0,
            tick_opened: false,
            tick_closed: false,
            segment_opened: false,
            in_tick: 0,
            to_skip: match slicing.mode {
                SliceMode::Time => 0,
                SliceMode::Count => first_tick.saturating_mul(slicing.tick.max(1)),
            },
            tick_first_ns: 0,
            latest_ns: 0,
            received: 0,
            closed_ns: 0,
            base_us: 0,
            pending: Vec::with_capacity(plan.chunk_events()),
            enabled: Enabled::new(plan),
            loss: Loss::None,
            tick_lost: None,
            tally: SliceTally::default(),
        }
    }

    /// Fixes the origin, given the time of the recording's first event, ns; only the first call counts.
    pub fn anchor(&mut self, first_event_ns: u64) {
        let origin = self.origin;
        self.t0_ns.get_or_insert_with(|| origin.resolve(first_event_ns));
    }

    /// Sensor time of the start of tick 0, ns (in count mode: the earliest time that counts); `None` before the first
    /// event.
    pub fn origin_ns(&self) -> Option<u64> {
        self.t0_ns
    }

    /// Sensor time of the start of the first tick, ns; `None` before the first event, and in count mode.
    pub fn start_ns(&self) -> Option<u64> {
        let t0 = self.t0_ns.filter(|_| self.mode == SliceMode::Time)?;
        Some(t0.saturating_add(self.first_tick.saturating_mul(self.tick_len)))
    }

    /// The next edge of a segment, sensor time in ns; `None` before the first event, and in count mode.
    pub fn next_edge_ns(&self) -> Option<u64> {
        let t0 = self.t0_ns.filter(|_| self.mode == SliceMode::Time)?;
        Some(self.edge_ns(t0, self.segment + 1))
    }

    /// Start of the segment under way, sensor time in ns: events before it come too late. `None` before the first event,
    /// and in count mode.
    pub(crate) fn segment_start_ns(&self) -> Option<u64> {
        let t0 = self.t0_ns.filter(|_| self.mode == SliceMode::Time)?;
        Some(self.edge_ns(t0, self.segment))
    }

    /// Puts tick `tick` at this sensor time, in ns, as an earlier ingest did; before the first event. Count
    /// mode: events are counted from the next one on.
    pub(crate) fn continue_grid(&mut self, tick: u64, start_ns: u64) {
        self.to_skip = 0;
        if self.mode == SliceMode::Time {
            let t0 = start_ns.saturating_sub(tick.saturating_mul(self.tick_len));
            self.t0_ns.get_or_insert(t0);
        }
    }

    /// True once something of the first tick has been taken or closed.
    pub(crate) fn has_begun(&self) -> bool {
        self.tick > self.first_tick || self.segment > 0 || self.tick_opened
    }

    /// True while events wait for their chunk to be full.
    pub(crate) fn keeps_events(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Events are missing from now on. The tick under way and all up to and with the one in which the next event
    /// falls are not whole: their chunks say so, and their events are thrown away.
    pub(crate) fn lose(&mut self, reason: Reason) {
        if let Loss::Open(_) = self.loss {
            return;
        }
        self.loss = Loss::Open(reason);
        self.tick_lost.get_or_insert(reason);
        self.tally.lost += self.pending.len() as u64;
        self.pending.clear();
    }

    /// Why the segment under way is not whole, if it is not.
    fn loss(&self) -> Option<Reason> {
        match self.loss {
            Loss::None => None,
            Loss::Open(reason) | Loss::Tick(reason) => Some(reason),
        }
    }

    /// Enters the tick under way into the tally, and goes on to the next.
    fn end_loss_with_tick(&mut self) {
        match self.tick_lost {
            Some(Reason::Dropped) => self.tally.dropped_ticks += 1,
            Some(_) => self.tally.missed_ticks += 1,
            None => {}
        }
        if let Loss::Tick(_) = self.loss {
            self.loss = Loss::None;
        }
        self.tick_lost = self.loss();
    }

    fn edge_ns(&self, t0: u64, edge: usize) -> u64 {
        let within = self.segments.edges.get(edge).copied().unwrap_or(self.tick_len);
        t0.saturating_add(self.tick.saturating_mul(self.tick_len))
            .saturating_add(within)
    }

    /// The first tick that is not opened yet.
    pub fn next_tick(&self) -> u64 {
        self.tick + u64::from(self.tick_opened)
    }

    /// What became of the events so far.
    pub fn tally(&self) -> SliceTally {
        self.tally
    }

    /// Leaves out and counts events before the origin and before the first tick; gives the others.
    pub fn skip<'a>(&mut self, mut events: &'a [RawEvent]) -> &'a [RawEvent] {
        let Some(first) = events.first() else {
            return events;
        };
        self.anchor(first.t_ns);
        let t0 = self.t0_ns.unwrap_or(0);
        if first.t_ns < t0 {
            let n = events.partition_point(|e| e.t_ns < t0);
            self.tally.before_origin += n as u64;
            events = &events[n..];
        }
        let start = self.start_ns().unwrap_or(0);
        let n = match self.mode {
            SliceMode::Time if events.first().is_some_and(|e| e.t_ns < start) => {
                events.partition_point(|e| e.t_ns < start)
            }
            SliceMode::Time => 0,
            SliceMode::Count => self.to_skip.min(events.len() as u64) as usize,
        };
        self.to_skip = self.to_skip.saturating_sub(n as u64);
        self.tally.before_resume += n as u64;
        &events[n..]
    }

    /// Takes events. What they show to be over is closed; the latest ones are kept until their chunk is full or over.
    ///
    /// # Errors
    /// Those of the port; and [`StageError::Fatal`] when time jumps ahead by more than [`MAX_GAP_TICKS`]. What came
    /// before is sent.
    pub fn push(&mut self, events: &[RawEvent], port: &mut dyn IngestPort) -> Result<(), StageError> {
        let mut rest = self.skip(events);
        while let Some(first) = rest.first() {
            let n = match self.mode {
                SliceMode::Time => {
                    self.check_gap(first)?;
                    self.advance(first.t_ns, port)?;
                    let edge = self.next_edge_ns().unwrap_or(u64::MAX);
                    rest.partition_point(|e| e.t_ns < edge).max(1)
                }
                SliceMode::Count => (self.segment_room() as usize).clamp(1, rest.len()),
            };
            if let Loss::Open(reason) = self.loss {
                self.loss = Loss::Tick(reason);
            }
            let (run, after) = rest.split_at(n);
            self.take(run, port)?;
            rest = after;
            if self.mode == SliceMode::Count {
                self.in_tick += n as u64;
                if self.segment_room() == 0 {
                    self.close_segment(port)?;
                }
            }
        }
        Ok(())
    }

    /// Closes everything that is over at sensor time `t_ns`, though no event says so. Count mode: nothing.
    ///
    /// # Errors
    /// Those of the port.
    pub fn watermark(&mut self, t_ns: u64, port: &mut dyn IngestPort) -> Result<(), StageError> {
        self.advance(t_ns.min(MAX_TIME_NS), port)
    }

    /// Sends the events that wait for their chunk to be full.
    ///
    /// # Errors
    /// Those of the port.
    pub fn flush(&mut self, port: &mut dyn IngestPort) -> Result<(), StageError> {
        if self.pending.is_empty() {
            Ok(())
        } else {
            self.send_chunk(false, port)
        }
    }

    /// Sends what is left and says that the stream ends at the first tick that is not closed; gives that tick.
    ///
    /// # Errors
    /// Those of the port.
    pub fn finish(&mut self, port: &mut dyn IngestPort) -> Result<u64, StageError> {
        self.flush(port)?;
        let end = self.tick + u64::from(self.tick_closed);
        let header = TickHeader {
            tick: end,
            kind: TickKind::End as u32,
            ..self.tick_header()
        };
        port.tick(header, &[])?;
        Ok(end)
    }

    /// Refuses an event too far ahead.
    pub(crate) fn check_gap(&self, event: &RawEvent) -> Result<(), StageError> {
        let (SliceMode::Time, Some(t0)) = (self.mode, self.t0_ns) else {
            return Ok(());
        };
        let ahead = (event.t_ns.saturating_sub(t0) / self.tick_len).saturating_sub(self.tick);
        if ahead <= MAX_GAP_TICKS && event.t_ns <= MAX_TIME_NS {
            return Ok(());
        }
        let (whence, before) = match self.received {
            0 => ("the origin of the ticks", self.start_ns().unwrap_or(t0)),
            _ => ("the event before it", self.latest_ns),
        };
        Err(StageError::Fatal(format!(
            "time jumps ahead by {}: event {} of this run (from 0), at {} (x {}, y {}), is more than {MAX_GAP_TICKS} \
             ticks after {whence} at {}; check the recording, source.time_unit and slicing.origin",
            rough_seconds(event.t_ns.saturating_sub(before)),
            self.received,
            seconds(event.t_ns),
            event.x,
            event.y,
            seconds(before),
        )))
    }

    /// Count mode: events that the segment still takes.
    fn segment_room(&self) -> u64 {
        let end = self
            .segments
            .edges
            .get(self.segment + 1)
            .copied()
            .unwrap_or(self.tick_len);
        end.saturating_sub(self.in_tick)
    }

    /// Closes all segments that end at or before `t_ns`.
    fn advance(&mut self, t_ns: u64, port: &mut dyn IngestPort) -> Result<(), StageError> {
        while self.next_edge_ns().is_some_and(|edge| edge <= t_ns) {
            self.close_segment(port)?;
        }
        Ok(())
    }

    /// Takes events that all belong to the segment under way.
    fn take(&mut self, run: &[RawEvent], port: &mut dyn IngestPort) -> Result<(), StageError> {
        let (Some(first), Some(last)) = (run.first(), run.last()) else {
            return Ok(());
        };
        self.open_tick(first.t_ns, port)?;
        self.received += run.len() as u64;
        self.latest_ns = last.t_ns;
        if self.loss().is_some() {
            self.tally.lost += run.len() as u64;
            return Ok(());
        }
        if !self.needed() {
            self.tally.unneeded += run.len() as u64;
            return Ok(());
        }
        let mut rest = run;
        while let Some(first) = rest.first() {
            if self.pending.len() >= self.chunk_events {
                self.send_chunk(false, port)?;
            }
            // Times that do not fit 32 bits after the tick's base begin a chunk with a base of its own.
            if (first.t_ns / 1_000).saturating_sub(self.base_us) > MAX_EVENT_US {
                self.flush(port)?;
                self.base_us = first.t_ns / 1_000;
            }
            let base_us = self.base_us;
            let after_base = |e: &RawEvent| (e.t_ns / 1_000).saturating_sub(base_us);
            let mut n = rest.len().min(self.chunk_events - self.pending.len());
            if after_base(&rest[n - 1]) > MAX_EVENT_US {
                n = rest[..n]
                    .partition_point(|e| after_base(e) <= MAX_EVENT_US)
                    .max(1);
            }
            let (part, after) = rest.split_at(n);
            let packed = part
                .iter()
                .map(|e| Event::new(after_base(e) as u32, e.x, e.y, e.on));
            self.pending.extend(packed);
            rest = after;
        }
        Ok(())
    }

    fn needed(&self) -> bool {
        let covered = self.segments.needed.get(self.segment).copied().unwrap_or(false);
        covered && self.enabled.want(self.segment)
    }

    fn send_chunk(&mut self, closing: bool, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let closes = if closing {
            self.segments.closes(self.segment)
        } else {
            0
        };
        let opens = if self.segment_opened {
            0
        } else {
            ChunkHeader::OPENS_SEGMENT
        };
        let closes_segment = if closing { ChunkHeader::CLOSES_SEGMENT } else { 0 };
        let header = ChunkHeader {
            tick: self.tick,
            base_us: self.base_us,
            closed_ns: if closes == 0 { 0 } else { port.now_ns() },
            epoch: self.epoch,
            segment: self.segment as u32,
            flags: ChunkHeader::with_loss(opens | closes_segment, self.loss()),
            closes,
            members: self.enabled.members,
            ..ChunkHeader::default()
        };
        let pending = &self.pending;
        port.chunk(header, pending.len(), &mut |slots| slots.copy_from_slice(pending))?;
        self.tally.sent += self.pending.len() as u64;
        self.pending.clear();
        self.segment_opened = true;
        if closes != 0 {
            self.closed_ns = header.closed_ns;
        }
        Ok(())
    }

    fn close_segment(&mut self, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let start = self.start_of_tick_ns();
        self.open_tick(start, port)?;
        if self.needed() {
            self.send_chunk(true, port)?;
        }
        let tick_over = self.segment + 1 >= self.segments.per_tick();
        let answerable = if self.lossless {
            tick_over
        } else {
            self.segment == self.segments.last_needed()
        };
        if answerable {
            let closed_ns = if self.closed_ns == 0 {
                port.now_ns()
            } else {
                self.closed_ns
            };
            let header = TickHeader {
                kind: TickKind::Close as u32,
                closed_ns,
                ..self.tick_header()
            };
            port.tick(header, &[])?;
            self.tick_closed = true;
        }
        self.segment_opened = false;
        self.segment += 1;
        if tick_over {
            self.end_loss_with_tick();
            self.tick += 1;
            self.segment = 0;
            self.in_tick = 0;
            self.closed_ns = 0;
            (self.tick_opened, self.tick_closed) = (false, false);
        }
        Ok(())
    }

    /// Announces the tick under way, unless that is done. `first_ns`: its first event's time, for count mode.
    fn open_tick(&mut self, first_ns: u64, port: &mut dyn IngestPort) -> Result<(), StageError> {
        if self.tick_opened {
            return Ok(());
        }
        self.enabled.follow(self.tick, port);
        self.tick_first_ns = first_ns;
        self.base_us = self.start_of_tick_ns() / 1_000;
        let mut header = TickHeader {
            kind: TickKind::Open as u32,
            ..self.tick_header()
        };
        if self.mode == SliceMode::Count {
            // Nobody knows yet when it ends.
            header.end_us = header.start_us;
        }
        port.tick(header, &self.enabled.weights)?;
        self.tick_opened = true;
        Ok(())
    }

    /// Start of the tick under way, ns; in count mode its first event's time.
    fn start_of_tick_ns(&self) -> u64 {
        match (self.mode, self.t0_ns) {
            (SliceMode::Time, Some(t0)) => self.edge_ns(t0, 0),
            _ => self.tick_first_ns,
        }
    }

    /// The tick under way.
    fn tick_header(&self) -> TickHeader {
        let end_ns = match (self.mode, self.t0_ns) {
            (SliceMode::Time, Some(t0)) => self.edge_ns(t0, self.segments.per_tick()),
            _ => self.latest_ns,
        };
        TickHeader {
            tick: self.tick,
            start_us: self.start_of_tick_ns() / 1_000,
            end_us: end_ns / 1_000,
            control_version: self.enabled.version,
            members: self.enabled.members,
            fuse: self.enabled.fuse,
            epoch: self.epoch,
            ..TickHeader::default()
        }
    }
}
