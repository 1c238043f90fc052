//! Frames instead of events: ingest says which ticks there are, and empty chunks tell the reconstruction `frames` to
//! read the frame of each.

use crate::SourceError;
use crate::enabled::Enabled;
use crate::pace::Pace;
use crossbeam::channel::{Receiver, TryRecvError};
use evpr_core::message::{ChunkHeader, TickHeader, TickKind};
use evpr_core::plan::{self, Plan, Sensor, Source};
use evpr_core::stage::{IngestPort, StageError};
use evpr_frames::{FrameError, FrameList, FrameTick, Timeline};

/// Opens and closes the ticks of a source of frames, one chunk each.
///
/// A frame is looked at before its tick opens, so a frame that is not there, of another size or cut short ends the
/// stream at its tick, and the ticks before it are answered.
#[derive(Debug)]
pub struct FrameIngest {
    list: FrameList,
    timeline: Timeline,
    sensor: Sensor,
    factor: Option<f64>,
    tick: u64,
    epoch: u32,
    enabled: Enabled,
    stop: Receiver<()>,
}

fn setup(error: &FrameError) -> SourceError {
    SourceError::Setup(error.to_string())
}

/// The size of a source's frames.
pub(crate) fn probe(source: &Source) -> Result<Sensor, SourceError> {
    let size = FrameList::open(source).and_then(|list| list.size());
    size.map_err(|e| setup(&e))
}

impl FrameIngest {
    /// Opens the plan's frames. The stream begins at `resume_tick`; `epoch` counts the starts of ingest, from 1. `stop`
    /// becomes ready, or disconnects, when ingest is to stop.
    ///
    /// # Errors
    /// When they cannot be opened, or their times do not go with the slicing.
    pub fn new(plan: &Plan, resume_tick: u64, epoch: u32, stop: Receiver<()>) -> Result<Self, SourceError> {
        let list = FrameList::open(&plan.source).map_err(|e| setup(&e))?;
        let ticks = plan.source.frames.clone().unwrap_or_default().ticks;
        let timeline = Timeline::new(&list, ticks, &plan.slicing).map_err(|e| setup(&e))?;
        tracing::info!(
            path = %list.path().display(),
            frames = list.len(),
            ticks = timeline.ticks(),
            resume_tick,
            "frames opened"
        );
        Ok(Self {
            list,
            timeline,
            sensor: plan.sensor,
            factor: match plan.source.pace {
                plan::Pace::Unpaced => None,
                plan::Pace::Factor(factor) => Some(factor),
            },
            tick: resume_tick,
            epoch,
            enabled: Enabled::new(plan),
            stop,
        })
    }

    /// Runs until the last frame, one that cannot be read, or the stop signal; then says where the stream ends.
    ///
    /// # Errors
    /// [`StageError::Fatal`] when a frame cannot be read, or the port broke. Every tick before that has been sent, and
    /// the end.
    pub fn run(mut self, port: &mut dyn IngestPort) -> Result<(), StageError> {
        let outcome = self.follow(port);
        let header = TickHeader {
            kind: TickKind::End as u32,
            ..self.header(&self.timeline.tick(&self.list, self.tick))
        };
        let ended = port.tick(header, &[]);
        let stopped = matches!(outcome, Ok(true) | Err(StageError::Stopped));
        tracing::info!(end_tick = self.tick, stopped, "frames done");
        match (outcome, ended) {
            (Err(e @ (StageError::Fatal(_) | StageError::Skip(_))), _) => Err(e),
            // Asked twice to stop: nobody waits for the end.
            (_, Err(StageError::Stopped)) if stopped => Ok(()),
            (_, ended) => ended,
        }
    }

    /// Sends all ticks. True when it was stopped.
    fn follow(&mut self, port: &mut dyn IngestPort) -> Result<bool, StageError> {
        let ticks = self.timeline.ticks();
        let mut pace = None;
        while self.tick < ticks {
            // A full channel must not outshout the request to stop.
            if self.stop.try_recv() != Err(TryRecvError::Empty) {
                return Ok(true);
            }
            let tick = self.timeline.tick(&self.list, self.tick);
            if let Some(factor) = self.factor {
                let pace = pace.get_or_insert_with(|| Pace::new(tick.due_ns, port.now_ns(), factor));
                port.wait_until(pace.wall_ns(tick.due_ns))?;
            }
            if let Some(frame) = tick.frame {
                let looked_at = self.list.check(frame, self.sensor);
                looked_at.map_err(|e| StageError::Fatal(e.to_string()))?;
            }
            self.send(&tick, port)?;
            self.tick += 1;
            let permille = u128::from(self.tick) * 1000 / u128::from(ticks);
            port.progress(permille as u64, self.tick, 0, 0);
        }
        Ok(false)
    }

