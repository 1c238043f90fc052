//! The stage around a kind of extractor: headers, members and reasons.

use crate::kind::{FrameView, Kind};
use crate::network::{self, NetworkExtractor};
use crate::registry;
use evpr_core::Reason;
use evpr_core::member::MAX_EXTRACTORS;
use evpr_core::message::{ChannelOrder, DescriptorHeader, Descriptors, FrameHeader, Frames};
use evpr_core::plan::{Plan, Sensor};
use evpr_core::stage::{Outlet, Stage, StageError};
use evpr_onnx::OnnxError;

/// Why an extractor cannot be made of a plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BuildError {
    /// The plan has fewer extractors.
    #[error("the plan has {count} extractors, none with index {index}; start as many processes as it has")]
    NoSuchExtractor {
        /// The index asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// No kind of this name.
    #[error("extractor \"{id}\": there is no kind \"{kind}\"; known: {known}")]
    UnknownKind {
        /// The extractor's name in the plan.
        id: String,
        /// The kind it names.
        kind: String,
        /// The kinds there are.
        known: String,
    },
    /// A parameter is missing, out of range or does not go with another.
    #[error("extractor \"{id}\": {problem}")]
    Params {
        /// The extractor's name in the plan.
        id: String,
        /// What is wrong and what to write.
        problem: String,
    },
    /// Its network cannot be used.
    #[error("extractor \"{id}\": {problem}")]
    Network {
        /// The extractor's name in the plan.
        id: String,
        /// What is wrong with it and what to do.
        problem: OnnxError,
    },
    /// The plan says something that this kind cannot do.
    #[error("extractor \"{id}\": {problem}; make the plan anew from its configuration")]
    Plan {
        /// The extractor's name in the plan.
        id: String,
        /// What is wrong.
        problem: String,
    },
}

/// One extractor of the plan: a [`Stage`] from [`Frames`] to [`Descriptors`].
///
/// For each frame that wants this extractor it emits one descriptor: the row, or no row with the frame's own reason, or
/// no row with [`Reason::Failed`] where the frame's payload is not as its header and the plan say, or the row has a
/// number that is not finite; [`StageError::Skip`] then tells what was wrong. A frame that the plan has no member
/// for is told likewise, and gives nothing.
pub struct Extract {
    id: String,
    extractor: usize,
    sensor: Sensor,
    /// Per reconstruction: channels per pixel that its frames may have; they may be grey instead.
    channels: Vec<usize>,
    /// Per reconstruction and window: the member.
    members: Vec<Vec<Option<u32>>>,
    engine: Engine,
    /// Length of a row.
    dim: usize,
}

/// What makes rows.
enum Engine {
    /// A kind of this crate, and the row that it made last.
    Kind(Box<dyn Kind>, Vec<f32>),
    Network(Box<NetworkExtractor>),
}

impl std::fmt::Debug for Extract {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Extract")
            .field("id", &self.id)
            .field("dim", &self.dim)
            .finish_non_exhaustive()
    }
}

/// Makes the stage of the plan's extractor `extractor`.
///
/// # Errors
/// [`BuildError`] when the plan has no such extractor, names a kind that does not exist, or gives it parameters or sizes
/// it cannot have.
pub fn build(plan: &Plan, extractor: usize) -> Result<Extract, BuildError> {
    let e = plan
        .extractors
        .get(extractor)
        .ok_or(BuildError::NoSuchExtractor {
            index: extractor,
            count: plan.extractors.len(),
        })?;
    let engine = engine(plan, extractor)?;
    let dim = match &engine {
        Engine::Kind(_, row) => row.len(),
        Engine::Network(network) => network.dimension(),
    };
    let problem = if dim != e.dim {
        Some(format!("its rows have {dim} numbers, not {}", e.dim))
    } else if extractor >= MAX_EXTRACTORS {
        Some(format!("it is one of more than {MAX_EXTRACTORS}"))
    } else {
        None
    };
    if let Some(problem) = problem {
        let id = e.id.clone();
        return Err(BuildError::Plan { id, problem });
    }
    let windows = 0..plan.slicing.windows.len();
    let member = |r, w| plan.member_of(r, w, extractor).map(|m| m as u32);
    let members = (0..plan.reconstructions.len())
        .map(|r| windows.clone().map(|w| member(r, w)).collect())
        .collect();
    Ok(Extract {
        id: e.id.clone(),
        extractor,
        sensor: plan.sensor,
        channels: plan.reconstructions.iter().map(|r| r.channels).collect(),
        members,
        engine,
        dim,
    })
}

