//! A settled tick in few numbers: what can be drawn of it.

use crate::fuser::FusedTick;

/// Writes the payload of [`evpr_core::message::ScoresHeader`]: of each of `columns` shares of the places the highest
/// fused score, NaN where none is eligible; then per member, by its index, the place of its own highest score, −1 without
/// a row. `out` has `columns` values and one per member of the plan; `columns` is at most the number of places.
pub fn write_overview(tick: &FusedTick<'_>, columns: usize, out: &mut [f32]) {
    let places = tick.fused.len();
    let edge = |column: usize| column * places / columns.max(1);
    let (shares, best) = out.split_at_mut(columns.min(out.len()));
    for (column, highest) in shares.iter_mut().enumerate() {
        let share = edge(column)..edge(column + 1);
        let scores = tick.fused[share.clone()].iter().zip(&tick.eligible[share]);
        let eligible = scores.filter(|(_, eligible)| **eligible).map(|(score, _)| *score);
        *highest = eligible.fold(f64::NAN, f64::max) as f32;
    }
    best.fill(-1.0);
    for member in tick.members {
        if let Some(slot) = best.get_mut(member.member) {
            *slot = best_place(member.similarity, member.scores).map_or(-1.0, |place| place as f32);
        }
    }
}

/// The first place with the highest score among those that the map has a row for.
fn best_place(similarity: &[f64], scores: &[f64]) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for (place, (known, score)) in similarity.iter().zip(scores).enumerate() {
        if !known.is_nan() && best.map_or(*score > f64::NEG_INFINITY, |(_, highest)| *score > highest) {
            best = Some((place, *score));
        }
    }
    best.map(|(place, _)| place)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuser::FusedMember;

    fn overview(fused: &[f64], eligible: &[bool], members: &[FusedMember<'_>], columns: usize) -> Vec<f32> {
        let mut out = vec![7.0; columns + 3];
        let tick = FusedTick {
            tick: 5,
            members,
            fused,
            eligible,
        };
        write_overview(&tick, columns, &mut out);
        out
    }

    #[test]
    fn shares_have_their_highest_score_and_members_their_own_place() {
        let fused = [1.0, 5.0, 2.0, -1.0, 9.0];
        let eligible = [true, true, true, true, false];
        let similarity = [0.0, f64::NAN, 0.0, 0.0, 0.0];
        let member = |member, scores| FusedMember {
            member,
            weight: 1.0,
            similarity: &similarity,
            scores,
        };
        let (a, b) = ([0.0, 9.0, 3.0, 3.0, 1.0], [f64::NAN; 5]);
        let members = [member(0, &a[..]), member(2, &b[..])];
        let got = overview(&fused, &eligible, &members, 2);
        assert_eq!(got, [5.0, 2.0, 2.0, -1.0, -1.0]);
        let each = overview(&fused, &eligible, &[], 5);
        assert_eq!(each[..4], [1.0, 5.0, 2.0, -1.0]);
        assert!(each[4].is_nan(), "a place that cannot be the answer has no score");
        assert_eq!(each[5..], [-1.0; 3]);
    }

    #[test]
    fn a_tick_that_only_builds_history_has_no_columns() {
        assert_eq!(overview(&[], &[], &[], 0), [-1.0; 3]);
    }
}
