//! What a process tells the supervisor about itself, a few times per second and at every change of phase; once per
//! second also from where it loads, computes or waits for room, by a thread that watches the main loop.

use crate::RuntimeError;
use crate::channel::{ChannelSender, ChannelServices, Ipc, Record};
use crate::clock::now_ns;
use crate::run::Identity;
use crate::stop::Stop;
use crossbeam::channel::{RecvTimeoutError, Sender, bounded};
use evpr_core::Plan;
use evpr_core::message::{
    DescriptorHeader, Doing, Header, MemberCost, ServicePhase, Span, SpanKind, Spans, SpansHeader, Stats,
    StatsHeader,
};
use evpr_core::plan::{SPANS_AT_ONCE, Topic};
use evpr_core::stage::{Outlet, StageError};
use iceoryx2::node::Node;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tracing::warn;

/// How often a main loop says that it is there, and looks whether there is something to do that nobody wakes it for.
pub(crate) const HEARTBEAT: Duration = Duration::from_millis(250);
/// When a main loop has said nothing for so long, the thread beside it does.
const WATCH: Duration = Duration::from_secs(1);

/// What the main loop is doing, and since when: written by it, read by the thread that watches it.
#[derive(Debug, Default)]
pub(crate) struct Activity {
    doing: AtomicU32,
    progress_ns: AtomicU64,
}

impl Activity {
    /// The main loop takes up something, or begins to wait. The two values need not be read together.
    pub(crate) fn set(&self, doing: Doing, now_ns: u64) {
        self.doing.store(doing as u32, Ordering::Relaxed);
        self.progress_ns.store(now_ns, Ordering::Relaxed);
    }

    /// A channel is full. Called again and again while it is.
    pub(crate) fn block(&self) {
        if self.doing.swap(Doing::Blocked as u32, Ordering::Relaxed) != Doing::Blocked as u32 {
            self.progress_ns.store(now_ns(), Ordering::Relaxed);
        }
    }

    /// Something was sent.
    pub(crate) fn unblock(&self, now_ns: u64) {
        if self.doing.load(Ordering::Relaxed) == Doing::Blocked as u32 {
            self.set(Doing::Working, now_ns);
        }
    }

    fn write(&self, stats: &mut StatsHeader) {
        stats.doing = self.doing.load(Ordering::Relaxed);
        stats.progress_ns = self.progress_ns.load(Ordering::Relaxed);
    }
}

/// The way out, shared by the main loop and the thread that watches it.
#[derive(Debug)]
struct Outgoing {
    sender: ChannelSender<Stats>,
    /// As the main loop sent them last.
    stats: StatsHeader,
    costs: Vec<MemberCost>,
    sent_ns: u64,
}

impl Outgoing {
    fn send(&mut self, activity: &Activity) -> Result<(), RuntimeError> {
        activity.write(&mut self.stats);
        self.sent_ns = now_ns();
        let costs = &self.costs;
        match self
            .sender
            .emit(self.stats, costs.len(), &mut |slots| slots.copy_from_slice(costs))
        {
            Ok(()) | Err(StageError::Stopped) => Ok(()),
            Err(e) => Err(RuntimeError::Ipc(e.to_string())),
        }
    }
}

/// Counters of this process and the channels they go out on.
#[derive(Debug)]
pub(crate) struct Telemetry {
    /// The counters; the loops write them.
    pub(crate) stats: StatsHeader,
    /// Per member of the plan, from sinks; empty from others.
    pub(crate) costs: Vec<MemberCost>,
    pub(crate) activity: Arc<Activity>,
    outgoing: Arc<Mutex<Outgoing>>,
    sent_ns: u64,
    trace: ChannelSender<Spans>,
    spans: Vec<Span>,
    /// Somebody listens to spans.
    traced: bool,
    /// Ends the watching thread when it goes.
    watched: Option<Sender<()>>,
    watcher: Option<std::thread::JoinHandle<()>>,
}

impl Telemetry {
    pub(crate) fn new(
        node: &Node<Ipc>,
        plan: &Plan,
        identity: Identity,
        stop: &Stop,
    ) -> Result<Self, RuntimeError> {
        let channel = |topic: Topic| {
            plan.channel(&topic)
                .ok_or_else(|| RuntimeError::Ipc(format!("the plan has no channel {topic}")))
        };
        let activity = Arc::new(Activity::default());
        activity.set(Doing::Loading, now_ns());
        let idle = Arc::new(Activity::default());
        let stats = ChannelServices::open(node, &channel(Topic::Stats)?)?;
        let spans = ChannelServices::open(node, &channel(Topic::Spans)?)?;
        let outgoing = Arc::new(Mutex::new(Outgoing {
            sender: ChannelSender::new(stats, identity, stop, 1, idle.clone())?,
            stats: StatsHeader {
                pid: std::process::id(),
                ..StatsHeader::default()
            },
            costs: Vec::new(),
            sent_ns: 0,
        }));
        let trace = ChannelSender::new(spans, identity, stop, 1, idle)?;
        let (watched, watcher) = watch(outgoing.clone(), activity.clone())?;
        let mut telemetry = Self {
            stats: StatsHeader {
                pid: std::process::id(),
                ..StatsHeader::default()
            },
            costs: Vec::new(),
            activity,
            outgoing,
            sent_ns: 0,
            traced: trace.is_heard(),
            trace,
            spans: Vec::new(),
            watched: Some(watched),
            watcher: Some(watcher),
        };
        telemetry.send()?;
        Ok(telemetry)
    }

