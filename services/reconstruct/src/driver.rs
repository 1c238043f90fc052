//! The stage around a method: segments, completeness, windows and members.

use crate::held::Held;
use crate::method::Method;
use crate::network::{LoadError, NetworkMethod};
use crate::registry;
use evpr_core::member::{MAX_EXTRACTORS, MAX_WINDOWS};
use evpr_core::message::{ChannelOrder, ChunkHeader, Chunks, Event, FrameHeader, Frames};
use evpr_core::plan::{Plan, SegmentPlan, Sensor};
use evpr_core::stage::{Outlet, Stage, StageError};
use evpr_core::{MemberSet, Reason};
use evpr_onnx::OnnxError;

/// Why a reconstruction cannot be made of a plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BuildError {
    /// The plan has fewer reconstructions.
    #[error(
        "the plan has {count} reconstructions, none with index {index}; start as many processes as it has"
    )]
    NoSuchReconstruction {
        /// The index asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// No method of this name.
    #[error("reconstruction \"{id}\": there is no kind \"{kind}\"; known: {known}")]
    UnknownKind {
        /// The reconstruction's name in the plan.
        id: String,
        /// The kind it names.
        kind: String,
        /// The kinds there are.
        known: String,
    },
    /// A parameter is missing, out of range or does not go with another.
    #[error("reconstruction \"{id}\": {problem}")]
    Params {
        /// The reconstruction's name in the plan.
        id: String,
        /// What is wrong and what to write.
        problem: String,
    },
    /// Its network cannot be used.
    #[error("reconstruction \"{id}\": {problem}")]
    Network {
        /// The reconstruction's name in the plan.
        id: String,
        /// What is wrong with it and what to do.
        problem: OnnxError,
    },
    /// The plan says something that this method cannot do.
    #[error("reconstruction \"{id}\": {problem}; make the plan anew from its configuration")]
    Plan {
        /// The reconstruction's name in the plan.
        id: String,
        /// What is wrong.
        problem: String,
    },
    /// The frames of the source cannot be opened.
    #[error("reconstruction \"{id}\": {problem}")]
    Frames {
        /// The reconstruction's name in the plan.
        id: String,
        /// Which file, what is wrong with it, and what to do.
        problem: String,
    },
}

/// One method of the plan with all its windows: a [`Stage`] from [`Chunks`] to [`Frames`].
///
/// For each window that closes, and that an enabled member wants, it emits one frame: with an image when every segment
/// of the window was seen whole and has events, else with the [`Reason`] why there is none and an empty payload. A
/// segment was seen whole when ingest says of no chunk that events are missing, its opening chunk came, and from then on every chunk, without a gap in the sequence
/// numbers and in one epoch, up to its closing chunk. Nothing of one epoch is mixed with another.
///
/// Segments that no enabled member wants cost nothing; a window that reaches back into one is incomplete.
pub struct Reconstruct {
    id: String,
    index: u32,
    sensor: Sensor,
    channel_order: ChannelOrder,
    segments: SegmentPlan,
    /// Per segment of the tick: the windows that close with it, as bits.
    closing: Vec<u32>,
    /// Per segment of the tick: the members of this reconstruction whose windows cover it.
    covering: Vec<Vec<usize>>,
    /// Per window: its members of this reconstruction, each with its extractor.
    members: Vec<Vec<(usize, usize)>>,
    held: Held,
    epoch: Option<u32>,
    method: Box<dyn Method>,
    /// The slots of the window that is being rendered.
    rendered: Vec<usize>,
    events: u64,
    outside_sensor: u64,
}

impl std::fmt::Debug for Reconstruct {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reconstruct")
            .field("id", &self.id)
            .field("epoch", &self.epoch)
            .field("held", &self.held)
            .field("events", &self.events)
            .finish_non_exhaustive()
    }
}

/// Makes the stage of the plan's reconstruction `reconstruction`.
///
/// # Errors
/// [`BuildError`] when the plan has no such reconstruction, names a kind that does not exist, or gives it parameters
/// or sizes it cannot have.
pub fn build(plan: &Plan, reconstruction: usize) -> Result<Reconstruct, BuildError> {
    let r = plan
        .reconstructions
        .get(reconstruction)
        .ok_or(BuildError::NoSuchReconstruction {
            index: reconstruction,
            count: plan.reconstructions.len(),
        })?;
    let row = registry::find(&r.kind);
    let channel_order = match &row {
        Some(row) if r.network.is_none() => row.kind.channel_order,
        None if r.network.is_none() => {
            return Err(BuildError::UnknownKind {
                id: r.id.clone(),
                kind: r.kind.clone(),
                known: registry::KINDS.map(|kind| kind.name).join(", "),
            });
        }
        _ => ChannelOrder::Grey,
    };
    check_sizes(plan, r.channels, channel_order).map_err(|problem| BuildError::Plan {
        id: r.id.clone(),
        problem,
    })?;
    let segments = plan.slicing.segments();
    let windows = 0..segments.windows.len();
    let members: Vec<Vec<(usize, usize)>> = windows.map(|w| members_of(plan, reconstruction, w)).collect();
    let covering = covering(&segments, &members);
    let used = segments
        .windows
        .iter()
        .zip(&members)
        .filter(|(_, m)| !m.is_empty());
    let held = Held::new(&segments, &used.map(|(w, _)| *w).collect::<Vec<_>>());
    let mut method = method(plan, reconstruction, row, held.slots())?;
    if r.masks_hot_pixels {
        method.mask(plan.reconstruction_mask(reconstruction));
    }
    Ok(Reconstruct {
        id: r.id.clone(),
        index: reconstruction as u32,
        sensor: plan.sensor,
        channel_order,
        closing: (0..segments.per_tick()).map(|s| segments.closes(s)).collect(),
        covering,
        members,
        epoch: None,
        method,
        rendered: Vec::with_capacity(held.slots()),
        held,
        segments,
        events: 0,
        outside_sensor: 0,
    })
}

