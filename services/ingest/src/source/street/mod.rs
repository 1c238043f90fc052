//! The simulated street: events without a recording.
//!
//! A camera drives along a street of houses, by day or by night. In each step a small ray-caster ([`render`]) makes a
//! picture of the street ([`scene`]) from where the camera then is ([`drive`]), and a model of the camera's pixels
//! ([`pixels`]) turns the change since the last picture into events. Houses come in nine kinds that repeat along the
//! street, so places resemble each other; house by house they vary. Everything is drawn from the seed and counters
//! ([`random`]): the same street gives the same events, whatever the number of threads.
//!
//! What the passes share: the street, the thresholds of the pixels, and the hot ones. What differs: noise, the speed,
//! the side of the lane, which windows are lit, and day or night.

mod drive;
mod houses;
mod pixels;
mod random;
mod render;
mod scene;
mod simulator;
mod sprites;
mod strip;
#[cfg(test)]
mod tests;
mod view;

use drive::Drive;
use evpr_core::plan::{self, Sensor};
use evpr_events::{BATCH_EVENTS, RawEvent, Recording, SourceError, SourceInfo, Trajectory};
use simulator::Simulator;
use std::path::{Path, PathBuf};

/// A drive along the street, as a recording. Times begin at 0 and are whole µs.
///
/// It cannot jump: to go on in the middle it simulates from the start.
pub(super) struct Street {
    simulator: Simulator,
    sensor: Sensor,
    drive: Drive,
    /// The events of the latest step, and how many of them have been handed out.
    step: Vec<RawEvent>,
    handed_out: usize,
    name: PathBuf,
}

impl Street {
    /// Builds the street; `name` is what it is called in messages.
    pub(super) fn new(street: &plan::Street, name: &Path) -> Self {
        Self {
            simulator: Simulator::new(street),
            sensor: street.sensor,
            drive: Drive::new(street),
            step: Vec::new(),
            handed_out: 0,
            name: name.to_owned(),
        }
    }
}

/// The hot pixels of its camera.
#[cfg(test)]
pub(crate) fn hot_pixels(street: &plan::Street) -> Vec<plan::Pixel> {
    let numbers = 0..street.sensor.pixels() as u32;
    let camera = pixels::Pixels::new(numbers.collect(), street.seed, 0);
    let width = street.sensor.width as u32;
    let pixel = |n: u32| plan::Pixel::from(((n % width) as u16, (n / width) as u16));
    camera.hot_numbers().map(pixel).collect()
}

impl Recording for Street {
    fn sensor(&self) -> Option<Sensor> {
        Some(self.sensor)
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        while out.len() < BATCH_EVENTS {
            let waiting = self.step.get(self.handed_out..).unwrap_or_default();
            if waiting.is_empty() {
                self.handed_out = 0;
                if !self.simulator.step(&mut self.step) {
                    break;
                }
                continue;
            }
            let n = waiting.len().min(BATCH_EVENTS - out.len());
            out.extend_from_slice(&waiting[..n]);
            self.handed_out += n;
        }
        Ok(!out.is_empty())
    }

    fn progress_permille(&self) -> u64 {
        self.simulator.progress_permille()
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: "street",
            path: self.name.clone(),
            time_unit: "us",
            time_unit_from: "format",
            events: None,
        }
    }

    fn trajectory(&self) -> Option<Box<dyn Trajectory>> {
        Some(Box::new(self.drive.clone()))
    }
}

/// East is along the street, 0 m at the start of the drive; north is to the left of its middle.
impl Trajectory for Drive {
    fn position(&mut self, t_ns: u64) -> Option<[f64; 2]> {
        Some([self.along_m(t_ns as f64 / 1e9), self.lateral_m()])
    }
}
