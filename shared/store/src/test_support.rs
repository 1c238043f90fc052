//! Traverses for tests.

use crate::{NewMember, NewTraverse, TickRecord, TraverseWriter};
use evpr_core::plan::test_plan;
use std::path::Path;

/// A header with members `m0/x`, `m1/x`, … of these dimensions.
pub(crate) fn new_traverse(dims: &[usize]) -> NewTraverse {
    let members = dims.iter().enumerate().map(|(i, dim)| NewMember {
        name: format!("m{i}/x"),
        dim: *dim,
        fingerprint: [("dim".to_owned(), dim.to_string())].into(),
    });
    NewTraverse {
        members: members.collect(),
        ..NewTraverse::from_plan(&test_plan())
    }
}

/// Tick `tick`; every third has a position.
pub(crate) fn record(tick: u64) -> TickRecord {
    TickRecord {
        tick,
        start_us: 1_000 * tick,
        end_us: 1_000 * (tick + 1),
        position: tick.is_multiple_of(3).then_some([0.1 * tick as f64, -7.0]),
    }
}

/// The row of member `member` at `tick`: `dim` numbers, none of them 0.
pub(crate) fn row(member: usize, tick: u64, dim: usize) -> Vec<f32> {
    let value = |i| 1.0 + tick as f32 * 10.0 + member as f32 * 0.1 + i as f32 * 0.001;
    (0..dim).map(value).collect()
}

/// Appends a tick in which the members of `present` have a row.
pub(crate) fn append(writer: &mut TraverseWriter, dims: &[usize], present: &[bool]) {
    let tick = writer.next_tick();
    let rows: Vec<Option<Vec<f32>>> = dims
        .iter()
        .zip(present)
        .enumerate()
        .map(|(m, (dim, present))| present.then(|| row(m, tick, *dim)))
        .collect();
    let rows: Vec<Option<&[f32]>> = rows.iter().map(Option::as_deref).collect();
    writer.append(&record(tick), &rows).unwrap();
}

/// Whether member `member` has a row at `tick` in [`recorded`].
pub(crate) fn has_row(member: usize, tick: u64) -> bool {
    (tick + member as u64) % 4 != 1
}

/// A recording of so many ticks, still open.
pub(crate) fn recording(path: &Path, dims: &[usize], ticks: u64) -> TraverseWriter {
    let mut writer = TraverseWriter::create(path, new_traverse(dims)).unwrap();
    for tick in 0..ticks {
        let present: Vec<bool> = (0..dims.len()).map(|m| has_row(m, tick)).collect();
        append(&mut writer, dims, &present);
    }
    writer
}

/// Checks that the traverse is the first `ticks` ticks of [`recording`].
pub(crate) fn assert_is_prefix(traverse: &crate::Traverse, dims: &[usize], ticks: u64) {
    let records: Vec<TickRecord> = (0..ticks).map(record).collect();
    assert_eq!(traverse.ticks(), records);
    for (m, dim) in dims.iter().enumerate() {
        let rows = traverse.member(&format!("m{m}/x")).unwrap();
        assert_eq!((rows.dim(), rows.len()), (*dim, ticks as usize));
        assert_eq!(rows.rows().len(), rows.len() * dim);
        for tick in 0..ticks {
            assert_eq!(rows.present()[tick as usize], has_row(m, tick));
            let expected = if has_row(m, tick) {
                row(m, tick, *dim)
            } else {
                vec![0.0; *dim]
            };
            assert_eq!(rows.row(tick as usize), expected, "member {m}, tick {tick}");
        }
        assert!(rows.row(ticks as usize).is_empty());
    }
}
