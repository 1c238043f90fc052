//! Prometheus metrics of a run, over HTTP: a listener on a thread of its own that asks the instance like any other
//! client. Text format 0.0.4 (prometheus.io/docs/instrumenting/exposition_formats).

use crate::commands::ask_status;
use crate::failure::Failure;
use evpr_runtime::{Status, Times};
use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Who does not ask, or read, within this time is sent away.
const PATIENCE: Duration = Duration::from_secs(1);
const MAX_REQUEST_BYTES: usize = 8 << 10;

/// Serves until it is dropped.
pub(crate) struct MetricsServer {
    address: SocketAddr,
    closing: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl MetricsServer {
    /// Listens at this address for the instance of this name.
    pub(crate) fn start(address: SocketAddr, instance: &str) -> Result<Self, Failure> {
        let listener = TcpListener::bind(address).map_err(|e| {
            Failure::new(format!(
                "cannot listen for metrics at {address}: {e}; give --metrics another address or port"
            ))
        })?;
        let address = listener.local_addr()?;
        let closing = Arc::new(AtomicBool::new(false));
        let (closed, instance) = (closing.clone(), instance.to_owned());
        let thread = std::thread::Builder::new()
            .name("metrics".to_owned())
            .spawn(move || {
                for stream in listener.incoming() {
                    if closed.load(Ordering::Acquire) {
                        return;
                    }
                    if let Ok(stream) = stream {
                        // A client that hangs up early is its own affair.
                        let _ = serve(stream, &instance);
                    }
                }
            })?;
        Ok(Self {
            address,
            closing,
            thread: Some(thread),
        })
    }

    /// Where it listens.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for MetricsServer {
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Release);
        // The accept loop looks at the flag when somebody knocks.
        let knocked = TcpStream::connect_timeout(&self.address, PATIENCE).is_ok();
        if let (true, Some(thread)) = (knocked, self.thread.take()) {
            let _ = thread.join();
        }
    }
}

fn serve(mut stream: TcpStream, instance: &str) -> std::io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let until = Instant::now() + PATIENCE;
    let mut request = Vec::new();
    let mut buffer = [0; 1024];
    while !request.windows(4).any(|w| w == b"\r\n\r\n") {
        let n = stream.read(&mut buffer)?;
        request.extend_from_slice(&buffer[..n]);
        if n == 0 || request.len() > MAX_REQUEST_BYTES || Instant::now() > until {
            return Ok(());
        }
    }
    let line =
        String::from_utf8_lossy(request.split(|b| *b == b'\r').next().unwrap_or_default()).into_owned();
    let mut words = line.split(' ');
    let (code, body) = match (words.next(), words.next()) {
        (Some("GET"), Some("/metrics")) => match ask_status(instance) {
            Ok(status) => ("200 OK", render(&status)),
            Err(_) => (
                "503 Service Unavailable",
                "the instance does not answer now\n".to_owned(),
            ),
        },
        (Some("GET"), _) => ("404 Not Found", "metrics are at /metrics\n".to_owned()),
        _ => ("405 Method Not Allowed", "only GET is understood\n".to_owned()),
    };
    let head = format!(
        "HTTP/1.1 {code}\r\nContent-Type: text/plain; version=0.0.4; charset=utf-8\r\nContent-Length: {}\r\n\
         Connection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body.as_bytes())
}

/// A label's value, quoted.
fn quoted(value: &str) -> String {
    let escaped = value
        .replace('\\', "\\\\")
        .replace('"', "\\\"")
        .replace('\n', "\\n");
    format!("\"{escaped}\"")
}

