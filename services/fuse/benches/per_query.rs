//! Time per query and member of similarity and sequence matching, as ratios to one plain read of the map's rows on
//! the same threads: `cargo bench -p evpr-fuse --bench per_query`.

use evpr_core::plan::{SequenceMethod, Similarity};
use evpr_fuse::{SequenceMatcher, similarity::similarity};
use rayon::prelude::*;
use std::hint::black_box;
use std::time::Instant;

const DIM: usize = 1024;
const LENGTH: usize = 30;

fn main() {
    for threads in [1, rayon::current_num_threads()] {
        match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
            Ok(pool) => pool.install(|| measure(threads)),
            Err(error) => eprintln!("no pool of {threads} threads: {error}"),
        }
    }
}

fn measure(threads: usize) {
    println!("D = {DIM}, L = {LENGTH}, {threads} threads; times in ms, ratios to the read");
    println!(
        "{:>9} {:>9} {:>9} {:>16} {:>16} {:>16} {:>16} {:>16} {:>6}",
        "R", "MB", "read", "l2", "l2_squared", "cosine", "sad", "matching", "l2+m"
    );
    for references in [1_000, 10_000, 100_000] {
        let rows: Vec<f32> = (0..references * DIM).map(value).collect();
        let query: Vec<f32> = (0..DIM).map(|i| value(i * 31 + 5)).collect();
        let valid = vec![true; references];
        let (mut out, mut scores) = (vec![0.0; references], vec![0.0; references]);
        let repeats = (40_000_000 / rows.len()).clamp(7, 101);
        let read = median_ms(repeats, || {
            black_box(plain_read(black_box(&rows)));
        });
        let kinds = [
            Similarity::L2,
            Similarity::L2Squared,
            Similarity::Cosine,
            Similarity::Sad,
        ]
        .map(|kind| {
            median_ms(repeats, || {
                similarity(kind, black_box(&query), &rows, &valid, &mut out)
            })
        });
        let mut matcher = SequenceMatcher::new(SequenceMethod::Paper, LENGTH, &valid);
        for t in 0..LENGTH {
            let row: Vec<f64> = (0..references)
                .map(|j| f64::from(value(t * 7919 + j * 3)))
                .collect();
            matcher.push(Some(&row));
        }
        let matching = median_ms(repeats, || {
            matcher.push(Some(&out));
            matcher.score(black_box(&mut scores));
        });
        let ratio = |ms: f64| format!("{ms:.3} ({:.2})", ms / read);
        println!(
            "{references:>9} {:>9.1} {read:>9.3} {:>16} {:>16} {:>16} {:>16} {:>16} {:>6.2}",
            (rows.len() * 4) as f64 / 1e6,
            ratio(kinds[0]),
            ratio(kinds[1]),
            ratio(kinds[2]),
            ratio(kinds[3]),
            ratio(matching),
            (kinds[0] + matching) / read
        );
    }
}

/// Reads every value once.
fn plain_read(rows: &[f32]) -> u32 {
    rows.par_chunks(1 << 16)
        .map(|block| {
            let mut lanes = [0u32; 32];
            for chunk in block.as_chunks::<32>().0 {
                for (lane, v) in lanes.iter_mut().zip(chunk) {
                    *lane = lane.wrapping_add(v.to_bits());
                }
            }
            lanes.iter().fold(0u32, |sum, v| sum.wrapping_add(*v))
        })
        .reduce(|| 0, u32::wrapping_add)
}

fn median_ms(repeats: usize, mut run: impl FnMut()) -> f64 {
    run();
    let mut times: Vec<f64> = (0..repeats)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[repeats / 2]
}

/// Noise that is the same every time.
fn value(i: usize) -> f32 {
    let h = (i as u32).wrapping_mul(2_654_435_761);
    let h = (h ^ (h >> 15)).wrapping_mul(2_246_822_519);
    (h >> 8) as f32 / (1 << 23) as f32 - 1.0
}
