//! What a receiver checks before it uses a message: that the plan has such a sender for it, and that sizes, indices and
//! codes are ones that the plan can have made. Whoever writes into a channel by mistake or by malice is refused here.

use super::{
    Candidate, ChannelOrder, ChunkHeader, ControlHeader, DescriptorHeader, Event, FrameHeader, FuseSettings,
    LifecycleHeader, MatchHeader, MemberCost, MemberSetting, ScoresHeader, ServiceHealth, ServicePhase,
    ServiceState, Span, SpanKind, SpansHeader, Stamp, StatsHeader, TickHeader, TickKind,
};
use crate::member::{MAX_MEMBERS, MemberSet, Reason};
use crate::plan::{MAX_DEADLINE_NS, MAX_LENGTH, Plan, SCORE_COLUMNS};

/// Ticks below this exist: at ten per second, nine hundred thousand years of them.
pub const MAX_TICK: u64 = 1 << 48;

/// What is wrong with a message, in a few words.
pub type Refusal = &'static str;
type Checked = Result<(), Refusal>;

fn that(holds: bool, refusal: Refusal) -> Checked {
    if holds { Ok(()) } else { Err(refusal) }
}

fn sent_by(stamp: &Stamp, service: usize) -> Checked {
    that(
        stamp.service as usize == service && stamp.incarnation > 0,
        "it is not its sender's to send",
    )
}

fn tick_exists(tick: u64) -> Checked {
    that(tick < MAX_TICK, "there is no such tick")
}

/// A payload, or the reason why there is none.
fn whole_or_reason(reason: u32, items: usize, whole: usize) -> Checked {
    if reason == 0 {
        that(items == whole, "its payload is not as long as it should be")
    } else {
        that(Reason::from_code(reason).is_some(), "there is no such reason")?;
        that(items == 0, "it has a payload, and a reason for having none")
    }
}

fn of_the_plan(members: &MemberSet, plan: &Plan) -> Checked {
    let all = (plan.members.len()..MAX_MEMBERS).all(|m| !members.contains(m));
    that(all, "it names members that the plan does not have")
}

fn settings(fuse: &FuseSettings) -> Checked {
    let sound = fuse.length <= MAX_LENGTH
        && fuse.deadline_ns <= MAX_DEADLINE_NS
        && fuse.trim.is_finite()
        && (0.0..=1.0).contains(&fuse.min_confidence)
        && fuse.sets_min_confidence <= 1;
    that(sound, "the fuser's settings are out of range")
}

pub(super) fn chunk(plan: &Plan, header: &ChunkHeader, events: &[Event]) -> Checked {
    sent_by(&header.stamp, 0)?;
    tick_exists(header.tick)?;
    of_the_plan(&header.members, plan)?;
    that(
        events.len() <= plan.chunk_events(),
        "it has more events than a chunk",
    )?;
    let windows = plan.slicing.windows.len();
    that(
        u64::from(header.closes) < 1 << windows.min(32),
        "it closes windows that the plan does not have",
    )
}

pub(super) fn frame(plan: &Plan, header: &FrameHeader, levels: &[u8]) -> Checked {
    let index = header.reconstruction as usize;
    let reconstruction = plan
        .reconstructions
        .get(index)
        .ok_or("there is no such reconstruction")?;
    sent_by(&header.stamp, plan.reconstruct_service(index))?;
    tick_exists(header.tick)?;
    that(
        (header.window as usize) < plan.slicing.windows.len(),
        "there is no such window",
    )?;
    let size = (header.height as usize, header.width as usize);
    that(
        header.reason != 0 || size == (plan.sensor.height, plan.sensor.width),
        "it is not as large as the sensor",
    )?;
    let order = ChannelOrder::from_code(header.channel_order).ok_or("there is no such order of channels")?;
    // Grey images come from sources of coloured ones too.
    that(
        order.channels() <= reconstruction.channels,
        "it has more channels than the reconstruction",
    )?;
    let levels_of_all = plan.sensor.pixels() * order.channels();
    whole_or_reason(header.reason, levels.len(), levels_of_all)
}

pub(super) fn descriptor(plan: &Plan, header: &DescriptorHeader, row: &[f32]) -> Checked {
    let member = plan.members.get(header.member as usize);
    let member = member.ok_or("there is no such member")?;
    sent_by(&header.stamp, plan.extract_service(member.extractor))?;
    that(
        header.reconstruct_service as usize == plan.reconstruct_service(member.reconstruction),
        "it was made of another member's frame",
    )?;
    tick_exists(header.tick)?;
    let dim = plan.extractors.get(member.extractor).map_or(0, |e| e.dim);
    that(
        header.reason != 0 || header.dim as usize == dim,
        "it is not as long as the plan's rows",
    )?;
    whole_or_reason(header.reason, row.len(), dim)
}

