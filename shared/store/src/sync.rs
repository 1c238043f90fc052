//! Synchronises an unfinished recording with the disk, on a thread of its own, so that a slow disk does not hold up
//! the recorder.

use nix::unistd::syncfs;
use std::fs::File;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often it is synchronised.
pub(crate) const PERIOD: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
struct State {
    synced: AtomicU64,
    error: Mutex<Option<io::Error>>,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Syncer {
    requests: Option<SyncSender<u64>>,
    thread: Option<JoinHandle<()>>,
    state: Arc<State>,
    period: Duration,
    last: Instant,
}

impl Syncer {
    /// For the recording in `folder`, of which the first `synced` ticks are on the disk.
    ///
    /// # Errors
    /// What the system says when it has no thread to give.
    pub(crate) fn start(folder: File, synced: u64, period: Duration) -> io::Result<Self> {
        let state = Arc::new(State::default());
        state.synced.store(synced, Ordering::Release);
        let (requests, incoming) = sync_channel(1);
        let shared = Arc::clone(&state);
        let thread = std::thread::Builder::new()
            .name("evpr-sync".to_owned())
            .spawn(move || run(&folder, &incoming, &shared))?;
        Ok(Self {
            requests: Some(requests),
            thread: Some(thread),
            state,
            period,
            last: Instant::now(),
        })
    }

    /// Asks that everything written so far, `ticks` ticks, be brought to the disk, when a period has passed since it
    /// was last asked. While the disk is still busy with that, the next tick asks again.
    pub(crate) fn request(&mut self, ticks: u64) {
        if self.last.elapsed() < self.period {
            return;
        }
        let sent = self.requests.as_ref().is_some_and(|r| r.try_send(ticks).is_ok());
        if sent {
            self.last = Instant::now();
        }
    }

    /// How many ticks are on the disk.
    pub(crate) fn synced(&self) -> u64 {
        self.state.synced.load(Ordering::Acquire)
    }

    /// What went wrong, once.
    pub(crate) fn take_error(&self) -> Option<io::Error> {
        let mut error = self.state.error.lock().unwrap_or_else(PoisonError::into_inner);
        error.take()
    }

    /// As if the disk had failed.
    #[cfg(test)]
    pub(crate) fn break_with(&self, error: io::Error) {
        *self.state.error.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
    }

    /// Waits for what was asked for and ends the thread.
    pub(crate) fn stop(&mut self) {
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // It does not panic; an error is in the state.
            let _ = thread.join();
        }
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        self.stop();
    }
}

/// One `syncfs` instead of an `fdatasync` per file: with two files per member the latter costs two orders of magnitude
/// more, as each waits for its own journal commit.
fn run(folder: &File, incoming: &Receiver<u64>, state: &State) {
    while let Ok(ticks) = incoming.recv() {
        match syncfs(folder) {
            Ok(()) => state.synced.store(ticks, Ordering::Release),
            Err(e) => {
                *state.error.lock().unwrap_or_else(PoisonError::into_inner) = Some(e.into());
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_is_done_by_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let mut syncer = Syncer::start(File::open(folder.path()).unwrap(), 3, Duration::ZERO).unwrap();
        assert_eq!(syncer.synced(), 3);
        syncer.request(7);
        syncer.stop();
        assert_eq!(syncer.synced(), 7);
        assert!(syncer.take_error().is_none());
        syncer.request(9);
        assert_eq!(syncer.synced(), 7, "stopped");
    }

    #[test]
    fn nothing_is_asked_for_within_the_period() {
        let folder = tempfile::tempdir().unwrap();
        let hour = Duration::from_secs(3600);
        let mut syncer = Syncer::start(File::open(folder.path()).unwrap(), 0, hour).unwrap();
        syncer.request(7);
        syncer.stop();
        assert_eq!(syncer.synced(), 0);
    }
}
