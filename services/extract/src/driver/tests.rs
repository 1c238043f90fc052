use super::*;
use crate::registry::KINDS;
use evpr_core::message::{Life, Stamp};
use evpr_core::plan::{Params, test_plan};
use evpr_core::stage::Kept;

/// 4×6 pixels, reconstructions `a` and `b` of one channel, extractor `x`: `patch_norm` 2×2.
fn plan() -> Plan {
    let mut plan = test_plan();
    plan.extractors[0].kind = "patch_norm".to_owned();
    plan.extractors[0].params = params(&[("side", 2), ("patch", 2)]);
    plan.extractors[0].dim = 4;
    plan
}

fn params(values: &[(&str, i64)]) -> Params {
    use evpr_core::plan::ParamValue::Integer;
    Params(
        values
            .iter()
            .map(|(k, v)| ((*k).to_owned(), Integer(*v)))
            .collect(),
    )
}

fn frame(reconstruction: u32) -> FrameHeader {
    FrameHeader {
        stamp: Stamp {
            service: reconstruction.wrapping_add(1),
            incarnation: 3,
            seq: 99,
            ..Stamp::default()
        },
        tick: 7,
        events: 5,
        life: Life {
            closed_ns: 10,
            reconstruct_started_ns: 11,
            reconstructed_ns: 12,
            ..Life::default()
        },
        epoch: 2,
        reconstruction,
        height: 4,
        width: 6,
        extractors: 1,
        ..FrameHeader::default()
    }
}

const PIXELS: [u8; 24] = [
    1, 2, 3, 4, 5, 6, 9, 9, 9, 4, 4, 4, 0, 0, 0, 1, 0, 2, 7, 8, 9, 3, 2, 1,
];

type Emitted = Vec<(DescriptorHeader, Vec<f32>)>;

fn process(stage: &mut Extract, header: &FrameHeader, pixels: &[u8]) -> (Emitted, Option<String>) {
    let mut kept = Kept::default();
    let skipped = stage
        .process(header, pixels, &mut kept)
        .err()
        .map(|error| error.to_string());
    (kept.messages, skipped)
}

#[test]
fn a_frame_becomes_a_row_of_its_member() {
    let mut stage = build(&plan(), 0).unwrap();
    let header = frame(1);
    let (emitted, skipped) = process(&mut stage, &header, &PIXELS);
    assert_eq!((emitted.len(), skipped), (1, None));
    let (got, row) = &emitted[0];
    let expected = DescriptorHeader {
        together: 1,
        tick: 7,
        life: header.life,
        epoch: 2,
        member: 1,
        dim: 4,
        reconstruct_service: 2,
        reconstruct_incarnation: 3,
        ..DescriptorHeader::default()
    };
    assert_eq!((got, row.len()), (&expected, 4));
    let length: f32 = row.iter().map(|v| v * v).sum();
    assert!((length - 1.0).abs() < 1e-6);
    assert!(row.iter().sum::<f32>().abs() < 1e-6);
}

#[test]
fn a_frame_for_others_gives_nothing() {
    let mut stage = build(&plan(), 0).unwrap();
    let header = FrameHeader {
        extractors: 0b10,
        ..frame(0)
    };
    assert_eq!(process(&mut stage, &header, &PIXELS), (vec![], None));
    let mut kept = Kept::default();
    stage.skip_dropped(&header, &mut kept).unwrap();
    assert!(kept.messages.is_empty());
}

#[test]
fn a_frame_without_an_image_hands_its_reason_on() {
    let mut stage = build(&plan(), 0).unwrap();
    for reason in Reason::ALL {
        let header = FrameHeader {
            reason: reason.code(),
            ..frame(0)
        };
        let (emitted, skipped) = process(&mut stage, &header, &[]);
        assert_eq!((emitted.len(), skipped), (1, None));
        assert_eq!((emitted[0].0.reason, emitted[0].0.member), (reason.code(), 0));
        assert!(emitted[0].1.is_empty());
    }
}

