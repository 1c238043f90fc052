//! What a process tells the supervisor about itself, a few times per second and at every change of phase.

use crate::RuntimeError;
use crate::channel::{ChannelSender, ChannelServices, Ipc};
use crate::clock::now_ns;
use crate::run::Identity;
use crate::stop::Stop;
use evpr_core::Plan;
use evpr_core::message::{ServicePhase, Stats, StatsHeader};
use evpr_core::plan::Topic;
use evpr_core::stage::Outlet;
use iceoryx2::node::Node;
use std::time::Duration;

/// How often an idle process says that it is there.
pub(crate) const HEARTBEAT: Duration = Duration::from_millis(250);

/// Counters of this process and the channel they go out on.
#[derive(Debug)]
pub(crate) struct Telemetry {
    sender: ChannelSender<Stats>,
    /// The counters; the loops write them.
    pub(crate) stats: StatsHeader,
    sent_ns: u64,
}

impl Telemetry {
    pub(crate) fn new(
        node: &Node<Ipc>,
        plan: &Plan,
        identity: Identity,
        stop: &Stop,
    ) -> Result<Self, RuntimeError> {
        let channel = plan
            .channel(&Topic::Stats)
            .ok_or_else(|| RuntimeError::Ipc("no stats channel".to_owned()))?;
        let sender = ChannelSender::new(ChannelServices::open(node, &channel)?, identity, stop, 1)?;
        let stats = StatsHeader {
            pid: std::process::id(),
            ..StatsHeader::default()
        };
        Ok(Self {
            sender,
            stats,
            sent_ns: 0,
        })
    }

    /// Changes the phase and says so at once.
    pub(crate) fn phase(&mut self, phase: ServicePhase) -> Result<(), RuntimeError> {
        self.stats.phase = phase as u32;
        self.send()
    }

    /// Sends the counters now.
    pub(crate) fn send(&mut self) -> Result<(), RuntimeError> {
        self.sent_ns = now_ns();
        match self.sender.emit(self.stats, 0, &mut |_| {}) {
            Ok(()) | Err(evpr_core::stage::StageError::Stopped) => Ok(()),
            Err(e) => Err(RuntimeError::Ipc(e.to_string())),
        }
    }

    /// Sends the counters if it is time.
    pub(crate) fn beat(&mut self) -> Result<(), RuntimeError> {
        if now_ns().saturating_sub(self.sent_ns) >= HEARTBEAT.as_nanos() as u64 {
            self.send()?;
        }
        Ok(())
    }
}

/// Lets a warning through at most once per second, and counts the rest.
#[derive(Debug, Default)]
pub(crate) struct RateLimit {
    last_ns: u64,
    held_back: u64,
}

impl RateLimit {
    /// `Some(n)` when a warning may go out now; n were held back since the last.
    pub(crate) fn pass(&mut self) -> Option<u64> {
        let now = now_ns();
        if now.saturating_sub(self.last_ns) < 1_000_000_000 {
            self.held_back += 1;
            return None;
        }
        self.last_ns = now;
        Some(std::mem::take(&mut self.held_back))
    }
}
