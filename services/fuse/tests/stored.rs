//! Maps and queries from traverses on disk.
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use evpr_core::{MemberSet, Plan};
use evpr_fuse::offline::{Query, answers};
use evpr_fuse::{FuseError, Map};
use evpr_store::{NewTraverse, StoreError, TickRecord, TraverseWriter};
use std::path::Path;
use support::*;

const DIMS: [usize; 2] = [4, 3];
const TICKS: usize = 12;

fn present(tick: usize, member: usize) -> bool {
    (tick + member) % 5 != 3
}

/// Writes a traverse of noise with holes, and every other position.
fn write(plan: &Plan, path: &Path) {
    let mut writer = TraverseWriter::create(path, NewTraverse::from_plan(plan)).unwrap();
    for tick in 0..TICKS {
        let rows: Vec<Vec<f32>> = (0..2).map(|m| noise(tick * 2 + m, DIMS[m])).collect();
        let rows: Vec<Option<&[f32]>> = (0..2)
            .map(|m| present(tick, m).then_some(rows[m].as_slice()))
            .collect();
        let record = TickRecord {
            tick: tick as u64,
            start_us: tick as u64 * 1000,
            end_us: tick as u64 * 1000 + 1000,
            position: (tick % 2 == 0).then_some([tick as f64, 0.5]),
        };
        writer.append(&record, &rows).unwrap();
    }
    writer.close().unwrap();
}

#[test]
fn a_traverse_recognises_itself() {
    let folder = tempfile::tempdir().unwrap();
    let mut plan = plan(&DIMS, 1);
    plan.map = Some(folder.path().join("map"));
    write(&plan, &folder.path().join("map"));
    let map = Map::open(&plan).unwrap();
    assert_eq!(
        (map.references, map.position(4), map.position(5)),
        (TICKS, Some([4.0, 0.5]), None)
    );
    assert_eq!(map.position(TICKS), None);
    for (m, member) in map.members.iter().enumerate() {
        for tick in 0..TICKS {
            let want = present(tick, m).then(|| noise(tick * 2 + m, DIMS[m]));
            assert_eq!(member.row(tick).map(<[f32]>::to_vec), want);
        }
        assert_eq!(member.row(TICKS), None);
    }
    let query = Query::open(&plan, &folder.path().join("map")).unwrap();
    let on = |_: u64| (0..2).collect::<MemberSet>();
    for (header, _) in answers(&plan, map, &query, on).unwrap() {
        let want = header.tick as i64;
        assert_eq!((header.reference, header.start_us), (want, header.tick * 1000));
        assert_eq!(header.east_m.is_nan(), want % 2 == 1);
    }
}

#[test]
fn a_map_that_does_not_fit_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut plan = plan(&DIMS, 1);
    let path = folder.path().join("map");
    write(&plan, &path);
    plan.map = Some(folder.path().join("elsewhere"));
    assert!(matches!(
        Map::open(&plan),
        Err(FuseError::Store(StoreError::Missing(_)))
    ));
    plan.map = Some(path.clone());
    plan.sensor.width += 1;
    let refused = Map::open(&plan);
    assert!(matches!(
        refused,
        Err(FuseError::Store(StoreError::Mismatch { .. }))
    ));
    assert!(matches!(
        Query::open(&plan, &path),
        Err(FuseError::Store(StoreError::Mismatch { .. }))
    ));
    plan.map = None;
    assert!(matches!(Map::open(&plan), Err(FuseError::NoMap)));
}