/// The method of the plan's reconstruction, with so many slots: its network, or else the registry's row.
fn method(
    plan: &Plan,
    reconstruction: usize,
    row: Option<registry::Row>,
    slots: usize,
) -> Result<Box<dyn Method>, BuildError> {
    let r = &plan.reconstructions[reconstruction];
    let id = || r.id.clone();
    let params = |problem| BuildError::Params { id: id(), problem };
    let loaded = NetworkMethod::load(plan, reconstruction, slots).map_err(|e| match e {
        LoadError::Network(problem) => BuildError::Network { id: id(), problem },
        LoadError::Params(problem) => params(problem),
    })?;
    match (loaded, row) {
        (Some(network), _) => Ok(Box::new(network)),
        (None, Some(row)) => {
            for info in row.kind.params {
                info.check(&r.params).map_err(params)?;
            }
            (row.make)(plan.sensor, slots, &r.params).map_err(params)
        }
        (None, None) => Err(BuildError::Plan {
            id: id(),
            problem: "it is neither a kind nor a network".to_owned(),
        }),
    }
}

fn check_sizes(plan: &Plan, channels: usize, order: ChannelOrder) -> Result<(), String> {
    const MAX_HEIGHT: usize = Event::Y_MAX as usize + 1;
    const MAX_WIDTH: usize = u16::MAX as usize + 1;
    let Sensor { height, width } = plan.sensor;
    if !(1..=MAX_HEIGHT).contains(&height) || !(1..=MAX_WIDTH).contains(&width) {
        return Err(format!(
            "the sensor is {} pixels, which events cannot address",
            plan.sensor
        ));
    }
    if channels != order.channels() {
        return Err(format!("it makes {} channels, not {channels}", order.channels()));
    }
    let (windows, extractors) = (plan.slicing.windows.len(), plan.extractors.len());
    if windows > MAX_WINDOWS || extractors > MAX_EXTRACTORS {
        return Err(format!(
            "{windows} windows and {extractors} extractors are more than {MAX_WINDOWS} and {MAX_EXTRACTORS}"
        ));
    }
    Ok(())
}

/// The members of a window, each with its extractor.
fn members_of(plan: &Plan, reconstruction: usize, window: usize) -> Vec<(usize, usize)> {
    (0..plan.extractors.len())
        .filter_map(|e| Some((plan.member_of(reconstruction, window, e)?, e)))
        .collect()
}

/// Per segment of the tick: the members whose windows cover it, in this tick or reaching back from a later one.
fn covering(segments: &SegmentPlan, members: &[Vec<(usize, usize)>]) -> Vec<Vec<usize>> {
    let per_tick = segments.per_tick();
    let mut covering = vec![Vec::new(); per_tick];
    for (window, members) in segments.windows.iter().zip(members) {
        for back in 0..window.len.min(per_tick) {
            let segment = (window.last + per_tick - back) % per_tick;
            covering[segment].extend(members.iter().map(|(member, _)| *member));
        }
    }
    covering
}

impl Reconstruct {
    /// Events left out because they lie outside the sensor (which ingest should have seen to).
    pub fn outside_sensor(&self) -> u64 {
        self.outside_sensor
    }

    /// The chunk's segment, counted from the start of the recording, if its header makes sense.
    fn segment_of(&self, header: &ChunkHeader) -> Result<u64, StageError> {
        let per_tick = self.segments.per_tick();
        let nonsense = |what: String| {
            Err(StageError::Skip(format!(
                "reconstruction \"{}\": chunk {} of tick {} {what}; use ingest of the same version and plan",
                self.id, header.stamp.seq, header.tick
            )))
        };
        let segment = header.segment as usize;
        let Some(closing) = self.closing.get(segment) else {
            return nonsense(format!("is in segment {segment} of {per_tick}"));
        };
        if header.closes & !closing != 0 {
            return nonsense(format!(
                "closes windows {:#b}, but segment {segment} only ends {closing:#b}",
                header.closes
            ));
        }
        let first = header.tick.checked_mul(per_tick as u64);
        match first.and_then(|first| first.checked_add(segment as u64)) {
            Some(global) => Ok(global),
            None => nonsense("is too far ahead to count".to_owned()),
        }
    }

