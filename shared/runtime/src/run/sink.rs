//! The loop of the fuser and the recorder.

use super::ServiceContext;
use crate::RuntimeError;
use crate::channel::{ChannelReceiver, ChannelSender, NoOutlet};
use crate::clock::now_ns;
use crate::telemetry::{HEARTBEAT, RateLimit};
use crate::wait::{Waiter, wait_set};
use evpr_core::message::{
    Descriptors, Doing, Lifecycle, Matches, MemberCost, ServicePhase, ServiceState, TickKind, Ticks,
};
use evpr_core::plan::Topic;
use evpr_core::stage::{Outlet, Sink, StageError};
use std::time::Duration;
use tracing::{debug, trace, warn};

/// How often a sink says what members cost where somebody acts on it.
const GOVERNED: Duration = Duration::from_millis(20);
/// Messages taken from one channel before the others have their turn.
const BATCH: usize = 32;

struct Channels {
    rows: Vec<ChannelReceiver<Descriptors>>,
    ticks: ChannelReceiver<Ticks>,
    lifecycle: ChannelReceiver<Lifecycle>,
}

struct Inputs<'c> {
    channels: &'c Channels,
    /// The newest word on who is dead, until every row sent before it has been taken.
    dead: Option<Vec<ServiceState>>,
    warnings: RateLimit,
}

impl Channels {
    fn open(ctx: &ServiceContext) -> Result<Self, RuntimeError> {
        let topic = |id: &String| Topic::Descriptors(id.clone());
        let rows = ctx
            .plan
            .extractors
            .iter()
            .map(|e| ctx.receiver(&topic(&e.id)))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            rows,
            ticks: ctx.receiver(&Topic::Ticks)?,
            lifecycle: ctx.receiver(&Topic::Lifecycle)?,
        })
    }
}

impl Inputs<'_> {
    /// One turn over all channels; true when something came.
    fn turn(&mut self, ctx: &mut ServiceContext, sink: &mut dyn Sink) -> Result<bool, RuntimeError> {
        let mut came = false;
        let mut rows_left = false;
        while let Some(message) = self.channels.lifecycle.receive()? {
            self.dead = Some(message.payload().to_vec());
        }
        for _ in 0..BATCH {
            let Some(message) = self.channels.ticks.receive()? else {
                break;
            };
            came = true;
            let started = now_ns();
            let outcome = sink.tick(message.header(), message.payload());
            if message.header().kind == TickKind::Close as u32 {
                ctx.telemetry.span(message.header(), started, now_ns());
            }
            trace!(
                tick = message.header().tick,
                kind = message.header().kind,
                gap = message.gap,
                "tick message"
            );
            self.skipped(ctx, message.header().tick, outcome)?;
        }
        for index in 0..self.channels.rows.len() {
            let mut taken = 0;
            while taken < BATCH {
                let Some(message) = self.channels.rows[index].receive()? else {
                    break;
                };
                taken += 1;
                let started = now_ns();
                ctx.telemetry.took(message.header(), started);
                let outcome = sink.descriptor(message.header(), message.payload());
                ctx.telemetry.row(message.header(), started);
                trace!(
                    tick = message.header().tick,
                    member = message.header().member,
                    gap = message.gap,
                    "row"
                );
                self.skipped(ctx, message.header().tick, outcome)?;
            }
            came |= taken > 0;
            rows_left |= taken == BATCH;
        }
        if !rows_left && let Some(dead) = self.dead.take() {
            sink.lifecycle(&dead);
        }
        let stats = &mut ctx.telemetry.stats;
        stats.dropped = self.channels.rows.iter().map(ChannelReceiver::lost).sum();
        stats.refused = self
            .channels
            .rows
            .iter()
            .map(ChannelReceiver::refused)
            .sum::<u64>()
            + self.channels.ticks.refused()
            + self.channels.lifecycle.refused();
        Ok(came)
    }

    fn skipped(
        &mut self,
        ctx: &mut ServiceContext,
        tick: u64,
        outcome: Result<(), StageError>,
    ) -> Result<(), RuntimeError> {
        match outcome {
            Ok(()) | Err(StageError::Stopped) => Ok(()),
            Err(StageError::Skip(what)) => {
                ctx.telemetry.stats.skipped += 1;
                if let Some(held_back) = self.warnings.pass() {
                    warn!(tick, held_back, "{what}");
                }
                Ok(())
            }
            Err(e) => Err(RuntimeError::Stage(e.to_string())),
        }
    }
}

