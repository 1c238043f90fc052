//! Blocking on several listeners at once.

use crate::RuntimeError;
use crate::channel::Ipc;
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::*;
use iceoryx2::waitset::{WaitSet, WaitSetGuard};
use std::time::Duration;

/// A wait set with its listeners.
pub(crate) struct Waiter<'a> {
    listeners: Vec<&'a Listener<Ipc>>,
    guards: Vec<WaitSetGuard<'a, 'a, Ipc>>,
    set: &'a WaitSet<Ipc>,
}

/// A wait set that leaves signals alone.
pub(crate) fn wait_set() -> Result<WaitSet<Ipc>, RuntimeError> {
    WaitSetBuilder::new()
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<Ipc>()
        .map_err(|e| RuntimeError::ipc("cannot create a wait set", e))
}

impl<'a> Waiter<'a> {
    pub(crate) fn new(
        set: &'a WaitSet<Ipc>,
        listeners: Vec<&'a Listener<Ipc>>,
    ) -> Result<Self, RuntimeError> {
        let guards = listeners
            .iter()
            .map(|l| {
                set.attach_notification(*l)
                    .map_err(|e| RuntimeError::ipc("cannot wait for a channel", e))
            })
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            listeners,
            guards,
            set,
        })
    }

    /// Blocks until a listener is notified or the time is over, and drains every listener, so that the caller may
    /// then drain the channels: what comes after that wakes again.
    pub(crate) fn wait(&self, timeout: Duration) -> Result<(), RuntimeError> {
        debug_assert_eq!(self.guards.len(), self.listeners.len());
        self.set
            .wait_and_process_once_with_timeout(|_| CallbackProgression::Continue, timeout)
            .map_err(|e| RuntimeError::ipc("cannot wait for channels", e))?;
        for listener in &self.listeners {
            listener
                .try_wait(|_| {})
                .map_err(|e| RuntimeError::ipc("cannot drain an event", e))?;
        }
        Ok(())
    }
}