#[test]
fn a_dropped_frame_says_so() {
    let mut stage = build(&plan(), 0).unwrap();
    let mut kept = Kept::default();
    stage.skip_dropped(&frame(1), &mut kept).unwrap();
    let (header, row) = &kept.messages[0];
    let got = (header.reason, header.member, header.tick, row.len());
    assert_eq!(got, (Reason::Dropped.code(), 1, 7, 0));
}

#[test]
fn a_frame_that_is_not_the_plans_fails_and_is_told() {
    let mut stage = build(&plan(), 0).unwrap();
    let good = frame(0);
    let bad = [
        (FrameHeader { height: 5, ..good }, 30, "5×6"),
        (FrameHeader { width: 5, ..good }, 20, "4×5"),
        (good, 23, "23 bytes"),
        (good, 0, "0 bytes"),
        (
            FrameHeader {
                channel_order: 1,
                ..good
            },
            72,
            "channel order 1",
        ),
        (
            FrameHeader {
                channel_order: 77,
                ..good
            },
            24,
            "channel order 77",
        ),
        (FrameHeader { reason: 1000, ..good }, 0, "code 1000"),
    ];
    for (header, bytes, what) in bad {
        let (emitted, skipped) = process(&mut stage, &header, &vec![1; bytes]);
        assert_eq!(emitted.len(), 1, "{what}");
        assert_eq!(emitted[0].0.reason, Reason::Failed.code(), "{what}");
        assert!(emitted[0].1.is_empty(), "{what}");
        let skipped = skipped.unwrap();
        assert!(skipped.contains(what) && skipped.contains("tick 7"), "{skipped}");
    }
    assert_eq!(process(&mut stage, &good, &PIXELS).1, None, "it goes on");
}

#[test]
fn a_frame_of_no_member_is_told_and_gives_nothing() {
    let mut one_member = plan();
    one_member.members.truncate(1);
    let mut stage = build(&one_member, 0).unwrap();
    let no_member = frame(1);
    let no_window = FrameHeader {
        window: 1,
        ..frame(0)
    };
    for header in [no_member, no_window, frame(2), frame(u32::MAX)] {
        let (emitted, skipped) = process(&mut stage, &header, &PIXELS);
        assert!(emitted.is_empty() && skipped.is_some());
        assert!(stage.skip_dropped(&header, &mut Kept::default()).is_err());
    }
}

#[test]
fn a_number_that_is_not_finite_fails() {
    struct Bad(f32);
    impl Kind for Bad {
        fn extract(&mut self, _: FrameView<'_>, row: &mut [f32]) {
            row.fill(1.0);
            row[2] = self.0;
        }
    }
    for value in [f32::NAN, f32::INFINITY] {
        let mut stage = build(&plan(), 0).unwrap();
        stage.engine = Engine::Kind(Box::new(Bad(value)), vec![0.0; stage.dim]);
        let (emitted, skipped) = process(&mut stage, &frame(0), &PIXELS);
        assert_eq!(
            (emitted[0].0.reason, emitted[0].1.len()),
            (Reason::Failed.code(), 0)
        );
        assert!(skipped.unwrap().contains("number 2 of its row"));
    }
}

#[test]
fn plans_that_cannot_be_are_refused() {
    assert!(matches!(
        build(&plan(), 1),
        Err(BuildError::NoSuchExtractor { index: 1, count: 1 })
    ));
    let refused = |change: fn(&mut Plan)| {
        let mut plan = plan();
        change(&mut plan);
        build(&plan, 0).unwrap_err().to_string()
    };
    let unknown = refused(|p| p.extractors[0].kind = "no_such_kind".to_owned());
    for kind in &KINDS {
        assert!(unknown.contains(kind.name), "{unknown}");
    }
    assert!(refused(|p| p.extractors[0].dim = 5).contains("rows have 4 numbers, not 5"));
    assert!(refused(|p| p.extractors[0].params = Params::default()).contains("\"side\" is missing"));
    assert!(
        refused(|p| p.extractors[0].params = params(&[("side", 4), ("patch", 3)]))
            .contains("does not divide")
    );
    assert!(refused(|p| p.extractors[0].params = params(&[("side", 0), ("patch", 1)])).contains("side"));
    assert!(refused(|p| p.sensor.height = 0).contains("sensor"));
}
