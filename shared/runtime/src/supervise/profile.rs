//! What the supervisor remembers in order to say how the last ten seconds were: a state per second.

use super::policy::Life;
use super::process::Process;
use crate::control::MemberState;
use crate::now_ns;
use crate::profile::{LatencyStatus, MemberStatus, ServiceStatus, Times};
use evpr_core::message::{
    Doing, Histogram, MatchHeader, MemberCost, ServiceHealth, ServicePhase, StatsHeader,
};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

const EVERY: Duration = Duration::from_secs(1);
const RECENT: Duration = Duration::from_secs(10);
/// Clock ticks per second in `/proc/<pid>/stat`: 100 on every Linux that evpr is built for.
const CLOCK_TICKS_PER_S: f64 = 100.0;

/// Processor time of a process, s, and its resident memory, bytes; 0 where the system does not say.
fn usage(pid: u32) -> (f64, u64) {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // The name in parentheses may hold anything; user and system time are the 12th and 13th words after it.
    let words = stat.rsplit_once(") ").map_or("", |(_, rest)| rest).split(' ');
    let ticks: f64 = words.skip(11).take(2).filter_map(|w| w.parse::<f64>().ok()).sum();
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let rss = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    let kib = rss.and_then(|l| l.split_whitespace().next()?.parse::<u64>().ok());
    (ticks / CLOCK_TICKS_PER_S, kib.unwrap_or(0) * 1024)
}

#[derive(Debug, Clone)]
struct Sample<T> {
    at: Instant,
    value: T,
}

/// States of the last ten seconds, oldest first.
#[derive(Debug)]
struct History<T>(VecDeque<Sample<T>>);

impl<T> Default for History<T> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<T> History<T> {
    fn push(&mut self, at: Instant, value: T) {
        while self.0.get(1).is_some_and(|s| at.duration_since(s.at) >= RECENT) {
            self.0.pop_front();
        }
        self.0.push_back(Sample { at, value });
    }

    fn oldest(&self) -> Option<&Sample<T>> {
        self.0.front()
    }
}

#[derive(Debug, Clone, Default)]
struct Answers {
    /// Reconstruct, extract, fuse, total.
    latency: [Histogram; 4],
    newest_ns: u64,
    matches: u64,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Profile {
    pub(super) started: Instant,
    next: Instant,
    /// Per process: its stats and its processor time.
    services: Vec<History<(StatsHeader, f64)>>,
    members: History<Vec<MemberCost>>,
    answers: Answers,
    answered: History<[Histogram; 4]>,
}

impl Profile {
    pub(super) fn new(services: usize) -> Self {
        let now = Instant::now();
        Self {
            started: now,
            next: now,
            services: std::iter::repeat_with(History::default).take(services).collect(),
            members: History::default(),
            answers: Answers::default(),
            answered: History::default(),
        }
    }

    /// Takes in the latencies of an answer.
    pub(super) fn answered(&mut self, header: &MatchHeader) {
        self.answers.matches += u64::from(header.reference >= 0);
        self.answers.newest_ns = header.total_ns;
        if header.total_ns == 0 {
            return;
        }
        let times = [
            header.reconstruct_ns,
            header.extract_ns,
            header.fuse_ns,
            header.total_ns,
        ];
        for (histogram, ns) in self.answers.latency.iter_mut().zip(times) {
            histogram.record(ns);
        }
    }

    /// Ticks answered with a place.
    pub(super) fn matches(&self) -> u64 {
        self.answers.matches
    }

    /// Remembers how things are, if it is time.
    pub(super) fn remember(&mut self, now: Instant, processes: &[Process]) {
        if now < self.next {
            return;
        }
        self.next = now + EVERY;
        for (history, process) in self.services.iter_mut().zip(processes) {
            let cpu_s = process.child.as_ref().map_or(0.0, |child| usage(child.id()).0);
            history.push(now, (process.stats, cpu_s));
        }
        self.members.push(now, costs(processes).to_vec());
        self.answered.push(now, self.answers.latency);
    }

    pub(super) fn latency(&self) -> LatencyStatus {
        let before = self.answered.oldest().map(|s| s.value).unwrap_or_default();
        let times = |i: usize| Times::of(&self.answers.latency[i], &before[i]);
        LatencyStatus {
            reconstruct: times(0),
            extract: times(1),
            fuse: times(2),
            total: times(3),
            newest_ms: self.answers.newest_ns as f64 / 1e6,
        }
    }