/// Runs a sink until its stream has ended and it is asked to stop. `answers` says whether it publishes matches.
///
/// # Errors
/// When shared memory fails or the sink cannot go on.
pub fn run_sink(mut ctx: ServiceContext, sink: &mut dyn Sink, answers: bool) -> Result<(), RuntimeError> {
    let channels = Channels::open(&ctx)?;
    let mut inputs = Inputs {
        channels: &channels,
        dead: None,
        warnings: RateLimit::default(),
    };
    let mut matches: Option<ChannelSender<Matches>> = if answers {
        Some(ctx.sender(&Topic::Matches, 1)?)
    } else {
        None
    };
    ctx.telemetry.costs = vec![MemberCost::default(); ctx.plan.members.len()];
    ctx.telemetry.stats.next_tick = sink.next_tick();
    ctx.telemetry.phase(ServicePhase::Ready)?;
    debug!(service = ctx.service.name, next_tick = sink.next_tick(), "ready");
    let (set, wake) = (wait_set()?, ctx.wake.clone());
    let mut listeners: Vec<_> = channels.rows.iter().map(ChannelReceiver::listener).collect();
    listeners.extend([channels.ticks.listener(), channels.lifecycle.listener(), &wake]);
    let waiter = Waiter::new(&set, listeners)?;
    let governed = ctx.plan.governor.is_some();
    let mut done = false;
    while !ctx.stop.requested() {
        ctx.telemetry.rests();
        waiter.wait(timeout(sink.deadline_ns()))?;
        loop {
            let came = inputs.turn(&mut ctx, sink)?;
            if came && governed {
                // The costs of a tick are known where its answer is judged.
                ctx.telemetry.beat_within(GOVERNED)?;
            }
            let started = now_ns();
            let before = sink.next_tick();
            if let Some(sender) = &mut matches {
                sender.started_ns = started;
            }
            let sending_ns = matches.as_ref().map_or(0, |m| m.record.sending.sum_ns);
            let outlet: &mut dyn Outlet<Matches> = match &mut matches {
                Some(sender) => sender,
                None => &mut NoOutlet,
            };
            if !answers {
                ctx.telemetry.activity.set(Doing::Writing, started);
            }
            let outcome = sink.settle(started, outlet);
            inputs.skipped(&mut ctx, before, outcome)?;
            let stats = &mut ctx.telemetry.stats;
            stats.next_tick = sink.next_tick();
            let settled = sink.next_tick() - before;
            let sent = matches.as_ref().map(|m| m.record.sending).unwrap_or_default();
            let took_ns = now_ns().saturating_sub(started + sent.sum_ns.saturating_sub(sending_ns));
            stats.sending = sent;
            if let Some(each_ns) = took_ns.checked_div(settled) {
                stats.processing.record(each_ns);
                stats.emitted += settled;
            }
            if let Some(sender) = &mut matches {
                ctx.telemetry.collect(&mut sender.record)?;
            }
            ctx.telemetry.beat()?;
            if !done && sink.finished() {
                done = true;
                ctx.telemetry.activity.set(Doing::Writing, now_ns());
                sink.close().map_err(|e| RuntimeError::Stage(e.to_string()))?;
                ctx.telemetry.phase(ServicePhase::Done)?;
            }
            if !came || ctx.stop.requested() {
                break;
            }
        }
    }
    if !done {
        ctx.telemetry.activity.set(Doing::Writing, now_ns());
        sink.close().map_err(|e| RuntimeError::Stage(e.to_string()))?;
    }
    ctx.telemetry.send()
}

fn timeout(deadline_ns: Option<u64>) -> Duration {
    let due = deadline_ns.map_or(Duration::MAX, |due| {
        Duration::from_nanos(due.saturating_sub(now_ns()))
    });
    due.min(HEARTBEAT)
}
