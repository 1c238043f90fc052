//! Traverses of noise for tests.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used, clippy::panic)]

use evpr_core::Plan;
use evpr_core::plan::{Extractor, Member, Params, Rule, SequenceMethod, Similarity, test_plan};
use evpr_evaluate::{Pair, PairSpec, Spec, SubsetChoice, SubsetKind, Truth};
use evpr_store::{NewTraverse, TickRecord, TraverseWriter};
use ndarray::{Array3, Axis};
use std::path::{Path, PathBuf};

pub const DIMS: [usize; 4] = [5, 4, 6, 3];
pub const REFERENCES: usize = 23;
pub const QUERIES: usize = 30;

/// A plan of four members: two reconstructions times two extractors, of one window.
pub fn plan() -> Plan {
    let mut plan = test_plan();
    plan.extractors = DIMS
        .iter()
        .enumerate()
        .map(|(i, dim)| Extractor {
            id: format!("x{i}"),
            kind: "raw_pixels".into(),
            dim: *dim,
            params: Params::default(),
            optional: false,
            network: None,
        })
        .collect();
    plan.members = (0..DIMS.len())
        .map(|i| Member {
            name: format!("{}@1ms/{}", ["a", "b"][i / 2], ["x", "y"][i % 2]),
            reconstruction: i / 2,
            window: 0,
            extractor: i,
            enabled: true,
            weight: 1.0,
        })
        .collect();
    plan.fuse.exclusion = 2;
    plan
}

/// Noise in −1…1 that is the same every time.
pub fn noise(seed: usize, len: usize) -> Vec<f32> {
    let mut state = (seed as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1);
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..16).for_each(|_| {
        next();
    });
    (0..len).map(|_| next()).collect()
}

/// The place that a query is at: slower than the map at first.
pub fn place(query: usize) -> usize {
    (query * 4 / 5).min(REFERENCES - 1)
}

/// Writes a traverse; `row` gives a member's row at a tick, `position` where it is.
pub fn write(
    plan: &Plan,
    path: &Path,
    ticks: usize,
    row: impl Fn(usize, usize) -> Option<Vec<f32>>,
    position: impl Fn(usize) -> Option<[f64; 2]>,
) {
    let mut writer = TraverseWriter::create(path, NewTraverse::from_plan(plan)).unwrap();
    for tick in 0..ticks {
        let rows: Vec<Option<Vec<f32>>> = (0..plan.members.len()).map(|m| row(m, tick)).collect();
        let rows: Vec<Option<&[f32]>> = rows.iter().map(Option::as_deref).collect();
        let record = TickRecord {
            tick: tick as u64,
            start_us: tick as u64 * 1000,
            end_us: tick as u64 * 1000 + 1000,
            position: position(tick),
        };
        writer.append(&record, &rows).unwrap();
    }
    writer.close().unwrap();
}

/// The row of a map: the place's own noise.
pub fn map_row(member: usize, tick: usize) -> Option<Vec<f32>> {
    (!(tick + member).is_multiple_of(11)).then(|| noise(1000 * member + tick, DIMS[member]))
}

/// The row of a query: the place's noise with some of its own; the higher members have more of it.
pub fn query_row(member: usize, tick: usize) -> Option<Vec<f32>> {
    let place = noise(1000 * member + place(tick), DIMS[member]);
    let own = noise(77_777 + 1000 * member + tick, DIMS[member]);
    let share = 0.7 + 0.3 * member as f32;
    let row = place.iter().zip(own).map(|(p, o)| p + share * o).collect();
    (!(tick + member).is_multiple_of(7)).then_some(row)
}

/// Writes a map and a query with positions a metre apart, and gives their pair.
pub fn pair_in(folder: &Path) -> PairSpec {
    let plan = plan();
    let (reference, query) = (folder.join("map"), folder.join("query"));
    write(&plan, &reference, REFERENCES, map_row, |t| Some([t as f64, 0.0]));
    write(&plan, &query, QUERIES, query_row, |t| {
        Some([place(t) as f64, 0.25])
    });
    PairSpec::new(reference, query, Truth::Positions { tolerance_m: 1.1 })
}

pub fn spec() -> Spec {
    Spec {
        subsets: SubsetKind::PAPER.into_iter().map(SubsetChoice::Kind).collect(),
        similarities: vec![Similarity::L2],
        methods: vec![SequenceMethod::Paper, SequenceMethod::None],
        lengths: vec![3, 6],
        rules: vec![Rule::Sum],
        exclusion: 2,
        weights: None,
        memory_bytes: 1 << 30,
    }
}

pub fn open(spec: &PairSpec) -> Pair {
    Pair::open(spec, &[]).unwrap()
}

/// A folder of shared data, or a line that the test is skipped.
pub fn shared(test: &str, folder: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared")
        .join(folder);
    if !path.is_dir() {
        println!("skipped: {test}: {} is not there", path.display());
        return None;
    }
    Some(path)
}

/// Rows of `raw_pixels` 7×7 with `log1p`: mean 0, standard deviation 1, L2-normalised.
fn brisbane_rows(path: &Path) -> Vec<Vec<f32>> {
    let images: Array3<u8> = ndarray_npy::read_npy(path).unwrap();
    let row = |image: ndarray::ArrayView2<'_, u8>| {
        let v: Vec<f64> = image.iter().map(|p| f64::from(*p).ln_1p()).collect();
        let mean = v.iter().sum::<f64>() / 49.0;
        let sigma = (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 49.0).sqrt() + 1e-6;
        let z: Vec<f64> = v.iter().map(|x| (x - mean) / sigma).collect();
        let norm = z.iter().map(|x| x * x).sum::<f64>().sqrt();
        // An image of one level has a row of zeros.
        z.iter().map(|z| (z / norm.max(1e-12)) as f32).collect()
    };
    images.axis_iter(Axis(0)).map(row).collect()
}

/// Traverses of one member from the images of Brisbane-Event-VPR in `data`, and their pair.
pub fn brisbane(data: &Path, folder: &Path) -> PairSpec {
    let mut plan = plan();
    plan.members.truncate(1);
    plan.extractors.truncate(1);
    plan.extractors[0].dim = 49;
    for (name, file) in [("map", "reference_sunset2.npy"), ("query", "query_sunset1.npy")] {
        let rows = brisbane_rows(&data.join(file));
        write(
            &plan,
            &folder.join(name),
            rows.len(),
            |_, t| Some(rows[t].clone()),
            |_| None,
        );
    }
    let truth = Truth::File {
        path: data.join("ground_truth.csv"),
        tolerance_frames: 0,
        orientation: None,
    };
    PairSpec::new(folder.join("map"), folder.join("query"), truth)
}
