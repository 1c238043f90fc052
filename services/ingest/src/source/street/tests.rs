//! Whole drives, as recordings.

use super::*;
use crate::testing::KeptPort;
use crate::{Ingest, open, probe};
use evpr_core::plan::{Source, StreetPass, test_plan};

const SMALL: Sensor = Sensor {
    height: 24,
    width: 32,
};

/// 60 m at 15 m/s: 4 s, or about 10 s with the stop.
fn street(pass: StreetPass) -> plan::Street {
    plan::Street {
        pass,
        length_m: 60.0,
        speed_m_s: 15.0,
        sensor: SMALL,
        ..plan::Street::default()
    }
}

fn events(street: &plan::Street) -> Vec<RawEvent> {
    let mut recording = open(&Source::street(street.clone())).unwrap();
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    while recording.next_batch(&mut batch).unwrap() {
        assert!(!batch.is_empty() && batch.len() <= BATCH_EVENTS);
        all.extend_from_slice(&batch);
    }
    assert_eq!(recording.progress_permille(), 1_000);
    assert!(!recording.next_batch(&mut batch).unwrap() && batch.is_empty());
    all
}

/// With bands of so many pixels, straight from the simulator.
fn banded(street: &plan::Street, band_pixels: usize) -> Vec<RawEvent> {
    let mut simulator = Simulator::with_bands(street, band_pixels);
    let (mut all, mut step) = (Vec::new(), Vec::new());
    while simulator.step(&mut step) {
        all.extend_from_slice(&step);
    }
    all
}

#[test]
fn equal_streets_give_equal_events_however_they_are_simulated() {
    for pass in StreetPass::ALL {
        let street = street(pass);
        let all = events(&street);
        assert!(all.len() > 1_000, "{}", all.len());
        // Bands of one column, of some columns, and one band, which takes no further threads.
        for band_pixels in [1, 24 * 5, 1 << 20] {
            assert!(
                banded(&street, band_pixels) == all,
                "{pass:?}, bands of {band_pixels}"
            );
        }
        let threads = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        assert!(threads.install(|| banded(&street, 24 * 4)) == all);
    }
}

#[test]
fn seeds_and_passes_differ() {
    let day = events(&street(StreetPass::Day));
    let day2 = events(&street(StreetPass::Day2));
    let night = events(&street(StreetPass::Night));
    assert!(day != day2 && day2 != night && day != night);
    let other = plan::Street {
        seed: 2,
        ..street(StreetPass::Day)
    };
    assert!(events(&other) != day);
}

#[test]
fn events_come_in_the_order_of_time_and_within_the_sensor() {
    for pass in StreetPass::ALL {
        let all = events(&street(pass));
        let ordered = all.windows(2).all(|e| {
            let place = |e: &RawEvent| (e.t_ns, e.y, e.x);
            place(&e[0]) < place(&e[1])
        });
        assert!(ordered, "by time, and then by pixel");
        assert!(all.iter().all(|e| e.x < 32 && e.y < 24 && e.t_ns % 1_000 == 0));
        let end_s = Drive::new(&street(pass)).duration_s();
        let last_s = all.last().unwrap().t_ns as f64 / 1e9;
        assert!(last_s < end_s && last_s > end_s - 0.1, "{last_s} of {end_s}");
        let on = all.iter().filter(|e| e.on).count() as f64 / all.len() as f64;
        assert!((0.3..0.7).contains(&on), "{on}");
    }
}

#[test]
fn rates_are_those_of_a_drive() {
    // Events per pixel and second over the drive, and of the second in which the car stands.
    let rates = |pass| {
        let street = street(pass);
        let drive = Drive::new(&street);
        let all = events(&street);
        let rate = |from: f64, to: f64| {
            let within = |e: &&RawEvent| (from..to).contains(&(e.t_ns as f64 / 1e9));
            all.iter().filter(within).count() as f64 / (SMALL.pixels() as f64 * (to - from))
        };
        let standing = (0..120)
            .map(|i| f64::from(i) * 0.1)
            .find(|t| drive.along_m(t + 1.0) - drive.along_m(*t) < 1e-6);
        (rate(0.0, 2.0), standing.map(|t| rate(t, t + 1.0)))
    };
    let (day, none) = rates(StreetPass::Day);
    assert!((3.0..60.0).contains(&day) && none.is_none(), "{day}");
    let (_, standing) = rates(StreetPass::Day2);
    assert!((1.0..8.0).contains(&standing.unwrap()), "{standing:?}");
    let (night, standing) = rates(StreetPass::Night);
    assert!((6.0..60.0).contains(&night), "{night}");
    assert!((8.0..25.0).contains(&standing.unwrap()), "{standing:?}");
}