/// What makes the rows of the plan's extractor `extractor`.
fn engine(plan: &Plan, extractor: usize) -> Result<Engine, BuildError> {
    let e = &plan.extractors[extractor];
    if plan.sensor.pixels() == 0 {
        return Err(BuildError::Plan {
            id: e.id.clone(),
            problem: format!("the sensor is {} pixels", plan.sensor),
        });
    }
    let loaded = NetworkExtractor::load(plan, extractor);
    let loaded = loaded.map_err(|problem| BuildError::Network {
        id: e.id.clone(),
        problem,
    })?;
    if let Some(network) = loaded {
        return Ok(Engine::Network(Box::new(network)));
    }
    let row = registry::find(&e.kind).ok_or_else(|| BuildError::UnknownKind {
        id: e.id.clone(),
        kind: e.kind.clone(),
        known: registry::KINDS.map(|kind| kind.name).join(", "),
    })?;
    let params = |problem| BuildError::Params {
        id: e.id.clone(),
        problem,
    };
    for info in row.kind.params {
        info.check(&e.params).map_err(params)?;
    }
    let dim = (row.kind.dim)(&e.params).map_err(params)?;
    Ok(Engine::Kind((row.make)(plan.sensor, &e.params), vec![0.0; dim]))
}

impl Extract {
    fn skip(&self, header: &FrameHeader, what: &str) -> StageError {
        StageError::Skip(format!(
            "extractor \"{}\": frame of tick {}, reconstruction {}, window {}: {what}",
            self.id, header.tick, header.reconstruction, header.window
        ))
    }

    /// The member of a frame; `None` when the frame does not want this extractor.
    fn member_of(&self, header: &FrameHeader) -> Result<Option<u32>, StageError> {
        let windows = self.members.get(header.reconstruction as usize);
        let Some(member) = windows.and_then(|w| w.get(header.window as usize)) else {
            return Err(self.skip(header, "the plan has no such window; use processes of one plan"));
        };
        if header.extractors >> self.extractor & 1 == 0 {
            return Ok(None);
        }
        match member {
            Some(member) => Ok(Some(*member)),
            None => Err(self.skip(header, "the plan has no such member; use processes of one plan")),
        }
    }

