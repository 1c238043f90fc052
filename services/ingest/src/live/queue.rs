//! The queue between the thread that reads the source and the driver: bounded. Where the source cannot wait, its sender
//! does not either: what does not fit is lost, and said so in its place.

use crossbeam::channel::{Receiver, Sender, bounded};
use evpr_events::{BATCH_EVENTS, RawEvent, SourceInfo};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Events that may wait for the driver: 16 MiB of them.
const MAX_EVENTS: usize = 1 << 20;
/// Entries that may wait for the driver.
const MAX_ITEMS: usize = 1 << 10;

/// What comes from the source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Item {
    /// Events in the order of the stream, and when the last of them was there (host monotonic ns).
    Events { arrival_ns: u64, events: Vec<RawEvent> },
    /// So many events were here and did not fit.
    Lost(u64),
    /// Connected; what it is.
    Connected(SourceInfo),
    /// No connection, and why; it is tried again.
    Unreachable(String),
    /// The connection is gone, and why; it is tried again.
    Disconnected(String),
    /// The source cannot go on, and it would be no use to try again.
    Failed(String),
    /// The stream is over.
    Ended,
}

/// What a full queue means.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Patience {
    /// The source waits for room.
    #[default]
    Waits,
    /// Events that do not fit are lost.
    Loses,
}

#[derive(Debug, Default)]
struct Waiting {
    items: VecDeque<Item>,
    events: usize,
    closed: bool,
}

#[derive(Debug, Default)]
struct Shared {
    waiting: Mutex<Waiting>,
    room: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The source's end.
#[derive(Debug)]
pub(super) struct ItemSender {
    shared: Arc<Shared>,
    bell: Sender<()>,
    patience: Patience,
}

/// The driver's end. Dropping it tells the source to go.
#[derive(Debug)]
pub(super) struct ItemReceiver {
    shared: Arc<Shared>,
    /// Ready when something may have come; disconnected when the source has gone.
    pub(super) bell: Receiver<()>,
}

pub(super) fn queue(patience: Patience) -> (ItemSender, ItemReceiver) {
    let shared = Arc::<Shared>::default();
    let (bell, rung) = bounded(1);
    let sender = ItemSender {
        shared: shared.clone(),
        bell,
        patience,
    };
    (sender, ItemReceiver { shared, bell: rung })
}

impl ItemSender {
    /// Hands events on; when there is no room it waits, or counts them as lost. False when nobody listens any more.
    pub(super) fn events(&self, arrival_ns: u64, events: &[RawEvent]) -> bool {
        if events.is_empty() {
            return !self.shared.lock().closed;
        }
        let mut waiting = self.shared.lock();
        if self.patience == Patience::Waits {
            let full = |w: &mut Waiting| w.events + events.len() > MAX_EVENTS || w.items.len() >= MAX_ITEMS;
            waiting = self.wait_while(waiting, full);
        }
        let fits = waiting.events + events.len() <= MAX_EVENTS;
        let room = waiting.items.len() < MAX_ITEMS;
        match waiting.items.back_mut() {
            Some(Item::Events {
                arrival_ns: arrival,
                events: before,
            }) if fits && before.len() + events.len() <= BATCH_EVENTS => {
                *arrival = arrival_ns;
                before.extend_from_slice(events);
                waiting.events += events.len();
            }
            Some(Item::Lost(lost)) if !(fits && room) => *lost += events.len() as u64,
            _ if fits && room => {
                waiting.events += events.len();
                waiting.items.push_back(Item::Events {
                    arrival_ns,
                    events: events.to_vec(),
                });
            }
            // The one entry beyond the limit: the next lost events are counted in it.
            _ => waiting.items.push_back(Item::Lost(events.len() as u64)),
        }
        self.ring(waiting)
    }

    /// The source itself has lost events, nobody knows how many.
    pub(super) fn overflowed(&self) {
        let mut waiting = self.shared.lock();
        if !matches!(waiting.items.back(), Some(Item::Lost(_))) {
            waiting.items.push_back(Item::Lost(0));
        }
    }

    /// Hands on how the source is. Waits while there is no room. False when nobody listens any more.
    pub(super) fn news(&self, item: Item) -> bool {
        let waiting = self.shared.lock();
        let mut waiting = self.wait_while(waiting, |w| w.items.len() >= MAX_ITEMS);
        waiting.items.push_back(item);
        self.ring(waiting)
    }

