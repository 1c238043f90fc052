//! `evpr events convert`: a recording in another format, or a piece of one.

use super::crop::Crop;
use super::{check_target, interrupted, kept};
use crate::args::ConvertArgs;
use crate::commands::parse_sensor;
use crate::commands::run::EXIT_INTERRUPTED;
use crate::failure::Failure;
use crate::output::refuse_input;
use crate::progress;
use evpr_core::plan::{OnBadEvent, Sensor};
use evpr_core::time::format_duration;
use evpr_events::writers::{self, WriteOptions, Writer};
use evpr_events::{
    BATCH_EVENTS, RawEvent, ReadOptions, Recording, SourceError, agreed_sensor, read_pixel_list,
};
use evpr_ingest::Screen;
use std::collections::HashSet;
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// As large as a sensor can be, where it is not known.
const ANY_SENSOR: Sensor = Sensor {
    height: 1 << 16,
    width: 1 << 16,
};

/// Which events are wanted.
struct Selection {
    from_ns: u64,
    to_ns: u64,
    crop: Option<Crop>,
}

impl Selection {
    fn keep(&self, event: &RawEvent, mask: &HashSet<(u16, u16)>) -> Option<RawEvent> {
        let in_time = (self.from_ns..self.to_ns).contains(&event.t_ns);
        if !in_time || (!mask.is_empty() && mask.contains(&(event.x, event.y))) {
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

/// How the copying ended.
enum End {
    Whole,
    Interrupted,
    /// The recording cannot be read on.
    Broken(SourceError),
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
    let recording = evpr_events::open(&args.input, &options)?;
    let sensor = agreed_sensor(&args.input, recording.sensor(), given)?;
    if let (Some(crop), Some(sensor)) = (args.crop, sensor) {
        crop.check(sensor)?;
    }
    let mask = args.mask.as_deref();
    let mask = mask.map(|mask| read_pixel_list(mask, sensor.unwrap_or(ANY_SENSOR)));
    let mask = mask.transpose()?.unwrap_or_default();
    let written = args.crop.map(|crop| Sensor {
        height: usize::from(crop.height),
        width: usize::from(crop.width),
    });
    let options = WriteOptions {
        sensor: written.or(sensor),
    };
    // From before the file begins: whoever sees it may interrupt.
    let stop = interrupted()?;
    let writer = writers::create(&args.output, &options)?;
    let mut copy = Copy {
        args,
        screen: Screen::of_recording(
            &args.input,
            sensor,
            args.bad.on_backward_time.unwrap_or(OnBadEvent::Error),
            args.bad.on_outside_sensor.unwrap_or(OnBadEvent::Error),
        ),
        recording,
        mask: mask.into_iter().map(Into::into).collect(),
        selection: None,
        writer,
        resolution_ns,
        tally: Tally::default(),
    };
    let bar = progress::bar(false, "converting");
    let end = copy.run(&stop, &mut |permille| bar.set_position(permille));
    bar.finish_and_clear();
    let end = end?;
    if matches!(end, End::Interrupted) {
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    }
    copy.screen.tally().log();
    let Tally { events, rounded } = copy.tally;
    if events > 0 {
        copy.writer.finish()?;
    }
    if rounded > 0 {
        eprintln!(
            "warning: the times of {rounded} events are rounded down to {}, the finest that the format keeps",
            format_duration(resolution_ns)
        );
    }
    match end {
        End::Broken(e) => return Err(kept(e, events, "events", &args.output)),
        _ if events == 0 => {
            return Err(Failure::new(format!(
                "{}: none of its events are in what was asked for; nothing is written",
                args.input.display()
            )));
        }
        _ => {}
    }
    eprintln!("{events} events written to {}", args.output.display());
    Ok(ExitCode::SUCCESS)
}

/// A recording on its way into another.
struct Copy<'a> {
    args: &'a ConvertArgs,
    recording: Box<dyn Recording>,
    screen: Screen,
    mask: HashSet<(u16, u16)>,
    /// Known from the first event on.
    selection: Option<Selection>,
    writer: Box<dyn Writer>,
    resolution_ns: u64,
    tally: Tally,
}

impl Copy<'_> {
    /// Copies what is wanted.
    fn run(&mut self, stop: &AtomicBool, progress: &mut dyn FnMut(u64)) -> Result<End, Failure> {
        let mut batch = Vec::with_capacity(BATCH_EVENTS);
        let mut kept = Vec::with_capacity(BATCH_EVENTS);
        loop {
            if stop.load(Ordering::Relaxed) {
                return Ok(End::Interrupted);
            }
            let more = self.recording.next_batch(&mut batch);
            let first = batch.first().map(|first| first.t_ns);
            if let (None, Some(first_ns)) = (&self.selection, first) {
                let selection = self.select(first_ns);
                let from_ns = selection.from_ns;
                self.selection = Some(selection);
                let passed = batch.last().is_none_or(|last| last.t_ns >= from_ns);
                // Only where times are known not to go back may the recording be searched by time.
                let ordered =
                    self.args.bad.on_backward_time.unwrap_or(OnBadEvent::Error) == OnBadEvent::Error;
                if !passed
                    && ordered
                    && let Some(index) = self.recording.seek_before(from_ns)?
                {
                    self.screen.restart(index);
                    continue;
                }
            }
            let mut past = false;
            let mut screened = Ok(());
            if let Some(selection) = &self.selection {
                // Times may go back a little, but not by a whole batch.
                past = first.is_some_and(|first_ns| first_ns >= selection.to_ns);
                // What is behind all that is wanted may be as it likes.
                let wanted = batch.iter().rposition(|event| event.t_ns < selection.to_ns);
                let wanted = wanted.map_or(0, |last| last + 1);
                past |= more.is_err() && wanted < batch.len();
                batch.truncate(wanted);
                screened = self.screen.apply(&mut batch);
                kept.clear();
                kept.extend(batch.iter().filter_map(|event| selection.keep(event, &self.mask)));
                self.write(&kept)?;
            }
            progress(self.recording.progress_permille());
            // An event that the screen refuses comes before the place where decoding failed.
            match screened.and(more) {
                Ok(true) if !past => {}
                Ok(_) => return Ok(End::Whole),
                Err(_) if past => return Ok(End::Whole),
                Err(e) => return Ok(End::Broken(e)),
            }
        }
    }

    /// What is wanted of a recording that begins then.
    fn select(&self, first_ns: u64) -> Selection {
        let args = self.args;
        let from_ns = first_ns.saturating_add(args.start.unwrap_or(0));
        Selection {
            from_ns: if args.start.is_some() { from_ns } else { 0 },
            to_ns: args.duration.map_or(u64::MAX, |d| from_ns.saturating_add(d)),
            crop: args.crop,
        }
    }

    fn write(&mut self, events: &[RawEvent]) -> Result<(), Failure> {
        let rounded = events.iter().filter(|e| e.t_ns % self.resolution_ns != 0);
        self.tally.rounded += rounded.count() as u64;
        self.tally.events += events.len() as u64;
        Ok(self.writer.write(events)?)
    }
}
