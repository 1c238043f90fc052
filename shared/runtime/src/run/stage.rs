//! The loop of reconstructions and extractors.

use super::ServiceContext;
use crate::RuntimeError;
use crate::channel::{ChannelReceiver, ChannelSender, Incoming};
use crate::clock::now_ns;
use crate::telemetry::{HEARTBEAT, RateLimit};
use crate::wait::{Waiter, wait_set};
use evpr_core::message::{Header, ServicePhase, TickKind, Ticks};
use evpr_core::plan::{Delivery, Topic};
use evpr_core::stage::{Stage, StageError};
use std::collections::VecDeque;
use tracing::{debug, warn};

/// Ticks that may lie between the one in hand and the newest before the stage counts as behind: what the buffers of
/// `latest` delivery hold.
const TICKS_IN_BUFFER: u64 = 2;

/// Decides once per tick whether it is dropped, so that a tick goes whole or not at all.
#[derive(Debug, Default)]
struct TickDrop {
    newest: u64,
    decided: VecDeque<(u64, bool)>,
}

impl TickDrop {
    const MEMORY: usize = 16;

    fn drops(&mut self, tick: u64, gap: bool) -> bool {
        if let Some((_, drop)) = self.decided.iter().find(|(t, _)| *t == tick) {
            return *drop;
        }
        let drop = gap || tick + TICKS_IN_BUFFER < self.newest;
        if self.decided.len() == Self::MEMORY {
            self.decided.pop_front();
        }
        self.decided.push_back((tick, drop));
        drop
    }
}

struct Loop<'a, S: Stage> {
    stage: &'a mut S,
    sender: ChannelSender<S::Out>,
    ticks: Option<ChannelReceiver<Ticks>>,
    drop: TickDrop,
    /// Messages of ticks that were dropped whole.
    dropped: u64,
    warnings: RateLimit,
}

impl<S: Stage> Loop<'_, S> {
    fn newest_tick(&mut self) -> Result<(), RuntimeError> {
        if let Some(ticks) = &self.ticks {
            while let Some(message) = ticks.receive()? {
                if message.header().kind == TickKind::Open as u32 {
                    self.drop.newest = self.drop.newest.max(message.header().tick);
                }
            }
        }
        Ok(())
    }

    /// Lets the stage give what it held back, as nothing waits.
    fn flush(&mut self, ctx: &mut ServiceContext) -> Result<(), StageError> {
        let started = now_ns();
        self.sender.started_ns = started;
        let (sent, sending_ns) = (self.sender.sent, self.sender.record.sending.sum_ns);
        let outcome = self.stage.flush(&mut self.sender);
        if self.sender.sent > sent {
            let sending_ns = self.sender.record.sending.sum_ns - sending_ns;
            let stats = &mut ctx.telemetry.stats;
            stats
                .processing
                .record(now_ns().saturating_sub(started).saturating_sub(sending_ns));
            stats.emitted = self.sender.sent;
        }
        self.judge(ctx, outcome)
    }

    fn take(&mut self, ctx: &mut ServiceContext, message: &Incoming<S::In>) -> Result<(), StageError> {
        let header = message.header();
        let started = now_ns();
        ctx.telemetry.took(header, started);
        self.sender.started_ns = started;
        let sending_ns = self.sender.record.sending.sum_ns;
        let dropped = self.ticks.is_some() && self.drop.drops(header.tick(), message.gap);
        let outcome = if dropped {
            self.dropped += 1;
            self.stage.skip_dropped(header, &mut self.sender)
        } else {
            self.stage.process(header, message.payload(), &mut self.sender)
        };
        let sending_ns = self.sender.record.sending.sum_ns - sending_ns;
        ctx.telemetry.worked(header, started, sending_ns);
        let stats = &mut ctx.telemetry.stats;
        stats.emitted = self.sender.sent;
        stats.events = self.stage.events();
        self.judge(ctx, outcome)
    }

    /// Goes on after what only one message is to blame for.
    fn judge(&mut self, ctx: &mut ServiceContext, outcome: Result<(), StageError>) -> Result<(), StageError> {
        match outcome {
            Err(StageError::Skip(what)) => {
                ctx.telemetry.stats.skipped += 1;
                if let Some(held_back) = self.warnings.pass() {
                    warn!(held_back, "{what}");
                }
                Ok(())
            }
            other => other,
        }
    }
}

/// Runs a stage until it is asked to stop.
///
/// # Errors
/// When shared memory fails or the stage cannot go on.
pub fn run_stage<S: Stage>(
    mut ctx: ServiceContext,
    inputs: &[Topic],
    output: &Topic,
    stage: &mut S,
) -> Result<(), RuntimeError> {
    let receivers = inputs
        .iter()
        .map(|topic| ctx.receiver::<S::In>(topic))
        .collect::<Result<Vec<_>, _>>()?;
    let latest = ctx.plan.delivery == Delivery::Latest;
    let ticks = if latest {
        Some(ctx.receiver::<Ticks>(&Topic::Ticks)?)
    } else {
        None
    };
    let sender = ctx.sender(output, 1)?;
    let mut state = Loop {
        stage,
        sender,
        ticks,
        drop: TickDrop::default(),
        dropped: 0,
        warnings: RateLimit::default(),
    };
    ctx.telemetry.phase(ServicePhase::Ready)?;
    debug!(service = ctx.service.name, "ready");
    let (set, wake) = (wait_set()?, ctx.wake.clone());
    let mut listeners: Vec<_> = receivers.iter().map(ChannelReceiver::listener).collect();
    listeners.push(&wake);
    let waiter = Waiter::new(&set, listeners)?;
    loop {
        ctx.telemetry.rests();
        waiter.wait(HEARTBEAT)?;
        let mut came = true;
        while came {
            came = false;
            state.newest_tick()?;
            for receiver in &receivers {
                if ctx.stop.requested() {
                    return ctx.telemetry.send();
                }
                if let Some(message) = receiver.receive()? {
                    came = true;
                    match state.take(&mut ctx, &message) {
                        Ok(()) | Err(StageError::Stopped) => {}
                        Err(e) => return Err(RuntimeError::Stage(e.to_string())),
                    }
                }
            }
            if !came {
                match state.flush(&mut ctx) {
                    Ok(()) | Err(StageError::Stopped) => {}
                    Err(e) => return Err(RuntimeError::Stage(e.to_string())),
                }
            }
            let stats = &mut ctx.telemetry.stats;
            stats.sending = state.sender.record.sending;
            stats.refused = receivers.iter().map(ChannelReceiver::refused).sum();
            stats.dropped = state.dropped + receivers.iter().map(ChannelReceiver::lost).sum::<u64>();
            ctx.telemetry.collect(&mut state.sender.record)?;
            ctx.telemetry.beat()?;
        }
        if ctx.stop.requested() {
            return ctx.telemetry.send();
        }
    }
}
