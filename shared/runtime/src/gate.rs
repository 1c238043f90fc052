//! What a receiver lets in: messages of this run, from a process that may send on this channel, from the one port that
//! this process has, in their order, and such as the plan allows. The rest is refused and counted.

use crate::telemetry::RateLimit;
use evpr_core::Plan;
use evpr_core::message::{Header, Message, Refusal, Stamp};
use evpr_core::plan::Topic;
use std::collections::HashMap;
use std::sync::Arc;
use tracing::warn;

/// Senders that are remembered; with more, all are forgotten: losses around that moment are then not counted.
const SENDERS: usize = 256;

/// What is known of a sender.
#[derive(Debug, Clone, Copy)]
struct Sender {
    /// Its port. Another one that calls itself the same is somebody else.
    port: u128,
    /// The number of its next message.
    next: u64,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Gate {
    run_id: u64,
    topic: Topic,
    plan: Arc<Plan>,
    /// The only service that may send here; `None` where all may.
    service: Option<u32>,
    /// By service and incarnation.
    senders: HashMap<(u32, u32), Sender>,
    /// Messages that were sent and never came.
    pub(crate) lost: u64,
    /// Messages that were not let in.
    pub(crate) refused: u64,
    warnings: RateLimit,
}

impl Gate {
    pub(crate) fn new(run_id: u64, topic: Topic, plan: Arc<Plan>) -> Self {
        let service = match &topic {
            Topic::Events | Topic::Ticks => Some(0),
            Topic::Frames(id) => {
                let index = plan.reconstructions.iter().position(|r| r.id == *id);
                index.map(|i| plan.reconstruct_service(i))
            }
            Topic::Descriptors(id) => {
                let index = plan.extractors.iter().position(|e| e.id == *id);
                index.map(|i| plan.extract_service(i))
            }
            Topic::Matches | Topic::Scores => plan.fuse_service(),
            Topic::Control | Topic::Lifecycle => Some(Stamp::SUPERVISOR as usize),
            Topic::Stats | Topic::Spans => None,
        };
        Self {
            run_id,
            topic,
            plan,
            service: service.map(|s| s as u32),
            senders: HashMap::new(),
            lost: 0,
            refused: 0,
            warnings: RateLimit::default(),
        }
    }

    /// The message's payload as far as it counts, and whether messages of its sender were lost just before it; `None` when
    /// it is not let in. `port` is the port that it came from, `slots` all there is of its payload.
    pub(crate) fn admit<M: Message>(
        &mut self,
        port: u128,
        header: &M::Header,
        slots: &[M::Item],
    ) -> Option<bool> {
        match self.judge::<M>(port, header, slots) {
            Ok(gap) => Some(gap),
            Err(refusal) => {
                self.refused += 1;
                if let Some(held_back) = self.warnings.pass() {
                    let stamp = header.stamp();
                    warn!(
                        service = stamp.service,
                        incarnation = stamp.incarnation,
                        held_back,
                        "channel {}: a message is refused: {refusal}",
                        self.topic
                    );
                }
                None
            }
        }
    }

    fn judge<M: Message>(
        &mut self,
        port: u128,
        header: &M::Header,
        slots: &[M::Item],
    ) -> Result<bool, Refusal> {
        let stamp = header.stamp();
        if stamp.run_id != self.run_id {
            return Err("it is of another run");
        }
        let payload = slots
            .get(..stamp.items as usize)
            .ok_or("it has fewer items than it says")?;
        if self.service.is_some_and(|service| service != stamp.service) {
            return Err("its sender does not send here");
        }
        M::check(&self.plan, header, payload)?;
        let key = (stamp.service, stamp.incarnation);
        if self.senders.len() >= SENDERS && !self.senders.contains_key(&key) {
            self.senders.clear();
        }
        let first = Sender {
            port,
            next: stamp.seq,
        };
        let sender = self.senders.entry(key).or_insert(first);
        if sender.port != port {
            return Err("somebody else sends under this name");
        }
        if stamp.seq < sender.next {
            return Err("it has been sent before");
        }
        let lost = stamp.seq - sender.next;
        sender.next = stamp.seq.saturating_add(1);
        self.lost = self.lost.saturating_add(lost);
        Ok(lost > 0)
    }
}
