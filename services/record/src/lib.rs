//! The recorder: writes the rows of a run as a traverse.
//!
//! It is a [`Sink`] like the fuser, on the same [`Ledger`]: a tick is recorded when every enabled member has ended it
//! with a row, a reason, or a tombstone, in the order of ticks, each once. Members that were disabled at a tick, or had
//! no row, are absent in it. It gives no answers.

use evpr_core::ledger::{Arrival, Ledger, Settled};
use evpr_core::message::{DescriptorHeader, Matches, ServiceState, TickHeader};
use evpr_core::stage::{Outlet, Sink, StageError};
use evpr_core::{End, Plan, Reason};
use evpr_store::{NewTraverse, StoreError, TickRecord, TraverseWriter, partial_path};

#[cfg(test)]
mod tests;

/// Why nothing can be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The plan has no recorder.
    #[error("the plan names no traverse to record; start the run with `--record DIR`")]
    NoPath,
    /// The traverse cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Records a run. See the module.
///
/// Memory: the rows of the ticks under way, in vectors that are used again.
#[derive(Debug)]
pub struct Recorder {
    ledger: Ledger<Vec<f32>>,
    /// None once the recording is closed or broken.
    writer: Option<TraverseWriter>,
    /// Names of the members, for messages.
    members: Vec<String>,
    /// Lengths of their rows.
    dims: Vec<usize>,
    /// Rows not in use, at most [`POOLED_TICKS`] ticks of them.
    pool: Vec<Vec<f32>>,
}

/// As many ticks as are under way in the ordinary course: one that is being settled and one that comes in.
const POOLED_TICKS: usize = 2;

impl Recorder {
    /// Starts recording the traverse that the plan names, or with `resume` goes on with what was recorded of it before
    /// this process's forerunner died. Without such a beginning it starts anew.
    ///
    /// # Errors
    /// [`RecordError::NoPath`] when the plan has no recorder; [`RecordError::Store`] with what
    /// [`TraverseWriter::create`] or [`TraverseWriter::resume`] says.
    pub fn new(plan: &Plan, resume: bool) -> Result<Self, RecordError> {
        let path = plan.record.clone().ok_or(RecordError::NoPath)?;
        let header = NewTraverse::from_plan(plan);
        let dims = header.members.iter().map(|m| m.dim).collect();
        let members = header.members.iter().map(|m| m.name.clone()).collect();
        let writer = if resume && partial_path(&path)?.exists() {
            TraverseWriter::resume(&path, header)?
        } else {
            TraverseWriter::create(&path, header)?
        };
        Ok(Self {
            ledger: Ledger::new(plan, writer.next_tick()),
            writer: Some(writer),
            members,
            dims,
            pool: Vec::new(),
        })
    }

    /// What a message says of its member's tick.
    fn read(&mut self, header: &DescriptorHeader, row: &[f32]) -> Result<End<Vec<f32>>, String> {
        if header.reason != 0 {
            return match Reason::from_code(header.reason) {
                Some(reason) => Ok(End::None(reason)),
                None => Err(format!("reason {} is not known", header.reason)),
            };
        }
        let expected = self.dims.get(header.member as usize).copied().unwrap_or(0);
        if row.len() != expected {
            let found = row.len();
            return Err(format!("the row has {found} numbers, it must have {expected}"));
        }
        if row.iter().any(|v| !v.is_finite()) {
            return Err("the row has numbers that are not finite".to_owned());
        }
        let mut kept = self.pool.pop().unwrap_or_default();
        kept.clear();
        kept.extend_from_slice(row);
        Ok(End::Row(kept))
    }

    /// Writes a tick and takes its rows back.
    fn record(&mut self, settled: Settled<Vec<f32>>) -> Result<(), StageError> {
        let tick = TickRecord {
            tick: settled.info.tick,
            start_us: settled.info.start_us,
            end_us: settled.info.end_us,
            position: settled.info.position,
        };
        let Some(writer) = self.writer.as_mut() else {
            return Ok(());
        };
        let rows: Vec<Option<&[f32]>> = settled
            .ends
            .iter()
            .map(|end| match end {
                Some(End::Row(arrived)) => Some(arrived.value.as_slice()),
                _ => None,
            })
            .collect();
        if let Err(error) = writer.append(&tick, &rows) {
            self.writer = None;
            return Err(StageError::Fatal(error.to_string()));
        }
        let room = (POOLED_TICKS * self.dims.len()).saturating_sub(self.pool.len());
        let used = settled.ends.into_iter().filter_map(|end| match end {
            Some(End::Row(arrived)) => Some(arrived.value),
            _ => None,
        });
        self.pool.extend(used.take(room));
        Ok(())
    }
}

impl Sink for Recorder {
    fn tick(&mut self, header: &TickHeader, weights: &[f64]) -> Result<(), StageError> {
        match self.ledger.tick(header, weights) {
            Arrival::Refused => Err(StageError::Skip(format!(
                "tick {} of kind {} is beyond reason: {} is due",
                header.tick,
                header.kind,
                self.ledger.next_tick()
            ))),
            Arrival::Accepted | Arrival::Duplicate | Arrival::Late => Ok(()),
        }
    }

    /// A row of the wrong length or with numbers that are not finite is skipped, and its member sits the tick out.
    fn descriptor(&mut self, header: &DescriptorHeader, row: &[f32]) -> Result<(), StageError> {
        let end = if self.ledger.wants(header) {
            self.read(header, row)
        } else {
            // It is not kept, but the ledger learns that its sender lives.
            Ok(End::None(Reason::Late))
        };
        let (end, problem) = match end {
            Ok(end) => (end, None),
            Err(problem) => (End::None(Reason::Failed), Some(problem)),
        };
        let problem = match self.ledger.arrive(header, end) {
            Arrival::Refused => Some("there is no such member, or its tick is beyond reason".to_owned()),
            Arrival::Accepted | Arrival::Duplicate | Arrival::Late => problem,
        };
        let Some(problem) = problem else {
            return Ok(());
        };
        let (tick, member) = (header.tick, header.member);
        let name = self.members.get(member as usize);
        let name = name.map_or_else(|| member.to_string(), Clone::clone);
        Err(StageError::Skip(format!("member {name}, tick {tick}: {problem}")))
    }

    fn lifecycle(&mut self, services: &[ServiceState]) {
        self.ledger.lifecycle(services);
    }

    fn settle(&mut self, now_ns: u64, _outlet: &mut dyn Outlet<Matches>) -> Result<(), StageError> {
        while let Some(settled) = self.ledger.settle(now_ns) {
            self.record(settled)?;
        }
        Ok(())
    }

    fn deadline_ns(&self) -> Option<u64> {
        self.ledger.deadline_ns()
    }

    fn next_tick(&self) -> u64 {
        self.ledger.next_tick()
    }

    fn finished(&self) -> bool {
        self.ledger.finished()
    }

    /// Gives the recording its final name. One that broke off has said so, and stays as it is. One without a single
    /// tick is removed, which is no failure of the recorder's: who started the run knows why it was so short.
    fn close(&mut self) -> Result<(), StageError> {
        let fatal = |e: StoreError| StageError::Fatal(e.to_string());
        let Some(writer) = self.writer.take() else {
            return Ok(());
        };
        if writer.next_tick() == 0 {
            return writer.discard().map_err(fatal);
        }
        writer.close().map(|_| ()).map_err(fatal)
    }
}
