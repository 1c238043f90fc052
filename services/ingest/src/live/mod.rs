//! The live driver: a stream that waits for nobody.
//!
//! A thread connects, reads and decodes ([`camera`]) into a bounded queue ([`queue`]); this side puts the times right
//! ([`timeline`]), screens, slices and sends. It never waits for the source, nor the source for it: it wakes for an item,
//! for a deadline, or for the request to stop.
//!
//! - **A quiet sensor** still closes its windows: by the host's clock ([`clock`]), `source.slack` after their end. Events
//!   that come later than that are left out and counted.
//! - **Overload**: what does not fit the queue is lost, and with it every tick that it touches: their chunks say that
//!   their segments are not whole, so no window over them is passed on. In latest delivery a slow stage does not make
//!   ingest wait; in lossless delivery it does, and then whole ticks are lost here.
//! - **Disconnection**: ticks go on by the host's clock, as missing, until events come again.
//! - **Damaged times** cost only the events that have them; a time that jumps and stays there costs the ticks in between,
//!   which are missing.
//! - **A new life of ingest** goes on with the grid of ticks that the one before had opened.
//!
//! Standard input in lossless delivery is the exception: whoever writes it waits, nothing is lost, and nothing closes but
//! by its events, as with a file.

mod camera;
mod clock;
mod queue;
#[cfg(test)]
mod tests;
mod timeline;

pub(crate) use camera::Camera;

use crate::{Noise, NoiseTally, RawEvent, Screen, ScreenTally, SliceTally, Slicer, SourceError, source};
use camera::{HostClock, Stream};
use crossbeam::channel::{Receiver, TryRecvError};
use evpr_core::Reason;
use evpr_core::message::LiveStats;
use evpr_core::plan::{Plan, Sensor};
use evpr_core::stage::{IngestPort, StageError};
use evpr_events::{rough_seconds, seconds};
use queue::{Item, ItemReceiver, Patience};
use std::time::Duration;
use timeline::{Step, Timeline};

/// Events leave at the latest after so long, ns, though their window is not over.
const FLUSH_NS: u64 = 10_000_000;
/// The driver wakes at least this often to say that it is there, ns.
const HEARTBEAT_NS: u64 = 200_000_000;
/// A stretch without events in a stream that is ahead of the host's clock is told from this length on, ns.
const TOLD_QUIET_NS: u64 = 1_000_000_000;
/// How often the drift is computed anew, ns.
const DRIFT_EVERY_NS: u64 = 5_000_000_000;
/// Least time between two warnings of one kind, ns.
const WARN_EVERY_NS: u64 = 10_000_000_000;

/// What a live run of ingest came to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LiveSummary {
    /// The tick that the stream ends at: the first that is not whole.
    pub end_tick: u64,
    /// What the screen left out or changed.
    pub screened: ScreenTally,
    /// What was left out as noise.
    pub noise: NoiseTally,
    /// What became of the events that passed it.
    pub sliced: SliceTally,
    /// The source and its clock.
    pub live: LiveStats,
    /// True when it was asked to stop before the stream ended.
    pub stopped: bool,
}

/// Takes a stream as it comes, and sends its chunks and ticks. See the module.
pub struct Live {
    camera: Box<dyn Camera>,
    sensor: Sensor,
    stop: Receiver<()>,
    driver: Driver,
}

impl std::fmt::Debug for Live {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Live")
            .field("source", &self.driver.name)
            .finish_non_exhaustive()
    }
}

impl Live {
    /// Prepares for the plan's live source, without connecting to it. `first_tick`, `epoch` and `stop` as for
    /// [`crate::Ingest::new`].
    ///
    /// # Errors
    /// When this build has no such source, or it cannot be read in the middle.
    pub fn new(plan: &Plan, first_tick: u64, epoch: u32, stop: Receiver<()>) -> Result<Self, SourceError> {
        Ok(Self {
            camera: source::camera(plan, epoch > 1)?,
            sensor: plan.sensor,
            stop,
            driver: Driver::new(plan, first_tick, epoch)?,
        })
    }