    /// Waits as long as there is somebody to wait for.
    fn wait_while<'w>(
        &self,
        waiting: MutexGuard<'w, Waiting>,
        mut full: impl FnMut(&mut Waiting) -> bool,
    ) -> MutexGuard<'w, Waiting> {
        self.shared
            .room
            .wait_while(waiting, |w| !w.closed && full(w))
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn ring(&self, waiting: MutexGuard<'_, Waiting>) -> bool {
        let listened_to = !waiting.closed;
        drop(waiting);
        // A full bell has been rung already.
        let _ = self.bell.try_send(());
        listened_to
    }
}

impl ItemReceiver {
    /// What has waited longest.
    pub(super) fn take(&self) -> Option<Item> {
        let mut waiting = self.shared.lock();
        let item = waiting.items.pop_front()?;
        if let Item::Events { events, .. } = &item {
            waiting.events -= events.len();
        }
        self.shared.room.notify_all();
        Some(item)
    }
}

impl Drop for ItemReceiver {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.room.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn events(n: usize) -> Vec<RawEvent> {
        vec![RawEvent::default(); n]
    }

    #[test]
    fn small_batches_share_an_entry_and_keep_the_newest_arrival() {
        let (sender, receiver) = queue(Patience::Loses);
        assert!(sender.events(5, &events(2)) && sender.events(6, &[]) && sender.events(7, &events(3)));
        let expected = Item::Events {
            arrival_ns: 7,
            events: events(5),
        };
        assert_eq!((receiver.take(), receiver.take()), (Some(expected), None));
    }

    #[test]
    fn what_does_not_fit_is_lost_in_its_place_and_nobody_waits() {
        let (sender, receiver) = queue(Patience::Loses);
        let batches = MAX_EVENTS / BATCH_EVENTS;
        for _ in 0..batches + 3 {
            assert!(sender.events(1, &events(BATCH_EVENTS)));
        }
        for _ in 0..batches {
            assert!(matches!(receiver.take(), Some(Item::Events { .. })));
        }
        assert!(sender.events(2, &events(1)));
        assert_eq!(receiver.take(), Some(Item::Lost(3 * BATCH_EVENTS as u64)));
        assert!(matches!(
            receiver.take(),
            Some(Item::Events { arrival_ns: 2, .. })
        ));
    }

    #[test]
    fn entries_are_bounded_too() {
        let (sender, receiver) = queue(Patience::Loses);
        for _ in 0..MAX_ITEMS / 2 {
            sender.news(Item::Ended);
            sender.events(0, &events(1));
        }
        for _ in 0..10 {
            sender.events(0, &events(BATCH_EVENTS));
        }
        let items: Vec<_> = std::iter::from_fn(|| receiver.take()).collect();
        assert_eq!(items.len(), MAX_ITEMS + 1);
        assert_eq!(items.last(), Some(&Item::Lost(10 * BATCH_EVENTS as u64)));
    }

    #[test]
    fn a_patient_source_waits_and_loses_nothing() {
        let (sender, receiver) = queue(Patience::Waits);
        let batches = 2 * MAX_EVENTS / BATCH_EVENTS;
        let source = std::thread::spawn(move || {
            let batch = vec![RawEvent::default(); BATCH_EVENTS];
            (0..batches).all(|i| sender.events(i as u64, &batch)) && sender.news(Item::Ended)
        });
        let mut got = 0;
        loop {
            match receiver.take() {
                Some(Item::Events { events, .. }) => got += events.len(),
                Some(other) => {
                    assert_eq!(other, Item::Ended);
                    break;
                }
                None => receiver.bell.recv().unwrap(),
            }
        }
        assert_eq!(got, batches * BATCH_EVENTS);
        assert!(source.join().unwrap());
    }

    #[test]
    fn a_source_that_waits_for_room_is_freed_when_the_driver_goes() {
        let (sender, receiver) = queue(Patience::Loses);
        for _ in 0..MAX_ITEMS {
            sender.news(Item::Ended);
        }
        let waits = std::thread::spawn(move || sender.news(Item::Ended));
        drop(receiver);
        assert!(!waits.join().unwrap());
    }
}
