//! Channels: a publish–subscribe service with its event of the same name, and for channels that wait a second event
//! by which subscribers say that there is room again. Nobody polls.

use crate::clock::now_ns;
use crate::gate::Gate;
use crate::run::Identity;
use crate::telemetry::Activity;
use crate::watcher::Watchers;
use crate::{RuntimeError, Stop};
use evpr_core::Plan;
use evpr_core::message::{Header, Histogram, Message, Span, SpanKind};
use evpr_core::plan::{Channel, Topic};
use evpr_core::stage::{Outlet, StageError};
use iceoryx2::port::BackpressureAction;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

/// The flavour of iceoryx2 used throughout: ports may move between threads.
pub(crate) type Ipc = ipc_threadsafe::Service;
pub(crate) type DataService<M> =
    publish_subscribe::PortFactory<Ipc, [<M as Message>::Item], <M as Message>::Header>;
/// A received message; its slot is given back when this drops.
pub(crate) type Received<M> = Sample<Ipc, [<M as Message>::Item], <M as Message>::Header>;

const DATA: usize = 1;
/// Event ids on the room event say which reader has just received: this plus its number.
const FIRST_READER: usize = 16;
/// The supervisor's number as a reader; services have their index in the plan.
pub(crate) const SUPERVISOR_READER: u32 = 200;
/// A blocked publisher looks at its stop flag this often, should a wake-up be lost with a dying subscriber.
const BLOCKED_RECHECK: Duration = Duration::from_millis(50);
/// Cache lines, and SIMD loads.
const ALIGNMENT: usize = 64;
/// Slots written once at the start, so that the first messages do not pay for fresh pages.
const TOUCHED_SLOTS: usize = 4;

/// Wakes the main loop of this process from another thread.
#[derive(Debug, Clone)]
pub(crate) struct WakeSender(Arc<Notifier<Ipc>>);

impl WakeSender {
    pub(crate) fn new(notifier: Notifier<Ipc>) -> Self {
        Self(Arc::new(notifier))
    }

    pub(crate) fn wake(&self) {
        // A full socket means that a wake-up is under way already.
        let _ = self.0.notify();
    }
}

pub(crate) fn failed(topic: &Topic, what: &str, error: &dyn std::fmt::Debug) -> RuntimeError {
    RuntimeError::Ipc(format!("channel {topic}: {what}: {error:?}"))
}

fn service_name(topic: &Topic, suffix: &str) -> Result<ServiceName, RuntimeError> {
    ServiceName::new(&format!("{topic}{suffix}")).map_err(|e| failed(topic, "bad name", &e))
}

/// The services behind one channel. Whoever opens them first creates them, with the sizes of the plan.
#[derive(Debug)]
pub(crate) struct ChannelServices<M: Message> {
    pub(crate) channel: Channel,
    pub(crate) data: Arc<DataService<M>>,
    pub(crate) wake: event::PortFactory<Ipc>,
    room: event::PortFactory<Ipc>,
}

impl<M: Message> ChannelServices<M> {
    pub(crate) fn open(node: &Node<Ipc>, channel: &Channel) -> Result<Self, RuntimeError> {
        let topic = &channel.topic;
        let alignment =
            Alignment::new(ALIGNMENT).ok_or_else(|| failed(topic, "bad alignment", &ALIGNMENT))?;
        let nodes = 2 * (channel.max_subscribers + channel.max_publishers);
        let data = node
            .service_builder(&service_name(topic, "")?)
            .publish_subscribe::<[M::Item]>()
            .user_header::<M::Header>()
            .payload_alignment(alignment)
            .enable_safe_overflow(!channel.waits)
            .history_size(0)
            .subscriber_max_buffer_size(channel.buffer)
            .subscriber_max_borrowed_samples(channel.borrowed)
            .max_publishers(channel.max_publishers)
            .max_subscribers(channel.max_subscribers)
            .max_nodes(nodes)
            .open_or_create()
            .map_err(|e| failed(topic, "cannot open", &e))?;
        let event = |suffix: &str| {
            node.service_builder(&service_name(topic, suffix)?)
                .event()
                .max_listeners(channel.max_subscribers + channel.max_publishers)
                .max_notifiers(channel.max_subscribers + channel.max_publishers)
                .max_nodes(nodes)
                .open_or_create()
                .map_err(|e| failed(topic, "cannot open its event", &e))
        };
        Ok(Self {
            channel: channel.clone(),
            data: Arc::new(data),
            wake: event("")?,
            room: event("/room")?,
        })
    }
}