    pub(super) fn members(&self, states: Vec<MemberState>, processes: &[Process]) -> Vec<MemberStatus> {
        let now = costs(processes);
        let before = self.members.oldest().map_or(&[][..], |s| s.value.as_slice());
        let status = |(member, state): (usize, MemberState)| {
            let total = now.get(member).copied().unwrap_or_default();
            let old: MemberCost = before.get(member).copied().unwrap_or_default();
            // A sink that was started again counts from 0.
            let old = if old.rows > total.rows {
                MemberCost::default()
            } else {
                old
            };
            let rows = total.rows - old.rows;
            let each_ms = |ns: u64| {
                if rows == 0 {
                    0.0
                } else {
                    ns as f64 / rows as f64 / 1e6
                }
            };
            MemberStatus {
                state,
                rows: total.rows,
                reconstruct_ms: each_ms(total.reconstruct_ns.saturating_sub(old.reconstruct_ns)),
                extract_ms: each_ms(total.extract_ns.saturating_sub(old.extract_ns)),
            }
        };
        states.into_iter().enumerate().map(status).collect()
    }

    pub(super) fn services(&self, processes: &[Process], lives: &[Life]) -> Vec<ServiceStatus> {
        let now = Instant::now();
        let each = processes.iter().zip(lives).zip(&self.services);
        each.map(|((process, life), history)| service(process, life, history, now))
            .collect()
    }
}

/// What members have cost, as the first sink that knows says.
fn costs(processes: &[Process]) -> &[MemberCost] {
    let mut told = processes.iter().map(|p| p.costs.as_slice());
    told.find(|costs| !costs.is_empty()).unwrap_or(&[])
}

fn service(
    process: &Process,
    life: &Life,
    history: &History<(StatsHeader, f64)>,
    now: Instant,
) -> ServiceStatus {
    let stats = &process.stats;
    let same_life = |s: &&Sample<(StatsHeader, f64)>| s.value.0.stamp.incarnation == stats.stamp.incarnation;
    let oldest = history.oldest().filter(same_life);
    let (before, cpu_before, since) = match oldest {
        Some(s) => (s.value.0, s.value.1, now.duration_since(s.at).as_secs_f64()),
        None => (StatsHeader::default(), 0.0, 0.0),
    };
    let per_s = |value: f64| if since > 0.0 { value / since } else { 0.0 };
    let rate = |now: u64, before: u64| per_s(now.saturating_sub(before) as f64);
    let pid = process.child.as_ref().map(std::process::Child::id);
    let (cpu_s, rss_bytes) = pid.map(usage).unwrap_or_default();
    let heard = stats.stamp.incarnation == life.incarnation && pid.is_some();
    let state = match life.health {
        ServiceHealth::Down => "down",
        ServiceHealth::Restarting if !life.in_phase(ServicePhase::Ready) => "restarting",
        _ if life.is_done() => "done",
        _ if life.in_phase(ServicePhase::Ready) => "ready",
        _ => "starting",
    };
    let doing = Doing::from_code(stats.doing).filter(|_| heard);
    ServiceStatus {
        name: life.name.clone(),
        kind: life.kind.name().to_owned(),
        pid,
        state: state.to_owned(),
        doing: doing.map_or("", Doing::name).to_owned(),
        doing_ms: doing.map_or(0.0, |_| now_ns().saturating_sub(stats.progress_ns) as f64 / 1e6),
        heard_ms: now_ns().saturating_sub(life.heard_ns) as f64 / 1e6,
        restarts: life.restarts,
        received: stats.received,
        emitted: stats.emitted,
        skipped: stats.skipped,
        dropped: stats.dropped,
        refused: stats.refused,
        events: stats.events,
        received_per_s: rate(stats.received, before.received),
        emitted_per_s: rate(stats.emitted, before.emitted),
        events_per_s: rate(stats.events, before.events),
        cpu_s,
        cpu_percent: 100.0 * per_s((cpu_s - cpu_before).max(0.0)),
        rss_bytes,
        waiting: Times::of(&stats.waiting, &before.waiting),
        processing: Times::of(&stats.processing, &before.processing),
        sending: Times::of(&stats.sending, &before.sending),
        age: Times::of(&stats.age, &before.age),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_ten_seconds_are_told_from_what_came_before() {
        let mut history = History::default();
        let start = Instant::now();
        (0..30).for_each(|s| history.push(start + Duration::from_secs(s), s));
        assert_eq!(history.oldest().unwrap().value, 19, "a state ten seconds back");
        assert!(history.0.len() <= 12);
    }

    #[test]
    fn this_process_uses_memory() {
        let (cpu_s, rss) = usage(std::process::id());
        assert!(cpu_s >= 0.0 && rss > 1 << 20, "{cpu_s} {rss}");
        assert_eq!(usage(u32::MAX), (0.0, 0));
    }
}
