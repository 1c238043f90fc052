//! The loop of reconstructions and extractors.

use super::ServiceContext;
use crate::RuntimeError;
use crate::channel::{ChannelReceiver, ChannelSender, Incoming};
use crate::clock::now_ns;
use crate::telemetry::{HEARTBEAT, RateLimit};
use crate::wait::{Waiter, wait_set};
use evpr_core::message::{Control, Doing, Header, ServicePhase, TickKind, Ticks};
use evpr_core::plan::{Delivery, Member, ServiceKind, Topic};
use evpr_core::stage::{Stage, StageError};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::Duration;
use tracing::{debug, info, warn};

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

/// Whether the stage shall give memory back.
struct Unload {
    control: ChannelReceiver<Control>,
    /// The members that the stage works for.
    members: Vec<usize>,
    wanted: bool,
    /// Messages sent when it was looked last, and when that number last changed.
    sent: u64,
    changed_ns: u64,
}

impl Unload {
    /// A stage that has sent nothing for so long has nothing under way for members that were just switched off.
    const IDLE_NS: u64 = 1_000_000_000;

    fn new(ctx: &ServiceContext) -> Result<Self, RuntimeError> {
        let (kind, index) = (ctx.service.kind, ctx.service.index);
        let works_for = |m: &Member| match kind {
            ServiceKind::Reconstruct => m.reconstruction == index,
            _ => m.extractor == index,
        };
        let members = ctx.plan.members.iter().enumerate();
        Ok(Self {
            control: ctx.receiver(&Topic::Control)?,
            members: members.filter(|(_, m)| works_for(m)).map(|(i, _)| i).collect(),
            wanted: false,
            sent: 0,
            changed_ns: now_ns(),
        })
    }

    /// Whether it is time to unload.
    fn is_due(&mut self, sent: u64) -> Result<bool, RuntimeError> {
        while let Some(message) = self.control.receive()? {
            let settings = message.payload();
            let mut own = self.members.iter().filter_map(|m| settings.get(*m)).peekable();
            self.wanted = own.peek().is_some();
            let mut unload = false;
            for setting in own {
                self.wanted &= setting.enabled == 0;
                unload |= setting.unload != 0;
            }
            self.wanted &= unload;
        }
        let now = now_ns();
        if sent != self.sent {
            (self.sent, self.changed_ns) = (sent, now);
        }
        Ok(self.wanted && now.saturating_sub(self.changed_ns) >= Self::IDLE_NS)
    }
}

/// Makes a stage slow on purpose, for tests of what happens then: the folder that `EVPR_TEST_DELAYS` names may hold a file
/// with the process's name (`/` as `_`) and in it the ms that each of its messages shall take longer.
struct Delay(PathBuf);

impl Delay {
    fn of(ctx: &ServiceContext) -> Option<Self> {
        let folder = std::env::var_os("EVPR_TEST_DELAYS")?;
        Some(Self(
            PathBuf::from(folder).join(ctx.service.name.replace('/', "_")),
        ))
    }

    fn wait(&self, ctx: &ServiceContext) {
        let text = std::fs::read_to_string(&self.0).unwrap_or_default();
        if let Ok(ms) = text.trim().parse() {
            // Ends early when the process is asked to stop.
            let _ = ctx.stop.signal().recv_timeout(Duration::from_millis(ms));
        }
    }
}

struct Loop<'a, S: Stage> {
    stage: &'a mut S,
    sender: ChannelSender<S::Out>,
    ticks: Option<ChannelReceiver<Ticks>>,
    drop: TickDrop,
    unload: Unload,
    delay: Option<Delay>,
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
        ctx.telemetry.activity.set(Doing::Working, started);
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
            if let Some(delay) = &self.delay {
                delay.wait(ctx);
            }
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
        unload: Unload::new(&ctx)?,
        delay: Delay::of(&ctx),
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
            stats.refused = receivers.iter().map(ChannelReceiver::refused).sum::<u64>()
                + state.ticks.as_ref().map_or(0, ChannelReceiver::refused)
                + state.unload.control.refused();
            stats.dropped = state.dropped + receivers.iter().map(ChannelReceiver::lost).sum::<u64>();
            ctx.telemetry.collect(&mut state.sender.record)?;
            ctx.telemetry.beat()?;
        }
        if state.unload.is_due(state.sender.sent)? && state.stage.unload() {
            info!(
                "{} has given its memory back; it loads again when it is needed",
                ctx.service.name
            );
        }
        if ctx.stop.requested() {
            return ctx.telemetry.send();
        }
    }
}
