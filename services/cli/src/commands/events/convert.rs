//! `evpr events convert`: a recording in another format, or a piece of one.

use super::crop::{Crop, read_mask};
use crate::args::ConvertArgs;
use crate::commands::parse_sensor;
use crate::commands::run::EXIT_INTERRUPTED;
use crate::failure::Failure;
use crate::output::refuse_input;
use crate::progress;
use evpr_core::plan::Sensor;
use evpr_core::time::format_duration;
use evpr_events::writers::{self, WriteOptions, Writer};
use evpr_events::{BATCH_EVENTS, RawEvent, ReadOptions, Recording};
use signal_hook::consts::{SIGINT, SIGTERM};
use std::collections::HashSet;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Refuses to write over something, unless that is wanted.
pub(super) fn check_target(out: &Path, force: bool) -> Result<(), Failure> {
    if out.exists() && !out.is_file() && !out.is_dir() {
        return Err(Failure::new(format!(
            "{} is no regular file; name a file to write",
            out.display()
        )));
    }
    if out.exists() && !force {
        return Err(Failure::new(format!(
            "{} exists already; give --force to replace it",
            out.display()
        )));
    }
    Ok(())
}

/// True after the first Ctrl-C or SIGTERM.
pub(super) fn interrupted() -> Result<Arc<AtomicBool>, Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, flag.clone())
            .map_err(|e| Failure::new(format!("cannot listen for signals: {e}")))?;
    }
    Ok(flag)
}

/// Which events are wanted.
struct Selection {
    from_ns: u64,
    to_ns: u64,
    crop: Option<Crop>,
    mask: HashSet<(u16, u16)>,
}

impl Selection {
    fn keep(&self, event: &RawEvent) -> Option<RawEvent> {
        let in_time = (self.from_ns..self.to_ns).contains(&event.t_ns);
        if !in_time || (!self.mask.is_empty() && self.mask.contains(&(event.x, event.y))) {
            return None;
        }
        self.crop.map_or(Some(*event), |crop| crop.apply(event))
    }
}

/// What was written.
#[derive(Default)]
struct Tally {
    events: u64,
    rounded: u64,
}

pub(super) fn convert(args: &ConvertArgs) -> Result<ExitCode, Failure> {
    let resolution_ns = writers::resolution_ns(&args.output)?;
    check_target(&args.output, args.force)?;
    let mut partial = args.output.as_os_str().to_owned();
    partial.push(".partial");
    // Under this name the new recording grows.
    refuse_input(Path::new(&partial), &[&args.input])?;
    let given = args.sensor.as_deref().map(parse_sensor).transpose()?;
    let options = ReadOptions {
        sensor: given,
        time_unit: args.time_unit.unwrap_or_default(),
        stream: args.stream.clone(),
        ..ReadOptions::default()
    };
    let mut recording = evpr_events::open(&args.input, &options)?;
    let sensor = given.or(recording.sensor());
    if let (Some(crop), Some(sensor)) = (args.crop, sensor) {
        crop.check(sensor)?;
    }
    let written = args.crop.map(|crop| Sensor {
        height: usize::from(crop.height),
        width: usize::from(crop.width),
    });
    let options = WriteOptions {
        sensor: written.or(sensor),
    };
    let mask = args.mask.as_deref().map(read_mask).transpose()?;
    // From before the file begins: whoever sees it may interrupt.
    let stop = interrupted()?;
    let mut writer = writers::create(&args.output, &options)?;
    let mask = mask.unwrap_or_default();
    let Some(tally) = copy(
        args,
        mask,
        recording.as_mut(),
        writer.as_mut(),
        resolution_ns,
        &stop,
    )?
    else {
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    };
    if tally.events == 0 {
        return Err(Failure::new(format!(
            "{}: none of its events are in what was asked for; nothing is written",
            args.input.display()
        )));
    }
    writer.finish()?;
    eprintln!("{} events written to {}", tally.events, args.output.display());
    if tally.rounded > 0 {
        eprintln!(
            "warning: the times of {} events are rounded down to {}, the finest that the format keeps",
            tally.rounded,
            format_duration(resolution_ns)
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// Copies what is wanted; `None` when interrupted.
fn copy(
    args: &ConvertArgs,
    mask: HashSet<(u16, u16)>,
    recording: &mut dyn Recording,
    writer: &mut dyn Writer,
    resolution_ns: u64,
    stop: &AtomicBool,
) -> Result<Option<Tally>, Failure> {
    let bar = progress::bar(false, "converting");
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    let mut kept = Vec::with_capacity(BATCH_EVENTS);
    let mut tally = Tally::default();
    let mut selection: Option<Selection> = None;
    let mut failed = None;
    loop {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let more = recording.next_batch(&mut batch);
        if let (None, Some(first)) = (&selection, batch.first()) {
            let from_ns = first.t_ns.saturating_add(args.start.unwrap_or(0));
            selection = Some(Selection {
                from_ns: if args.start.is_some() { from_ns } else { 0 },
                to_ns: args.duration.map_or(u64::MAX, |d| from_ns.saturating_add(d)),
                crop: args.crop,
                mask: mask.clone(),
            });
            let passed = batch.last().is_none_or(|last| last.t_ns >= from_ns);
            if !passed && recording.seek_before(from_ns)?.is_some() {
                continue;
            }
        }
        let Some(selection) = &selection else {
            if more? {
                continue;
            }
            break;
        };
        kept.clear();
        kept.extend(batch.iter().filter_map(|event| selection.keep(event)));
        tally.events += kept.len() as u64;
        tally.rounded += kept.iter().filter(|e| e.t_ns % resolution_ns != 0).count() as u64;
        writer.write(&kept)?;
        bar.set_position(recording.progress_permille());
        // Times may go back a little, but not by a whole batch.
        let past = batch.first().is_some_and(|first| first.t_ns >= selection.to_ns);
        match more {
            Ok(true) if !past => {}
            Ok(_) => break,
            Err(e) => {
                failed = Some(e);
                break;
            }
        }
    }
    bar.finish_and_clear();
    failed.map_or(Ok(Some(tally)), |e| Err(e.into()))
}
