use super::*;
use crate::Slicer;
use crate::testing::{KeptPort, Sent};
use crossbeam::channel::bounded;
use evpr_core::Reason;
use evpr_core::message::TickKind;
use evpr_core::plan::{Sensor, test_plan};
use evpr_events::RawEvent;

/// A plan of two windows in ticks of 1 ms, and a tape of it in a folder.
fn plan() -> (tempfile::TempDir, Plan) {
    let folder = tempfile::tempdir().unwrap();
    let mut plan = test_plan();
    plan.sensor = Sensor { height: 4, width: 6 };
    plan.slicing.windows = vec![500_000, 1_000_000];
    plan.record_events = Some(folder.path().join("t.aedat4"));
    (folder, plan)
}

fn events(from_us: u64, upto_us: u64) -> Vec<RawEvent> {
    let event = |t_us: u64| RawEvent {
        t_ns: t_us * 1_000,
        x: (t_us % 6) as u16,
        y: (t_us % 4) as u16,
        on: t_us.is_multiple_of(3),
    };
    (from_us..upto_us).step_by(7).map(event).collect()
}

/// What is sent of these events, and what of it stands on the tape of the plan.
fn record(plan: &Plan, first_tick: u64, epoch: u32, lost_at_us: u64, events: &[RawEvent]) -> KeptPort {
    let mut port = KeptPort::default();
    let recorder = Recorder::resume(plan).unwrap().unwrap();
    let mut taped = Taped::new(&mut port, &recorder);
    let mut slicer = Slicer::new(plan, first_tick, epoch);
    let at = events.partition_point(|e| e.t_ns < lost_at_us.saturating_mul(1_000));
    slicer.push(&events[..at], &mut taped).unwrap();
    if at < events.len() {
        slicer.lose(Reason::Disconnected);
        slicer.push(&events[at..], &mut taped).unwrap();
    }
    slicer.finish(&mut taped).unwrap();
    port
}

fn replay(plan: &Plan, first_tick: u64) -> (KeptPort, Result<(), String>) {
    let mut port = KeptPort::default();
    let tape = plan.record_events.clone().unwrap();
    let (_keep, stop) = bounded(0);
    let ingest = TapeIngest::new(&plan.clone().of_tape(tape), first_tick, 1, stop);
    let ran = ingest
        .map_err(|e| e.to_string())
        .and_then(|i| i.run(&mut port).map_err(|e| e.to_string()));
    (port, ran)
}

/// A message without its host times and epoch, which are those of the replay.
fn plain(sent: &Sent) -> Sent {
    match sent.clone() {
        Sent::Chunk(mut header, events) => {
            (header.epoch, header.closed_ns) = (0, 0);
            Sent::Chunk(header, events)
        }
        Sent::Tick(mut header, weights) => {
            (header.epoch, header.closed_ns) = (0, 0);
            if header.kind == TickKind::End as u32 {
                (header.start_us, header.end_us, header.members) = Default::default();
            }
            Sent::Tick(header, weights)
        }
    }
}

fn plains(port: &KeptPort) -> Vec<Sent> {
    port.sent.iter().map(plain).collect()
}

#[test]
fn what_was_sent_is_sent_again() {
    let (_folder, plan) = plan();
    let tape = plan.record_events.clone().unwrap();
    create(&tape, &plan).unwrap();
    let sent = record(&plan, 0, 1, 1_003_300, &events(1_000_000, 1_009_500));
    assert!(
        sent.chunks()
            .any(|(header, _)| header.loss() == Some(Reason::Disconnected))
    );
    let (again, ran) = replay(&plan, 0);
    assert_eq!(ran, Ok(()));
    assert_eq!(plains(&again), plains(&sent));
    assert_eq!(read_head(&tape).unwrap().plan, plan);
    // From the middle: what comes before is left out.
    let (again, ran) = replay(&plan, 4);
    assert_eq!(ran, Ok(()));
    let later = |sent: &Sent| match sent {
        Sent::Chunk(header, _) => header.tick >= 4,
        Sent::Tick(header, _) => header.tick >= 4,
    };
    let expected: Vec<Sent> = plains(&sent).into_iter().filter(later).collect();
    assert_eq!(plains(&again), expected);
}

