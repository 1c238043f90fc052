//! A trace in the Trace Event Format that Perfetto (ui.perfetto.dev) and Chrome (chrome://tracing) read, written as
//! it comes: one track per process, and an arrow per member from the chunk that closed its window to the answer.
//!
//! Format: "Trace Event Format", Chromium project: complete events (X), async events (b, e) for waiting messages,
//! flow events (s, t, f), metadata (M); times in µs.

use evpr_core::Plan;
use evpr_core::message::{Span, SpanKind};
use evpr_core::plan::ServiceKind;
use std::collections::HashSet;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Rows whose answer has not come yet that are kept in mind at most.
const MAX_OPEN_ROWS: usize = 1 << 16;

/// Writes a trace.
pub(crate) struct TraceWriter {
    path: PathBuf,
    out: BufWriter<File>,
    plan: Plan,
    kinds: Vec<ServiceKind>,
    /// (tick, member) of rows that the fuser has taken and not answered yet.
    rows: HashSet<(u64, u32)>,
    events: u64,
    /// The first line that could not be written, if there was one.
    failed: Option<String>,
}

/// A time in µs, as JSON.
fn us(ns: u64) -> String {
    format!("{}.{:03}", ns / 1000, ns % 1000)
}

impl TraceWriter {
    /// Begins the file.
    pub(crate) fn create(path: &Path, plan: &Plan) -> Result<Self, String> {
        let failed = |e: io::Error| format!("cannot write {}: {e}", path.display());
        let out = BufWriter::new(File::create(path).map_err(failed)?);
        let services = plan.services();
        let mut writer = Self {
            path: path.to_owned(),
            out,
            plan: plan.clone(),
            kinds: services.iter().map(|s| s.kind).collect(),
            rows: HashSet::new(),
            events: 0,
            failed: None,
        };
        writer.raw("{\"displayTimeUnit\":\"ms\",\"traceEvents\":[\n");
        let name = serde_json::Value::from(format!("evpr {}", plan.name));
        writer.event(&format!(
            "\"ph\":\"M\",\"name\":\"process_name\",\"pid\":1,\"args\":{{\"name\":{name}}}"
        ));
        for (index, service) in services.iter().enumerate() {
            let (tid, name) = (index + 1, serde_json::Value::from(service.name.as_str()));
            writer.event(&format!(
                "\"ph\":\"M\",\"name\":\"thread_name\",\"pid\":1,\"tid\":{tid},\"args\":{{\"name\":{name}}}"
            ));
            writer.event(&format!(
                "\"ph\":\"M\",\"name\":\"thread_sort_index\",\"pid\":1,\"tid\":{tid},\"args\":{{\"sort_index\":{tid}}}"
            ));
        }
        Ok(writer)
    }

    fn raw(&mut self, text: &str) {
        if let (None, Err(e)) = (&self.failed, self.out.write_all(text.as_bytes())) {
            self.failed = Some(format!("cannot write {}: {e}", self.path.display()));
        }
    }

    fn event(&mut self, fields: &str) {
        let comma = if self.events == 0 { "" } else { ",\n" };
        self.raw(&format!("{comma}{{{fields}}}"));
        self.events += 1;
    }

    /// What a span of this process is called.
    fn name(&self, kind: ServiceKind, of: SpanKind, part: u32) -> String {
        let frame = || {
            let (r, w) = ((part >> 16) as usize, (part & 0xffff) as usize);
            let id = self.plan.reconstructions.get(r).map_or("?", |r| r.id.as_str());
            let known = w < self.plan.slicing.windows.len();
            let window = if known {
                self.plan.slicing.window_id(w)
            } else {
                "?".to_owned()
            };
            format!("frame {id}@{window}")
        };
        let member = || {
            self.plan
                .members
                .get(part as usize)
                .map_or("?", |m| m.name.as_str())
        };
        match (kind, of) {
            _ if part == u32::MAX => "tick".to_owned(),
            (ServiceKind::Ingest, _) | (ServiceKind::Reconstruct, SpanKind::Input) if part == 0 => {
                "chunk".to_owned()
            }
            (ServiceKind::Ingest, _) | (ServiceKind::Reconstruct, SpanKind::Input) => {
                "closing chunk".to_owned()
            }
            (ServiceKind::Reconstruct, SpanKind::Output) | (ServiceKind::Extract, SpanKind::Input) => frame(),
            (ServiceKind::Extract, SpanKind::Output) => format!("row {}", member()),
            (ServiceKind::Fuse | ServiceKind::Record, SpanKind::Input) => format!("row {}", member()),
            (ServiceKind::Fuse | ServiceKind::Record, SpanKind::Output) => "answer".to_owned(),
            (ServiceKind::Dashboard, _) => "look".to_owned(),
        }
    }