    /// Sends a tick: its opening, its chunk, its closing.
    fn send(&mut self, tick: &FrameTick, port: &mut dyn IngestPort) -> Result<(), StageError> {
        self.enabled.follow(self.tick, port);
        let mut opening = self.header(tick);
        if let Some(position) = tick.position {
            [opening.east_m, opening.north_m] = position;
        }
        port.tick(opening, &self.enabled.weights)?;
        let chunk = ChunkHeader {
            tick: self.tick,
            base_us: tick.start_ns / 1_000,
            closed_ns: port.now_ns(),
            epoch: self.epoch,
            flags: ChunkHeader::OPENS_SEGMENT | ChunkHeader::CLOSES_SEGMENT,
            closes: 1,
            members: self.enabled.members,
            ..ChunkHeader::default()
        };
        if self.enabled.want(0) {
            port.chunk(chunk, 0, &mut |_| {})?;
        }
        let closing = TickHeader {
            kind: TickKind::Close as u32,
            closed_ns: chunk.closed_ns,
            ..self.header(tick)
        };
        port.tick(closing, &[])
    }

    fn header(&self, tick: &FrameTick) -> TickHeader {
        TickHeader {
            tick: self.tick,
            start_us: tick.start_ns / 1_000,
            end_us: tick.end_ns / 1_000,
            control_version: self.enabled.version,
            members: self.enabled.members,
            fuse: self.enabled.fuse,
            epoch: self.epoch,
            kind: TickKind::Open as u32,
            ..TickHeader::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{KeptPort, Sent};
    use crossbeam::channel::bounded;
    use evpr_core::plan::{FrameSource, test_plan};

    /// Four frames of 2×3 pixels as a stack, in ticks of 1 ms.
    fn plan() -> (tempfile::TempDir, Plan) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.npy");
        let header =
            b"\x93NUMPY\x01\x00\x3e\x00{'descr': '|u1', 'fortran_order': False, 'shape': (4, 2, 3), }";
        let mut bytes = header.to_vec();
        bytes.resize(10 + 0x3e + 24, 7);
        std::fs::write(&path, bytes).unwrap();
        let mut plan = test_plan();
        plan.source = Source::frames(path, FrameSource::default());
        plan.sensor = Sensor { height: 2, width: 3 };
        (folder, plan)
    }

    fn run(plan: &Plan, resume_tick: u64, port: &mut KeptPort) -> Result<(), StageError> {
        let (_keep, stop) = bounded(0);
        FrameIngest::new(plan, resume_tick, 3, stop).unwrap().run(port)
    }

    #[test]
    fn every_frame_is_a_tick_of_one_chunk() {
        let (_folder, plan) = plan();
        assert_eq!(probe(&plan.source).unwrap(), plan.sensor);
        let mut port = KeptPort::default();
        run(&plan, 0, &mut port).unwrap();
        assert_eq!(port.progress, (1000, 4, 0, 0));
        let kinds: Vec<u32> = port.ticks().map(|(kind, _)| kind as u32).collect();
        assert_eq!(kinds, [0, 1, 0, 1, 0, 1, 0, 1, 2]);
        let (_, second) = port.ticks().nth(2).unwrap();
        assert_eq!(
            (second.tick, second.start_us, second.end_us, second.epoch),
            (1, 1000, 2000, 3)
        );
        let chunks: Vec<_> = port
            .chunks()
            .map(|(c, events)| (c.tick, c.closes, c.base_us, events.len()))
            .collect();
        assert_eq!(
            chunks,
            [(0, 1, 0, 0), (1, 1, 1000, 0), (2, 1, 2000, 0), (3, 1, 3000, 0)]
        );
    }

    #[test]
    fn it_resumes_at_a_tick_with_the_same_ones() {
        let (_folder, plan) = plan();
        let (mut whole, mut resumed) = (KeptPort::default(), KeptPort::default());
        run(&plan, 0, &mut whole).unwrap();
        run(&plan, 2, &mut resumed).unwrap();
        assert_eq!(whole.sent[6..], resumed.sent);
        let mut beyond = KeptPort::default();
        run(&plan, 9, &mut beyond).unwrap();
        assert!(matches!(beyond.sent[..], [Sent::Tick(..)]));
    }

    #[test]
    fn paced_frames_leave_when_they_are_due() {
        let (_folder, mut plan) = plan();
        plan.source.pace = plan::Pace::Factor(0.5);
        let mut port = KeptPort::default();
        run(&plan, 0, &mut port).unwrap();
        let chunk_ns: Vec<u64> = port
            .sent
            .iter()
            .zip(&port.sent_ns)
            .filter_map(|(sent, ns)| matches!(sent, Sent::Chunk(..)).then_some(*ns))
            .collect();
        assert_eq!(chunk_ns, [0, 2_000_000, 4_000_000, 6_000_000]);
    }

    #[test]
    fn a_frame_of_another_size_ends_the_stream_at_its_tick() {
        let (_folder, mut plan) = plan();
        plan.sensor.width = 4;
        let mut port = KeptPort::default();
        let error = run(&plan, 0, &mut port).unwrap_err().to_string();
        assert!(error.contains("2×3"), "{error}");
        assert_eq!(port.tick_numbers(), [(TickKind::End, 0)]);
    }

    #[test]
    fn a_request_to_stop_ends_it_between_ticks() {
        let (_folder, plan) = plan();
        let (keep, stop) = bounded(0);
        let mut port = KeptPort {
            stop_after: Some((4, keep)),
            ..KeptPort::default()
        };
        FrameIngest::new(&plan, 0, 1, stop)
            .unwrap()
            .run(&mut port)
            .unwrap();
        assert_eq!(port.tick_numbers().last(), Some(&(TickKind::End, 2)));
    }
}