#[test]
fn wherever_a_tape_is_cut_the_ticks_before_are_whole() {
    let (_folder, plan) = plan();
    let tape = plan.record_events.clone().unwrap();
    create(&tape, &plan).unwrap();
    let sent = plains(&record(&plan, 0, 1, u64::MAX, &events(1_000_000, 1_006_000)));
    let (ticks, bytes) = (ticks_path(&tape), std::fs::read(&tape).unwrap());
    let lines = std::fs::read(&ticks).unwrap();
    let begin = lines
        .iter()
        .enumerate()
        .filter(|(_, b)| **b == b'\n')
        .nth(2)
        .unwrap()
        .0
        + 1;
    let mut longest = 0;
    for cut in (begin..=lines.len()).step_by(11).chain([lines.len()]) {
        std::fs::write(&ticks, &lines[..cut]).unwrap();
        // Of the events there is what was committed, and the beginning of more.
        let committed = Lines::open(&tape).unwrap().whole().1;
        let more = bytes.len().min(committed.bytes as usize + cut % 50);
        std::fs::write(&tape, &bytes[..more]).unwrap();
        if committed.events == 0 {
            continue;
        }
        let (again, ran) = replay(&plan, 0);
        assert_eq!(ran, Ok(()), "cut at {cut}");
        let mut again = plains(&again);
        // The end is that of what is left.
        assert!(matches!(again.pop(), Some(Sent::Tick(end, _)) if end.kind == TickKind::End as u32));
        assert_eq!(again[..], sent[..again.len()], "cut at {cut}");
        longest = longest.max(again.len());
        // It can be gone on with, too.
        drop(Recorder::resume(&plan).unwrap());
        assert_eq!(Lines::open(&tape).unwrap().whole().1.events, committed.events);
    }
    assert_eq!(longest, sent.len() - 1);
}

#[test]
fn ticks_that_are_not_on_the_tape_are_sent_as_lost() {
    let (_folder, plan) = plan();
    let tape = plan.record_events.clone().unwrap();
    create(&tape, &plan).unwrap();
    // One life up to the middle of tick 3, and another from tick 5 on.
    record(&plan, 0, 1, u64::MAX, &events(0, 3_200));
    record(&plan, 5, 2, u64::MAX, &events(0, 8_000));
    let (again, ran) = replay(&plan, 0);
    assert_eq!(ran, Ok(()));
    let ticks: Vec<(TickKind, u64, u64)> = again
        .ticks()
        .map(|(kind, h)| (kind, h.tick, h.start_us))
        .collect();
    let expected: Vec<_> = (0..7)
        .flat_map(|t| [(TickKind::Open, t, t * 1_000), (TickKind::Close, t, t * 1_000)])
        .collect();
    assert_eq!(ticks[..expected.len()], expected[..]);
    let lost: Vec<(u64, u32)> = again
        .chunks()
        .filter(|(header, _)| header.loss() == Some(Reason::Lost))
        .map(|(header, _)| (header.tick, header.segment))
        .collect();
    assert_eq!(lost, [(3, 0), (3, 1), (4, 0), (4, 1)]);
    let epochs: Vec<u32> = again.ticks().map(|(_, header)| header.epoch).collect();
    assert!(epochs.is_sorted() || epochs.last() == Some(&0), "{epochs:?}");
}

#[test]
fn nonsense_on_a_tape_is_refused_and_what_was_before_stands() {
    let (_folder, plan) = plan();
    let tape = plan.record_events.clone().unwrap();
    create(&tape, &plan).unwrap();
    record(&plan, 0, 1, u64::MAX, &events(0, 4_100));
    let ticks = ticks_path(&tape);
    let text = std::fs::read_to_string(&ticks).unwrap();
    for (from, to) in [
        ("{\"close\":{\"tick\":2}}", "{\"close\":{\"tick\":9}}"),
        ("{\"close\":{\"tick\":2}}", "{\"clothes\":2}"),
        (
            "{\"close\":{\"tick\":2}}",
            "{\"chunk\":{\"segment\":7,\"flags\":0,\"closes\":0,\"base_us\":0,\"events\":0}}",
        ),
        (
            "{\"close\":{\"tick\":2}}",
            "{\"chunk\":{\"segment\":0,\"flags\":0,\"closes\":0,\"base_us\":0,\"events\":60000}}",
        ),
        ("\"base_us\":2000", "\"base_us\":9000"),
        (
            "{\"open\":{\"tick\":2,",
            "{\"open\":{\"tick\":18446744073709551615,",
        ),
        ("\"members\":[0,1]", "\"members\":[0,200]"),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&ticks, text.replacen(from, to, 1)).unwrap();
        let (again, ran) = replay(&plan, 0);
        let why = ran.unwrap_err();
        assert!(
            why.contains("the tape is damaged") && why.lines().count() == 1,
            "{why}"
        );
        let (last, _) = again.ticks().last().unwrap();
        assert_eq!(last, TickKind::End, "{from}");
    }
}