/// What a sender has noted.
#[derive(Debug, Default)]
pub(crate) struct Record {
    /// Of each message: handing it over, waiting for room included.
    pub(crate) sending: Histogram,
    /// Whether spans are wanted.
    pub(crate) traced: bool,
    /// One per message, until they are taken away.
    pub(crate) spans: Vec<Span>,
}

/// The sending end of a channel.
#[derive(Debug)]
pub(crate) struct ChannelSender<M: Message> {
    topic: Topic,
    max_items: usize,
    publisher: Publisher<Ipc, [M::Item], M::Header>,
    wake: Notifier<Ipc>,
    identity: Identity,
    seq: u64,
    stop: Stop,
    activity: Arc<Activity>,
    /// When the work on the next message began: the stage took up its input, or had sent the message before.
    pub(crate) started_ns: u64,
    /// Messages sent.
    pub(crate) sent: u64,
    pub(crate) record: Record,
    // The publisher does not keep its service alive by itself.
    services: ChannelServices<M>,
}

impl<M: Message> ChannelSender<M> {
    /// `stop_at` is how many stop requests it takes to give up waiting for room: ingest still sends its end after
    /// the first. `activity` is told when it waits for room.
    pub(crate) fn new(
        services: ChannelServices<M>,
        identity: Identity,
        stop: &Stop,
        stop_at: u32,
        activity: Arc<Activity>,
    ) -> Result<Self, RuntimeError> {
        let channel = services.channel.clone();
        let topic = channel.topic.clone();
        let slots = TOUCHED_SLOTS.min(channel.slots());
        let builder = services
            .data
            .publisher_builder()
            .initial_max_slice_len(channel.max_items.max(1))
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(slots)
            .backpressure_strategy(BackpressureStrategy::DiscardData);
        let room = channel
            .waits
            .then(|| services.room.listener_builder().create())
            .transpose();
        let room = room
            .map_err(|e| failed(&topic, "cannot listen for room", &e))?
            .map(Arc::new);
        let publisher = match &room {
            Some(room) => {
                let (flag, room, activity) = (stop.clone(), room.clone(), activity.clone());
                let watchers = Watchers::<M>::new(services.data.clone());
                builder.set_backpressure_handler(move |full| {
                    if watchers.has(full.receiver_port_id) {
                        return BackpressureAction::DiscardData;
                    }
                    if flag.count() >= stop_at {
                        return BackpressureAction::DiscardDataAndFail;
                    }
                    activity.block();
                    // A wait that fails leaves iceoryx2's own back-off between the retries.
                    let _ = room.timed_wait(|_| {}, BLOCKED_RECHECK);
                    BackpressureAction::Retry
                })
            }
            None => builder,
        }
        .create()
        .map_err(|e| failed(&topic, "cannot publish", &e))?;
        let wake = services
            .wake
            .notifier_builder()
            .create()
            .map_err(|e| failed(&topic, "cannot notify", &e))?;
        let touched: Result<Vec<_>, _> = (0..slots)
            .map(|_| publisher.loan_slice(channel.max_items.max(1)))
            .collect();
        drop(touched.map_err(|e| failed(&topic, "cannot touch its buffers", &e))?);
        if let Some(room) = &room {
            meet_readers(&services, room, &wake, stop)?;
        }
        Ok(Self {
            topic,
            max_items: channel.max_items.max(1),
            publisher,
            wake,
            identity,
            seq: 0,
            stop: stop.clone(),
            activity,
            started_ns: 0,
            sent: 0,
            record: Record::default(),
            services,
        })
    }

    /// Whether anybody reads the channel now.
    pub(crate) fn is_heard(&self) -> bool {
        self.services.data.dynamic_config().number_of_subscribers() > 0
    }
}

