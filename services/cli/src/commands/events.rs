//! `evpr events`: recordings without a graph.

use crate::args::{AlignArg, EventsCommand, EventsInfoArgs, ReconstructArgs};
use crate::catalog::CATALOG;
use crate::failure::Failure;
use crate::frames_npy::FramesWriter;
use crate::output::say;
use crate::progress;
use evpr_core::Plan;
use evpr_core::config::{self, Overrides};
use evpr_core::message::{ChunkHeader, Event, FrameHeader, Frames, MemberSetting, TickHeader, TickKind};
use evpr_core::plan::{Align, Origin, Sensor, Source};
use evpr_core::stage::{IngestPort, Outlet, Stage, StageError};
use evpr_core::time::format_duration;
use evpr_events::{ReadOptions, RecordingInfo};
use evpr_runtime::Progress;
use indicatif::ProgressBar;
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;

/// `evpr events …`.
pub(crate) fn events(command: EventsCommand) -> Result<ExitCode, Failure> {
    match command {
        EventsCommand::Info(args) => info(&args),
        EventsCommand::Reconstruct(args) => reconstruct(&args),
    }
}

fn info(args: &EventsInfoArgs) -> Result<ExitCode, Failure> {
    let bar = progress::bar(args.json, "reading");
    let info = evpr_events::info(&args.input, &ReadOptions::default(), &mut |permille| {
        bar.set_position(permille);
    })?;
    bar.finish_and_clear();
    if args.json {
        say!("{}", serde_json::to_string_pretty(&info)?);
    } else {
        show(&info);
    }
    Ok(ExitCode::SUCCESS)
}

/// The report for a person.
fn show(info: &RecordingInfo) {
    let row = |label: &str, value: String| say!("{label:<16} {value}");
    let unit_from = info.source.time_unit_from;
    row("recording", info.source.path.display().to_string());
    row(
        "format",
        format!(
            "{}, times in {} (by {unit_from})",
            info.source.format, info.source.time_unit
        ),
    );
    match (info.height, info.width) {
        (Some(height), Some(width)) => row("sensor", Sensor { height, width }.to_string()),
        _ => row(
            "sensor",
            format!(
                "not told; largest row {}, largest column {}",
                info.max_y, info.max_x
            ),
        ),
    }
    row(
        "events",
        format!("{}, {:.1} % ON", info.events, info.on_share * 100.0),
    );
    row(
        "time",
        format!(
            "{} to {} ns, {:.3} s",
            info.first_ns, info.last_ns, info.duration_s
        ),
    );
    row(
        "rate",
        format!(
            "{:.0} events/s, at most {:.0} over 100 ms",
            info.mean_rate_hz, info.peak_rate_hz
        ),
    );
    row("longest gap", format!("{:.3} ms", info.max_gap_ns as f64 / 1e6));
    row("backward times", info.backward_times.to_string());
    row("equal times", info.duplicate_times.to_string());
    row(
        "outside sensor",
        info.outside_sensor
            .map_or_else(|| "unknown".to_owned(), |n| n.to_string()),
    );
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

fn parse_sensor(text: &str) -> Result<Sensor, Failure> {
    let parsed = text
        .split_once('x')
        .and_then(|(h, w)| Some((h.parse().ok()?, w.parse().ok()?)));
    let (height, width) = parsed.ok_or_else(|| {
        Failure::usage(format!(
            "--sensor {text} is not a size; write HEIGHTxWIDTH, such as 260x346"
        ))
    })?;
    Ok(Sensor { height, width })
}

fn offline_plan(args: &ReconstructArgs) -> Result<Plan, Failure> {
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