#[test]
fn hot_pixels_are_the_same_in_all_passes() {
    // Large enough to have some: 200 × 200 × 5e-4 = 20.
    let sensor = Sensor {
        height: 200,
        width: 200,
    };
    let busiest = |pass| {
        let street = plan::Street {
            sensor,
            length_m: 20.0,
            speed_m_s: 40.0,
            ..street(pass)
        };
        let mut counts = vec![0u32; sensor.pixels()];
        let mut simulator = Simulator::new(&street);
        let mut step = Vec::new();
        for _ in 0..125 {
            simulator.step(&mut step);
            for e in &step {
                counts[usize::from(e.y) * sensor.width + usize::from(e.x)] += u32::from(e.on);
            }
        }
        let mut order: Vec<usize> = (0..counts.len()).collect();
        order.sort_by_key(|i| std::cmp::Reverse(counts[*i]));
        order.truncate(4);
        order
    };
    let (day, night) = (busiest(StreetPass::Day2), busiest(StreetPass::Night));
    assert!(day.iter().any(|pixel| night.contains(pixel)), "{day:?} {night:?}");
}

#[test]
fn the_trajectory_is_the_drive() {
    for pass in StreetPass::ALL {
        let source = Source::street(street(pass));
        let mut trajectory = open(&source).unwrap().trajectory().unwrap();
        let positions: Vec<[f64; 2]> = (0..120)
            .map(|i| trajectory.position(i * 100_000_000).unwrap())
            .collect();
        assert_eq!(positions[0][0], 0.0);
        assert!(positions.windows(2).all(|p| p[0][0] <= p[1][0]));
        let lateral_m = if pass == StreetPass::Day { -2.5 } else { -2.0 };
        assert!(positions.iter().all(|p| p[1] == lateral_m));
        let stands = positions.windows(2).any(|p| p[1][0] - p[0][0] < 1e-6);
        assert_eq!(stands, pass != StreetPass::Day);
    }
}

#[test]
fn ticks_of_a_street_carry_positions_and_a_resumed_run_is_the_rest() {
    let mut plan = test_plan();
    plan.source = Source::street(street(StreetPass::Night));
    plan.sensor = SMALL;
    (plan.slicing.tick, plan.slicing.windows) = (500_000_000, vec![100_000_000, 500_000_000]);
    let ran = |resume_tick| {
        let (_keep, stop) = crossbeam::channel::bounded(0);
        let mut port = KeptPort::default();
        let ingest = Ingest::new(&plan, resume_tick, 1, stop).unwrap();
        (ingest.run(&mut port).unwrap(), port)
    };
    let (summary, whole) = ran(0);
    assert!(summary.end_tick > 10);
    let drive = Drive::new(&street(StreetPass::Night));
    for (kind, header) in whole.ticks() {
        let expected = match kind {
            evpr_core::message::TickKind::Open => {
                Some([drive.along_m(header.start_us as f64 / 1e6), drive.lateral_m()])
            }
            _ => None,
        };
        assert_eq!(header.position(), expected);
    }
    let (_, rest) = ran(6);
    let later: Vec<_> = whole.segments().into_iter().filter(|s| s.0 >= 6).collect();
    assert!(rest.segments() == later);
}

#[test]
fn a_street_has_the_sensor_that_it_was_given_and_says_what_it_is() {
    let source = Source::street(street(StreetPass::Night));
    assert_eq!(probe(&source).unwrap(), Some(SMALL));
    let about = open(&source).unwrap().describe();
    assert_eq!(
        (about.format, about.path),
        ("street", PathBuf::from("street (night, seed 1)"))
    );
    let lost = Source {
        street: None,
        ..source
    };
    let message = open(&lost).err().unwrap().to_string();
    assert!(
        message.contains("\"street\" is not known, or incomplete"),
        "{message}"
    );
}
