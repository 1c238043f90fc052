//! `frames`: no reconstruction at all. The frames come from files, one for each tick that ingest closes.

use crate::BuildError;
use evpr_core::message::{ChannelOrder, ChunkHeader, Chunks, Event, FrameHeader, Frames};
use evpr_core::plan::{FRAMES, Plan, ReconstructionKind, Sensor};
use evpr_core::stage::{Outlet, Stage, StageError};
use evpr_core::{MemberSet, Reason};
use evpr_frames::{FrameList, Picture, Timeline};

/// Its row in the catalog.
pub(crate) const KIND: ReconstructionKind = ReconstructionKind {
    name: FRAMES,
    doc: "frames of a camera or of another reconstruction, as they are (one channel, or blue, green and red)",
    channel_order: ChannelOrder::BlueGreenRed,
    masks_hot_pixels: false,
    params: &[],
};

/// Reads the frame of each tick whose chunk closes the window, if an enabled member wants it: a [`Stage`] from
/// [`Chunks`], which are empty, to [`Frames`].
///
/// It keeps nothing from one tick to the next. Grey frames have one channel, whatever the plan's slots have room for.
#[derive(Debug)]
pub struct ReadFrames {
    id: String,
    index: u32,
    sensor: Sensor,
    list: FrameList,
    timeline: Timeline,
    /// Members of this reconstruction, each with its extractor.
    members: Vec<(usize, usize)>,
    epoch: u32,
    picture: Picture,
    frames: u64,
}

/// Makes the stage of the plan's reconstruction `reconstruction`, which is of the kind `frames`.
///
/// # Errors
/// [`BuildError`] when the plan has no such reconstruction or another kind of it, and when the frames cannot be opened.
pub fn build_frames(plan: &Plan, reconstruction: usize) -> Result<ReadFrames, BuildError> {
    let count = plan.reconstructions.len();
    let index = reconstruction;
    let r = plan
        .reconstructions
        .get(index)
        .ok_or(BuildError::NoSuchReconstruction { index, count })?;
    let wrong = |problem: String| BuildError::Plan {
        id: r.id.clone(),
        problem,
    };
    let Some(source) = plan.source.frames.as_ref().filter(|_| r.kind == FRAMES) else {
        return Err(wrong(format!(
            "{} of a source of kind \"{}\" are no frames",
            r.kind, plan.source.kind
        )));
    };
    if r.channels != KIND.channel_order.channels() || plan.slicing.windows.len() != 1 {
        return Err(wrong(
            "its channels or windows are not those of frames".to_owned(),
        ));
    }
    let unreadable = |e: evpr_frames::FrameError| BuildError::Frames {
        id: r.id.clone(),
        problem: e.to_string(),
    };
    let list = FrameList::open(&plan.source).map_err(unreadable)?;
    let timeline = Timeline::new(&list, source.ticks, &plan.slicing).map_err(unreadable)?;
    let extractors = 0..plan.extractors.len();
    Ok(ReadFrames {
        id: r.id.clone(),
        index: reconstruction as u32,
        sensor: plan.sensor,
        list,
        timeline,
        members: extractors
            .filter_map(|e| Some((plan.member_of(reconstruction, 0, e)?, e)))
            .collect(),
        epoch: 0,
        picture: Picture::default(),
        frames: 0,
    })
}

impl ReadFrames {
    /// Frames read so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The header of the tick's frame, if the chunk closes the window and an enabled member wants it.
    fn header(&mut self, chunk: &ChunkHeader) -> Result<Option<FrameHeader>, StageError> {
        if chunk.epoch < self.epoch {
            return Err(StageError::Skip(format!(
                "reconstruction \"{}\": tick {} is of epoch {}, which ended when {} began",
                self.id, chunk.tick, chunk.epoch, self.epoch
            )));
        }
        self.epoch = chunk.epoch;
        let wanted = |enabled: &MemberSet| {
            let wanted = self
                .members
                .iter()
                .filter(|(member, _)| enabled.contains(*member));
            wanted.fold(0, |bits, (_, extractor)| bits | 1 << extractor)
        };
        let extractors: u32 = wanted(&chunk.members);
        if chunk.closes & 1 == 0 || extractors == 0 {
            return Ok(None);
        }
        let mut header = FrameHeader {
            tick: chunk.tick,
            epoch: chunk.epoch,
            reconstruction: self.index,
            height: self.sensor.height as u32,
            width: self.sensor.width as u32,
            channel_order: KIND.channel_order as u32,
            extractors,
            ..FrameHeader::default()
        };
        header.life.closed_ns = chunk.closed_ns;
        Ok(Some(header))
    }
}

impl Stage for ReadFrames {
    type In = Chunks;
    type Out = Frames;

    fn process(
        &mut self,
        chunk: &ChunkHeader,
        _events: &[Event],
        outlet: &mut dyn Outlet<Frames>,
    ) -> Result<(), StageError> {
        let Some(mut header) = self.header(chunk)? else {
            return Ok(());
        };
        let tick = self.timeline.tick(&self.list, chunk.tick);
        if tick.start_ns / 1_000 != chunk.base_us {
            return Err(StageError::Fatal(format!(
                "{}: was changed while it is read: tick {} is at another time; begin again",
                self.list.path().display(),
                chunk.tick
            )));
        }
        let Some(frame) = tick.frame else {
            header.reason = Reason::EmptyWindow.code();
            return outlet.emit(header, 0, &mut |_| {});
        };
        let picture = &mut self.picture;
        let read = self.list.read(frame, self.sensor, picture);
        read.map_err(|e| StageError::Fatal(e.to_string()))?;
        self.frames += 1;
        header.channel_order = picture.order as u32;
        outlet.emit(header, picture.pixels.len(), &mut |out| {
            out.copy_from_slice(&picture.pixels);
        })
    }

    fn skip_dropped(
        &mut self,
        chunk: &ChunkHeader,
        outlet: &mut dyn Outlet<Frames>,
    ) -> Result<(), StageError> {
        let Some(mut header) = self.header(chunk)? else {
            return Ok(());
        };
        header.reason = Reason::Dropped.code();
        outlet.emit(header, 0, &mut |_| {})
    }
}
