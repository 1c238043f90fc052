//! `evpr events render`: frames of a recording as pictures.

use super::pictures::Pictures;
use super::plan::offline_plan;
use super::{check_target, interrupted, kept};
use crate::args::{AlignArg, ReconstructArgs, RenderArgs};
use crate::chain;
use crate::commands::run::EXIT_INTERRUPTED;
use crate::failure::Failure;
use crate::progress;
use evpr_core::message::{ChannelOrder, FrameHeader, Frames};
use evpr_core::plan::{Origin, Sensor};
use evpr_core::stage::{Outlet, StageError};
use std::io;
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

/// Ticks in order, those without events black.
struct Render {
    pictures: Pictures,
    order: ChannelOrder,
    frame: Vec<u8>,
    next: u64,
    most: u64,
    failed: Option<io::Error>,
}

impl Render {
    fn full(&self) -> bool {
        self.next >= self.most
    }

    fn draw(&mut self, header: FrameHeader, len: usize, fill: &mut dyn FnMut(&mut [u8])) -> io::Result<()> {
        self.frame.clear();
        self.frame.resize(len, 0);
        while self.next < header.tick && !self.full() {
            self.pictures.add(self.next, self.order, &self.frame)?;
            self.next += 1;
        }
        if self.full() {
            return Ok(());
        }
        fill(&mut self.frame);
        self.next = header.tick + 1;
        self.pictures.add(header.tick, self.order, &self.frame)
    }
}

impl Outlet<Frames> for Render {
    fn emit(
        &mut self,
        header: FrameHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), StageError> {
        if header.reason != 0 {
            return Ok(());
        }
        if self.failed.is_none()
            && let Err(e) = self.draw(header, len, fill)
        {
            self.failed = Some(e);
        }
        if self.failed.is_some() || self.full() {
            return Err(StageError::Stopped);
        }
        Ok(())
    }
}

/// Refuses a name that promises something else.
fn check_ending(out: &Path) -> Result<(), Failure> {
    let ending = out.extension().map(|e| e.to_string_lossy().to_lowercase());
    let is_folder = out.as_os_str().as_encoded_bytes().ends_with(b"/");
    match ending {
        Some(ending) if !is_folder && ending != "gif" && ending.starts_with(char::is_alphabetic) => {
            Err(Failure::usage(format!(
                "--out {}: what is written is an animated .gif, or a folder of .png files, not .{ending}; name it so, or \
                 with a / at its end",
                out.display()
            )))
        }
        _ => Ok(()),
    }
}

pub(super) fn render(args: &RenderArgs) -> Result<ExitCode, Failure> {
    check_ending(&args.out)?;
    check_target(&args.out, args.force)?;
    if args.out.is_dir() {
        return Err(Failure::new(format!(
            "{} is a folder that exists already; name a new one, or a .gif",
            args.out.display()
        )));
    }
    let plan = offline_plan(&ReconstructArgs {
        input: args.input.clone(),
        method: args.method.clone(),
        models: args.models.clone(),
        window: args.window,
        tick: args.tick.unwrap_or(args.window),
        align: AlignArg::Start,
        origin: Origin::FirstEvent,
        param: args.param.clone(),
        sensor: args.sensor.clone(),
        bad: args.bad,
        out: args.out.clone(),
    })?;
    let failed = |e| Failure::new(format!("{}: cannot be written: {e}", args.out.display()));
    let Sensor { height, width } = plan.sensor;
    let side = |n: usize| u16::try_from(n).map_err(|_| Failure::new("the sensor is too large for a picture"));
    let order = evpr_reconstruct::KINDS
        .iter()
        .find(|kind| kind.name == args.method)
        .map_or(ChannelOrder::Grey, |kind| kind.channel_order);
    let step = args.tick.unwrap_or(args.window);
    let stop = interrupted()?;
    let mut out = Render {
        pictures: Pictures::create(&args.out, side(height)?, side(width)?, order, step).map_err(failed)?,
        order,
        frame: Vec::new(),
        next: 0,
        most: args.frames.unwrap_or(u64::MAX),
        failed: None,
    };
    let bar = progress::bar(false, "rendering");
    let chained = chain::run(&plan, 0..plan.reconstructions.len(), &mut out, &stop, &mut |p| {
        progress::show(&bar, p)
    });
    bar.finish_and_clear();
    let chained = chained?;
    if stop.load(Ordering::Relaxed) {
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    }
    if let Some(e) = out.failed {
        return Err(failed(e));
    }
    let complete = out.full();
    let count = out.pictures.count();
    if count > 0 {
        out.pictures.finish().map_err(failed)?;
    }
    if !complete {
        chained
            .outcome
            .map_err(|e| kept(e, count, "pictures", &args.out))?;
    }
    if count == 0 {
        return Err(Failure::new(format!(
            "{} is shorter than one tick, or its ticks are all empty; there is nothing to show",
            args.input.display()
        )));
    }
    eprintln!("{count} pictures written to {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_promises_something_else_is_refused() {
        for good in ["a.gif", "a.GIF", "a", "b/a.", "a.mp4/", "run1.5", ".hidden"] {
            assert!(check_ending(Path::new(good)).is_ok(), "{good}");
        }
        for bad in ["a.mp4", "a.png", "b/a.npy", "a.gif.webm"] {
            assert!(check_ending(Path::new(bad)).is_err(), "{bad}");
        }
    }
}
