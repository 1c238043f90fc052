//! The camera's side: a thread that connects, reads and decodes, and connects again when the connection is lost.

use super::queue::{Item, ItemReceiver, ItemSender, Patience, queue};
use crate::SourceError;
use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use evpr_core::plan::Sensor;
use evpr_events::{BATCH_EVENTS, Recording};
use std::time::{Duration, Instant};

const FIRST_WAIT: Duration = Duration::from_millis(100);
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// A connection that lasted so long was a good one: the next attempt is made at once.
const GOOD_CONNECTION: Duration = Duration::from_secs(1);

/// What can be connected to, again and again.
pub(crate) trait Camera: Send {
    /// Connects. Waits until the stream has said what it is.
    ///
    /// # Errors
    /// Why there is no connection now.
    fn connect(&mut self) -> Result<Box<dyn Recording>, SourceError>;

    /// True when there is only one stream, and its end is the end.
    fn once(&self) -> bool {
        false
    }
}

/// Waits between attempts: none, then longer and longer.
#[derive(Debug, Default)]
struct Backoff {
    attempts: u32,
}

impl Backoff {
    fn next(&mut self) -> Duration {
        let wait = match self.attempts {
            0 => Duration::ZERO,
            n => (FIRST_WAIT * 2u32.pow((n - 1).min(16))).min(LONGEST_WAIT),
        };
        self.attempts = self.attempts.saturating_add(1);
        wait
    }
}

/// The thread, as long as this is kept.
#[derive(Debug)]
pub(super) struct Stream {
    pub(super) items: ItemReceiver,
    /// The thread waits on the other end between attempts.
    _stop: Sender<()>,
}

impl Stream {
    /// Starts the thread. When the stream is dropped it ends, at the latest with the bytes or the attempt it waits for.
    pub(super) fn start(
        camera: Box<dyn Camera>,
        name: String,
        sensor: Sensor,
        patience: Patience,
        clock: HostClock,
    ) -> Result<Self, SourceError> {
        let (sender, items) = queue(patience);
        let (keeper, stop) = bounded(0);
        std::thread::Builder::new()
            .name("camera".to_owned())
            .spawn(move || follow(camera, &name, sensor, &sender, clock, &stop))
            .map_err(|e| SourceError::Setup(format!("cannot start the thread of the camera: {e}")))?;
        Ok(Self { items, _stop: keeper })
    }
}

/// The host's monotonic clock, for a thread without a port.
#[derive(Debug, Clone, Copy)]
pub(super) struct HostClock {
    base_ns: u64,
    at: Instant,
}

impl HostClock {
    /// A clock that says `now_ns` now.
    pub(super) fn new(now_ns: u64) -> Self {
        Self {
            base_ns: now_ns,
            at: Instant::now(),
        }
    }

    fn now_ns(&self) -> u64 {
        self.base_ns.saturating_add(self.at.elapsed().as_nanos() as u64)
    }
}

/// Reads connection after connection, until nobody listens any more or it is no use.
fn follow(
    mut camera: Box<dyn Camera>,
    name: &str,
    sensor: Sensor,
    sender: &ItemSender,
    clock: HostClock,
    stop: &Receiver<()>,
) {
    let mut backoff = Backoff::default();
    loop {
        let began = Instant::now();
        let (news, goes_on) = match camera.connect() {
            Ok(recording) => {
                if let Some(other) = recording.sensor().filter(|other| *other != sensor) {
                    let what =
                        format!("{name}: the camera's sensor is {other}, not {sensor}; correct [sensor]");
                    (Item::Failed(what), false)
                } else {
                    if !sender.news(Item::Connected(recording.describe())) {
                        return;
                    }
                    let Some(outcome) = pump(recording, sender, clock) else {
                        return;
                    };
                    if began.elapsed() >= GOOD_CONNECTION {
                        backoff = Backoff::default();
                    }
                    match (outcome, camera.once()) {
                        (Ok(()), true) => (Item::Ended, false),
                        (Err(e), true) => (Item::Failed(e.to_string()), false),
                        (Ok(()), false) => (
                            Item::Disconnected(format!("{name}: the other end closed the connection")),
                            true,
                        ),
                        (Err(e), false) => (Item::Disconnected(e.to_string()), true),
                    }
                }
            }
            Err(e) if camera.once() => (Item::Failed(e.to_string()), false),
            Err(e) => (Item::Unreachable(e.to_string()), true),
        };
        if !sender.news(news) || !goes_on {
            return;
        }
        match stop.recv_timeout(backoff.next()) {
            Err(RecvTimeoutError::Timeout) => {}
            _ => return,
        }
    }
}

/// Decodes one connection to its end; `None` when nobody listens any more.
fn pump(
    mut recording: Box<dyn Recording>,
    sender: &ItemSender,
    clock: HostClock,
) -> Option<Result<(), SourceError>> {
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    loop {
        let outcome = recording.next_batch(&mut batch);
        if recording.take_overflows() > 0 {
            sender.overflowed();
        }
        if !sender.events(clock.now_ns(), &batch) {
            return None;
        }
        match outcome {
            Ok(true) => {}
            Ok(false) => return Some(Ok(())),
            Err(e) => return Some(Err(e)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_retry_is_made_at_once_and_no_wait_is_longer_than_the_longest() {
        let mut backoff = Backoff::default();
        let waits: Vec<u128> = (0..9).map(|_| backoff.next().as_millis()).collect();
        assert_eq!(waits, [0, 100, 200, 400, 800, 1_600, 3_200, 5_000, 5_000]);
        backoff.attempts = u32::MAX - 1;
        assert_eq!(backoff.next(), LONGEST_WAIT);
    }
}
