//! `evpr events`: recordings without a graph.

use crate::args::{AlignArg, EventsCommand, ReconstructArgs};
use crate::catalog::CATALOG;
use crate::failure::Failure;
use crate::frames_npy::FramesWriter;
use crate::progress;
use evpr_core::Plan;
use evpr_core::config::{self, Overrides};
use evpr_core::message::{ChunkHeader, Event, FrameHeader, Frames, MemberSetting, TickHeader, TickKind};
use evpr_core::plan::{Align, Origin, Sensor, Source};
use evpr_core::stage::{IngestPort, Outlet, Stage, StageError};
use evpr_core::time::format_duration;
use evpr_runtime::Progress;
use indicatif::ProgressBar;
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;

/// `evpr events …`.
pub(crate) fn events(command: EventsCommand) -> Result<ExitCode, Failure> {
    match command {
        EventsCommand::Info(args) => super::events_info::info(&args),
        EventsCommand::HotPixels(args) => super::hot_pixels::hot_pixels(&args),
        EventsCommand::Reconstruct(args) => reconstruct(&args),
    }
}

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

fn offline_plan(args: &ReconstructArgs) -> Result<Plan, Failure> {
    let given = args.sensor.as_deref().map(super::parse_sensor).transpose()?;
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
struct Chain<'a> {
    stage: evpr_reconstruct::Reconstruct,
    events: Vec<Event>,
    seq: u64,
    end: Option<u64>,
    out: WriteFrames<'a>,
    bar: ProgressBar,
}

struct WriteFrames<'a> {
    writer: FramesWriter,
    path: &'a Path,
    frame: Vec<u8>,
}

impl Outlet<Frames> for WriteFrames<'_> {
    fn emit(
        &mut self,
        header: FrameHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), StageError> {
        if header.reason != 0 {
            return Ok(());
        }
        self.frame.clear();
        self.frame.resize(len, 0);
        fill(&mut self.frame);
        self.writer
            .write(header.tick, &self.frame)
            .map_err(|e| StageError::Fatal(format!("cannot write {}: {e}", self.path.display())))
    }
}

impl IngestPort for Chain<'_> {
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

fn reconstruct(args: &ReconstructArgs) -> Result<ExitCode, Failure> {
    let plan = offline_plan(args)?;
    let stage = evpr_reconstruct::build(&plan, 0)?;
    let Sensor { height, width } = plan.sensor;
    let writer = FramesWriter::create(&args.out, height, width, plan.reconstructions[0].channels)
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", args.out.display())))?;
    let mut chain = Chain {
        stage,
        events: Vec::new(),
        seq: 0,
        end: None,
        out: WriteFrames {
            writer,
            path: &args.out,
            frame: Vec::new(),
        },
        bar: progress::bar(false, "reconstructing"),
    };
    let stop = evpr_runtime::Stop::new();
    let ingest = evpr_ingest::Ingest::new(&plan, 0, 1, stop.signal().clone())?;
    let outcome = ingest.run(&mut chain);
    chain.bar.finish_and_clear();
    // A recording that fails in its middle has an end too: the array then holds the ticks before.
    let ticks = chain.end.unwrap_or(0);
    chain
        .out
        .writer
        .finish(ticks)
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", args.out.display())))?;
    outcome?;
    if ticks == 0 {
        return Err(Failure::new(format!(
            "{} is shorter than one tick of {}; there is no frame to write",
            args.input.display(),
            plan.slicing.tick_id()
        )));
    }
    eprintln!("{ticks} frames written to {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}