    /// The image of a frame, if it is as the plan says.
    fn view<'p>(&self, header: &FrameHeader, pixels: &'p [u8]) -> Result<FrameView<'p>, StageError> {
        let Sensor { height, width } = self.sensor;
        let order = ChannelOrder::from_code(header.channel_order);
        let planned = self.channels.get(header.reconstruction as usize);
        let Some(channel_order) = order.filter(|o| planned.is_some_and(|p| o.channels() <= *p)) else {
            let what = format!("channel order {} is not the plan's", header.channel_order);
            return Err(self.skip(header, &what));
        };
        if (header.height as usize, header.width as usize) != (height, width) {
            let what = format!(
                "it is {}×{} pixels, the plan's sensor {}",
                header.height, header.width, self.sensor
            );
            return Err(self.skip(header, &what));
        }
        let expected = self.sensor.pixels() * channel_order.channels();
        if pixels.len() != expected {
            let what = format!("it has {} bytes, not {expected}", pixels.len());
            return Err(self.skip(header, &what));
        }
        Ok(FrameView {
            channel_order,
            pixels,
        })
    }

    /// Emits the row of a frame, now or once enough frames wait.
    fn take(
        &mut self,
        header: &FrameHeader,
        member: u32,
        frame: FrameView<'_>,
        outlet: &mut dyn Outlet<Descriptors>,
    ) -> Result<(), StageError> {
        match &mut self.engine {
            Engine::Network(network) => {
                if network.push(*header, member, frame) {
                    return self.run_network(outlet);
                }
                Ok(())
            }
            Engine::Kind(kind, row) => {
                kind.extract(frame, row);
                let bad = row.iter().position(|v| !v.is_finite()).map(|i| (i, row[i]));
                if let Some((i, value)) = bad {
                    self.emit_none(header, member, Reason::Failed, outlet)?;
                    return Err(self.skip(header, &format!("number {i} of its row is {value}")));
                }
                let Engine::Kind(_, row) = &self.engine else {
                    return Ok(());
                };
                outlet.emit(self.header(header, member), row.len(), &mut |out| {
                    out.copy_from_slice(row);
                })
            }
        }
    }

    /// Computes what waits for the network, and emits it.
    fn run_network(&mut self, outlet: &mut dyn Outlet<Descriptors>) -> Result<(), StageError> {
        let Engine::Network(network) = &mut self.engine else {
            return Ok(());
        };
        let (frames, computed) = network.run();
        let mut failed = None;
        for (index, (header, member)) in frames.iter().enumerate() {
            let row = match &computed {
                Ok(descriptors) => {
                    let row = descriptors.get(index);
                    network::length(row).map(|length| (row, length))
                }
                Err(e) => Err(e.to_string()),
            };
            match row {
                Ok((row, length)) => {
                    let mut header = self.header(header, *member);
                    header.together = frames.len() as u32;
                    outlet.emit(header, row.len(), &mut |out| {
                        network::write_unit(row, length, out)
                    })?;
                }
                Err(problem) => {
                    self.emit_none(header, *member, Reason::Failed, outlet)?;
                    failed = Some(self.skip(header, &problem));
                }
            }
        }
        failed.map_or(Ok(()), Err)
    }

    fn header(&self, frame: &FrameHeader, member: u32) -> DescriptorHeader {
        DescriptorHeader {
            tick: frame.tick,
            life: frame.life,
            epoch: frame.epoch,
            member,
            dim: self.dim as u32,
            together: 1,
            reconstruct_service: frame.stamp.service,
            reconstruct_incarnation: frame.stamp.incarnation,
            ..DescriptorHeader::default()
        }
    }

    fn emit_none(
        &self,
        frame: &FrameHeader,
        member: u32,
        reason: Reason,
        outlet: &mut dyn Outlet<Descriptors>,
    ) -> Result<(), StageError> {
        let mut header = self.header(frame, member);
        header.reason = reason.code();
        outlet.emit(header, 0, &mut |_| {})
    }
}

impl Stage for Extract {
    type In = Frames;
    type Out = Descriptors;

    fn process(
        &mut self,
        header: &FrameHeader,
        payload: &[u8],
        outlet: &mut dyn Outlet<Descriptors>,
    ) -> Result<(), StageError> {
        let Some(member) = self.member_of(header)? else {
            return Ok(());
        };
        let frame = match (header.reason, Reason::from_code(header.reason)) {
            (0, _) => self.view(header, payload),
            (_, Some(reason)) => return self.emit_none(header, member, reason, outlet),
            (code, None) => Err(self.skip(header, &format!("there is no reason with code {code}"))),
        };
        match frame {
            Ok(frame) => self.take(header, member, frame, outlet),
            Err(error) => {
                self.emit_none(header, member, Reason::Failed, outlet)?;
                Err(error)
            }
        }
    }

    fn flush(&mut self, outlet: &mut dyn Outlet<Descriptors>) -> Result<(), StageError> {
        match &self.engine {
            Engine::Network(network) if network.is_waiting() => self.run_network(outlet),
            _ => Ok(()),
        }
    }

    fn unload(&mut self) -> bool {
        match &mut self.engine {
            Engine::Network(network) if !network.is_waiting() => network.unload(),
            _ => false,
        }
    }

    fn skip_dropped(
        &mut self,
        header: &FrameHeader,
        outlet: &mut dyn Outlet<Descriptors>,
    ) -> Result<(), StageError> {
        let Some(member) = self.member_of(header)? else {
            return Ok(());
        };
        self.emit_none(header, member, Reason::Dropped, outlet)
    }
}

#[cfg(test)]
mod tests;