    /// Only says where the stream ends: at tick `first_tick`. For a new life of ingest that is to stop before it begins,
    /// though its source cannot be read again.
    ///
    /// # Errors
    /// Those of the port, and when the plan cannot be used.
    pub fn end_at(
        plan: &Plan,
        first_tick: u64,
        epoch: u32,
        port: &mut dyn IngestPort,
    ) -> Result<LiveSummary, StageError> {
        let driver = Driver::new(plan, first_tick, epoch).map_err(|e| StageError::Fatal(e.to_string()))?;
        driver.end(Ok(true), port)
    }

    /// Runs until the stream ends for good, it fails, or the stop signal comes; then says where the stream ends.
    ///
    /// # Errors
    /// [`StageError::Fatal`] when it would be no use to connect again, or the port broke. Everything before that has
    /// been sent, the end included.
    pub fn run(self, port: &mut dyn IngestPort) -> Result<LiveSummary, StageError> {
        let Self {
            camera,
            sensor,
            stop,
            mut driver,
        } = self;
        let clock = HostClock::new(port.now_ns());
        let stream = Stream::start(camera, driver.name.clone(), sensor, driver.patience, clock);
        let outcome = stream
            .map_err(|e| StageError::Fatal(e.to_string()))
            .and_then(|stream| {
                let items = &stream.items;
                driver.run(&mut Wait { items, stop }, port)
            });
        driver.end(outcome, port)
    }
}

/// What the driver woke for.
enum Next {
    Item(Item),
    /// The deadline.
    Due,
    /// The request to stop.
    Stopped,
    /// The source's thread has gone without a word.
    Gone,
}

/// Where items come from.
trait Arrivals {
    /// The next item, or what else is next until the host time `deadline_ns`.
    fn next(&mut self, deadline_ns: u64, port: &mut dyn IngestPort) -> Next;
}

/// The queue and the request to stop.
struct Wait<'a> {
    items: &'a ItemReceiver,
    stop: Receiver<()>,
}

impl Arrivals for Wait<'_> {
    fn next(&mut self, deadline_ns: u64, port: &mut dyn IngestPort) -> Next {
        if self.stop.try_recv() != Err(TryRecvError::Empty) {
            return Next::Stopped;
        }
        loop {
            if let Some(item) = self.items.take() {
                return Next::Item(item);
            }
            let wait = Duration::from_nanos(deadline_ns.saturating_sub(port.now_ns()));
            port.rests();
            crossbeam::select! {
                recv(self.stop) -> _ => return Next::Stopped,
                recv(self.items.bell) -> rung => if rung.is_err() {
                    // What it had left comes first.
                    return self.items.take().map_or(Next::Gone, Next::Item);
                },
                default(wait) => return Next::Due,
            }
        }
    }
}

/// What becomes of the items.
struct Driver {
    name: String,
    patience: Patience,
    slack_ns: u64,
    slicer: Slicer,
    screen: Screen,
    noise: Noise,
    timeline: Timeline,
    /// When the events that are kept back were kept back first.
    kept_since_ns: Option<u64>,
    live: LiveStats,
    /// Lost before they came to the slicer.
    lost_in_queue: u64,
    last_unreachable: String,
    drift_at_ns: u64,
    warned: [Option<u64>; 4],
}

/// What is warned of now and then.
#[derive(Debug, Clone, Copy)]
enum Warning {
    Overload = 0,
    Late = 1,
    Jump = 2,
    Damaged = 3,
}

impl Driver {
    fn new(plan: &Plan, first_tick: u64, epoch: u32) -> Result<Self, SourceError> {
        let live = plan.is_live();
        Ok(Self {
            name: plan.source.path.display().to_string(),
            patience: if live { Patience::Loses } else { Patience::Waits },
            slack_ns: plan.source.live.as_ref().map_or(0, |l| l.slack_ns),
            slicer: Slicer::new(plan, first_tick, epoch),
            screen: Screen::new(plan),
            noise: Noise::new(plan)?,
            timeline: Timeline::default(),
            kept_since_ns: None,
            live: LiveStats {
                is_live: 1,
                ..LiveStats::default()
            },
            lost_in_queue: 0,
            last_unreachable: String::new(),
            drift_at_ns: 0,
            warned: [None; 4],
        })
    }

