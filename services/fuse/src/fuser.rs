//! The fuser as the end of the graph: rows and ticks in, one answer per tick out.

use crate::engine::{Engine, Input, Verdict};
use crate::history::{Keep, KeptTick};
use crate::{FuseError, History, Map};
use evpr_core::ledger::{Arrival, Arrived, Ledger, Settled};
use evpr_core::member::MAX_MEMBERS;
use evpr_core::message::{
    Candidate, DescriptorHeader, MatchHeader, Matches, ServiceState, TickHeader, TickKind,
};
use evpr_core::stage::{Outlet, Sink, StageError};
use evpr_core::{End, MemberSet, Plan, Reason};
use std::collections::VecDeque;

/// Host monotonic time, ns: so that `fuse_ns` includes the matching itself.
pub type Clock = Box<dyn Fn() -> u64 + Send>;

/// Is shown every settled tick. See [`Fuser::observe`].
pub type Observer = Box<dyn FnMut(FusedTick<'_>) + Send>;

/// A member's row of a settled tick, as an [`Observer`] sees it.
#[derive(Debug, Clone, Copy)]
pub struct FusedMember<'a> {
    /// Index in the plan.
    pub member: usize,
    /// Its weight.
    pub weight: f64,
    /// S, one value per reference; NaN where the map has no row.
    pub similarity: &'a [f64],
    /// S̃; empty where the tick only builds history.
    pub scores: &'a [f64],
}

/// A settled tick, as an [`Observer`] sees it.
#[derive(Debug)]
pub struct FusedTick<'a> {
    /// The tick.
    pub tick: u64,
    /// The members with a row.
    pub members: &'a [FusedMember<'a>],
    /// E, one value per reference; empty where the tick only builds history.
    pub fused: &'a [f64],
    /// Which of them mean something: the places that a member had a row for. As long as `fused`.
    pub eligible: &'a [bool],
}

/// The fuser: compares each row with the map as soon as it comes, and answers each tick when it is settled.
///
/// A row that cannot be used (wrong length, a value that is not finite) ends its member's tick as
/// [`Reason::Failed`], so that nobody waits for it.
pub struct Fuser {
    ledger: Ledger<Vec<f64>>,
    engine: Engine,
    plan_weights: Vec<f64>,
    answer_from: u64,
    clock: Clock,
    /// Where the last ticks are kept, and what was wrong with that.
    history: Option<History>,
    problem: Option<String>,
    /// Ticks that the last incarnation had settled, and whose answers it had not sent.
    unsent: VecDeque<KeptTick>,
    /// Similarity rows to be used again.
    pool: Vec<Vec<f64>>,
    observer: Option<Observer>,
}

impl std::fmt::Debug for Fuser {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Fuser")
            .field("ledger", &self.ledger)
            .field("answer_from", &self.answer_from)
            .finish()
    }
}

impl Fuser {
    /// A fuser whose first tick is `first_tick`. Ticks below `answer_from` only build history and are not
    /// answered: a restarted fuser goes back L − 1 ticks and then goes on as if it had never been away.
    ///
    /// Reads the rows of the map through once: that finds values that are not finite, and spares the first query the
    /// reading from disk.
    ///
    /// # Errors
    /// Map and plan do not fit: see [`FuseError`].
    pub fn new(
        plan: &Plan,
        map: Map,
        first_tick: u64,
        answer_from: u64,
        clock: Clock,
    ) -> Result<Self, FuseError> {
        let mut engine = Engine::new(plan, map)?;
        if first_tick == 0 {
            engine.starts_the_run();
        }
        Ok(Self {
            ledger: Ledger::new(plan, first_tick),
            engine,
            plan_weights: plan.members.iter().map(|m| m.weight).collect(),
            answer_from,
            clock,
            history: None,
            problem: None,
            unsent: VecDeque::new(),
            pool: Vec::new(),
            observer: None,
        })
    }

    /// The same with a file in which the last ticks are kept. What an earlier incarnation has left there is taken up: the
    /// ticks before `answer_from` as history, and answers that it had not sent any more are sent with the first
    /// [`Sink::settle`], without latencies.
    #[must_use]
    pub fn with_history(mut self, plan: &Plan, history: History) -> Self {
        let first = self.answer_from.saturating_sub(history.capacity());
        let oldest = (first..self.answer_from).find(|tick| history.tick(*tick).is_some());
        if let Some(oldest) = oldest {
            for tick in oldest..self.answer_from {
                self.recall(history.tick(tick).as_ref());
            }
        }
        let mut next = self.answer_from;
        while let Some(kept) = history.tick(next) {
            self.unsent.push_back(kept);
            next += 1;
        }
        if next > self.answer_from {
            self.ledger = Ledger::new(plan, next);
        }
        self.history = Some(history);
        self
    }

    /// Takes a tick into the history, as lost where it is not there.
    fn recall(&mut self, kept: Option<&KeptTick>) {
        let Some(kept) = kept else {
            let rows = vec![None; self.plan_weights.len()];
            let input = Input {
                enabled: &MemberSet::default(),
                weights: &self.plan_weights,
                rows: &rows,
                lost: true,
            };
            self.engine.advance(input, false);
            return;
        };
        self.engine.set(&kept.info.fuse);
        let rows: Vec<Option<&[f64]>> = kept.rows.iter().map(Option::as_deref).collect();
        self.engine.advance(kept.input(&rows), false);
        self.engine.resume(&kept.standing);
    }

