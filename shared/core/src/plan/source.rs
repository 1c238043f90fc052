//! Where events come from.

use super::{Delivery, FRAMES, Filters, FrameSource, HotPixels, Plan, Positions, Sensor};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The kind of a source that is a tape of events as ingest cut them.
pub const TAPE: &str = "tape";

/// Where events come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// `file`, `street`, `frames`, `stdin`, `tcp`, `aedat4_tcp`, `usb`, or [`TAPE`], which no configuration names.
    pub kind: String,
    /// The recording. Of another kind: what it is called in messages and in traverses.
    pub path: PathBuf,
    /// How fast it is replayed.
    pub pace: Pace,
    /// Unit of times in text recordings.
    pub time_unit: TimeUnit,
    /// Name of the encoding of bare words; `None` where the bytes say what they are.
    pub format: Option<String>,
    /// What to do with a time that goes back.
    pub on_backward_time: OnBadEvent,
    /// What to do with an event outside the sensor.
    pub on_outside_sensor: OnBadEvent,
    /// The mask of hot pixels, if there is one.
    pub hot_pixels: Option<HotPixels>,
    /// Filters of events.
    pub filters: Filters,
    /// The street, when the kind is `street`.
    pub street: Option<Street>,
    /// How frames are read, when the kind is `frames`.
    pub frames: Option<FrameSource>,
    /// Where the camera was, when a file says it. It takes precedence over what the recording knows.
    pub positions: Option<Positions>,
    /// How the stream is got at, when it is no recording and no street.
    pub live: Option<LiveSource>,
}

/// A stream that comes when it comes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LiveSource {
    /// `host:port` of the server, for `tcp` and `aedat4_tcp`.
    pub address: Option<String>,
    /// Serial number of the camera, for `usb`.
    pub serial: Option<String>,
    /// While no event comes, a window closes this long after its end, ns.
    pub slack_ns: u64,
}

impl Source {
    /// A recording, with the defaults: unpaced, and everything that cannot be right is an error.
    pub fn file(path: impl Into<PathBuf>) -> Self {
        Self {
            kind: "file".to_owned(),
            path: path.into(),
            pace: Pace::Unpaced,
            time_unit: TimeUnit::Auto,
            format: None,
            on_backward_time: OnBadEvent::Error,
            on_outside_sensor: OnBadEvent::Error,
            hot_pixels: None,
            filters: Filters::default(),
            street: None,
            frames: None,
            live: None,
            positions: None,
        }
    }

    /// A live stream of this kind, with the defaults as for [`Source::file`].
    pub fn live(kind: &str, live: LiveSource) -> Self {
        let name = match (kind, &live.address, &live.serial) {
            ("stdin", ..) => "standard input".to_owned(),
            (_, Some(address), _) => address.clone(),
            (_, _, Some(serial)) => format!("USB camera {serial}"),
            _ => "USB camera".to_owned(),
        };
        Self {
            kind: kind.to_owned(),
            live: Some(live),
            ..Self::file(name)
        }
    }

    /// True for a tape.
    pub fn is_tape(&self) -> bool {
        self.kind == TAPE
    }

    /// True for standard input.
    pub fn is_stdin(&self) -> bool {
        self.kind == "stdin"
    }

    /// A simulated street, with the defaults as for [`Source::file`].
    pub fn street(street: Street) -> Self {
        let path = format!("street ({}, seed {})", street.pass.name(), street.seed);
        Self {
            kind: "street".to_owned(),
            street: Some(street),
            ..Self::file(path)
        }
    }

    /// Frames, with the defaults as for [`Source::file`].
    pub fn frames(path: impl Into<PathBuf>, frames: FrameSource) -> Self {
        Self {
            kind: FRAMES.to_owned(),
            frames: Some(frames),
            ..Self::file(path)
        }
    }
}

/// A simulated street, and a drive along it. Equal values give equal events; equal seeds give the same street and the
/// same camera, whatever the pass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Street {
    /// The drive.
    pub pass: StreetPass,
    /// What houses, trees and the camera's pixels are drawn from.
    pub seed: u64,
    /// Length of the drive, metres.
    pub length_m: f64,
    /// Speed of the first pass by day, metres per second; the others are slower and not steady.
    pub speed_m_s: f64,
    /// Time between two pictures of the street from which events are made, ns; a multiple of 1000.
    pub step_ns: u64,
    /// Size of the camera's sensor.
    pub sensor: Sensor,
}

impl Default for Street {
    /// What the configuration has where it says nothing.
    fn default() -> Self {
        Self {
            pass: StreetPass::Day,
            seed: 1,
            length_m: 400.0,
            speed_m_s: 5.0,
            step_ns: 4_000_000,
            sensor: Sensor {
                height: 120,
                width: 160,
            },
        }
    }
}

/// A drive along the street.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StreetPass {
    /// By day, at a steady speed.
    Day,
    /// By day again: half a metre to the side, at 0.9 times the speed with variation, and with a stop.
    Day2,
    /// The same by night.
    Night,
}

impl StreetPass {
    /// All passes.
    pub const ALL: [Self; 3] = [Self::Day, Self::Day2, Self::Night];

    /// As in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Day => "day",
            Self::Day2 => "day2",
            Self::Night => "night",
        }
    }
}

/// How fast a recording is replayed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// As fast as the graph takes it.
    Unpaced,
    /// So many times as fast as it was recorded.
    Factor(f64),
}

/// Unit of times in text recordings.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeUnit {
    #[default]
    /// A decimal point means seconds, else decided by magnitude; said in the log.
    Auto,
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

/// What to do with an event that cannot be right.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnBadEvent {
    /// Stop with an error that names it.
    Error,
    /// Leave it out and count it.
    Drop,
    /// Times only: treat it as at the latest time so far, and count it.
    Clamp,
}

impl Plan {
    /// The same graph over a tape of its events: lossless, and nothing is recorded. The tape says who is enabled at each
    /// tick, so nobody governs.
    pub fn of_tape(mut self, tape: PathBuf) -> Self {
        self.source.kind = TAPE.to_owned();
        self.source.path = tape;
        self.source.live = None;
        self.source.street = None;
        self.governor = None;
        self.replayed()
    }

    /// The same graph, replayed: lossless and unpaced, and nothing is recorded.
    pub fn replayed(mut self) -> Self {
        self.source.pace = Pace::Unpaced;
        self.delivery = Delivery::Lossless;
        (self.record, self.record_events) = (None, None);
        self
    }

    /// Calls this with every path in the plan.
    pub fn each_path(&mut self, visit: &mut dyn FnMut(&mut PathBuf)) {
        if self.source.live.is_none() && self.source.street.is_none() {
            visit(&mut self.source.path);
        }
        let positions = self.source.positions.as_mut().map(|p| &mut p.path);
        let own = [&mut self.map, &mut self.record, &mut self.record_events];
        let own = own.into_iter().filter_map(Option::as_mut);
        let networks = self.reconstructions.iter_mut().map(|r| &mut r.network);
        let networks = networks.chain(self.extractors.iter_mut().map(|e| &mut e.network));
        let models = networks.flatten().map(|n| &mut n.model.file);
        let library = self.inference.library.as_mut();
        let all = positions.into_iter().chain(own).chain(models).chain(library);
        all.for_each(visit);
    }

    /// Whether events are taken as they come, by the time of the host, and lost when nobody takes them. In lossless
    /// delivery standard input is not: whoever writes it can wait, so it is read like a file.
    pub fn is_live(&self) -> bool {
        self.source.live.is_some() && !(self.source.is_stdin() && self.delivery == Delivery::Lossless)
    }
}
