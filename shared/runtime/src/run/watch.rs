//! The loop of a process that only watches: it reads along, and nobody waits for it.

use super::ServiceContext;
use crate::RuntimeError;
use crate::channel::{ChannelSender, Ipc};
use crate::clock::now_ns;
use crate::telemetry::HEARTBEAT;
use crate::wait::{Waiter, wait_set};
use crate::watcher::ChannelWatcher;
use evpr_core::message::{
    Candidate, Doing, FrameHeader, Frames, Lifecycle, MatchHeader, Matches, Message, Scores, ScoresHeader,
    ServicePhase, ServiceState,
};
use evpr_core::plan::Topic;
use evpr_core::stage::{Outlet, StageError};
use iceoryx2::port::listener::Listener;
use std::time::Duration;
use tracing::{debug, warn};

/// However fast messages come, they are looked at no more often than this.
const PAUSE: Duration = Duration::from_millis(40);
/// The same for frames, which are large.
const FRAMES_NS: u64 = 200_000_000;
/// Scores are sent no more often than this.
const SCORES_NS: u64 = 40_000_000;

/// What is shown of a run. Under load some of it is left out; what is shown is whole, and in order.
pub trait Spectator {
    /// The answer of a tick.
    fn answer(&mut self, header: &MatchHeader, candidates: &[Candidate]);

    /// What the fuser made of a tick: see [`ScoresHeader`].
    fn scores(&mut self, header: &ScoresHeader, values: &[f32]);

    /// A frame, or the reason why there is none.
    fn frame(&mut self, header: &FrameHeader, pixels: &[u8]);

    /// Who is dead and who is there, by index of service in the plan.
    fn lifecycle(&mut self, services: &[ServiceState]);
}

struct Channels {
    answers: Option<ChannelWatcher<Matches>>,
    scores: Option<ChannelWatcher<Scores>>,
    frames: Vec<ChannelWatcher<Frames>>,
    lifecycle: ChannelWatcher<Lifecycle>,
}

fn watcher<M: Message>(ctx: &ServiceContext, topic: &Topic) -> Result<ChannelWatcher<M>, RuntimeError> {
    ChannelWatcher::new(ctx.services(topic)?, &ctx.shared, ctx.identity.run_id)
}

/// Hands on what waits in a channel, but no more than fits it: a quick sender does not keep this reader for ever.
fn drain<M: Message>(
    channel: &ChannelWatcher<M>,
    mut show: impl FnMut(&M::Header, &[M::Item]),
) -> Result<u64, RuntimeError> {
    let mut taken = 0;
    while (taken as usize) < channel.buffer {
        let Some(message) = channel.receive()? else {
            break;
        };
        show(message.header(), message.payload());
        taken += 1;
    }
    Ok(taken)
}

impl Channels {
    fn open(ctx: &ServiceContext) -> Result<Self, RuntimeError> {
        let fused = ctx.plan.map.is_some();
        let frames = ctx.plan.reconstructions.iter();
        let frames = frames.map(|r| watcher(ctx, &Topic::Frames(r.id.clone())));
        Ok(Self {
            answers: fused.then(|| watcher(ctx, &Topic::Matches)).transpose()?,
            scores: fused.then(|| watcher(ctx, &Topic::Scores)).transpose()?,
            frames: frames.collect::<Result<_, _>>()?,
            lifecycle: watcher(ctx, &Topic::Lifecycle)?,
        })
    }

    /// Shows what has come, and gives the number of messages.
    fn show(&self, spectator: &mut dyn Spectator, frames: bool) -> Result<u64, RuntimeError> {
        let mut taken = drain(&self.lifecycle, |_, states| spectator.lifecycle(states))?;
        if let Some(answers) = &self.answers {
            taken += drain(answers, |header, candidates| {
                let count = (header.candidates as usize).min(candidates.len());
                spectator.answer(header, &candidates[..count]);
            })?;
        }
        if let Some(scores) = &self.scores {
            taken += drain(scores, |header, values| spectator.scores(header, values))?;
        }
        for channel in self.frames.iter().filter(|_| frames) {
            taken += drain(channel, |header, pixels| spectator.frame(header, pixels))?;
        }
        Ok(taken)
    }

    fn lost(&self) -> u64 {
        let frames: u64 = self.frames.iter().map(ChannelWatcher::lost).sum();
        let answers = self.answers.as_ref().map_or(0, ChannelWatcher::lost);
        let scores = self.scores.as_ref().map_or(0, ChannelWatcher::lost);
        frames + answers + scores
    }
}

/// Shows the run to `spectator` until it is asked to stop.
///
/// # Errors
/// When shared memory fails.
pub fn run_watcher(mut ctx: ServiceContext, spectator: &mut dyn Spectator) -> Result<(), RuntimeError> {
    let channels = Channels::open(&ctx)?;
    ctx.telemetry.phase(ServicePhase::Ready)?;
    debug!(service = ctx.service.name, "ready");
    // Frames and scores come with answers; without answers a look every heartbeat is enough.
    let answered = channels
        .answers
        .as_ref()
        .map(ChannelWatcher::listener)
        .transpose()?;
    let died = channels.lifecycle.listener()?;
    let wake = ctx.wake.clone();
    let mut listeners: Vec<&Listener<Ipc>> = vec![&died, &wake];
    listeners.extend(&answered);
    let set = wait_set()?;
    let waiter = Waiter::new(&set, listeners)?;
    let mut frames_due_ns = 0;
    while !ctx.stop.requested() {
        ctx.telemetry.rests();
        waiter.wait(HEARTBEAT)?;
        let started = now_ns();
        ctx.telemetry.activity.set(Doing::Working, started);
        let frames = started >= frames_due_ns;
        if frames {
            frames_due_ns = started + FRAMES_NS;
        }
        let taken = channels.show(spectator, frames)?;
        let stats = &mut ctx.telemetry.stats;
        stats.received += taken;
        stats.processing.record(now_ns().saturating_sub(started));
        // By decision: nobody waits for a watcher.
        stats.skipped = channels.lost();
        ctx.telemetry.beat()?;
        let _ = ctx.stop.signal().recv_timeout(PAUSE);
    }
    channels.show(spectator, true)?;
    ctx.telemetry.send()
}

/// Sends scores to whoever watches.
#[derive(Debug)]
pub struct ScoresSender {
    sender: ChannelSender<Scores>,
    due_ns: u64,
    broken: bool,
}

impl ScoresSender {
    pub(super) fn new(sender: ChannelSender<Scores>) -> Self {
        Self {
            sender,
            due_ns: 0,
            broken: false,
        }
    }

    /// Whether somebody watches, and the last scores are not too recent.
    pub fn is_due(&self) -> bool {
        !self.broken && self.sender.is_heard() && now_ns() >= self.due_ns
    }

    /// Sends the scores of a tick: `fill` writes their `len` values in place. One that cannot be sent is left out, and so
    /// are all after it.
    pub fn send(&mut self, header: ScoresHeader, len: usize, fill: &mut dyn FnMut(&mut [f32])) {
        self.due_ns = now_ns() + SCORES_NS;
        match self.sender.emit(header, len, fill) {
            Ok(()) | Err(StageError::Stopped) => {}
            Err(e) => {
                warn!("the dashboard gets no scores any more: {e}");
                self.broken = true;
            }
        }
    }
}
