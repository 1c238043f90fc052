//! What a stage is: a plain state machine over slices. The runtime gives it a process; offline commands and
//! tests chain it in theirs.

use crate::message::{
    ChunkHeader, DescriptorHeader, Event, FuseSettings, LiveStats, MatchHeader, Matches, MemberSetting,
    Message, ServiceState, TickHeader,
};
use serde::{Deserialize, Serialize};

/// Why a stage could not go on.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// This message cannot be used; it is counted, logged (rate-limited) and the stage goes on.
    #[error("{0}")]
    Skip(String),
    /// The stage cannot go on: one line saying what was wrong, with which input, and what to do.
    #[error("{0}")]
    Fatal(String),
    /// The outlet is closed because the process is asked to stop.
    #[error("stopped")]
    Stopped,
}

/// Where a stage puts its output.
pub trait Outlet<M: Message> {
    /// Sends one message: `fill` writes the `len` payload items in place, straight into the loaned
    /// shared-memory slice (which it must fill whole; it starts zeroed).
    ///
    /// The outlet completes the header's stamp and times. Lossless delivery blocks until there is room.
    ///
    /// # Errors
    /// [`StageError::Stopped`] when the process is asked to stop while it waits; [`StageError::Fatal`] when
    /// the channel is broken.
    fn emit(
        &mut self,
        header: M::Header,
        len: usize,
        fill: &mut dyn FnMut(&mut [M::Item]),
    ) -> Result<(), StageError>;
}

/// An outlet that keeps what it is given: for tests and in-process chains.
#[derive(Debug)]
pub struct Kept<M: Message> {
    /// What was emitted, in order.
    pub messages: Vec<(M::Header, Vec<M::Item>)>,
}

impl<M: Message> Default for Kept<M> {
    fn default() -> Self {
        Self { messages: Vec::new() }
    }
}

impl<M: Message> Outlet<M> for Kept<M> {
    fn emit(
        &mut self,
        header: M::Header,
        len: usize,
        fill: &mut dyn FnMut(&mut [M::Item]),
    ) -> Result<(), StageError> {
        let mut payload = vec![M::Item::default(); len];
        fill(&mut payload);
        self.messages.push((header, payload));
        Ok(())
    }
}

/// A stage with one kind of input and one kind of output: reconstructions and extractors.
pub trait Stage {
    /// What it takes.
    type In: Message;
    /// What it gives.
    type Out: Message;

    /// Takes one message. Called for every message, in the order of each sender.
    ///
    /// # Errors
    /// [`StageError::Skip`] when this message cannot be used, [`StageError::Fatal`] when nothing can go on.
    fn process(
        &mut self,
        header: &<Self::In as Message>::Header,
        payload: &[<Self::In as Message>::Item],
        outlet: &mut dyn Outlet<Self::Out>,
    ) -> Result<(), StageError>;

    /// Called instead of [`Stage::process`] for each message of a tick that is dropped whole because the
    /// process fell behind: the stage says "no row" where it would have given one.
    ///
    /// # Errors
    /// As [`Stage::process`].
    fn skip_dropped(
        &mut self,
        header: &<Self::In as Message>::Header,
        outlet: &mut dyn Outlet<Self::Out>,
    ) -> Result<(), StageError>;

    /// Called when no message waits any more: gives what it held back in order to do several at once.
    ///
    /// # Errors
    /// As [`Stage::process`].
    fn flush(&mut self, outlet: &mut dyn Outlet<Self::Out>) -> Result<(), StageError> {
        let _ = outlet;
        Ok(())
    }

    /// Called when no enabled member needs the stage for a while and memory is wanted: gives back what it can load again
    /// by itself when it is needed. True when it gave something back.
    fn unload(&mut self) -> bool {
        false
    }

    /// Events counted so far, for the stats; 0 where that means nothing.
    fn events(&self) -> u64 {
        0
    }
}

