//! Frames of the queries that a report shows, made anew from the recordings that the traverses name.

use crate::catalog;
use crate::colors;
use crate::failure::Failure;
use crate::seen::{Frame, frames_of};
use evpr_core::Plan;
use evpr_core::config::Overrides;
use evpr_evaluate::report::{Look, Raster};
use evpr_evaluate::{MemberName, Pair};
use std::path::Path;

/// Gives a look its frames, or says in it why there are none: a report is worth having without them.
pub(crate) fn show_frames(look: &mut Look, pairs: &[Pair], config: &Path) {
    let Some(pair) = pairs.iter().find(|p| p.name() == look.pair()) else {
        return;
    };
    match frames(look, pair, config) {
        Ok((what, frames)) => look.set_frames(what, frames),
        Err(failure) => look.set_no_frames(failure.text()),
    }
}

type Frames = Vec<[Option<Raster>; 3]>;

fn frames(look: &Look, pair: &Pair, config: &Path) -> Result<(String, Frames), Failure> {
    let [reference, query] = pair.sources();
    let (reference, query) = (plan(pair, config, reference)?, plan(pair, config, query)?);
    let member = cheapest(look, &query).ok_or_else(|| {
        Failure::new(format!(
            "{} has none of the members {}; give the configuration that the traverses were recorded with",
            config.display(),
            look.members().join(", ")
        ))
    })?;
    let queries: Vec<u64> = look.shown().iter().map(|s| s.query as u64).collect();
    // The answered place of each query, and after them the right ones.
    let answers = look.shown().iter().map(|s| s.answer as u64);
    let places: Vec<u64> = answers
        .chain(look.shown().iter().map(|s| s.right as u64))
        .collect();
    let seen = |plan: &Plan, ticks: &[u64]| -> Result<Vec<Option<Raster>>, Failure> {
        let at = member.reconstruction;
        let frames = frames_of(plan, at..at + 1, ticks, member.window)?;
        let first = frames
            .into_iter()
            .map(|of_tick| of_tick.into_iter().next().flatten());
        Ok(first.map(|frame| frame.map(|f| raster(plan, &f))).collect())
    };
    let mut queries = seen(&query, &queries)?.into_iter();
    let places = seen(&reference, &places)?;
    let (answers, right) = places.split_at(places.len() / 2);
    let frames = answers.iter().zip(right);
    let frames = frames.map(|(answer, right)| [queries.next().flatten(), answer.clone(), right.clone()]);
    let what = format!(
        "{}, windows of {}",
        member.id,
        query.slicing.window_id(member.window)
    );
    Ok((what, frames.collect()))
}

/// The plan of a traverse's recording.
fn plan(pair: &Pair, config: &Path, source: &str) -> Result<Plan, Failure> {
    // A simulated street says its pass and what it was drawn from.
    let street = source
        .strip_prefix("street (")
        .and_then(|rest| rest.split(',').next());
    let overrides = Overrides {
        input: Some(street.unwrap_or(source).into()),
        ..Overrides::default()
    };
    if street.is_none() && !Path::new(source).exists() {
        return Err(Failure::new(format!(
            "the recording {source} is not there; put it back, or start evpr where the traverses were recorded"
        )));
    }
    let plan = catalog::plan(config, &overrides)?;
    let (cut, recorded) = (&plan.slicing, pair.slicing());
    if (cut.mode, cut.tick, &cut.origin) != (recorded.mode, recorded.tick, &recorded.origin) {
        return Err(Failure::new(format!(
            "{} cuts recordings in another way than the traverses were cut; give the configuration that they were recorded \
             with",
            config.display()
        )));
    }
    Ok(plan)
}

/// Whose frames are shown.
struct Member {
    reconstruction: usize,
    window: usize,
    id: String,
}

/// The first member whose reconstruction is no network, if there is one: frames of networks take time.
fn cheapest(look: &Look, plan: &Plan) -> Option<Member> {
    let members = look.members().iter().filter_map(|name| {
        let parts = MemberName::parse(name)?;
        let reconstruction = plan
            .reconstructions
            .iter()
            .position(|r| r.id == parts.reconstruction)?;
        let windows = 0..plan.slicing.windows.len();
        let window = windows
            .into_iter()
            .find(|w| plan.slicing.window_id(*w) == parts.window)?;
        Some(Member {
            reconstruction,
            window,
            id: parts.reconstruction.to_owned(),
        })
    });
    members.min_by_key(|m| plan.reconstructions[m.reconstruction].network.is_some())
}

fn raster(plan: &Plan, frame: &Frame) -> Raster {
    let pixels = colors::pixels(frame.order, &frame.pixels);
    Raster {
        width: plan.sensor.width,
        height: plan.sensor.height,
        pixels: pixels.map(|pixel| colors::color(frame.order, pixel)).collect(),
    }
}
