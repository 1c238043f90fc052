//! Channels between two nodes of one process: what holds for the library that everything rests on.

use crate::RunFolder;
use crate::channel::{ChannelReceiver, ChannelSender, ChannelServices, Ipc};
use crate::run::Identity;
use crate::stop::Stop;
use crate::watcher::ChannelWatcher;
use evpr_core::message::{ChunkHeader, Chunks, Event};
use evpr_core::plan::{Channel, Delivery, Topic, test_plan};
use evpr_core::stage::{Outlet, StageError};
use iceoryx2::node::Node;
use std::sync::Arc;

struct Bench {
    folder: RunFolder,
    _temp: tempfile::TempDir,
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.folder.sweep();
    }
}

impl Bench {
    fn new() -> Self {
        let temp = tempfile::Builder::new().prefix("ev").tempdir_in("/tmp").unwrap();
        Self {
            folder: RunFolder::at(temp.path()),
            _temp: temp,
        }
    }

    fn node(&self) -> Node<Ipc> {
        self.folder.node("test").unwrap()
    }
}

fn channel(delivery: Delivery) -> Channel {
    let mut plan = test_plan();
    plan.delivery = delivery;
    let mut channel = plan.channel(&Topic::Events).unwrap();
    channel.max_items = 100;
    channel.buffer = 3;
    channel
}

fn sender(node: &Node<Ipc>, channel: &Channel, stop: &Stop, incarnation: u32) -> ChannelSender<Chunks> {
    let identity = Identity {
        run_id: 7,
        service: 0,
        incarnation,
    };
    ChannelSender::new(
        ChannelServices::open(node, channel).unwrap(),
        identity,
        stop,
        1,
        Default::default(),
    )
    .unwrap()
}

fn receiver(node: &Node<Ipc>, channel: &Channel) -> ChannelReceiver<Chunks> {
    ChannelReceiver::new(
        ChannelServices::open(node, channel).unwrap(),
        &Arc::new(test_plan()),
        7,
        1,
    )
    .unwrap()
}

fn send(sender: &mut ChannelSender<Chunks>, tick: u64, len: usize) -> Result<(), StageError> {
    let fill = &mut |slots: &mut [Event]| {
        for (i, slot) in slots.iter_mut().enumerate() {
            *slot = Event::new(i as u32, 1, 2, true);
        }
    };
    sender.emit(
        ChunkHeader {
            tick,
            ..ChunkHeader::default()
        },
        len,
        fill,
    )
}

/// (tick, payload length, gap) of everything that has come.
fn drain(receiver: &ChannelReceiver<Chunks>) -> Vec<(u64, usize, bool)> {
    let mut all = Vec::new();
    while let Some(message) = receiver.receive().unwrap() {
        all.push((message.header().tick, message.payload().len(), message.gap));
    }
    all
}

#[test]
fn empty_and_full_messages_arrive_with_their_true_length() {
    let bench = Bench::new();
    let (a, b) = (bench.node(), bench.node());
    let channel = channel(Delivery::Lossless);
    let mut from = sender(&a, &channel, &Stop::new(), 1);
    let to = receiver(&b, &channel);
    send(&mut from, 1, 0).unwrap();
    send(&mut from, 2, 100).unwrap();
    assert_eq!(drain(&to), [(1, 0, false), (2, 100, false)]);
    assert!(matches!(send(&mut from, 3, 101), Err(StageError::Fatal(_))));
}

#[test]
fn what_was_sent_can_be_read_after_the_sender_has_gone() {
    let bench = Bench::new();
    let (a, b) = (bench.node(), bench.node());
    let channel = channel(Delivery::Lossless);
    let mut from = sender(&a, &channel, &Stop::new(), 1);
    let to = receiver(&b, &channel);
    for tick in 0..3 {
        send(&mut from, tick, 5).unwrap();
    }
    drop(from);
    drop(a);
    assert_eq!(drain(&to), [(0, 5, false), (1, 5, false), (2, 5, false)]);
}

#[test]
fn latest_loses_the_oldest_and_counts_it() {
    let bench = Bench::new();
    let (a, b) = (bench.node(), bench.node());
    let channel = channel(Delivery::Latest);
    let mut from = sender(&a, &channel, &Stop::new(), 1);
    let to = receiver(&b, &channel);
    send(&mut from, 0, 1).unwrap();
    assert_eq!(drain(&to).len(), 1);
    for tick in 1..=5 {
        send(&mut from, tick, 1).unwrap();
    }
    assert_eq!(drain(&to), [(3, 1, true), (4, 1, false), (5, 1, false)]);
    assert_eq!(to.lost(), 2);
}

#[test]
fn lossless_waits_for_room_and_gives_up_when_stopped() {
    let bench = Bench::new();
    let (a, b) = (bench.node(), bench.node());
    let channel = channel(Delivery::Lossless);
    let stop = Stop::new();
    let mut from = sender(&a, &channel, &stop, 1);
    let to = receiver(&b, &channel);
    for tick in 0..3 {
        send(&mut from, tick, 1).unwrap();
    }
    // The fourth waits until the reader, in another thread, has made room.
    std::thread::scope(|scope| {
        let blocked = scope.spawn(|| (3..10).try_for_each(|tick| send(&mut from, tick, 1)));
        let mut seen = 0;
        while seen < 10 {
            seen += drain(&to).len();
            std::thread::yield_now();
        }
        assert!(blocked.join().unwrap().is_ok());
    });
    for tick in 10..13 {
        send(&mut from, tick, 1).unwrap();
    }
    stop.raise();
    assert!(matches!(send(&mut from, 13, 1), Err(StageError::Stopped)));
}