    /// The members that a message which a process sends goes on to.
    fn members(&self, kind: ServiceKind, span: &Span) -> Vec<u32> {
        let members = (0u32..).zip(&self.plan.members);
        match kind {
            ServiceKind::Ingest => members
                .filter(|(_, m)| span.part >> m.window & 1 == 1)
                .map(|(index, _)| index)
                .collect(),
            ServiceKind::Reconstruct => members
                .filter(|(_, m)| (m.reconstruction << 16 | m.window) as u32 == span.part)
                .map(|(index, _)| index)
                .collect(),
            ServiceKind::Extract => vec![span.part],
            ServiceKind::Fuse | ServiceKind::Record | ServiceKind::Dashboard => Vec::new(),
        }
    }

    /// Writes the spans of one process.
    pub(crate) fn write(&mut self, service: usize, spans: &[Span]) {
        let Some(kind) = self.kinds.get(service).copied() else {
            return;
        };
        for span in spans {
            self.span(service + 1, kind, span);
        }
    }

    fn span(&mut self, tid: usize, kind: ServiceKind, span: &Span) {
        let Some(of) = SpanKind::from_code(span.kind) else {
            return;
        };
        let name = serde_json::Value::from(self.name(kind, of, span.part));
        let closed = if span.closed_ns > 0 {
            format!(",\"window_closed_us\":{}", us(span.closed_ns))
        } else {
            String::new()
        };
        let (start, took) = (us(span.start_ns), us(span.end_ns.saturating_sub(span.start_ns)));
        let cat = match of {
            SpanKind::Input => "input",
            SpanKind::Output => "output",
        };
        self.event(&format!(
            "\"ph\":\"X\",\"cat\":\"{cat}\",\"name\":{name},\"pid\":1,\"tid\":{tid},\"ts\":{start},\"dur\":{took},\
             \"args\":{{\"tick\":{}{closed}}}",
            span.tick
        ));
        match of {
            SpanKind::Input => {
                if kind == ServiceKind::Fuse && span.part != u32::MAX {
                    if self.rows.len() >= MAX_OPEN_ROWS {
                        self.rows.clear();
                    }
                    self.rows.insert((span.tick, span.part));
                }
                if span.sent_ns > 0 && span.sent_ns < span.start_ns {
                    let id = self.events;
                    for (ph, at) in [("b", span.sent_ns), ("e", span.start_ns)] {
                        self.event(&format!(
                            "\"ph\":\"{ph}\",\"cat\":\"waiting\",\"name\":{name},\"id\":{id},\"pid\":1,\"tid\":{tid},\
                             \"ts\":{},\"args\":{{\"tick\":{}}}",
                            us(at),
                            span.tick
                        ));
                    }
                }
            }
            SpanKind::Output => self.flow(tid, kind, span),
        }
    }

    /// The arrows that begin, pass by or end at an output.
    fn flow(&mut self, tid: usize, kind: ServiceKind, span: &Span) {
        let (ph, members) = match kind {
            ServiceKind::Ingest if span.part == u32::MAX => return,
            ServiceKind::Ingest => ("s", self.members(kind, span)),
            ServiceKind::Reconstruct => ("t", self.members(kind, span)),
            ServiceKind::Extract => ("t", self.members(kind, span)),
            ServiceKind::Fuse => {
                let members = 0..self.plan.members.len() as u32;
                let came = |m: &u32| self.rows.remove(&(span.tick, *m));
                ("f\",\"bp\":\"e", members.filter(came).collect())
            }
            ServiceKind::Record | ServiceKind::Dashboard => return,
        };
        let at = us(span.start_ns.midpoint(span.end_ns));
        for member in members {
            let id = span.tick.wrapping_mul(1 << 9).wrapping_add(u64::from(member));
            self.event(&format!(
                "\"ph\":\"{ph}\",\"cat\":\"tick\",\"name\":\"row\",\"id\":{id},\"pid\":1,\"tid\":{tid},\"ts\":{at}"
            ));
        }
    }

    /// Ends the file. Gives how many events it has.
    pub(crate) fn finish(mut self) -> Result<u64, String> {
        self.raw("\n]}\n");
        if let Err(e) = self.out.flush() {
            self.failed
                .get_or_insert(format!("cannot write {}: {e}", self.path.display()));
        }
        self.failed.map_or(Ok(self.events), Err)
    }
}
