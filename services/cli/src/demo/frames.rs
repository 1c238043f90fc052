//! What the methods see: their frames of one window of one tick, made in this process by ingest and the
//! reconstructions themselves.

use super::recall::Positions;
use crate::failure::Failure;
use crate::seen::{Frame, frames_of};
use evpr_core::Plan;
use evpr_core::plan::{Sensor, StreetPass};

/// What all methods see of one place on several drives.
#[derive(Debug)]
pub(crate) struct Place {
    pub(crate) sensor: Sensor,
    /// Ids of the reconstructions.
    pub(crate) methods: Vec<String>,
    /// Length of the window, such as `250ms`.
    pub(crate) window: String,
    pub(crate) seen: Vec<Seen>,
}

/// A place on one drive.
#[derive(Debug)]
pub(crate) struct Seen {
    pub(crate) pass: StreetPass,
    pub(crate) tick: u64,
    /// Where the camera was at the start of the tick, metres along the street.
    pub(crate) along_m: f64,
    /// Per method; `None` where the window had no events.
    pub(crate) frames: Vec<Option<Frame>>,
}

/// Looks at the place of the map that the drives of `queries`, each with its plan and positions, come nearest to at the
/// start of a tick; `mapping` is the plan of the drive that was mapped. The place lies in the first third of the street,
/// as the street cannot be entered in its middle.
///
/// # Errors
/// When there is no such place, or a drive cannot be simulated.
pub(crate) fn look(mapping: &Plan, queries: &[(StreetPass, &Plan, &Positions)]) -> Result<Place, Failure> {
    let positions: Vec<&Positions> = queries.iter().map(|(_, _, positions)| *positions).collect();
    let place = common_place(&positions).ok_or_else(|| Failure::new("the drives have no place in common"))?;
    let window = mapping.slicing.windows.len().saturating_sub(1).min(1);
    let mut drives = vec![(StreetPass::Day, mapping, place.reference)];
    drives.extend(
        queries
            .iter()
            .zip(&place.queries)
            .map(|((pass, plan, _), tick)| (*pass, *plan, *tick)),
    );
    let frames: Result<Vec<_>, Failure> = std::thread::scope(|scope| {
        // Threads of their own: the simulation needs rayon's, which must not wait for it.
        let start = |(_, plan, tick): &(StreetPass, &Plan, usize)| {
            let (plan, tick) = ((*plan).clone(), *tick as u64);
            scope.spawn(move || {
                let all = 0..plan.reconstructions.len();
                let mut frames = frames_of(&plan, all, &[tick], window)?;
                Ok(frames.pop().unwrap_or_default())
            })
        };
        let threads: Vec<_> = drives.iter().map(start).collect();
        let joined = threads.into_iter().map(std::thread::ScopedJoinHandle::join);
        joined
            .map(|frames| frames.unwrap_or_else(|_| Err(Failure::new("making frames panicked"))))
            .collect()
    });
    let seen = drives.iter().zip(frames?).zip(place.along_m);
    Ok(Place {
        sensor: mapping.sensor,
        methods: mapping.reconstructions.iter().map(|r| r.id.clone()).collect(),
        window: mapping.slicing.window_id(window),
        seen: seen
            .map(|(((pass, _, tick), frames), along_m)| Seen {
                pass: *pass,
                tick: *tick as u64,
                along_m,
                frames,
            })
            .collect(),
    })
}

/// A place that several drives come by.
struct CommonPlace {
    reference: usize,
    queries: Vec<usize>,
    /// Metres along the street of the reference and of each query.
    along_m: Vec<f64>,
}

/// The reference, not at the very start, that all queries come nearest to.
fn common_place(drives: &[&Positions]) -> Option<CommonPlace> {
    let references = &drives.first()?.references;
    let nearest = |reference: usize| {
        let at = references[reference];
        let near = drives.iter().map(|positions| positions.nearest_query(at));
        let near: Option<Vec<(usize, f64)>> = near.collect();
        near.map(|near| (reference, near))
    };
    let far = |near: &[(usize, f64)]| near.iter().map(|(_, distance_m)| distance_m).sum::<f64>();
    let (reference, near) = (references.len() / 8..references.len().div_ceil(3))
        .filter_map(nearest)
        .min_by(|a, b| far(&a.1).total_cmp(&far(&b.1)))?;
    let queries: Vec<usize> = near.into_iter().map(|(query, _)| query).collect();
    let of_queries = queries
        .iter()
        .zip(drives)
        .map(|(query, positions)| positions.queries[*query][0]);
    Some(CommonPlace {
        along_m: std::iter::once(references[reference][0])
            .chain(of_queries)
            .collect(),
        reference,
        queries,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_common_place_is_the_nearest_of_all_drives() {
        let along = |metres: &[f64]| metres.iter().map(|m| [*m, 0.0]).collect::<Vec<_>>();
        let references = along(&[0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0]);
        let drive = |queries: &[f64]| Positions {
            references: references.clone(),
            queries: along(queries),
        };
        // 0 m fits best, but is the very start; 30 m and more are beyond the first third.
        let (a, b) = (drive(&[0.0, 7.0, 19.0, 30.0]), drive(&[0.0, 14.0, 20.5, 30.0]));
        let place = common_place(&[&a, &b]).unwrap();
        assert_eq!((place.reference, place.queries), (2, vec![2, 2]));
        assert_eq!(place.along_m, [20.0, 19.0, 20.5]);
        assert!(common_place(&[]).is_none());
        assert!(common_place(&[&drive(&[])]).is_none());
    }
}