    fn loses(&self) -> bool {
        self.patience == Patience::Loses
    }

    /// Takes items until the stream ends (false) or it is stopped (true).
    fn run(&mut self, arrivals: &mut dyn Arrivals, port: &mut dyn IngestPort) -> Result<bool, StageError> {
        self.resume(port);
        loop {
            let deadline_ns = self.deadline_ns(port.now_ns());
            match arrivals.next(deadline_ns, port) {
                Next::Stopped => return Ok(true),
                Next::Gone => {
                    return Err(StageError::Fatal(format!("{}: decoding it panicked", self.name)));
                }
                Next::Due => self.close_what_is_over(port)?,
                Next::Item(item) => {
                    if self.take(item, port)? {
                        return Ok(false);
                    }
                }
            }
            self.flush_in_time(port)?;
            self.report(port);
        }
    }

    /// Goes on with the ticks of an earlier ingest, if there was one.
    fn resume(&mut self, port: &mut dyn IngestPort) {
        let Some(opened) = port.opened_before().filter(|_| self.loses()) else {
            return;
        };
        let start_ns = opened.start_us.saturating_mul(1_000);
        self.slicer.continue_grid(opened.tick, start_ns);
        self.slicer.lose(Reason::Lost);
        // It was opened within the slack of its start.
        let offset = (opened.sent_ns as i64).saturating_sub(i64::try_from(start_ns).unwrap_or(i64::MAX));
        self.timeline = Timeline::resumed(offset, port.now_ns());
    }

    /// When to wake though nothing comes, host ns.
    fn deadline_ns(&self, now_ns: u64) -> u64 {
        let flush = self.kept_since_ns.map(|since| since.saturating_add(FLUSH_NS));
        let edge = self.slicer.next_edge_ns().filter(|_| self.loses());
        let over = edge.and_then(|edge| self.timeline.clock.host_ns(edge));
        let over = over.map(|ns| ns.saturating_add(self.slack_ns));
        let heartbeat = now_ns.saturating_add(HEARTBEAT_NS);
        [flush, over].into_iter().flatten().fold(heartbeat, u64::min)
    }

    /// Closes the segments that are over by the host's clock.
    fn close_what_is_over(&mut self, port: &mut dyn IngestPort) -> Result<(), StageError> {
        if !self.loses() {
            return Ok(());
        }
        let until_ns = port.now_ns().saturating_sub(self.slack_ns);
        match self.timeline.clock.sensor_ns(until_ns) {
            Some(t_ns) => self.slicer.watermark(t_ns, port),
            None => Ok(()),
        }
    }

    /// Sends what has been kept back long enough.
    fn flush_in_time(&mut self, port: &mut dyn IngestPort) -> Result<(), StageError> {
        if !self.loses() || !self.slicer.keeps_events() {
            self.kept_since_ns = None;
            return Ok(());
        }
        let now = port.now_ns();
        let since = *self.kept_since_ns.get_or_insert(now);
        if now >= since.saturating_add(FLUSH_NS) {
            self.kept_since_ns = None;
            self.slicer.flush(port)?;
        }
        Ok(())
    }

