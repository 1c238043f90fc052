//! The main loops of the processes: block until something comes, drain everything, tell what was done.

mod ingest;
mod sink;
mod stage;
mod watch;

pub use ingest::run_ingest;
pub use sink::run_sink;
pub use stage::run_stage;
pub use watch::{ScoresSender, Spectator, run_watcher};

use crate::RuntimeError;
use crate::channel::{ChannelReceiver, ChannelSender, ChannelServices, Ipc};
use crate::domain::{RunFolder, RunSpec};
use crate::stop::{SignalListener, Stop, wake_pair};
use crate::telemetry::Telemetry;
use evpr_core::Plan;
use evpr_core::message::{Message, Stamp};
use evpr_core::plan::{Service, Topic};
use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;

/// Which process of which run this is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Identity {
    /// The run.
    pub run_id: u64,
    /// Index of the service in the plan.
    pub service: u32,
    /// How often it has been started, from 1.
    pub incarnation: u32,
}

impl Identity {
    pub(crate) fn stamp(self, seq: u64, sent_ns: u64, items: usize) -> Stamp {
        Stamp {
            run_id: self.run_id,
            seq,
            sent_ns,
            service: self.service,
            incarnation: self.incarnation,
            items: items as u32,
            _pad: 0,
        }
    }
}

/// Everything a process has from the runtime.
#[derive(Debug)]
pub struct ServiceContext {
    /// The plan.
    pub plan: Plan,
    /// Who this is.
    pub identity: Identity,
    /// The service in the plan.
    pub service: Service,
    /// The same plan, for what outlives a borrow of this.
    shared: Arc<Plan>,
    folder: RunFolder,
    stop: Stop,
    wake: Rc<Listener<Ipc>>,
    telemetry: Telemetry,
    node: Node<Ipc>,
    _signals: SignalListener,
}

impl ServiceContext {
    /// Joins the run of this folder as its service number `service`.
    ///
    /// # Errors
    /// When the folder holds no run, or shared memory cannot be joined.
    pub fn join(folder: RunFolder, service: usize, incarnation: u32) -> Result<Self, RuntimeError> {
        let RunSpec {
            run_id,
            supervisor,
            plan,
        } = folder.read_spec()?;
        die_with(supervisor)?;
        let described = plan
            .services()
            .get(service)
            .cloned()
            .ok_or_else(|| RuntimeError::Folder(format!("the plan has no service number {service}")))?;
        let identity = Identity {
            run_id,
            service: service as u32,
            incarnation,
        };
        let node = folder.node(&described.name)?;
        let (wake_sender, wake) = wake_pair(&node, &format!("{service}"))?;
        let (stop, signals) = Stop::listen(wake_sender, false)?;
        let telemetry = Telemetry::new(&node, &plan, identity, &stop)?;
        Ok(Self {
            shared: Arc::new(plan.clone()),
            plan,
            identity,
            service: described,
            folder,
            stop,
            wake: Rc::new(wake),
            telemetry,
            node,
            _signals: signals,
        })
    }

    /// A file of this process in the run folder, which its next incarnation finds again.
    pub fn kept_file(&self) -> PathBuf {
        self.folder.kept_file(self.service.kind.name())
    }

    /// The stop flag, raised by SIGTERM and SIGINT.
    pub fn stop(&self) -> &Stop {
        &self.stop
    }

    /// The folder of the run.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// The way of the fuser's scores to whoever watches; none in a graph that nobody watches.
    ///
    /// # Errors
    /// When shared memory fails.
    pub fn scores(&self) -> Result<Option<ScoresSender>, RuntimeError> {
        let Some(channel) = self.plan.channel(&Topic::Scores) else {
            return Ok(None);
        };
        let services = ChannelServices::open(&self.node, &channel)?;
        let sender = ChannelSender::new(services, self.identity, &self.stop, 1, Arc::default())?;
        Ok(Some(ScoresSender::new(sender)))
    }

    fn services<M: Message>(&self, topic: &Topic) -> Result<ChannelServices<M>, RuntimeError> {
        let channel = self
            .plan
            .channel(topic)
            .ok_or_else(|| RuntimeError::Ipc(format!("the plan has no channel {topic}")))?;
        ChannelServices::open(&self.node, &channel)
    }

    fn receiver<M: Message>(&self, topic: &Topic) -> Result<ChannelReceiver<M>, RuntimeError> {
        ChannelReceiver::new(
            self.services(topic)?,
            &self.shared,
            self.identity.run_id,
            self.identity.service,
        )
    }

    fn sender<M: Message>(&self, topic: &Topic, stop_at: u32) -> Result<ChannelSender<M>, RuntimeError> {
        let activity = self.telemetry.activity.clone();
        let mut sender = ChannelSender::new(
            self.services(topic)?,
            self.identity,
            &self.stop,
            stop_at,
            activity,
        )?;
        sender.record.traced = self.telemetry.is_traced();
        Ok(sender)
    }
}

/// Asks the kernel for SIGTERM when the supervisor dies, so that a killed supervisor leaves no orphans.
fn die_with(supervisor: u32) -> Result<(), RuntimeError> {
    nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGTERM)
        .map_err(|e| RuntimeError::Process(format!("cannot ask to end with the supervisor: {e}")))?;
    if nix::unistd::getppid().as_raw() as u32 != supervisor {
        return Err(RuntimeError::Process(
            "the supervisor of this run has gone".to_owned(),
        ));
    }
    Ok(())
}