    /// Whether somebody listens to spans.
    pub(crate) fn is_traced(&self) -> bool {
        self.traced
    }

    /// Changes the phase and says so at once.
    pub(crate) fn phase(&mut self, phase: ServicePhase) -> Result<(), RuntimeError> {
        self.stats.phase = phase as u32;
        self.send()
    }

    /// Sends the counters now, and the spans there are.
    pub(crate) fn send(&mut self) -> Result<(), RuntimeError> {
        self.send_spans()?;
        self.traced = self.trace.is_heard();
        let mut outgoing = self.outgoing.lock().unwrap_or_else(PoisonError::into_inner);
        outgoing.stats = self.stats;
        outgoing.costs.clone_from(&self.costs);
        let sent = outgoing.send(&self.activity);
        self.sent_ns = outgoing.sent_ns;
        sent
    }

    /// Sends the counters if it is time.
    pub(crate) fn beat(&mut self) -> Result<(), RuntimeError> {
        self.beat_within(HEARTBEAT)
    }

    /// Sends the counters if they are older than this.
    pub(crate) fn beat_within(&mut self, age: Duration) -> Result<(), RuntimeError> {
        if now_ns().saturating_sub(self.sent_ns) >= age.as_nanos() as u64 {
            self.send()?;
        }
        Ok(())
    }

    /// Notes work on an input from `started_ns` until now, `sending_ns` of it spent on handing over what came of it.
    pub(crate) fn worked(&mut self, header: &impl Header, started_ns: u64, sending_ns: u64) {
        let now = now_ns();
        self.stats
            .processing
            .record(now.saturating_sub(started_ns).saturating_sub(sending_ns));
        self.span(header, started_ns, now);
    }

    /// Notes a stretch of work on an input.
    pub(crate) fn span(&mut self, header: &impl Header, start_ns: u64, end_ns: u64) {
        if self.traced {
            self.spans.push(Span {
                sent_ns: header.stamp().sent_ns,
                start_ns,
                end_ns,
                tick: header.tick(),
                closed_ns: header.closed_ns(),
                kind: SpanKind::Input as u32,
                part: header.part(),
            });
        }
    }

    /// Notes that an input is taken up.
    pub(crate) fn took(&mut self, header: &impl Header, now_ns: u64) {
        self.activity.set(Doing::Working, now_ns);
        let stats = &mut self.stats;
        stats.received += 1;
        stats
            .waiting
            .record(now_ns.saturating_sub(header.stamp().sent_ns));
        if header.closed_ns() > 0 {
            stats.age.record(now_ns.saturating_sub(header.closed_ns()));
        }
    }

    /// Notes that a sink has taken in a row: what it says of its cost.
    pub(crate) fn row(&mut self, header: &DescriptorHeader, started_ns: u64) {
        if let Some(cost) = self
            .costs
            .get_mut(header.member as usize)
            .filter(|_| header.reason == 0)
        {
            let life = &header.life;
            cost.rows += 1;
            cost.reconstruct_ns += life.reconstructed_ns.saturating_sub(life.reconstruct_started_ns);
            let extract_ns = life.extracted_ns.saturating_sub(life.extract_started_ns);
            cost.extract_ns += extract_ns / u64::from(header.together.max(1));
        }
        self.span(header, started_ns, now_ns());
    }

    /// Notes that the main loop waits for input from now on.
    pub(crate) fn rests(&self) {
        self.activity.set(Doing::Waiting, now_ns());
    }

    /// Takes over what a sender has noted.
    pub(crate) fn collect(&mut self, record: &mut Record) -> Result<(), RuntimeError> {
        self.spans.append(&mut record.spans);
        record.traced = self.traced;
        if self.spans.len() >= SPANS_AT_ONCE {
            self.send_spans()?;
        }
        Ok(())
    }

    fn send_spans(&mut self) -> Result<(), RuntimeError> {
        let spans = std::mem::take(&mut self.spans);
        for part in spans.chunks(SPANS_AT_ONCE) {
            let sent = self.trace.emit(SpansHeader::default(), part.len(), &mut |slots| {
                slots.copy_from_slice(part)
            });
            match sent {
                Ok(()) | Err(StageError::Stopped) => {}
                Err(e) => return Err(RuntimeError::Ipc(e.to_string())),
            }
        }
        Ok(())
    }
}

impl Drop for Telemetry {
    fn drop(&mut self) {
        drop(self.watched.take());
        if let Some(watcher) = self.watcher.take() {
            let _ = watcher.join();
        }
    }
}

/// Starts the thread that speaks for the main loop while that says nothing.
fn watch(
    outgoing: Arc<Mutex<Outgoing>>,
    activity: Arc<Activity>,
) -> Result<(Sender<()>, std::thread::JoinHandle<()>), RuntimeError> {
    let (watched, ends) = bounded::<()>(0);
    let watcher = std::thread::Builder::new()
        .name("heartbeat".to_owned())
        .spawn(move || {
            while ends.recv_timeout(WATCH) == Err(RecvTimeoutError::Timeout) {
                let mut outgoing = outgoing.lock().unwrap_or_else(PoisonError::into_inner);
                let silent_ns = now_ns().saturating_sub(outgoing.sent_ns);
                if silent_ns < WATCH.as_nanos() as u64 {
                    continue;
                }
                if let Err(e) = outgoing.send(&activity) {
                    warn!("the heartbeat cannot be sent: {e}");
                    return;
                }
            }
        })
        .map_err(|e| RuntimeError::Process(format!("cannot start a thread: {e}")))?;
    Ok((watched, watcher))
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
