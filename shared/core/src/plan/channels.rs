//! The channels of a plan, with the sizes of their buffers: made from the plan, not from the library's maxima.

use super::{Delivery, Pace, Plan};
use crate::message::{
    Candidate, ChunkHeader, ControlHeader, DescriptorHeader, Event, FrameHeader, LifecycleHeader,
    MatchHeader, MemberCost, MemberSetting, ScoresHeader, ServiceState, Span, SpansHeader, StatsHeader,
    TickHeader,
};

/// A channel's name.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Topic {
    /// Chunks of the camera.
    Events,
    /// Frames of one reconstruction.
    Frames(String),
    /// Rows of one extractor.
    Descriptors(String),
    /// Openings and closings of ticks.
    Ticks,
    /// Answers.
    Matches,
    /// Wanted members, weights and settings, supervisor to ingest; stages learn by it what need not stay in memory.
    Control,
    /// Who is dead, supervisor to the sinks.
    Lifecycle,
    /// What every process has done, to the supervisor.
    Stats,
    /// What every process does when, to whoever makes a trace.
    Spans,
    /// What the fuser made of a tick, to the dashboard.
    Scores,
}

impl std::fmt::Display for Topic {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Topic::Events => write!(f, "events/camera"),
            Topic::Frames(id) => write!(f, "frames/{id}"),
            Topic::Descriptors(id) => write!(f, "descriptors/{id}"),
            Topic::Ticks => write!(f, "ticks"),
            Topic::Matches => write!(f, "matches"),
            Topic::Control => write!(f, "control"),
            Topic::Lifecycle => write!(f, "lifecycle"),
            Topic::Stats => write!(f, "stats"),
            Topic::Spans => write!(f, "spans"),
            Topic::Scores => write!(f, "scores"),
        }
    }
}

/// One channel with its sizes. Everybody who opens it uses this table, so that the first to come fixes what all expect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its name.
    pub topic: Topic,
    /// Largest payload, items.
    pub max_items: usize,
    /// Bytes per item.
    pub item_bytes: usize,
    /// Bytes of the header.
    pub header_bytes: usize,
    /// Subscribers planned, headroom for observers and restarts included.
    pub max_subscribers: usize,
    /// Publishers planned, headroom for restarts included.
    pub max_publishers: usize,
    /// Publishers that send at the same time.
    pub publishers: usize,
    /// Messages that wait for a subscriber.
    pub buffer: usize,
    /// Messages that a subscriber holds at the same time.
    pub borrowed: usize,
    /// Whether a publisher waits for room (else the oldest message is lost, and counted).
    pub waits: bool,
}

impl Channel {
    /// Slots that one publisher reserves.
    pub fn slots(&self) -> usize {
        self.max_subscribers * (self.buffer + self.borrowed) + LOANED
    }

    /// Shared memory that all its publishers reserve, bytes.
    pub fn bytes(&self) -> usize {
        const SLOT_OVERHEAD: usize = 256;
        self.publishers
            * self.slots()
            * (self.max_items * self.item_bytes + self.header_bytes + SLOT_OVERHEAD)
    }
}

/// Messages that a publisher fills at the same time.
pub(super) const LOANED: usize = 1;
/// Most spans in one message.
pub const SPANS_AT_ONCE: usize = 128;
/// Most shares that the places of the map are in, in [`Topic::Scores`].
pub const SCORE_COLUMNS: usize = 512;
/// Observers and restarting processes, beyond the planned subscribers.
const SPARE_SUBSCRIBERS: usize = 2;
/// A restarted process may come before its dead forerunner is cleaned up; bridges take one too.
const MIN_PUBLISHERS: usize = 4;

impl Plan {
    /// Most events in one chunk: as many as fit 512 KiB unpaced; less when paced or live, as chunks are then short. A source
    /// of frames has none, but a channel has room for at least one.
    pub fn chunk_events(&self) -> usize {
        if self.source.frames.is_some() {
            1
        } else if self.source.is_tape() || (self.source.pace == Pace::Unpaced && !self.is_live()) {
            1 << 16
        } else {
            1 << 14
        }
    }