pub(super) fn tick(plan: &Plan, header: &TickHeader, weights: &[f64]) -> Checked {
    sent_by(&header.stamp, 0)?;
    let kind = TickKind::from_code(header.kind).ok_or("there is no such kind of tick message")?;
    that(header.tick <= MAX_TICK, "there is no such tick")?;
    of_the_plan(&header.members, plan)?;
    settings(&header.fuse)?;
    that(
        kind != TickKind::Open || header.start_us <= header.end_us,
        "its tick ends before it begins",
    )?;
    let wanted = if kind == TickKind::Open {
        plan.members.len()
    } else {
        0
    };
    that(weights.len() == wanted, "it has not one weight per member")?;
    that(
        weights.iter().all(|w| w.is_finite() && *w >= 0.0),
        "a weight is no weight",
    )
}

pub(super) fn scores(plan: &Plan, header: &ScoresHeader, values: &[f32]) -> Checked {
    let fuse = plan.fuse_service().ok_or("the plan has no fuser")?;
    sent_by(&header.stamp, fuse)?;
    tick_exists(header.tick)?;
    let columns = header.columns as usize;
    that(
        columns <= SCORE_COLUMNS && u64::from(header.columns) <= header.references,
        "it has more columns than there can be",
    )?;
    that(
        values.len() == columns + plan.members.len(),
        "its payload is not as long as it should be",
    )
}

pub(super) fn matched(plan: &Plan, header: &MatchHeader, candidates: &[Candidate]) -> Checked {
    let fuse = plan.fuse_service().ok_or("the plan has no fuser")?;
    sent_by(&header.stamp, fuse)?;
    tick_exists(header.tick)?;
    let wanted = (header.candidates as usize).max(1);
    that(
        candidates.len() == wanted,
        "its payload is not as long as it should be",
    )?;
    let reason = header.reason == 0 || Reason::from_code(header.reason).is_some();
    that(reason, "there is no such reason")?;
    let place = header.reference >= 0 && header.reason == 0 && header.candidates > 0;
    that(
        place || header.reference == -1,
        "it has a place, and a reason for having none",
    )
}

pub(super) fn control(plan: &Plan, header: &ControlHeader, members: &[MemberSetting]) -> Checked {
    sent_by(&header.stamp, Stamp::SUPERVISOR as usize)?;
    settings(&header.fuse)?;
    that(
        members.len() == plan.members.len(),
        "it has not one setting per member",
    )?;
    that(
        members.iter().all(|m| m.weight.is_finite() && m.weight >= 0.0),
        "a weight is no weight",
    )
}

pub(super) fn lifecycle(plan: &Plan, header: &LifecycleHeader, states: &[ServiceState]) -> Checked {
    sent_by(&header.stamp, Stamp::SUPERVISOR as usize)?;
    that(
        states.len() == plan.service_count(),
        "it has not one state per process",
    )?;
    that(
        states.iter().all(|s| s.health <= ServiceHealth::Down as u32),
        "there is no such state",
    )
}

pub(super) fn stats(plan: &Plan, header: &StatsHeader, costs: &[MemberCost]) -> Checked {
    let stamp = &header.stamp;
    that(
        (stamp.service as usize) < plan.service_count() && stamp.incarnation > 0,
        "the plan has no such process",
    )?;
    that(header.next_tick <= MAX_TICK, "there is no such tick")?;
    that(
        header.phase <= ServicePhase::Stopped as u32,
        "there is no such phase",
    )?;
    that(
        costs.is_empty() || costs.len() == plan.members.len(),
        "it has not one cost per member",
    )
}

pub(super) fn spans(plan: &Plan, header: &SpansHeader, spans: &[Span]) -> Checked {
    let stamp = &header.stamp;
    that(
        (stamp.service as usize) < plan.service_count() && stamp.incarnation > 0,
        "the plan has no such process",
    )?;
    that(
        spans.iter().all(|s| SpanKind::from_code(s.kind).is_some()),
        "there is no such kind of span",
    )
}

#[cfg(test)]
mod tests {
    use super::super::{Chunks, Descriptors, Frames, Matches, Message, Stats, Ticks};
    use super::*;
    use crate::plan::test_plan;
    use proptest::prelude::*;

    fn stamp(service: usize) -> Stamp {
        Stamp {
            service: service as u32,
            incarnation: 1,
            ..Stamp::default()
        }
    }

