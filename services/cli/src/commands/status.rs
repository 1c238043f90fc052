//! `evpr status`: a running instance at one moment.

use super::member::state as member_state;
use crate::args::InstanceArgs;
use crate::failure::Failure;
use crate::output::say;
use evpr_runtime::{ControlRequest, RunFolder, ServiceStatus, Status, Times};
use std::process::ExitCode;

/// Asks an instance how it is.
pub(crate) fn ask(name: &str) -> Result<Status, Failure> {
    let reply = evpr_runtime::request(&RunFolder::of_instance(name), &ControlRequest::Status)?;
    match (reply.error, reply.status) {
        (None, Some(status)) => Ok(*status),
        (Some(error), _) => Err(Failure::new(error)),
        (None, None) => Err(Failure::new(format!(
            "the instance \"{name}\" is of another version and does not say how it is"
        ))),
    }
}

/// `evpr status`.
pub(crate) fn status(args: &InstanceArgs) -> Result<ExitCode, Failure> {
    let status = ask(&args.name)?;
    if args.json {
        say!("{}", serde_json::to_string(&status)?);
    } else {
        print(&status);
    }
    Ok(ExitCode::SUCCESS)
}

/// A time in the unit that suits it, 7 characters wide at most.
pub(crate) fn time(us: f64) -> String {
    match us {
        us if us <= 0.0 => "-".to_owned(),
        us if us < 1e3 => format!("{us:.0}µs"),
        us if us < 1e5 => format!("{:.1}ms", us / 1e3),
        us if us < 1e6 => format!("{:.0}ms", us / 1e3),
        us => format!("{:.1}s", us / 1e6),
    }
}

/// A count, 6 characters wide at most.
pub(crate) fn count(n: f64) -> String {
    match n {
        n if n < 1e5 => format!("{n:.0}"),
        n if n < 1e7 => format!("{:.0}k", n / 1e3),
        n if n < 1e10 => format!("{:.0}M", n / 1e6),
        n => format!("{:.0}G", n / 1e9),
    }
}

/// What a process is doing, in a word.
pub(crate) fn doing(service: &ServiceStatus) -> String {
    match service.state.as_str() {
        "ready" | "starting" if !service.doing.is_empty() && service.doing_ms >= 1e3 => {
            format!("{} {}", service.doing, time(service.doing_ms * 1e3))
        }
        "ready" if !service.doing.is_empty() => service.doing.clone(),
        state => state.to_owned(),
    }
}

type Part = (&'static str, fn(&ServiceStatus) -> &Times);

const PARTS: [Part; 4] = [
    ("waiting", |s| &s.waiting),
    ("processing", |s| &s.processing),
    ("sending", |s| &s.sending),
    ("age", |s| &s.age),
];

fn print(status: &Status) {
    say!(
        "{}: {}, {}, {:.0} s, tick {}, {} answers, {} of them with a place{}",
        status.name,
        status.state,
        status.delivery,
        status.uptime_s,
        status.tick.map_or("-".to_owned(), |t| t.to_string()),
        status.answers,
        status.matches,
        if status.progress_permille > 0 {
            format!(", {:.1} % read", status.progress_permille as f64 / 10.0)
        } else {
            String::new()
        }
    );
    let width = status
        .services
        .iter()
        .map(|s| s.name.len())
        .max()
        .unwrap_or(7)
        .max(7);
    say!();
    say!(
        "{:<width$}  {:<14} {:>7} {:>8} {:>8} {:>8} {:>8} {:>8} {:>6} {:>7} {:>8}",
        "process",
        "doing",
        "pid",
        "received",
        "emitted",
        "skipped",
        "dropped",
        "restarts",
        "cpu %",
        "cpu s",
        "MiB"
    );
    for s in &status.services {
        say!(
            "{:<width$}  {:<14} {:>7} {:>8} {:>8} {:>8} {:>8} {:>8} {:>6.1} {:>7.1} {:>8.1}",
            s.name,
            doing(s),
            s.pid.map_or("-".to_owned(), |pid| pid.to_string()),
            count(s.received as f64),
            count(s.emitted as f64),
            count(s.skipped as f64),
            count(s.dropped as f64),
            s.restarts,
            s.cpu_percent,
            s.cpu_s,
            s.rss_bytes as f64 / f64::from(1 << 20)
        );
    }
    times_head(width, "process");
    for s in &status.services {
        for (name, part) in PARTS {
            times(width, &s.name, name, part(s));
        }
    }
    let l = &status.latency;
    if l.total.whole.count > 0 {
        times_head(width, "answer");
        let parts = [
            ("reconstruct", &l.reconstruct),
            ("extract", &l.extract),
            ("fuse", &l.fuse),
            ("total", &l.total),
        ];
        for (name, part) in parts {
            times(width, "answer", name, part);
        }
    }
    say!();
    let width = status
        .members
        .iter()
        .map(|m| m.state.name.len())
        .max()
        .unwrap_or(6);
    say!(
        "{:<width$}  {:<8} {:>7} {:>8} {:>15} {:>11} {:>7}",
        "member",
        "state",
        "weight",
        "rows",
        "reconstruct ms",
        "extract ms",
        "ms"
    );
    for m in &status.members {
        say!(
            "{:<width$}  {:<8} {:>7} {:>8} {:>15.3} {:>11.3} {:>7.3}",
            m.state.name,
            member_state(&m.state),
            m.state.weight,
            m.rows,
            m.reconstruct_ms,
            m.extract_ms,
            m.cost_ms()
        );
    }
    let f = &status.fuse;
    say!();
    say!(
        "fuse: length {}, rule {}, deadline {} ms, least confidence {}",
        f.length,
        f.rule,
        f.deadline_ms,
        f.min_confidence
    );
    if let Some(g) = &status.governor {
        let p95 = g.p95_ms.map_or("-".to_owned(), |ms| format!("{ms:.1}"));
        let shed = if g.shed.is_empty() {
            "nobody".to_owned()
        } else {
            g.shed.join(" ")
        };
        say!("governor: p95 {p95} ms of {} ms; shed: {shed}", g.budget_ms);
    }
    let refused = status.services.iter().map(|s| (s.name.as_str(), s.refused));
    for (name, count) in refused.chain([("the supervisor", status.refused)]) {
        if count > 0 {
            say!("refused: {count} messages that came to {name}, which nobody of this run can have sent");
        }
    }
    for c in &status.changes {
        let when = c
            .from_tick
            .map_or("the next tick that opens".to_owned(), |t| format!("tick {t}"));
        say!("change: from {when} on, by {}: {}", c.who, c.what);
    }
}

fn times_head(width: usize, what: &str) {
    say!();
    say!(
        "{what:<width$}  {:<11} {:>44}   {:>44}",
        "time",
        "last 10 s: p50     p90     p99   p99.9     max",
        "whole run: p50     p90     p99   p99.9     max"
    );
}

fn times(width: usize, of: &str, name: &str, times: &Times) {
    if times.whole.count == 0 {
        return;
    }
    let row = |q: &evpr_runtime::Quantiles| {
        let all = [q.p50_us, q.p90_us, q.p99_us, q.p999_us, q.max_us];
        all.map(|us| format!("{:>8}", time(us))).concat()
    };
    say!(
        "{of:<width$}  {name:<11} {:>46}   {:>44}",
        row(&times.last_10s),
        row(&times.whole)
    );
}