/// Waits until every reader there is has connected to this new sender. A reader connects when it receives, and until
/// then a full channel drops what is sent to it, however lossless it is meant to be.
///
/// Each reader is heard of twice: the first word may still be of a receive that began before this sender was there.
/// Readers that come later connect at once (see [`ChannelReceiver::new`]).
fn meet_readers<M: Message>(
    services: &ChannelServices<M>,
    room: &Listener<Ipc>,
    wake: &Notifier<Ipc>,
    stop: &Stop,
) -> Result<(), RuntimeError> {
    let topic = &services.channel.topic;
    let mut heard: HashMap<usize, u32> = HashMap::new();
    room.try_wait(|_| {})
        .map_err(|e| failed(topic, "cannot listen for readers", &e))?;
    loop {
        // Looked up each time: a reader that dies meanwhile vanishes from the list once it is cleaned up.
        let mut missing = false;
        services.data.dynamic_config().list_subscribers(|reader| {
            let number = reader.subscriber_name.as_str().parse::<usize>().ok();
            missing |= number.is_some_and(|n| heard.get(&(FIRST_READER + n)).is_none_or(|times| *times < 2));
            CallbackProgression::Continue
        });
        if !missing || stop.requested() {
            return Ok(());
        }
        let _ = wake.notify_with_custom_event_id(EventId::new(DATA));
        match room.timed_wait(
            |event| *heard.entry(event.id.as_value()).or_default() += 1,
            BLOCKED_RECHECK,
        ) {
            // After a signal, the loop looks whether it was one to stop.
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
            Err(e) => return Err(failed(topic, "cannot wait for readers", &e)),
        }
    }
}

impl<M: Message> Outlet<M> for ChannelSender<M> {
    fn emit(
        &mut self,
        mut header: M::Header,
        len: usize,
        fill: &mut dyn FnMut(&mut [M::Item]),
    ) -> Result<(), StageError> {
        if len > self.max_items {
            return Err(StageError::Fatal(format!(
                "channel {}: a message of {len} items does not fit the plan's {}",
                self.topic, self.max_items
            )));
        }
        let broken = |what: &str, e: &dyn std::fmt::Debug| {
            StageError::Fatal(format!("channel {}: {what}: {e:?}", self.topic))
        };
        // Slices in shared memory have at least one item; receivers take the true length from the header.
        let mut sample = self
            .publisher
            .loan_slice(len.max(1))
            .map_err(|e| broken("no free slot", &e))?;
        if len > 0 {
            fill(sample.payload_mut());
        }
        let now = now_ns();
        header.mark(self.started_ns, now);
        *header.stamp_mut() = self.identity.stamp(self.seq, now, len);
        *sample.user_header_mut() = header;
        let (tick, closed_ns, part, together) = (
            header.tick(),
            header.closed_ns(),
            header.part(),
            header.together(),
        );
        match sample.send() {
            Ok(_) => {}
            Err(_) if self.stop.requested() => return Err(StageError::Stopped),
            Err(e) => return Err(broken("cannot send", &e)),
        }
        // A full socket means that the subscriber has a wake-up waiting; it drains the channel whole.
        let _ = self.wake.notify_with_custom_event_id(EventId::new(DATA));
        // Taken after the wake-up, as whoever is woken may well get this processor first.
        let sent = now_ns();
        self.activity.unblock(sent);
        self.record.sending.record(sent.saturating_sub(now));
        if self.record.traced {
            self.record.spans.push(Span {
                sent_ns: now,
                start_ns: self.started_ns.min(now),
                end_ns: sent,
                tick,
                closed_ns,
                kind: SpanKind::Output as u32,
                part,
            });
        }
        // What is computed at once has one beginning.
        if together <= 1 {
            self.started_ns = sent;
        }
        self.seq += 1;
        self.sent += 1;
        Ok(())
    }
}

/// What a reader takes messages from.
#[derive(Debug)]
pub(crate) struct Inlet<M: Message> {
    topic: Topic,
    subscriber: Subscriber<Ipc, [M::Item], M::Header>,
    gate: RefCell<Gate>,
    services: ChannelServices<M>,
}

/// The receiving end of a channel.
#[derive(Debug)]
pub(crate) struct ChannelReceiver<M: Message> {
    inlet: Inlet<M>,
    listener: Listener<Ipc>,
    room: Option<Notifier<Ipc>>,
    reader: EventId,
}

/// A message with what the receiver knows about it.
#[derive(Debug)]
pub(crate) struct Incoming<M: Message> {
    sample: Received<M>,
    /// Messages of this sender were lost just before this one.
    pub(crate) gap: bool,
}