/// The end of the graph: takes rows and ticks, and settles ticks in order. The fuser and the recorder.
///
/// The runtime calls [`Sink::tick`], [`Sink::descriptor`] and [`Sink::lifecycle`] as messages come, then
/// [`Sink::settle`] once after each batch and whenever [`Sink::deadline_ns`] has passed.
pub trait Sink {
    /// A tick opened, closed, or the stream ended. `weights` has one entry per member with an opening.
    ///
    /// # Errors
    /// As [`Stage::process`].
    fn tick(&mut self, header: &TickHeader, weights: &[f64]) -> Result<(), StageError>;

    /// A row, or the reason why there is none.
    ///
    /// # Errors
    /// As [`Stage::process`].
    fn descriptor(&mut self, header: &DescriptorHeader, row: &[f32]) -> Result<(), StageError>;

    /// Who is dead, by index of service in the plan.
    fn lifecycle(&mut self, services: &[ServiceState]);

    /// Settles every tick that is complete or overdue at `now_ns` (host monotonic), in order.
    ///
    /// # Errors
    /// As [`Stage::process`].
    fn settle(&mut self, now_ns: u64, outlet: &mut dyn Outlet<Matches>) -> Result<(), StageError>;

    /// When to call [`Sink::settle`] again though nothing came (host monotonic ns).
    fn deadline_ns(&self) -> Option<u64>;

    /// The first tick that is not settled yet.
    fn next_tick(&self) -> u64;

    /// True once the stream has ended and every tick before the end is settled.
    fn finished(&self) -> bool;

    /// Called once before the process ends, whatever the reason: completes what is to be kept.
    ///
    /// # Errors
    /// [`StageError::Fatal`] when it could not be completed.
    fn close(&mut self) -> Result<(), StageError>;
}

/// A header with what it carries, for [`MatchHeader`] consumers in process.
pub type Answer = (MatchHeader, Vec<crate::message::Candidate>);

/// A tick that was opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenedTick {
    /// Its number.
    pub tick: u64,
    /// Sensor time of its start, µs.
    pub start_us: u64,
    /// When that was sent (host monotonic ns).
    pub sent_ns: u64,
}

/// What can change while a run goes on; each change holds from the opening of a tick on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Settings {
    /// Grows by one with each change.
    pub version: u64,
    /// The fuser's.
    pub fuse: FuseSettings,
    /// Per member of the plan.
    pub members: Vec<MemberSetting>,
}

/// What ingest sends into and hears from, given by the runtime. A request to stop reaches ingest by a receiver of its
/// own, so that it can wait for events and for the request at the same time.
pub trait IngestPort {
    /// Host monotonic time, ns.
    fn now_ns(&self) -> u64;

    /// Sends a chunk: `fill` writes its `len` events in place. Lossless delivery blocks until there is room.
    ///
    /// # Errors
    /// [`StageError::Stopped`] when it gave up waiting for room; [`StageError::Fatal`] when the channel is broken.
    fn chunk(
        &mut self,
        header: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError>;

    /// Sends a tick message. `weights` has one entry per member with an opening, and is empty with a closing and with
    /// the end.
    ///
    /// # Errors
    /// As [`IngestPort::chunk`].
    fn tick(&mut self, header: TickHeader, weights: &[f64]) -> Result<(), StageError>;

    /// The settings that hold from this tick on, with their version, if they differ from those of the last call.
    /// Asked at every opening of a tick, so it must be quick. Ticks that are opened a second time (ingest went back)
    /// get the settings that they had.
    fn control(&mut self, tick: u64) -> Option<Settings>;

    /// Waits until the host monotonic time `ns`.
    ///
    /// # Errors
    /// [`StageError::Stopped`], at once, when the process is asked to stop.
    fn wait_until(&mut self, ns: u64) -> Result<(), StageError>;

    /// Tells that there is nothing to do until something comes: waiting long is then no fault.
    fn rests(&mut self) {}

    /// Tells how far it is, for the stats: permille of the recording read (0 when not known), the first tick not
    /// opened yet, events sent, and events left out by decision.
    fn progress(&mut self, permille: u64, next_tick: u64, events: u64, skipped: u64);

    /// Tells how a live source is, for the stats.
    fn live(&mut self, stats: LiveStats) {
        let _ = stats;
    }

    /// A tick that an earlier ingest of this run opened, if there was one: a live source goes on with its grid.
    fn opened_before(&self) -> Option<OpenedTick> {
        None
    }
}