    /// All channels of the plan.
    pub fn channels(&self) -> Vec<Channel> {
        let lossless = self.delivery == Delivery::Lossless;
        let sinks = usize::from(self.map.is_some()) + usize::from(self.record.is_some());
        let watchers = usize::from(self.dashboard);
        let stages = self.reconstructions.len() + self.extractors.len();
        let windows = self.slicing.windows.len();
        let mut all = Vec::new();
        let mut add =
            |topic, max_items, item_bytes, header_bytes, publishers: usize, subscribers, buffer, waits| {
                all.push(Channel {
                    topic,
                    max_items,
                    item_bytes,
                    header_bytes,
                    max_subscribers: subscribers + SPARE_SUBSCRIBERS,
                    max_publishers: (publishers * 2).max(MIN_PUBLISHERS),
                    publishers,
                    buffer,
                    borrowed: 1,
                    waits,
                });
            };
        let (header, item) = (size_of::<ChunkHeader>(), size_of::<Event>());
        let buffer = if lossless { 3 } else { 64 };
        add(
            Topic::Events,
            self.chunk_events(),
            item,
            header,
            1,
            self.reconstructions.len(),
            buffer,
            lossless,
        );
        // A stage that falls behind drops whole ticks, so two of them must fit.
        let ticks = if lossless { 1 } else { 2 };
        for r in &self.reconstructions {
            let pixels = self.sensor.pixels() * r.channels;
            let header = size_of::<FrameHeader>();
            let buffer = (ticks * windows).max(2);
            add(
                Topic::Frames(r.id.clone()),
                pixels,
                1,
                header,
                1,
                self.extractors.len() + watchers,
                buffer,
                lossless,
            );
        }
        let rows_per_tick = windows * self.reconstructions.len();
        for e in &self.extractors {
            let header = size_of::<DescriptorHeader>();
            // Rows are small: room for several ticks of them, so that a sink that computes loses none.
            let buffer = if lossless {
                (2 * rows_per_tick).max(4)
            } else {
                (4 * rows_per_tick).max(64)
            };
            add(
                Topic::Descriptors(e.id.clone()),
                e.dim,
                size_of::<f32>(),
                header,
                1,
                sinks,
                buffer,
                lossless,
            );
        }
        let members = self.members.len().max(1);
        let header = size_of::<TickHeader>();
        let buffer = if lossless { 64 } else { 512 };
        add(
            Topic::Ticks,
            members,
            size_of::<f64>(),
            header,
            1,
            stages + sinks + 1,
            buffer,
            lossless,
        );
        if self.map.is_some() {
            let (header, item) = (size_of::<MatchHeader>(), size_of::<Candidate>());
            // Also in latest delivery: an answer that has been made is not lost. A reader of matches that is more than
            // 64 ticks behind holds the fuser up, and ticks are then dropped, and named, before it.
            add(
                Topic::Matches,
                self.fuse.top.max(1),
                item,
                header,
                1,
                1 + watchers,
                64,
                true,
            );
        }
        let (header, item) = (size_of::<ControlHeader>(), size_of::<MemberSetting>());
        add(Topic::Control, members, item, header, 1, 1 + stages, 4, false);
        let services = self.services().len();
        let (header, item) = (size_of::<LifecycleHeader>(), size_of::<ServiceState>());
        add(
            Topic::Lifecycle,
            services,
            item,
            header,
            1,
            sinks + watchers,
            4,
            false,
        );
        add(
            Topic::Stats,
            members,
            size_of::<MemberCost>(),
            size_of::<StatsHeader>(),
            services,
            1,
            2 * services.max(4),
            false,
        );
        let (header, item) = (size_of::<SpansHeader>(), size_of::<Span>());
        add(Topic::Spans, SPANS_AT_ONCE, item, header, services, 0, 16, false);
        if self.dashboard && self.map.is_some() {
            let (items, header) = (SCORE_COLUMNS + self.members.len(), size_of::<ScoresHeader>());
            add(
                Topic::Scores,
                items,
                size_of::<f32>(),
                header,
                1,
                watchers,
                16,
                false,
            );
        }
        all
    }

    /// The channel of this topic, if the plan has it.
    pub fn channel(&self, topic: &Topic) -> Option<Channel> {
        self.channels().into_iter().find(|c| c.topic == *topic)
    }

    /// Shared memory that the plan reserves in all, bytes.
    pub fn shared_memory_bytes(&self) -> usize {
        self.channels().iter().map(Channel::bytes).sum()
    }
}
