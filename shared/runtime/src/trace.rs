//! Listening to the spans of a running instance.

use crate::RuntimeError;
use crate::channel::{ChannelReceiver, ChannelServices, Ipc};
use crate::domain::{RunFolder, RunSpec};
use crate::wait::{Waiter, wait_set};
use evpr_core::Plan;
use evpr_core::message::{Span, Spans};
use evpr_core::plan::Topic;
use iceoryx2::node::Node;
use std::sync::Arc;
use std::time::Duration;

/// The number of whoever listens, among readers.
const TRACE_READER: u32 = 201;
/// How often it is looked whether the instance is still there.
const ROUND: Duration = Duration::from_millis(250);

/// The spans of a running instance, as long as it lives. Nobody waits for this reader: what it is too slow for is lost,
/// and counted.
#[derive(Debug)]
pub struct TraceReader {
    spec: RunSpec,
    folder: RunFolder,
    spans: ChannelReceiver<Spans>,
    // Goes last.
    _node: Node<Ipc>,
}

impl TraceReader {
    /// Joins the instance of this folder. Its processes notice within a quarter of a second.
    ///
    /// # Errors
    /// When no instance runs there.
    pub fn join(folder: RunFolder) -> Result<Self, RuntimeError> {
        let spec = folder.read_spec().map_err(|_| folder.is_not_running())?;
        let node = folder.node("trace")?;
        let spans = receiver(&node, &Arc::new(spec.plan.clone()), spec.run_id, TRACE_READER)?;
        Ok(Self {
            spec,
            folder,
            spans,
            _node: node,
        })
    }

    /// The plan of the instance.
    pub fn plan(&self) -> &Plan {
        &self.spec.plan
    }

    /// Messages of spans that were lost because this reader was too slow.
    pub fn lost(&self) -> u64 {
        self.spans.lost()
    }

    /// Waits for spans, no longer than `timeout`, and hands on each batch with the index of its service in the plan; false
    /// once the instance has gone.
    ///
    /// # Errors
    /// When shared memory fails.
    pub fn read(
        &self,
        timeout: Duration,
        take: &mut dyn FnMut(usize, &[Span]),
    ) -> Result<bool, RuntimeError> {
        let set = wait_set()?;
        Waiter::new(&set, vec![self.spans.listener()])?.wait(timeout.min(ROUND))?;
        drain(&self.spans, take)?;
        Ok(self.folder.control_socket().exists())
    }
}

pub(crate) fn receiver(
    node: &Node<Ipc>,
    plan: &Arc<Plan>,
    run_id: u64,
    reader: u32,
) -> Result<ChannelReceiver<Spans>, RuntimeError> {
    let channel = plan
        .channel(&Topic::Spans)
        .ok_or_else(|| RuntimeError::Ipc("the plan has no channel spans".to_owned()))?;
    ChannelReceiver::new(ChannelServices::open(node, &channel)?, plan, run_id, reader)
}

pub(crate) fn drain(
    spans: &ChannelReceiver<Spans>,
    take: &mut dyn FnMut(usize, &[Span]),
) -> Result<(), RuntimeError> {
    while let Some(message) = spans.receive()? {
        take(message.header().stamp.service as usize, message.payload());
    }
    Ok(())
}