/// The text of `/metrics`.
fn render(status: &Status) -> String {
    let mut text = String::new();
    let mut family = |name: &str, kind: &str, help: &str, lines: Vec<(String, f64)>| {
        let _ = writeln!(text, "# HELP evpr_{name} {help}\n# TYPE evpr_{name} {kind}");
        for (labels, value) in lines {
            let _ = writeln!(text, "evpr_{name}{labels} {value}");
        }
    };
    let process =
        |s: &evpr_runtime::ServiceStatus, more: &str| format!("{{process={}{more}}}", quoted(&s.name));
    let messages = status.services.iter().flat_map(|s| {
        let counts = [
            ("received", s.received),
            ("emitted", s.emitted),
            ("skipped", s.skipped),
            ("dropped", s.dropped),
            ("refused", s.refused),
        ];
        counts.map(|(what, n)| (process(s, &format!(",what=\"{what}\"")), n as f64))
    });
    family(
        "messages_total",
        "counter",
        "Messages of a process since its last start.",
        messages.collect(),
    );
    let each = |value: fn(&evpr_runtime::ServiceStatus) -> f64| -> Vec<_> {
        status
            .services
            .iter()
            .map(|s| (process(s, ""), value(s)))
            .collect()
    };
    family(
        "events_total",
        "counter",
        "Events sent (ingest) or counted (reconstructions).",
        each(|s| s.events as f64),
    );
    family(
        "restarts_total",
        "counter",
        "Starts after deaths.",
        each(|s| s.restarts as f64),
    );
    family(
        "cpu_seconds_total",
        "counter",
        "Processor time since the last start.",
        each(|s| s.cpu_s),
    );
    family(
        "resident_bytes",
        "gauge",
        "Resident memory, shared memory included.",
        each(|s| s.rss_bytes as f64),
    );
    family(
        "up",
        "gauge",
        "1 while the process is ready.",
        each(|s| f64::from(s.state == "ready")),
    );
    let uptime = vec![(String::new(), status.uptime_s)];
    family("uptime_seconds", "gauge", "Since the start of the run.", uptime);
    family(
        "answers_total",
        "counter",
        "Ticks answered.",
        vec![(String::new(), status.answers as f64)],
    );
    family(
        "matches_total",
        "counter",
        "Ticks answered with a place.",
        vec![(String::new(), status.matches as f64)],
    );
    let member = |value: fn(&evpr_runtime::MemberStatus) -> f64| -> Vec<_> {
        let line =
            |m: &evpr_runtime::MemberStatus| (format!("{{member={}}}", quoted(&m.state.name)), value(m));
        status.members.iter().map(line).collect()
    };
    family(
        "member_enabled",
        "gauge",
        "1 while the member is enabled.",
        member(|m| f64::from(m.state.enabled)),
    );
    family(
        "member_weight",
        "gauge",
        "Its weight.",
        member(|m| m.state.weight),
    );
    family(
        "member_rows_total",
        "counter",
        "Rows that came of it.",
        member(|m| m.rows as f64),
    );
    let cost = "What a row of the last 10 s cost: its reconstruction's window and its extraction.";
    family(
        "member_cost_seconds",
        "gauge",
        cost,
        member(|m| m.cost_ms() / 1e3),
    );
    let mut summary = |name: &str, help: &str, all: Vec<(String, &Times)>| {
        let name = format!("evpr_{name}_seconds");
        let _ = writeln!(
            text,
            "# HELP {name} {help} Quantiles over the last 10 s.\n# TYPE {name} summary"
        );
        for (label, times) in all {
            let q = &times.last_10s;
            for (quantile, us) in [
                ("0.5", q.p50_us),
                ("0.9", q.p90_us),
                ("0.99", q.p99_us),
                ("0.999", q.p999_us),
            ] {
                let value = if q.count == 0 { f64::NAN } else { us / 1e6 };
                let _ = writeln!(text, "{name}{{{label},quantile=\"{quantile}\"}} {value}");
            }
            let _ = writeln!(text, "{name}_sum{{{label}}} {}", times.whole.sum_us / 1e6);
            let _ = writeln!(text, "{name}_count{{{label}}} {}", times.whole.count);
        }
    };
    let of = |part: fn(&evpr_runtime::ServiceStatus) -> &Times| -> Vec<_> {
        let mut all = Vec::new();
        for s in &status.services {
            all.push((format!("process={}", quoted(&s.name)), part(s)));
        }
        all
    };
    summary(
        "waiting",
        "Input: from being sent to being taken up.",
        of(|s| &s.waiting),
    );
    summary(
        "processing",
        "Input: from being taken up to done, without sending.",
        of(|s| &s.processing),
    );
    summary(
        "sending",
        "Output: handing it over, waiting for room included.",
        of(|s| &s.sending),
    );
    summary(
        "age",
        "Input: from the closing of its window to being taken up.",
        of(|s| &s.age),
    );
    let l = &status.latency;
    let stages = [
        ("reconstruct", &l.reconstruct),
        ("extract", &l.extract),
        ("fuse", &l.fuse),
        ("total", &l.total),
    ];
    let stages = stages.map(|(stage, times)| (format!("stage=\"{stage}\""), times));
    summary(
        "latency",
        "From the closing of a tick's last window to its answer.",
        stages.into(),
    );
    text
}