impl<M: Message> Incoming<M> {
    pub(crate) fn header(&self) -> &M::Header {
        self.sample.user_header()
    }

    pub(crate) fn payload(&self) -> &[M::Item] {
        let items = self.header().stamp().items as usize;
        &self.sample.payload()[..items.min(self.sample.payload().len())]
    }
}

impl<M: Message> Inlet<M> {
    /// Subscribes under this name.
    pub(crate) fn new(
        services: ChannelServices<M>,
        plan: &Arc<Plan>,
        run_id: u64,
        name: &str,
    ) -> Result<Self, RuntimeError> {
        let topic = services.channel.topic.clone();
        let name = PortName::new(name).map_err(|e| failed(&topic, "bad port name", &e))?;
        let subscriber = services
            .data
            .subscriber_builder()
            .buffer_size(services.channel.buffer)
            .name(&name)
            .create()
            .map_err(|e| failed(&topic, "cannot subscribe", &e))?;
        // Connects to the senders there are, so that what is sent from now on comes.
        subscriber
            .has_samples()
            .map_err(|e| failed(&topic, "cannot connect", &e))?;
        Ok(Self {
            gate: RefCell::new(Gate::new(run_id, topic.clone(), plan.clone())),
            topic,
            subscriber,
            services,
        })
    }

    /// A listener to the channel's wake-ups.
    pub(crate) fn listener(&self) -> Result<Listener<Ipc>, RuntimeError> {
        let listener = self.services.wake.listener_builder().create();
        listener.map_err(|e| failed(&self.topic, "cannot listen", &e))
    }

    /// Messages that were sent and never came.
    pub(crate) fn lost(&self) -> u64 {
        self.gate.borrow().lost
    }

    /// The next message of this run, if there is one. `received` is told of each that is taken out.
    pub(crate) fn receive(&self, received: impl Fn()) -> Result<Option<Incoming<M>>, RuntimeError> {
        loop {
            let sample = self
                .subscriber
                .receive()
                .map_err(|e| failed(&self.topic, "cannot receive", &e))?;
            received();
            let Some(sample) = sample else { return Ok(None) };
            let port = sample.origin().value();
            let admitted = self
                .gate
                .borrow_mut()
                .admit::<M>(port, sample.user_header(), sample.payload());
            let Some(gap) = admitted else { continue };
            return Ok(Some(Incoming { sample, gap }));
        }
    }
}

impl<M: Message> ChannelReceiver<M> {
    /// `reader` is the number of this process among the readers.
    pub(crate) fn new(
        services: ChannelServices<M>,
        plan: &Arc<Plan>,
        run_id: u64,
        reader: u32,
    ) -> Result<Self, RuntimeError> {
        let topic = services.channel.topic.clone();
        let inlet = Inlet::new(services, plan, run_id, &reader.to_string())?;
        let listener = inlet.listener()?;
        let services = &inlet.services;
        let room = services
            .channel
            .waits
            .then(|| services.room.notifier_builder().create());
        let room = room
            .transpose()
            .map_err(|e| failed(&topic, "cannot notify of room", &e))?;
        Ok(Self {
            inlet,
            listener,
            room,
            reader: EventId::new(FIRST_READER + reader as usize),
        })
    }

    /// What the wait set listens to.
    pub(crate) fn listener(&self) -> &Listener<Ipc> {
        &self.listener
    }

    /// Messages that were sent and never came.
    pub(crate) fn lost(&self) -> u64 {
        self.inlet.lost()
    }

    /// Messages that were not let in (see [`Gate`]).
    pub(crate) fn refused(&self) -> u64 {
        self.inlet.gate.borrow().refused
    }

    /// The next message of this run, if there is one.
    pub(crate) fn receive(&self) -> Result<Option<Incoming<M>>, RuntimeError> {
        self.inlet.receive(|| {
            if let Some(room) = &self.room {
                let _ = room.notify_with_custom_event_id(self.reader);
            }
        })
    }
}

/// A message that only its channel's receivers may see; no stage emits it.
pub(crate) struct NoOutlet;

impl<M: Message> Outlet<M> for NoOutlet {
    fn emit(&mut self, _: M::Header, _: usize, _: &mut dyn FnMut(&mut [M::Item])) -> Result<(), StageError> {
        Ok(())
    }
}
