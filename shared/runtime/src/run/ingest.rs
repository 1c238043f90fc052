//! The process that reads and cuts events.

use super::ServiceContext;
use crate::RuntimeError;
use crate::channel::{ChannelReceiver, ChannelSender};
use crate::clock::now_ns;
use crate::domain::Schedule;
use crate::telemetry::HEARTBEAT;
use crate::wait::{Waiter, wait_set};
use evpr_core::message::{
    ChunkHeader, Chunks, Control, Doing, Event, LiveStats, ServicePhase, TickHeader, TickKind, Ticks,
};
use evpr_core::plan::{Delivery, Topic};
use evpr_core::stage::{IngestPort, OpenedTick, Outlet, Settings, StageError};
use std::time::Duration;
use tracing::{debug, warn};

struct Port {
    ctx: ServiceContext,
    chunks: ChannelSender<Chunks>,
    ticks: ChannelSender<Ticks>,
    control: ChannelReceiver<Control>,
    /// What held when this process was started.
    inherited: Schedule,
    /// The newest settings that came since, until a tick opens for which they can hold.
    came: Option<Settings>,
    version: u64,
    /// The end of the stream, once it is said.
    end: Option<TickHeader>,
    /// The tick at which the stream ends, whatever the source still has.
    end_tick: Option<u64>,
    /// Requests to stop before the end was sent.
    stops_at_end: u32,
}

impl IngestPort for Port {
    fn now_ns(&self) -> u64 {
        now_ns()
    }

