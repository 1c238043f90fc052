//! Finding the hot pixels of a plan before its processes start.

use super::mask::Learner;
use crate::reader::next_screened;
use crate::{Screen, SourceError, source};
use evpr_core::plan::{HotPixelsFrom, MaskedBy, Pixel, Plan};
use evpr_events::{PixelListErrors, read_pixel_list, rough_seconds};

/// Why the hot pixels cannot be known.
#[derive(Debug, thiserror::Error)]
pub enum HotPixelsError {
    /// Their file is not as it should be: one line for each mistake.
    #[error(transparent)]
    List(#[from] PixelListErrors),
    /// The recording cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A live stream cannot be looked at in advance.
    #[error(
        "source.hot_pixels: a live stream cannot be learned from before it is there, as reconstructions would need it; \
         write file = \"…\", made by `evpr events hot-pixels`, or apply = \"all\""
    )]
    Live,
}

/// Puts the hot pixels into the plan: those of the file, or those of the first stretch of the recording, which is
/// opened, screened and read so far for it. Whoever gets the plan then has the same ones, however often it starts.
/// A live stream is left to be learned from under way. Does nothing where there is nothing to find.
///
/// # Errors
/// When the file or the recording cannot be read. A bad event in the stretch is no error here: what is before it
/// decides, and the replay comes to it too.
pub fn find_hot_pixels(plan: &mut Plan) -> Result<(), HotPixelsError> {
    let Some(hot) = plan.source.hot_pixels.as_ref().filter(|hot| hot.pixels.is_none()) else {
        return Ok(());
    };
    let pixels = match &hot.from {
        HotPixelsFrom::File(path) => read_pixel_list(path, plan.sensor)?,
        HotPixelsFrom::Learn { .. } if !source::can_be_read_again(&plan.source) => {
            return match hot.masked_by {
                MaskedBy::Ingest => Ok(()),
                MaskedBy::Reconstruction => Err(HotPixelsError::Live),
            };
        }
        HotPixelsFrom::Learn { period_ns, rule } => {
            look_ahead(plan, *period_ns, Learner::new(plan.sensor, *period_ns, *rule))?
        }
    };
    tracing::info!(hot_pixels = pixels.len(), sensor = %plan.sensor, "hot pixels found");
    if let Some(hot) = &mut plan.source.hot_pixels {
        hot.pixels = Some(pixels);
    }
    Ok(())
}

fn look_ahead(plan: &Plan, period_ns: u64, mut learner: Learner) -> Result<Vec<Pixel>, SourceError> {
    let mut recording = source::open(&plan.source)?;
    let mut screen = Screen::new(plan);
    let (mut first_ns, mut last_ns) = (None, 0);
    let mut batch = Vec::new();
    loop {
        let outcome = next_screened(recording.as_mut(), &mut screen, &mut batch);
        if let Some((_, pixels)) = learner.learn(&batch) {
            return Ok(pixels);
        }
        if let (Some(first), Some(last)) = (batch.first(), batch.last()) {
            first_ns.get_or_insert(first.t_ns);
            last_ns = last.t_ns;
        }
        if !matches!(outcome, Ok(true)) {
            break;
        }
    }
    // It ended or failed before: what there was decides.
    let length_ns = last_ns.saturating_sub(first_ns.unwrap_or(last_ns));
    tracing::warn!(
        "source.hot_pixels.learn is {}, but only {} of {} can be learned from",
        rough_seconds(period_ns),
        rough_seconds(length_ns),
        plan.source.path.display()
    );
    Ok(learner.hot(length_ns))
}
