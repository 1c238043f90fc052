//! Readers that no sender waits for, whatever the delivery: what they are too slow for is lost to them, and counted.

use crate::RuntimeError;
use crate::channel::{ChannelServices, DataService, Incoming, Inlet, Ipc};
use evpr_core::Plan;
use evpr_core::message::Message;
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::*;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// The name of their ports. Readers that are waited for have numbers.
const NAME: &str = "watcher";
/// Ports that are remembered: a watcher that died may still be connected, and is not listed any more.
const REMEMBERED: usize = 64;

/// Tells a sender which of its readers are watchers.
#[derive(Debug)]
pub(crate) struct Watchers<M: Message> {
    data: Arc<DataService<M>>,
    known: Mutex<VecDeque<u128>>,
}

impl<M: Message> Watchers<M> {
    pub(crate) fn new(data: Arc<DataService<M>>) -> Self {
        Self {
            data,
            known: Mutex::default(),
        }
    }

    /// Whether this reader is one. Asked only when its buffer is full.
    pub(crate) fn has(&self, port: u128) -> bool {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.contains(&port) {
            return true;
        }
        let mut watches = false;
        self.data.dynamic_config().list_subscribers(|reader| {
            if reader.subscriber_id.value() == port {
                watches = reader.subscriber_name.as_str() == NAME;
                return CallbackProgression::Stop;
            }
            CallbackProgression::Continue
        });
        if watches {
            if known.len() == REMEMBERED {
                known.pop_front();
            }
            known.push_back(port);
        }
        watches
    }
}

/// The watching end of a channel.
#[derive(Debug)]
pub(crate) struct ChannelWatcher<M: Message> {
    inlet: Inlet<M>,
    /// The most messages that wait.
    pub(crate) buffer: usize,
}

impl<M: Message> ChannelWatcher<M> {
    pub(crate) fn new(
        services: ChannelServices<M>,
        plan: &Arc<Plan>,
        run_id: u64,
    ) -> Result<Self, RuntimeError> {
        let buffer = services.channel.buffer;
        Ok(Self {
            inlet: Inlet::new(services, plan, run_id, NAME)?,
            buffer,
        })
    }

    /// A listener that is woken by every message.
    pub(crate) fn listener(&self) -> Result<Listener<Ipc>, RuntimeError> {
        self.inlet.listener()
    }

    /// Messages that were lost because this reader was too slow.
    pub(crate) fn lost(&self) -> u64 {
        self.inlet.lost()
    }

    /// The next message of this run, if there is one.
    pub(crate) fn receive(&self) -> Result<Option<Incoming<M>>, RuntimeError> {
        self.inlet.receive(|| {})
    }
}