    fn sound_row(plan: &Plan) -> DescriptorHeader {
        DescriptorHeader {
            stamp: stamp(plan.extract_service(0)),
            member: 1,
            dim: 3,
            reconstruct_service: plan.reconstruct_service(plan.members[1].reconstruction) as u32,
            ..DescriptorHeader::default()
        }
    }

    #[test]
    fn a_row_is_refused_for_whatever_is_wrong_with_it() {
        let plan = test_plan();
        let check = |change: fn(&mut DescriptorHeader), items: usize| {
            let mut header = sound_row(&plan);
            change(&mut header);
            Descriptors::check(&plan, &header, &vec![0.5; items])
        };
        assert_eq!(check(|_| {}, 3), Ok(()));
        assert_eq!(check(|h| h.reason = Reason::Late as u32, 0), Ok(()));
        type Change = fn(&mut DescriptorHeader);
        let wrong: [(Change, usize); 9] = [
            (|_| {}, 2),
            (|h| h.dim = 2, 2),
            (|h| h.reason = Reason::Late as u32, 3),
            (|h| h.reason = 999, 0),
            (|h| h.member = 2, 3),
            (|h| h.stamp.service = 0, 3),
            (|h| h.stamp.incarnation = 0, 3),
            (|h| h.reconstruct_service = 0, 3),
            (|h| h.tick = u64::MAX, 3),
        ];
        for (index, (change, items)) in wrong.into_iter().enumerate() {
            assert!(check(change, items).is_err(), "number {index}");
        }
    }

    #[test]
    fn an_opening_has_one_weight_per_member_and_nothing_else_has_any() {
        let plan = test_plan();
        let check = |kind: u32, weights: &[f64]| {
            let header = TickHeader {
                stamp: stamp(0),
                kind,
                ..TickHeader::default()
            };
            Ticks::check(&plan, &header, weights)
        };
        assert_eq!(check(0, &[1.0, 2.0]), Ok(()));
        assert_eq!(check(1, &[]), Ok(()));
        assert_eq!(check(2, &[]), Ok(()));
        for (kind, weights) in [
            (0, &[1.0][..]),
            (0, &[1.0, f64::NAN]),
            (0, &[1.0, -1.0]),
            (1, &[1.0, 2.0]),
            (3, &[]),
        ] {
            assert!(check(kind, weights).is_err(), "{kind} {weights:?}");
        }
    }

    #[test]
    fn an_answer_has_a_place_or_a_reason() {
        let plan = test_plan();
        let header = MatchHeader {
            stamp: stamp(plan.fuse_service().unwrap()),
            reference: 4,
            candidates: 2,
            ..MatchHeader::default()
        };
        let two = [Candidate::default(); 2];
        assert_eq!(Matches::check(&plan, &header, &two), Ok(()));
        assert!(Matches::check(&plan, &header, &two[..1]).is_err());
        let none = MatchHeader {
            reference: -1,
            candidates: 0,
            reason: Reason::NoRows as u32,
            ..header
        };
        assert_eq!(Matches::check(&plan, &none, &two[..1]), Ok(()));
        let both = MatchHeader { reason: 10, ..header };
        assert!(Matches::check(&plan, &both, &two).is_err());
    }

    proptest! {
        #[test]
        fn headers_of_any_numbers_are_judged_without_harm(
            words in prop::collection::vec(prop_oneof![0u32..5, any::<u32>()], 12), tick in any::<u64>(), items in 0usize..9,
        ) {
            let plan = test_plan();
            let stamp = Stamp { service: words[0], incarnation: words[1], items: words[2], ..Stamp::default() };
            let frame = FrameHeader {
                stamp, tick, reconstruction: words[3], window: words[4], height: words[5], width: words[6],
                reason: words[7], ..FrameHeader::default()
            };
            let accepted = Frames::check(&plan, &frame, &vec![0; items]).is_ok();
            prop_assert!(!accepted || (words[3] as usize) < plan.reconstructions.len());
            let chunk = ChunkHeader { stamp, tick, closes: words[8], segment: words[9], ..ChunkHeader::default() };
            let _ = Chunks::check(&plan, &chunk, &vec![Event::default(); items]);
            let stats = StatsHeader { stamp, phase: words[10], doing: words[11], next_tick: tick, ..StatsHeader::default() };
            let accepted = Stats::check(&plan, &stats, &vec![MemberCost::default(); items]).is_ok();
            prop_assert!(!accepted || (words[0] as usize) < plan.service_count() && tick <= MAX_TICK);
            prop_assert_eq!(plan.service_count(), plan.services().len());
        }
    }
}
