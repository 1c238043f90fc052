//! Stopping: SIGTERM and SIGINT become a flag that every wait hears at once.

use crate::RuntimeError;
use crate::channel::{Ipc, WakeSender};
use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use iceoryx2::prelude::*;
use nix::sys::signal::{Signal, kill};
use nix::unistd::getpid;
use signal_hook::consts::{SIGCHLD, SIGINT, SIGTERM};
use signal_hook::iterator::{Handle, Signals};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The stop flag of a process, shared by all who wait.
#[derive(Debug, Clone)]
pub struct Stop {
    requests: Arc<AtomicU32>,
    interrupted: Arc<AtomicBool>,
    /// Disconnects at the first request, when the keeper is dropped.
    signal: Receiver<()>,
    keeper: Arc<Mutex<Option<Sender<()>>>>,
}

/// A process whose supervisor has gone ends within this time, whatever it is busy with.
const ORPHANED: Duration = Duration::from_millis(1_500);

/// Ends the thread that listens for signals when dropped.
#[derive(Debug)]
pub(crate) struct SignalListener {
    handle: Handle,
    /// Disconnects when this is dropped.
    ends: Option<Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for SignalListener {
    fn drop(&mut self) {
        self.handle.close();
        self.ends.take();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Default for Stop {
    fn default() -> Self {
        Self::new()
    }
}

impl Stop {
    /// A flag that only [`Stop::raise`] raises.
    pub fn new() -> Self {
        let (keeper, signal) = bounded(0);
        Self {
            requests: Arc::default(),
            interrupted: Arc::default(),
            signal,
            keeper: Arc::new(Mutex::new(Some(keeper))),
        }
    }

    /// A flag that SIGTERM and SIGINT raise, until the process ends.
    ///
    /// # Errors
    /// When signals cannot be listened for.
    pub fn on_signals() -> Result<Self, RuntimeError> {
        let stop = Self::new();
        let mut signals = Signals::new([SIGTERM, SIGINT])
            .map_err(|e| RuntimeError::Process(format!("cannot listen for signals: {e}")))?;
        let raised = stop.clone();
        std::thread::Builder::new()
            .name("signals".to_owned())
            .spawn(move || signals.forever().for_each(|_| raised.raise()))
            .map_err(|e| RuntimeError::Process(format!("cannot start a thread: {e}")))?;
        Ok(stop)
    }

    /// One request to stop.
    pub fn raise(&self) {
        self.requests.fetch_add(1, Ordering::AcqRel);
        self.keeper.lock().unwrap_or_else(PoisonError::into_inner).take();
    }

    /// True after the first SIGTERM or SIGINT.
    pub fn requested(&self) -> bool {
        self.requests.load(Ordering::Acquire) > 0
    }

    /// How many requests there have been: a second one means "at once".
    pub(crate) fn count(&self) -> u32 {
        self.requests.load(Ordering::Acquire)
    }

    /// True when one of them was SIGINT (Ctrl-C).
    pub(crate) fn interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Acquire)
    }

    /// Disconnects at the first request: for selects.
    pub fn signal(&self) -> &Receiver<()> {
        &self.signal
    }

    /// Listens for SIGTERM and SIGINT, and for SIGCHLD too when `children`; each also sends a wake-up. A process without
    /// children is one of the graph: when its supervisor has gone it is killed, should it not end by itself.
    pub(crate) fn listen(wake: WakeSender, children: bool) -> Result<(Self, SignalListener), RuntimeError> {
        let wanted: &[i32] = if children {
            &[SIGTERM, SIGINT, SIGCHLD]
        } else {
            &[SIGTERM, SIGINT]
        };
        let mut signals = Signals::new(wanted)
            .map_err(|e| RuntimeError::Process(format!("cannot listen for signals: {e}")))?;
        let handle = signals.handle();
        let stop = Self::new();
        let raised = stop.clone();
        let parent = nix::unistd::getppid();
        let (ends, ended) = bounded::<()>(0);
        let thread = std::thread::Builder::new()
            .name("signals".to_owned())
            .spawn(move || {
                for signal in signals.forever() {
                    if signal != SIGCHLD {
                        raised.interrupted.fetch_or(signal == SIGINT, Ordering::AcqRel);
                        raised.raise();
                        if nix::unistd::getppid() != parent {
                            raised.raise(); // nobody is there any more to ask a second time
                            wake.wake();
                            if !children && ended.recv_timeout(ORPHANED) == Err(RecvTimeoutError::Timeout) {
                                let _ = kill(getpid(), Signal::SIGKILL);
                            }
                        }
                    }
                    wake.wake();
                }
            })
            .map_err(|e| RuntimeError::Process(format!("cannot start a thread: {e}")))?;
        Ok((
            stop,
            SignalListener {
                handle,
                ends: Some(ends),
                thread: Some(thread),
            },
        ))
    }
}

/// A private event of this process, by which its own threads wake its main loop.
pub(crate) fn wake_pair(
    node: &Node<Ipc>,
    name: &str,
) -> Result<(WakeSender, iceoryx2::port::listener::Listener<Ipc>), RuntimeError> {
    let failed =
        |e: &dyn std::fmt::Debug| RuntimeError::Ipc(format!("cannot create the wake-up event: {e:?}"));
    let service_name =
        ServiceName::new(&format!("wake/{name}/{}", std::process::id())).map_err(|e| failed(&e))?;
    let event = node
        .service_builder(&service_name)
        .event()
        .max_listeners(1)
        .max_notifiers(4)
        .open_or_create()
        .map_err(|e| failed(&e))?;
    let listener = event.listener_builder().create().map_err(|e| failed(&e))?;
    let notifier = event.notifier_builder().create().map_err(|e| failed(&e))?;
    Ok((WakeSender::new(notifier), listener))
}
