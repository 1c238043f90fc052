//! The channels, all of which the supervisor creates, and its own ends of some.

use crate::channel::{ChannelReceiver, ChannelSender, ChannelServices, Ipc, SUPERVISOR_READER};
use crate::domain::Settings;
use crate::run::Identity;
use crate::{RuntimeError, Stop};
use evpr_core::Plan;
use evpr_core::message::{
    Chunks, Control, ControlHeader, Descriptors, Frames, Lifecycle, LifecycleHeader, Matches, Message,
    Scores, ServiceState, Spans, Stats, Ticks,
};
use evpr_core::plan::Topic;
use evpr_core::stage::Outlet;
use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use std::any::Any;
use std::sync::Arc;

/// See the module.
pub(super) struct Ports {
    pub(super) stats: ChannelReceiver<Stats>,
    /// When a trace is made.
    pub(super) spans: Option<ChannelReceiver<Spans>>,
    pub(super) ticks: ChannelReceiver<Ticks>,
    pub(super) matches: Option<ChannelReceiver<Matches>>,
    lifecycle: ChannelSender<Lifecycle>,
    lifecycle_version: u64,
    control: ChannelSender<Control>,
    // Channels without a port of the supervisor's: held so that their sizes are the plan's.
    _held: Vec<Box<dyn Any>>,
}

fn hold<M: Message>(
    node: &Node<Ipc>,
    plan: &Plan,
    topic: &Topic,
) -> Result<ChannelServices<M>, RuntimeError> {
    let channel = plan
        .channel(topic)
        .ok_or_else(|| RuntimeError::Ipc(format!("no channel {topic}")))?;
    ChannelServices::open(node, &channel)
}

impl Ports {
    /// Creates every channel of the plan.
    pub(super) fn create(
        node: &Node<Ipc>,
        plan: &Plan,
        identity: Identity,
        stop: &Stop,
    ) -> Result<Self, RuntimeError> {
        let mut held: Vec<Box<dyn Any>> = vec![
            Box::new(hold::<Chunks>(node, plan, &Topic::Events)?),
            Box::new(hold::<Spans>(node, plan, &Topic::Spans)?),
        ];
        for r in &plan.reconstructions {
            held.push(Box::new(hold::<Frames>(
                node,
                plan,
                &Topic::Frames(r.id.clone()),
            )?));
        }
        for e in &plan.extractors {
            let topic = Topic::Descriptors(e.id.clone());
            held.push(Box::new(hold::<Descriptors>(node, plan, &topic)?));
        }
        if plan.channel(&Topic::Scores).is_some() {
            held.push(Box::new(hold::<Scores>(node, plan, &Topic::Scores)?));
        }
        let shared = Arc::new(plan.clone());
        let matches = if plan.map.is_some() {
            let services = hold(node, plan, &Topic::Matches)?;
            Some(ChannelReceiver::new(
                services,
                &shared,
                identity.run_id,
                SUPERVISOR_READER,
            )?)
        } else {
            None
        };
        let stats = hold(node, plan, &Topic::Stats)?;
        let ticks = hold(node, plan, &Topic::Ticks)?;
        let lifecycle = hold(node, plan, &Topic::Lifecycle)?;
        let control = hold(node, plan, &Topic::Control)?;
        Ok(Self {
            stats: ChannelReceiver::new(stats, &shared, identity.run_id, SUPERVISOR_READER)?,
            spans: None,
            ticks: ChannelReceiver::new(ticks, &shared, identity.run_id, SUPERVISOR_READER)?,
            matches,
            lifecycle: ChannelSender::new(lifecycle, identity, stop, 1, Arc::default())?,
            lifecycle_version: 0,
            control: ChannelSender::new(control, identity, stop, 1, Arc::default())?,
            _held: held,
        })
    }

    /// Messages that were not let in.
    pub(super) fn refused(&self) -> u64 {
        let spans = self.spans.as_ref().map_or(0, ChannelReceiver::refused);
        let matches = self.matches.as_ref().map_or(0, ChannelReceiver::refused);
        self.stats.refused() + self.ticks.refused() + spans + matches
    }

    /// Whatever wakes the supervisor.
    pub(super) fn listeners(&self) -> Vec<&Listener<Ipc>> {
        let mut listeners = vec![self.stats.listener(), self.ticks.listener()];
        listeners.extend(self.spans.as_ref().map(ChannelReceiver::listener));
        listeners.extend(self.matches.as_ref().map(ChannelReceiver::listener));
        listeners
    }

    /// Tells the sinks who is dead.
    pub(super) fn tell_states(&mut self, states: &[ServiceState]) -> Result<(), RuntimeError> {
        self.lifecycle_version += 1;
        let header = LifecycleHeader {
            version: self.lifecycle_version,
            ..LifecycleHeader::default()
        };
        let sent = self
            .lifecycle
            .emit(header, states.len(), &mut |slots| slots.copy_from_slice(states));
        sent.map_err(|e| RuntimeError::Ipc(e.to_string()))
    }

    /// Tells everybody what members and the fuser are to be.
    pub(super) fn tell_settings(&mut self, settings: &Settings) -> Result<(), RuntimeError> {
        let members = settings.messages();
        let header = ControlHeader {
            version: settings.version,
            fuse: settings.fuse.message(),
            ..ControlHeader::default()
        };
        let sent = self.control.emit(header, members.len(), &mut |slots| {
            slots.copy_from_slice(&members)
        });
        sent.map_err(|e| RuntimeError::Ipc(e.to_string()))
    }
}