#[test]
fn a_new_sender_waits_until_the_readers_have_connected() {
    let bench = Bench::new();
    let (a, b) = (bench.node(), bench.node());
    let channel = channel(Delivery::Lossless);
    let to = receiver(&b, &channel);
    std::thread::scope(|scope| {
        // More than the channel holds, and nobody has received yet.
        let sending = scope.spawn(|| {
            let mut from = sender(&a, &channel, &Stop::new(), 1);
            (0..50)
                .try_for_each(|tick| send(&mut from, tick, 1))
                .map(|()| from)
        });
        let mut seen = Vec::new();
        while seen.len() < 50 {
            seen.extend(drain(&to));
            std::thread::yield_now();
        }
        assert_eq!(seen, (0..50).map(|tick| (tick, 1, false)).collect::<Vec<_>>());
        assert!(sending.join().unwrap().is_ok());
    });
}

#[test]
fn a_watcher_is_not_waited_for_and_readers_are() {
    let bench = Bench::new();
    let (a, b, c) = (bench.node(), bench.node(), bench.node());
    let channel = channel(Delivery::Lossless);
    let services = |node| ChannelServices::open(node, &channel).unwrap();
    let watcher = ChannelWatcher::<Chunks>::new(services(&c), &Arc::new(test_plan()), 7).unwrap();
    let to = receiver(&b, &channel);
    std::thread::scope(|scope| {
        let sending = scope.spawn(|| {
            let mut from = sender(&a, &channel, &Stop::new(), 1);
            (0..50)
                .try_for_each(|tick| send(&mut from, tick, 1))
                .map(|()| from)
        });
        let mut seen = Vec::new();
        while seen.len() < 50 {
            seen.extend(drain(&to));
            std::thread::yield_now();
        }
        assert_eq!(seen, (0..50).map(|tick| (tick, 1, false)).collect::<Vec<_>>());
        // The watcher has what fitted its buffer, and the next message says how much was lost.
        let mut from = sending.join().unwrap().unwrap();
        let next = || watcher.receive().unwrap().map(|m| (m.header().tick, m.gap));
        assert_eq!(
            [next(), next(), next()],
            [0, 1, 2].map(|tick| Some((tick, false)))
        );
        assert_eq!((next(), watcher.lost()), (None, 0));
        send(&mut from, 50, 1).unwrap();
        assert_eq!((next(), watcher.lost()), (Some((50, true)), 47));
        assert_eq!(drain(&to), [(50, 1, false)]);
    });
}

#[test]
fn messages_of_another_run_are_refused() {
    let bench = Bench::new();
    let (a, b) = (bench.node(), bench.node());
    let channel = channel(Delivery::Lossless);
    let mut from = sender(&a, &channel, &Stop::new(), 1);
    let to = ChannelReceiver::<Chunks>::new(
        ChannelServices::open(&b, &channel).unwrap(),
        &Arc::new(test_plan()),
        8,
        1,
    )
    .unwrap();
    send(&mut from, 0, 1).unwrap();
    assert_eq!(drain(&to), []);
    assert_eq!(to.refused(), 1);
}

#[test]
fn nothing_is_left_in_shared_memory() {
    let bench = Bench::new();
    let prefix = bench.folder.prefix();
    {
        let node = bench.node();
        let channel = channel(Delivery::Lossless);
        let _from = sender(&node, &channel, &Stop::new(), 1);
        let _to = receiver(&node, &channel);
    }
    let left = || {
        let entries = std::fs::read_dir("/dev/shm").unwrap().flatten();
        entries
            .filter(|e| e.file_name().to_string_lossy().starts_with(&prefix))
            .count()
    };
    assert!(
        left() <= 1,
        "more than iceoryx2's own table, which it never removes"
    );
    bench.folder.sweep();
    assert_eq!(left(), 0);
}

#[test]
fn somebody_else_under_the_same_name_is_refused_and_counted() {
    let bench = Bench::new();
    let (a, b, c) = (bench.node(), bench.node(), bench.node());
    let channel = channel(Delivery::Latest);
    let to = receiver(&b, &channel);
    let mut from = sender(&a, &channel, &Stop::new(), 1);
    send(&mut from, 1, 1).unwrap();
    assert_eq!(drain(&to), [(1, 1, false)]);
    let mut rogue = sender(&c, &channel, &Stop::new(), 1);
    send(&mut rogue, 2, 1).unwrap();
    assert_eq!(drain(&to), []);
    send(&mut from, 2, 1).unwrap();
    // Started again, it is somebody else with a right to its name.
    let mut again = sender(&c, &channel, &Stop::new(), 2);
    send(&mut again, 3, 1).unwrap();
    let mut came = drain(&to);
    came.sort_unstable();
    assert_eq!(came, [(2, 1, false), (3, 1, false)]);
    assert_eq!((to.refused(), to.lost()), (1, 0));
}

#[test]
fn what_the_plan_cannot_have_sent_is_refused_and_counted() {
    let bench = Bench::new();
    let (a, b) = (bench.node(), bench.node());
    let channel = channel(Delivery::Latest);
    let to = receiver(&b, &channel);
    let mut from = sender(&a, &channel, &Stop::new(), 1);
    send(&mut from, u64::MAX, 1).unwrap();
    let header = ChunkHeader {
        closes: u32::MAX,
        ..ChunkHeader::default()
    };
    from.emit(header, 0, &mut |_| {}).unwrap();
    send(&mut from, 3, 1).unwrap();
    assert_eq!(drain(&to), [(3, 1, false)]);
    assert_eq!((to.refused(), to.lost()), (2, 0));
}