    /// Checks a header and follows its epoch. Returns its segment, counted from the start of the recording.
    fn admit(&mut self, header: &ChunkHeader) -> Result<u64, StageError> {
        match self.epoch {
            Some(epoch) if header.epoch < epoch => {
                return Err(StageError::Skip(format!(
                    "reconstruction \"{}\": chunk {} of tick {} is of epoch {}, which ended when {epoch} began",
                    self.id, header.stamp.seq, header.tick, header.epoch
                )));
            }
            Some(epoch) if header.epoch == epoch => {}
            _ => {
                self.epoch = Some(header.epoch);
                self.held.forget();
                self.method.forget();
            }
        }
        let segment = self.segment_of(header);
        if segment.is_err() {
            self.held.break_off();
        }
        segment
    }

    /// Begins a segment, if an enabled member wants it.
    fn open(&mut self, header: &ChunkHeader, segment: u64) {
        let covering = &self.covering[header.segment as usize];
        if !covering.iter().any(|member| header.members.contains(*member)) {
            self.held.break_off();
            return;
        }
        if let Some(slot) = self.held.open(segment, header.stamp.seq) {
            self.method.clear(slot);
        }
    }

    /// Enters a chunk's events, as long as its segment is whole so far.
    fn enter(&mut self, header: &ChunkHeader, segment: u64, events: &[Event]) {
        if let Some(reason) = header.loss() {
            self.held.lose(segment, reason);
            return;
        }
        if header.opens_segment() {
            self.open(header, segment);
        }
        let Some(slot) = self.held.slot_for(segment, header.stamp.seq) else {
            return;
        };
        let entered = self.method.accumulate(slot, events, header.base_us) as u64;
        self.events += entered;
        self.outside_sensor += events.len() as u64 - entered;
        self.held.add(segment, entered);
        if header.closes_segment() {
            self.held.close(segment);
        }
    }

    /// The extractors that want a window, as bits.
    fn wanted(&self, window: usize, enabled: &MemberSet) -> u32 {
        let members = self.members[window].iter();
        let wanted = members.filter(|(member, _)| enabled.contains(*member));
        wanted.fold(0, |bits, (_, extractor)| bits | 1 << extractor)
    }

    /// Emits a frame for each wanted window that the chunk closes; `all` is the reason for all of them, if there is one.
    fn close(
        &mut self,
        header: &ChunkHeader,
        segment: u64,
        all: Option<Reason>,
        outlet: &mut dyn Outlet<Frames>,
    ) -> Result<(), StageError> {
        let mut failed = None;
        for window in 0..self.segments.windows.len() {
            let extractors = self.wanted(window, &header.members);
            if header.closes >> window & 1 == 0 || extractors == 0 {
                continue;
            }
            let len = self.segments.windows[window].len;
            let gathered = match all {
                Some(reason) => Err(reason),
                None => self.held.window(segment, len, &mut self.rendered),
            };
            let gathered = gathered.and_then(|events| {
                let prepared = self.method.prepare(window, header.tick, &self.rendered);
                prepared.map(|()| events).map_err(|problem| {
                    failed = Some(problem);
                    Reason::Failed
                })
            });
            let mut frame = FrameHeader {
                tick: header.tick,
                epoch: header.epoch,
                reconstruction: self.index,
                window: window as u32,
                height: self.sensor.height as u32,
                width: self.sensor.width as u32,
                channel_order: self.channel_order as u32,
                extractors,
                ..FrameHeader::default()
            };
            frame.life.closed_ns = header.closed_ns;
            match gathered {
                Ok(events) => {
                    frame.events = events;
                    let len = self.sensor.pixels() * self.channel_order.channels();
                    let (method, slots) = (&mut self.method, &self.rendered);
                    outlet.emit(frame, len, &mut |out| method.render(slots, out))?;
                }
                Err(reason) => {
                    frame.reason = reason.code();
                    outlet.emit(frame, 0, &mut |_| {})?;
                }
            }
        }
        match failed {
            None => Ok(()),
            Some(problem) => Err(StageError::Skip(format!(
                "reconstruction \"{}\": tick {}: {problem}",
                self.id, header.tick
            ))),
        }
    }
}

impl Stage for Reconstruct {
    type In = Chunks;
    type Out = Frames;

    fn process(
        &mut self,
        header: &ChunkHeader,
        payload: &[Event],
        outlet: &mut dyn Outlet<Frames>,
    ) -> Result<(), StageError> {
        let segment = self.admit(header)?;
        self.enter(header, segment, payload);
        self.close(header, segment, None, outlet)
    }

    fn skip_dropped(
        &mut self,
        header: &ChunkHeader,
        outlet: &mut dyn Outlet<Frames>,
    ) -> Result<(), StageError> {
        let segment = self.admit(header)?;
        self.held.drop_segment(segment);
        self.close(header, segment, Some(Reason::Dropped), outlet)
    }

    fn unload(&mut self) -> bool {
        self.method.unload()
    }

    fn events(&self) -> u64 {
        self.events
    }
}
