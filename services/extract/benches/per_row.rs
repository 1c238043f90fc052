//! Time per row of every kind, beside one plain read of the same frame in the same run:
//! `cargo bench -p evpr-extract --bench per_row`. One thread.

use evpr_core::message::{ChannelOrder, DescriptorHeader, Descriptors, FrameHeader};
use evpr_core::plan::{Params, Plan, Sensor, test_plan};
use evpr_core::stage::{Outlet, Stage, StageError};
use evpr_extract::{build, kinds};
use std::hint::black_box;
use std::time::Instant;

const REPEATS: usize = 101;

fn main() {
    for (height, width) in [(260, 346), (720, 1280)] {
        for order in [ChannelOrder::Grey, ChannelOrder::OffOnZero] {
            let sensor = Sensor { height, width };
            let pixels: Vec<u8> = (0..sensor.pixels() * order.channels()).map(level).collect();
            let read = median_ms(&mut || _ = black_box(plain_read(black_box(&pixels))));
            println!(
                "{width}×{height}, {} channels; plain read {read:.4} ms ({:.1} GB/s)",
                order.channels(),
                pixels.len() as f64 / read / 1e6
            );
            for kind in kinds() {
                let mut stage = match build(&plan(kind.name, sensor, order), 0) {
                    Ok(stage) => stage,
                    Err(error) => unreachable!("{error}"),
                };
                let header = FrameHeader {
                    height: height as u32,
                    width: width as u32,
                    channel_order: order as u32,
                    extractors: 1,
                    ..FrameHeader::default()
                };
                let mut outlet = Reused::default();
                let row = median_ms(&mut || {
                    if let Err(error) = stage.process(&header, black_box(&pixels), &mut outlet) {
                        eprintln!("{error}");
                    }
                });
                println!("{:>12} {row:>8.3} ms ({:.1} reads)", kind.name, row / read);
            }
        }
    }
}

/// An outlet with one buffer, as a slot of shared memory is used again and again.
#[derive(Default)]
struct Reused {
    buffer: Vec<f32>,
}

impl Outlet<Descriptors> for Reused {
    fn emit(
        &mut self,
        _header: DescriptorHeader,
        len: usize,
        fill: &mut dyn FnMut(&mut [f32]),
    ) -> Result<(), StageError> {
        self.buffer.resize(len, 0.0);
        fill(&mut self.buffer);
        black_box(&mut self.buffer);
        Ok(())
    }
}

/// An extractor of this kind with its defaults.
fn plan(kind: &str, sensor: Sensor, order: ChannelOrder) -> Plan {
    let mut plan = test_plan();
    plan.sensor = sensor;
    plan.reconstructions[0].channels = order.channels();
    for info in kinds().iter().filter(|k| k.name == kind) {
        let defaults = info.params.iter().map(|p| (p.name.to_owned(), p.default_value()));
        let params = Params(defaults.collect());
        plan.extractors[0].kind = kind.to_owned();
        plan.extractors[0].dim = (info.dim)(&params).unwrap_or(0);
        plan.extractors[0].params = params;
    }
    plan
}

/// Reads every byte once.
fn plain_read(pixels: &[u8]) -> u64 {
    let words = pixels
        .as_chunks::<8>()
        .0
        .iter()
        .map(|word| u64::from_le_bytes(*word));
    words.fold(0, u64::wrapping_add)
}

/// Levels that are the same every time.
fn level(i: usize) -> u8 {
    ((i as u32).wrapping_mul(2_654_435_761) >> 24) as u8
}

fn median_ms(run: &mut dyn FnMut()) -> f64 {
    run();
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[REPEATS / 2]
}