    /// Takes one item. True when the stream is over.
    fn take(&mut self, item: Item, port: &mut dyn IngestPort) -> Result<bool, StageError> {
        match item {
            Item::Events { arrival_ns, events } if self.loses() => self.arrived(arrival_ns, events, port)?,
            Item::Events { events, .. } => self.enter(events, port)?,
            Item::Lost(events) => {
                self.lost_in_queue += events;
                self.slicer.lose(Reason::Dropped);
                if self.may_warn(Warning::Overload, port) {
                    tracing::warn!(
                        events = self.lost_in_queue,
                        "{}: events come faster than they are taken; whole ticks are dropped",
                        self.name
                    );
                }
            }
            Item::Connected(about) => {
                self.live.connected = 1;
                self.last_unreachable.clear();
                tracing::info!(
                    format = about.format,
                    time_unit = about.time_unit,
                    time_unit_from = about.time_unit_from,
                    "{}: connected",
                    self.name
                );
            }
            Item::Unreachable(why) => {
                if why != self.last_unreachable {
                    tracing::warn!("{why}; trying again until it works");
                    self.last_unreachable = why;
                }
            }
            Item::Disconnected(why) => {
                tracing::warn!("{why}; connecting again, and ticks until then are missing");
                self.live.connected = 0;
                self.live.disconnects += 1;
                if self.slicer.origin_ns().is_some() {
                    self.slicer.lose(Reason::Disconnected);
                    self.timeline.reconnects();
                }
            }
            Item::Failed(why) => return Err(StageError::Fatal(why)),
            Item::Ended => return Ok(true),
        }
        Ok(false)
    }

    /// Events with a time of their own.
    fn arrived(
        &mut self,
        arrival_ns: u64,
        mut events: Vec<RawEvent>,
        port: &mut dyn IngestPort,
    ) -> Result<(), StageError> {
        let steps = self.timeline.admit(arrival_ns, &mut events);
        self.left_out_damaged(port);
        let mut done = 0;
        for step in steps {
            let after = events.split_off(step.at - done);
            done = step.at;
            self.enter(events, port)?;
            self.stepped(step, port);
            events = after;
        }
        self.enter(events, port)
    }

    fn stepped(&mut self, step: Step, port: &mut dyn IngestPort) {
        if step.anchored {
            self.live.jumps += 1;
            self.slicer.lose(Reason::Disconnected);
            if self.may_warn(Warning::Jump, port) {
                tracing::warn!(
                    jumps = self.live.jumps,
                    "{}: the camera's time jumped to {}; it is taken to be {}, by the host's clock, and the ticks in \
                     between are missing",
                    self.name,
                    seconds(step.sensor_ns),
                    seconds(step.at_ns)
                );
            }
        } else if step.ahead_ns >= TOLD_QUIET_NS && self.may_warn(Warning::Jump, port) {
            tracing::warn!(
                "{}: the camera's time went ahead by {} to {}, faster than the host's clock; the ticks in between have no \
                 events",
                self.name,
                rough_seconds(step.ahead_ns),
                seconds(step.at_ns)
            );
        }
    }

    /// Counts what the timeline has left out.
    fn left_out_damaged(&mut self, port: &mut dyn IngestPort) {
        let damaged = self.timeline.take_damaged();
        if damaged == 0 {
            return;
        }
        self.screen.left_out_damaged(damaged);
        if self.may_warn(Warning::Damaged, port) {
            tracing::warn!(
                damaged_times = self.screen.tally().damaged_times,
                "{}: events whose times do not go with those around them are left out; the stream is damaged",
                self.name
            );
        }
    }

    /// Events on the timeline.
    fn enter(&mut self, mut events: Vec<RawEvent>, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let screened = self.screen.apply(&mut events);
        // Noise or not: they say when the stream begins, and how far it has come.
        let (first, last) = (events.first().copied(), events.last().copied());
        self.noise.apply(&mut events);
        let mut rest = events.as_slice();
        if let Some(first) = first.filter(|_| self.loses()) {
            // Whole µs, so that a later life of ingest finds the same grid in what this one says of its ticks.
            self.slicer.anchor(first.t_ns - first.t_ns % 1_000);
            let begun = self.slicer.segment_start_ns().filter(|_| self.slicer.has_begun());
            let late = rest.partition_point(|e| begun.is_some_and(|start| e.t_ns < start));
            if late > 0 {
                self.late(late, rest[0].t_ns, port);
                rest = &rest[late..];
            }
        }
        if let Some(first) = first {
            self.slicer.anchor(first.t_ns);
        }
        self.slicer.push(rest, port)?;
        if let Some(last) = last {
            self.slicer.check_gap(&last)?;
            self.slicer.watermark(last.t_ns, port)?;
        }
        screened.map_err(|e| StageError::Fatal(e.to_string()))
    }