    /// Answers what the last incarnation had settled and not sent.
    fn send_unsent(&mut self, outlet: &mut dyn Outlet<Matches>) -> Result<(), StageError> {
        while let Some(kept) = self.unsent.pop_front() {
            self.engine.set(&kept.info.fuse);
            let rows: Vec<Option<&[f64]>> = kept.rows.iter().map(Option::as_deref).collect();
            if let Some(verdict) = self.engine.advance(kept.input(&rows), true) {
                let mut ends = [0; MAX_MEMBERS];
                ends.iter_mut().zip(&kept.ends).for_each(|(to, end)| *to = *end);
                let header = self.engine.header(&kept.info, verdict, ends);
                send(&self.engine, header, verdict, outlet)?;
            }
        }
        Ok(())
    }

    /// Keeps a tick that has just been fused.
    fn keep(&mut self, settled: &Settled<Vec<f64>>) {
        let Some(history) = &mut self.history else { return };
        let rows: Vec<Option<&[f64]>> = settled
            .ends
            .iter()
            .map(|end| used(end).map(|row| row.value.as_slice()))
            .collect();
        let ends = end_codes(&settled.ends);
        let keep = Keep {
            info: &settled.info,
            lost: settled.lost,
            ends: &ends,
            rows: &rows,
            standing: &self.engine.standing(),
        };
        let kept = history
            .lengthen(self.engine.length(), settled.info.tick.saturating_sub(1))
            .and_then(|()| history.keep(&keep));
        if let Err(e) = kept {
            self.problem = Some(format!(
                "{}: the history cannot be kept: {e}; should the fuser die, it begins without any",
                history.path().display()
            ));
            self.history = None;
        }
    }

    /// Shows every settled tick to `observer`, once its answer has been sent.
    pub fn observe(&mut self, observer: Observer) {
        self.observer = Some(observer);
    }

    /// What a descriptor comes to: its similarity row, or the reason why there is none.
    fn measure(&mut self, header: &DescriptorHeader, row: &[f32]) -> Result<End<Vec<f64>>, StageError> {
        let member = header.member as usize;
        let about = |problem: String| {
            let name = self.engine.member_name(member);
            StageError::Skip(format!("row of member {name} at tick {}: {problem}", header.tick))
        };
        if header.reason != 0 {
            let reason = Reason::from_code(header.reason);
            return reason
                .map(End::None)
                .ok_or_else(|| about(format!("no such reason: {}", header.reason)));
        }
        let dim = self.engine.dim(member);
        if row.len() != dim {
            return Err(about(format!(
                "it has {} values, the map's rows have {dim}",
                row.len()
            )));
        }
        if let Some(at) = row.iter().position(|v| !v.is_finite()) {
            return Err(about(format!("value {at} is {}, not a finite number", row[at])));
        }
        let mut similarity = self.pool.pop().unwrap_or_default();
        similarity.resize(self.engine.references(), 0.0);
        self.engine
            .similarity(member, row, &mut similarity)
            .map_err(|error| StageError::Fatal(error.to_string()))?;
        Ok(End::Row(similarity))
    }

    /// Fuses one settled tick; `None` where it only builds history.
    fn fuse(&mut self, settled: &Settled<Vec<f64>>, now_ns: u64) -> Option<(MatchHeader, Verdict)> {
        let (info, answer) = (&settled.info, settled.info.tick >= self.answer_from);
        let rows: Vec<Option<&[f64]>> = settled
            .ends
            .iter()
            .map(|end| used(end).map(|row| row.value.as_slice()))
            .collect();
        let input = Input {
            enabled: &info.members,
            weights: &info.weights,
            rows: &rows,
            lost: settled.lost,
        };
        self.engine.set(&info.fuse);
        let verdict = self.engine.advance(input, answer)?;
        let mut header = self.engine.header(info, verdict, end_codes(&settled.ends));
        set_latencies(&mut header, settled, (self.clock)().max(now_ns));
        Some((header, verdict))
    }

    /// Shows a settled tick to whoever observes.
    fn show(&mut self, settled: &Settled<Vec<f64>>, answered: bool) {
        let Some(observer) = &mut self.observer else {
            return;
        };
        let engine = &self.engine;
        let ends = settled.ends.iter().enumerate();
        let members: Vec<FusedMember<'_>> = ends
            .filter_map(|(member, end)| {
                let row = used(end)?;
                Some(FusedMember {
                    member,
                    weight: settled.info.weights[member],
                    similarity: row.value.as_slice(),
                    scores: if answered { engine.scores(member) } else { &[] },
                })
            })
            .collect();
        let (fused, eligible) = if answered {
            (engine.fused(), engine.eligible())
        } else {
            (&[][..], &[][..])
        };
        observer(FusedTick {
            tick: settled.info.tick,
            members: &members,
            fused,
            eligible,
        });
    }

