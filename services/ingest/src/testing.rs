//! A port that keeps what it is given, for tests.

use evpr_core::message::{ChunkHeader, Event, LiveStats, TickHeader, TickKind};
use evpr_core::stage::{IngestPort, OpenedTick, Settings, StageError};
use std::collections::VecDeque;

/// One message, as it was sent.
#[derive(Debug, Clone)]
pub(crate) enum Sent {
    Chunk(ChunkHeader, Vec<Event>),
    Tick(TickHeader, Vec<f64>),
}

impl PartialEq for Sent {
    /// Two unknown positions are alike, though they are not numbers.
    fn eq(&self, other: &Self) -> bool {
        let rest = |h: &TickHeader| TickHeader {
            east_m: 0.0,
            north_m: 0.0,
            ..*h
        };
        match (self, other) {
            (Sent::Chunk(a, events), Sent::Chunk(b, others)) => a == b && events == others,
            (Sent::Tick(a, weights), Sent::Tick(b, others)) => {
                a.position() == b.position() && rest(a) == rest(b) && weights == others
            }
            _ => false,
        }
    }
}

/// Tick, segment, and its events: time in µs, column, row, ON.
pub(crate) type Segment = (u64, u32, Vec<(u64, u16, u16, bool)>);

/// Time stands still but for [`IngestPort::wait_until`], which sets it.
#[derive(Debug, Default)]
pub(crate) struct KeptPort {
    pub(crate) now_ns: u64,
    pub(crate) sent: Vec<Sent>,
    /// When each message was sent.
    pub(crate) sent_ns: Vec<u64>,
    /// Handed out at one opening each.
    pub(crate) control: VecDeque<Option<Settings>>,
    /// Calls of `wait_until` that still succeed.
    pub(crate) waits_left: Option<usize>,
    /// Chunks that still find room.
    pub(crate) room: Option<usize>,
    pub(crate) progress: (u64, u64, u64, u64),
    pub(crate) live: LiveStats,
    pub(crate) opened_before: Option<OpenedTick>,
    /// Dropped once this many messages are sent: the request to stop.
    pub(crate) stop_after: Option<(usize, crossbeam::channel::Sender<()>)>,
}

impl KeptPort {
    fn keep(&mut self, sent: Sent) {
        self.sent.push(sent);
        self.sent_ns.push(self.now_ns);
        if self
            .stop_after
            .as_ref()
            .is_some_and(|(after, _)| self.sent.len() >= *after)
        {
            self.stop_after = None;
        }
    }

    pub(crate) fn chunks(&self) -> impl Iterator<Item = (&ChunkHeader, &[Event])> {
        self.sent.iter().filter_map(|s| match s {
            Sent::Chunk(header, events) => Some((header, events.as_slice())),
            Sent::Tick(..) => None,
        })
    }

    pub(crate) fn ticks(&self) -> impl Iterator<Item = (TickKind, &TickHeader)> {
        self.sent.iter().filter_map(|s| match s {
            Sent::Tick(header, _) => Some((TickKind::from_code(header.kind).unwrap(), header)),
            Sent::Chunk(..) => None,
        })
    }

    /// Kind and number of each tick message.
    pub(crate) fn tick_numbers(&self) -> Vec<(TickKind, u64)> {
        self.ticks().map(|(kind, header)| (kind, header.tick)).collect()
    }

    /// Everything that was sent, with the times of the host and of chunk borders taken out: per (tick, segment) all
    /// events with absolute times.
    pub(crate) fn segments(&self) -> Vec<Segment> {
        let mut all: Vec<Segment> = Vec::new();
        for (h, events) in self.chunks() {
            if h.opens_segment() {
                all.push((h.tick, h.segment, Vec::new()));
            }
            let last = all.last_mut().expect("a segment opens with its first chunk");
            assert_eq!((last.0, last.1), (h.tick, h.segment));
            last.2.extend(
                events
                    .iter()
                    .map(|e| (h.base_us + u64::from(e.t_us), e.x, e.y(), e.on())),
            );
        }
        all
    }
}

impl IngestPort for KeptPort {
    fn now_ns(&self) -> u64 {
        self.now_ns
    }

    fn chunk(
        &mut self,
        header: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError> {
        if let Some(room) = &mut self.room {
            *room = room.checked_sub(1).ok_or(StageError::Stopped)?;
        }
        let mut events = vec![Event::default(); len];
        fill(&mut events);
        self.keep(Sent::Chunk(header, events));
        Ok(())
    }

    fn tick(&mut self, header: TickHeader, weights: &[f64]) -> Result<(), StageError> {
        self.keep(Sent::Tick(header, weights.to_vec()));
        Ok(())
    }

    fn control(&mut self, _tick: u64) -> Option<Settings> {
        self.control.pop_front().flatten()
    }

    fn wait_until(&mut self, ns: u64) -> Result<(), StageError> {
        if let Some(left) = &mut self.waits_left {
            *left = left.checked_sub(1).ok_or(StageError::Stopped)?;
        }
        self.now_ns = self.now_ns.max(ns);
        Ok(())
    }

    fn progress(&mut self, permille: u64, next_tick: u64, events: u64, skipped: u64) {
        self.progress = (permille, next_tick, events, skipped);
    }

    fn live(&mut self, stats: LiveStats) {
        self.live = stats;
    }

    fn opened_before(&self) -> Option<OpenedTick> {
        self.opened_before
    }
}