    fn chunk(
        &mut self,
        header: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError> {
        let started = now_ns();
        let telemetry = &mut self.ctx.telemetry;
        telemetry.activity.set(Doing::Working, started);
        self.chunks.started_ns = started;
        let sending_ns = self.chunks.record.sending.sum_ns;
        self.chunks.emit(header, len, fill)?;
        let sending_ns = self.chunks.record.sending.sum_ns - sending_ns;
        let stats = &mut telemetry.stats;
        stats
            .processing
            .record(now_ns().saturating_sub(started).saturating_sub(sending_ns));
        stats.emitted += 1;
        telemetry
            .collect(&mut self.chunks.record)
            .map_err(|e| StageError::Fatal(e.to_string()))
    }

    fn tick(&mut self, header: TickHeader, weights: &[f64]) -> Result<(), StageError> {
        let ends = header.kind == TickKind::End as u32;
        if self.end.is_some() {
            return if ends { Ok(()) } else { Err(StageError::Stopped) };
        }
        if let Some(tick) = self.end_tick.filter(|end| header.tick >= *end && !ends) {
            let end = TickHeader {
                tick,
                kind: TickKind::End as u32,
                ..header
            };
            self.end = Some(end);
            self.ticks.emit(end, 0, &mut |_| {})?;
            return Err(StageError::Stopped);
        }
        if ends {
            self.end = Some(header);
            // Looked at before the end goes out: once it is out, the supervisor may ask this process to go.
            self.stops_at_end = self.ctx.stop.count();
        }
        self.ticks.started_ns = now_ns();
        self.ticks
            .emit(header, weights.len(), &mut |slots| slots.copy_from_slice(weights))?;
        self.ctx
            .telemetry
            .collect(&mut self.ticks.record)
            .map_err(|e| StageError::Fatal(e.to_string()))
    }

    fn control(&mut self, tick: u64) -> Option<Settings> {
        loop {
            match self.control.receive() {
                Ok(Some(message)) => {
                    let header = message.header();
                    self.came = Some(Settings {
                        version: header.version,
                        fuse: header.fuse,
                        members: message.payload().to_vec(),
                    });
                }
                Ok(None) => break,
                Err(e) => {
                    warn!("settings cannot be received: {e}");
                    break;
                }
            }
        }
        let old = self.inherited.entries.iter().rfind(|(from, _)| *from <= tick);
        let old = old.map(|(_, settings)| settings.for_ingest());
        let new = if tick >= self.inherited.opened_before {
            self.came.take()
        } else {
            None
        };
        let newest = [old, new].into_iter().flatten().max_by_key(|s| s.version);
        let settings = newest.filter(|s| s.version > self.version)?;
        self.version = settings.version;
        Some(settings)
    }

    fn wait_until(&mut self, ns: u64) -> Result<(), StageError> {
        loop {
            let now = now_ns();
            if now >= ns {
                self.ctx.telemetry.activity.set(Doing::Working, now);
                return Ok(());
            }
            self.ctx.telemetry.rests();
            let pause = Duration::from_nanos(ns - now).min(HEARTBEAT);
            match self.ctx.stop.signal().recv_timeout(pause) {
                Err(crossbeam::channel::RecvTimeoutError::Timeout) => {
                    self.ctx
                        .telemetry
                        .beat()
                        .map_err(|e| StageError::Fatal(e.to_string()))?;
                }
                _ => return Err(StageError::Stopped),
            }
        }
    }

    fn rests(&mut self) {
        self.ctx.telemetry.rests();
    }

    fn progress(&mut self, permille: u64, next_tick: u64, events: u64, skipped: u64) {
        let stats = &mut self.ctx.telemetry.stats;
        stats.progress_permille = permille;
        stats.next_tick = next_tick;
        stats.events = events;
        stats.skipped = skipped;
        stats.sending = self.chunks.record.sending;
        stats.refused = self.control.refused();
        self.ctx.telemetry.activity.set(Doing::Working, now_ns());
        if let Err(e) = self.ctx.telemetry.beat() {
            warn!("progress cannot be reported: {e}");
        }
    }

    fn live(&mut self, stats: LiveStats) {
        self.ctx.telemetry.stats.live = stats;
    }

    fn opened_before(&self) -> Option<OpenedTick> {
        self.inherited.newest
    }
}

/// Runs ingest: `work` is given the port and returns when its stream has ended, the end included; with `end_tick` the
/// stream ends there at the latest. The process then
/// stays until it is asked to stop, so that what it sent can still be read.
///
/// # Errors
/// When shared memory fails or `work` does.
pub fn run_ingest(
    ctx: ServiceContext,
    end_tick: Option<u64>,
    work: impl FnOnce(&mut dyn IngestPort) -> Result<(), StageError>,
) -> Result<(), RuntimeError> {
    // The end is sent even after a first request to stop: only a second one gives up waiting for room.
    let chunks = ctx.sender(&Topic::Events, 2)?;
    let ticks = ctx.sender(&Topic::Ticks, 2)?;
    let control = ctx.receiver(&Topic::Control)?;
    let inherited = ctx.folder.read_schedule()?;
    let mut port = Port {
        ctx,
        chunks,
        ticks,
        control,
        inherited,
        came: None,
        version: 0,
        end: None,
        end_tick,
        stops_at_end: 0,
    };
    port.ctx.telemetry.phase(ServicePhase::Ready)?;
    debug!("ready");
    let outcome = work(&mut port);
    let stopped_by = if port.end.is_some() {
        port.stops_at_end
    } else {
        port.ctx.stop.count()
    };
    let phase = if stopped_by > 0 {
        ServicePhase::Stopped
    } else {
        ServicePhase::Done
    };
    port.ctx.telemetry.phase(phase)?;
    let (set, wake) = (wait_set()?, port.ctx.wake.clone());
    let waiter = Waiter::new(&set, vec![&wake])?;
    // A failed source has sent its end too; what came before it is answered before the failure is reported.
    let latest = port.ctx.plan.delivery == Delivery::Latest;
    port.ctx.telemetry.rests();
    while port.ctx.stop.count() <= stopped_by.min(1) {
        waiter.wait(HEARTBEAT)?;
        port.ctx.telemetry.beat()?;
        // In latest delivery it may have been lost like any other message.
        if let Some(end) = port.end.filter(|_| latest) {
            port.ticks
                .emit(end, 0, &mut |_| {})
                .map_err(|e| RuntimeError::Stage(e.to_string()))?;
        }
    }
    match outcome {
        Ok(()) | Err(StageError::Stopped) => Ok(()),
        Err(e) => Err(RuntimeError::Stage(e.to_string())),
    }
}
