//! Frames of a recording without a graph: ingest and one reconstruction in this process.

use crate::args::{AlignArg, ReconstructArgs};
use crate::catalog::CATALOG;
use crate::commands::parse_sensor;
use crate::failure::Failure;
use crate::progress;
use evpr_core::Plan;
use evpr_core::config::{self, Overrides};
use evpr_core::message::{ChunkHeader, Event, Frames, MemberSetting, TickHeader, TickKind};
use evpr_core::plan::{Align, Origin, Sensor, Source};
use evpr_core::stage::{IngestPort, Outlet, Stage, StageError};
use evpr_core::time::format_duration;
use evpr_runtime::Progress;
use indicatif::ProgressBar;
use std::fmt::Write;

/// The configuration that stands for the options, so that they are checked in one place.
fn as_config(args: &ReconstructArgs, sensor: Sensor) -> String {
    let mut text = String::new();
    let align = match args.align {
        AlignArg::Start => Align::Start,
        AlignArg::End => Align::End,
    };
    let origin = match args.origin {
        Origin::FirstEvent => "\"first_event\"".to_owned(),
        Origin::Grid(step) => format!("\"grid:{}\"", format_duration(step)),
        Origin::At(ns) => ns.to_string(),
    };
    let _ = writeln!(
        text,
        "[sensor]\nheight = {}\nwidth = {}",
        sensor.height, sensor.width
    );
    let _ = writeln!(text, "[slicing]\ntick = \"{}\"", format_duration(args.tick));
    let _ = writeln!(
        text,
        "windows = [\"{}\"]\nalign = \"{}\"",
        format_duration(args.window),
        align.name()
    );
    let _ = writeln!(text, "origin = {origin}");
    let _ = writeln!(
        text,
        "[[reconstruction]]\nid = \"frames\"\nkind = {:?}",
        args.method
    );
    let params: Vec<String> = args.param.iter().map(|p| as_toml(p)).collect();
    let _ = writeln!(text, "params = {{ {} }}", params.join(", "));
    let _ = writeln!(text, "[[extractor]]\nid = \"none\"\nkind = \"raw_pixels\"");
    text
}

/// `tau=50ms` as TOML: numbers stay numbers, everything else is a string.
fn as_toml(param: &str) -> String {
    let (name, value) = param.split_once('=').unwrap_or((param, ""));
    if value.parse::<f64>().is_ok() {
        format!("{name} = {value}")
    } else {
        format!("{name} = {value:?}")
    }
}

/// The plan of one method, window and tick.
pub(super) fn offline_plan(args: &ReconstructArgs) -> Result<Plan, Failure> {
    let given = args.sensor.as_deref().map(parse_sensor).transpose()?;
    let source = Source::file(&args.input);
    let sensor = evpr_ingest::probe(&source)?.or(given).ok_or_else(|| {
        Failure::new(format!(
            "{} does not tell the sensor's size; give it with --sensor HEIGHTxWIDTH",
            args.input.display()
        ))
    })?;
    let config = config::parse(&as_config(args, sensor), "command line", &CATALOG).map_err(Failure::usage)?;
    let overrides = Overrides {
        input: Some(args.input.clone()),
        ..Overrides::default()
    };
    config.resolve(sensor, &overrides).map_err(Failure::usage)
}

/// Ingest and one reconstruction chained in this process.
pub(super) struct Chain<O> {
    pub(super) stage: evpr_reconstruct::Reconstruct,
    pub(super) out: O,
    pub(super) bar: ProgressBar,
    events: Vec<Event>,
    seq: u64,
    /// The tick at which the recording ended, once it has.
    pub(super) end: Option<u64>,
}

impl<O> Chain<O> {
    pub(super) fn new(plan: &Plan, out: O, what: &str) -> Result<Self, Failure> {
        Ok(Self {
            stage: evpr_reconstruct::build(plan, 0)?,
            out,
            bar: progress::bar(false, what),
            events: Vec::new(),
            seq: 0,
            end: None,
        })
    }
}

impl<O: Outlet<Frames>> IngestPort for Chain<O> {
    fn now_ns(&self) -> u64 {
        evpr_runtime::now_ns()
    }

    fn chunk(
        &mut self,
        mut header: ChunkHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [Event]),
    ) -> Result<(), StageError> {
        self.events.clear();
        self.events.resize(len, Event::default());
        fill(&mut self.events);
        header.stamp.seq = self.seq;
        self.seq += 1;
        self.stage.process(&header, &self.events, &mut self.out)
    }

    fn tick(&mut self, header: TickHeader, _weights: &[f64]) -> Result<(), StageError> {
        if header.kind == TickKind::End as u32 {
            self.end = Some(header.tick);
        }
        Ok(())
    }

    fn control(&mut self, _tick: u64) -> Option<(u64, Vec<MemberSetting>)> {
        None
    }

    fn wait_until(&mut self, _ns: u64) -> Result<(), StageError> {
        Ok(())
    }

    fn progress(&mut self, permille: u64, next_tick: u64, events: u64, _skipped: u64) {
        progress::show(
            &self.bar,
            &Progress {
                permille,
                events,
                answers: next_tick,
                recorded: 0,
            },
        );
    }
}