    /// Takes the tick's buffers back.
    fn recycle(&mut self, settled: Settled<Vec<f64>>) {
        let most = 2 * self.plan_weights.len();
        for end in settled.ends.into_iter().flatten() {
            if let (End::Row(row), true) = (end, self.pool.len() < most) {
                self.pool.push(row.value);
            }
        }
    }
}

fn send(
    engine: &Engine,
    header: MatchHeader,
    verdict: Verdict,
    outlet: &mut dyn Outlet<Matches>,
) -> Result<(), StageError> {
    let candidates = engine.candidates(verdict);
    let fill = &mut |payload: &mut [Candidate]| {
        for (to, from) in payload.iter_mut().zip(candidates) {
            *to = *from;
        }
    };
    outlet.emit(header, candidates.len().max(1), fill)
}

fn used<T>(end: &Option<End<Arrived<T>>>) -> Option<&Arrived<T>> {
    match end {
        Some(End::Row(row)) => Some(row),
        _ => None,
    }
}

/// How each member ended, as it travels in [`MatchHeader::ends`].
fn end_codes<T>(ends: &[Option<End<T>>]) -> [u8; MAX_MEMBERS] {
    let mut codes = [0; MAX_MEMBERS];
    for (code, end) in codes.iter_mut().zip(ends) {
        *code = match end {
            None => 0,
            Some(End::Row(_)) => 1,
            Some(End::None(reason)) => *reason as u8,
        };
    }
    codes
}

/// Where the time went, from the closing of the last window to `now_ns`. The stations follow one another, so that
/// the three parts come to the total. With no row all of it is fusing (waiting for rows, that is); a closing that
/// is not known is taken from the rows, and without any the total is 0.
fn set_latencies(header: &mut MatchHeader, settled: &Settled<Vec<f64>>, now_ns: u64) {
    let latest = |station: fn(&Arrived<Vec<f64>>) -> u64| {
        settled
            .ends
            .iter()
            .filter_map(used)
            .map(station)
            .max()
            .unwrap_or(0)
    };
    let closed = match settled.closed_ns {
        0 => latest(|row| row.life.closed_ns),
        known => known,
    };
    let last_frame = latest(|row| row.life.reconstructed_ns).max(closed);
    let last_row = latest(|row| row.life.extracted_ns).max(last_frame);
    if closed > 0 {
        header.reconstruct_ns = last_frame - closed;
        header.total_ns = now_ns.saturating_sub(closed);
    }
    if last_frame > 0 {
        header.extract_ns = last_row - last_frame;
    }
    if last_row > 0 {
        header.fuse_ns = now_ns.saturating_sub(last_row);
    }
}

impl Sink for Fuser {
    fn tick(&mut self, header: &TickHeader, weights: &[f64]) -> Result<(), StageError> {
        let opens = TickKind::from_code(header.kind) == Some(TickKind::Open);
        let sound = weights.len() == self.plan_weights.len() && weights.iter().all(|w| w.is_finite());
        let arrival = if opens && !sound {
            self.ledger.tick(header, &self.plan_weights)
        } else {
            self.ledger.tick(header, weights)
        };
        let problem = if arrival == Arrival::Refused {
            "neither its kind nor its number can be right; it is ignored"
        } else if opens && !sound {
            "its weights are not one finite number per member; the plan's are used"
        } else {
            return Ok(());
        };
        Err(StageError::Skip(format!(
            "message of tick {} (kind {}): {problem}",
            header.tick, header.kind
        )))
    }

    fn descriptor(&mut self, header: &DescriptorHeader, row: &[f32]) -> Result<(), StageError> {
        if !self.ledger.wants(header) {
            // It comes too late or twice, but it still shows that its sender lives.
            return match self.ledger.arrive(header, End::None(Reason::Late)) {
                Arrival::Refused => Err(StageError::Skip(format!(
                    "row of member number {} at tick {}: no such member, or a tick out of reach; it is ignored",
                    header.member, header.tick
                ))),
                _ => Ok(()),
            };
        }
        match self.measure(header, row) {
            Ok(end) => {
                self.ledger.arrive(header, end);
                Ok(())
            }
            Err(error) => {
                self.ledger.arrive(header, End::None(Reason::Failed));
                Err(error)
            }
        }
    }

    fn lifecycle(&mut self, services: &[ServiceState]) {
        self.ledger.lifecycle(services);
    }

    fn settle(&mut self, now_ns: u64, outlet: &mut dyn Outlet<Matches>) -> Result<(), StageError> {
        self.send_unsent(outlet)?;
        while let Some(settled) = self.ledger.settle(now_ns) {
            let fused = self.fuse(&settled, now_ns);
            self.keep(&settled);
            let answered = fused.is_some();
            if let Some((header, verdict)) = fused {
                send(&self.engine, header, verdict, outlet)?;
            }
            self.show(&settled, answered);
            self.recycle(settled);
        }
        match self.problem.take() {
            Some(problem) => Err(StageError::Skip(problem)),
            None => Ok(()),
        }
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

    fn close(&mut self) -> Result<(), StageError> {
        Ok(())
    }
}