    fn late(&mut self, events: usize, t_ns: u64, port: &mut dyn IngestPort) {
        self.live.late_events += events as u64;
        if self.may_warn(Warning::Late, port) {
            let begun = self.slicer.segment_start_ns().unwrap_or(t_ns);
            tracing::warn!(
                late_events = self.live.late_events,
                "{}: events come {} after their window was closed and are left out; if that goes on, make source.slack \
                 longer",
                self.name,
                rough_seconds(begun.saturating_sub(t_ns))
            );
        }
    }

    fn may_warn(&mut self, what: Warning, port: &mut dyn IngestPort) -> bool {
        let now = port.now_ns();
        let Some(last) = self.warned.get_mut(what as usize) else {
            return false;
        };
        let may = last.is_none_or(|last| now >= last.saturating_add(WARN_EVERY_NS));
        if may {
            *last = Some(now);
        }
        may
    }

    fn measure(&mut self) {
        let clock = &self.timeline.clock;
        let sliced = self.slicer.tally();
        self.live.dropped_ticks = sliced.dropped_ticks;
        self.live.missed_ticks = sliced.missed_ticks;
        self.live.lost_events = sliced.lost + self.lost_in_queue;
        self.live.offset_ns = clock.offset_ns().unwrap_or(0);
        self.live.delay_p50_ns = clock.delay_ns(0.5);
        self.live.delay_p99_ns = clock.delay_ns(0.99);
    }

    fn report(&mut self, port: &mut dyn IngestPort) {
        let now = port.now_ns();
        if now >= self.drift_at_ns {
            self.drift_at_ns = now.saturating_add(DRIFT_EVERY_NS);
            self.live.drift_ppb = self.timeline.clock.drift_ppb().unwrap_or(0);
            self.measure();
        }
        let sliced = self.slicer.tally();
        self.live.dropped_ticks = sliced.dropped_ticks;
        self.live.missed_ticks = sliced.missed_ticks;
        port.live(self.live);
        let skipped = sliced.skipped()
            + self.screen.tally().dropped()
            + self.noise.tally().dropped()
            + self.live.late_events;
        port.progress(
            0,
            self.slicer.next_tick(),
            sliced.sent,
            skipped + self.lost_in_queue,
        );
    }

    /// Sends the end of the stream, whatever happened before.
    fn end(
        mut self,
        outcome: Result<bool, StageError>,
        port: &mut dyn IngestPort,
    ) -> Result<LiveSummary, StageError> {
        let ended = self.slicer.finish(port);
        self.timeline.give_up();
        self.left_out_damaged(port);
        self.live.connected = 0;
        self.measure();
        self.drift_at_ns = 0;
        self.report(port);
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
        let (sliced, screened, live) = (self.slicer.tally(), self.screen.tally(), self.live);
        let noise = self.noise.tally();
        tracing::info!(
            end_tick,
            stopped,
            sent = sliced.sent,
            dropped_ticks = live.dropped_ticks,
            missed_ticks = live.missed_ticks,
            lost_events = live.lost_events,
            late_events = live.late_events,
            disconnects = live.disconnects,
            jumps = live.jumps,
            drift_ppm = live.drift_ppb as f64 / 1e3,
            delay_p50_ms = live.delay_p50_ns as f64 / 1e6,
            delay_p99_ms = live.delay_p99_ns as f64 / 1e6,
            "live stream done"
        );
        screened.log();
        noise.log();
        Ok(LiveSummary {
            end_tick,
            screened,
            noise,
            sliced,
            live,
            stopped,
        })
    }
}
