//! The simulator: drive, picture and pixels, step by step.

use super::drive::Drive;
use super::pixels::{Pixels, Spike, Step};
use super::random::{Purpose, number};
use super::render::{Frame, Renderer, Scratch};
use super::scene::Scene;
use super::view::View;
use crate::RawEvent;
use evpr_core::plan::Street;
use rayon::prelude::*;

/// Pixels that one thread simulates at a time. A sensor of no more than these takes no further threads.
const BAND_PIXELS: usize = 1 << 15;

/// Some columns of the sensor, with what simulating them needs.
struct Band {
    first_column: usize,
    columns: usize,
    pixels: Pixels,
    scratch: Scratch,
    light: Vec<f32>,
    spikes: Vec<Spike>,
}

/// See the module.
pub(super) struct Simulator {
    drive: Drive,
    renderer: Renderer,
    frame: Frame,
    bands: Vec<Band>,
    spikes: Vec<Spike>,
    seed: u64,
    pass: u64,
    step_us: u64,
    steps: u64,
    next: u64,
}

impl Simulator {
    pub(super) fn new(street: &Street) -> Self {
        Self::with_bands(street, BAND_PIXELS)
    }

    /// With bands of at most so many pixels, but at least one column.
    pub(super) fn with_bands(street: &Street, band_pixels: usize) -> Self {
        let drive = Drive::new(street);
        let sensor = street.sensor;
        let view = View::new(sensor, drive.lateral_m() as f32);
        let renderer = Renderer::new(Scene::new(street), view);
        let pass = street.pass as u64;
        let columns = (band_pixels / sensor.height.max(1)).max(1);
        let band = |first_column: usize| {
            let columns = columns.min(sensor.width - first_column);
            let numbers = (first_column..first_column + columns)
                .flat_map(|k| (0..sensor.height).map(move |v| (v * sensor.width + k) as u32));
            Band {
                first_column,
                columns,
                pixels: Pixels::new(numbers.collect(), street.seed, pass),
                scratch: Scratch::default(),
                light: vec![0.0; sensor.height],
                spikes: Vec::new(),
            }
        };
        let step_us = (street.step_ns / 1_000).max(1);
        let mut simulator = Self {
            bands: (0..sensor.width).step_by(columns).map(band).collect(),
            frame: Frame::default(),
            spikes: Vec::new(),
            seed: street.seed,
            pass,
            step_us,
            steps: (drive.duration_s() * 1e6 / step_us as f64) as u64,
            next: 0,
            drive,
            renderer,
        };
        simulator.settle();
        simulator
    }

    /// How much of the drive is done, permille.
    pub(super) fn progress_permille(&self) -> u64 {
        self.next * 1_000 / self.steps.max(1)
    }

    fn settle(&mut self) {
        let (seed, pass) = (self.seed, self.pass);
        self.draw(self.drive.along_m(0.0), |pixels, at, light, _| {
            pixels.settle(at, light, seed, pass);
        });
    }

    /// Simulates the next step; `out` is its events, in the order of time and then of pixels. False when the drive is
    /// over.
    pub(super) fn step(&mut self, out: &mut Vec<RawEvent>) -> bool {
        out.clear();
        if self.next >= self.steps {
            return false;
        }
        let step = Step {
            start_us: self.next * self.step_us,
            length_us: self.step_us,
            key: number(self.seed, Purpose::Noise, &[self.pass, self.next, u64::MAX]) as u32,
        };
        self.next += 1;
        let along_m = self.drive.along_m((self.next * self.step_us) as f64 * 1e-6);
        self.draw(along_m, |pixels, at, light, spikes| {
            pixels.expose(at, light, step, spikes);
        });
        self.spikes.clear();
        for band in &mut self.bands {
            band.pixels.hot(step, &mut band.spikes);
            self.spikes.append(&mut band.spikes);
        }
        self.spikes.sort_unstable();
        let width = self.renderer.view().sensor.width as u32;
        out.extend(self.spikes.iter().map(|spike| RawEvent {
            t_ns: (step.start_us + spike.after_us()) * 1_000,
            x: (spike.pixel() % width) as u16,
            y: (spike.pixel() / width) as u16,
            on: spike.on(),
        }));
        true
    }

    /// Draws the street from `along_m` and hands the pixels the light of each column.
    fn draw(&mut self, along_m: f64, expose: impl Fn(&mut Pixels, usize, &[f32], &mut Vec<Spike>) + Sync) {
        let parallel = self.bands.len() > 1;
        self.renderer.begin(along_m, &mut self.frame, parallel);
        let (renderer, frame) = (&self.renderer, &self.frame);
        let draw = |band: &mut Band| {
            for column in 0..band.columns {
                renderer.column(
                    frame,
                    band.first_column + column,
                    &mut band.scratch,
                    &mut band.light,
                );
                let at = column * band.light.len();
                expose(&mut band.pixels, at, &band.light, &mut band.spikes);
            }
        };
        if parallel {
            self.bands.par_iter_mut().for_each(draw);
        } else {
            self.bands.iter_mut().for_each(draw);
        }
    }
}
