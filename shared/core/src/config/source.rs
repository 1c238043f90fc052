//! The section `[source]`: a recording, the simulated street, frames, or a live stream.

use super::frames::{check_source, frames};
use super::noise::{self, HotPixelsSection};
use super::reader::{Table, Value};
use super::schema::key;
use super::words::{
    ON_BACKWARD_TIME, ON_OUTSIDE_SENSOR, PACE_HELP, RAW_FORMATS, STREET_PASSES, TIME_UNITS, Words, one_of,
    pace_of_factor, parse_pace,
};
use crate::plan::{FRAMES, Filters, FrameSource, OnBadEvent, Pace, Street, TimeUnit};
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Kinds of sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SourceKind {
    File,
    Street,
    Frames,
    Stdin,
    Tcp,
    Aedat4Tcp,
    Usb,
}

const SOURCE_KINDS: Words<'static, SourceKind> = Words::new(&[
    ("file", SourceKind::File),
    ("street", SourceKind::Street),
    (FRAMES, SourceKind::Frames),
    ("stdin", SourceKind::Stdin),
    ("tcp", SourceKind::Tcp),
    ("aedat4_tcp", SourceKind::Aedat4Tcp),
    ("usb", SourceKind::Usb),
]);

impl SourceKind {
    /// Sources that are connected to, at an address.
    pub(super) const CONNECTED: &'static [Self] = &[Self::Tcp, Self::Aedat4Tcp];
    const REPLAYED: &'static [Self] = &[Self::File, Self::Street, Self::Frames];
    const LIVE: &'static [Self] = &[Self::Stdin, Self::Tcp, Self::Aedat4Tcp, Self::Usb];
    /// Sources whose bytes may be of any format.
    const ANY_FORMAT: &'static [Self] = &[Self::File, Self::Stdin, Self::Tcp];

    /// As in the configuration.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::File => "file",
            Self::Street => "street",
            Self::Frames => FRAMES,
            Self::Stdin => "stdin",
            Self::Tcp => "tcp",
            Self::Aedat4Tcp => "aedat4_tcp",
            Self::Usb => "usb",
        }
    }

    /// A stream that comes when it comes.
    pub(super) fn is_live(self) -> bool {
        Self::LIVE.contains(&self)
    }
}

/// Lengths of a street, metres.
const LENGTHS_M: RangeInclusive<f64> = 20.0..=5_000.0;
/// Speeds along it, metres per second.
const SPEEDS_M_S: RangeInclusive<f64> = 1.0..=40.0;
/// Steps of its simulation, ns.
const STEPS_NS: RangeInclusive<u64> = 500_000..=10_000_000;

/// Slacks of live sources, ns.
const SLACKS_NS: RangeInclusive<u64> = 1_000_000..=10_000_000_000;
/// The slack where the configuration says nothing, ns.
const SLACK_NS: u64 = 100_000_000;
/// Longest serial number of a camera.
const MAX_SERIAL: usize = 64;

/// `[source]` as written: path or address may be missing.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SourceSection {
    pub kind: SourceKind,
    pub path: Option<PathBuf>,
    pub pace: Pace,
    pub address: Option<String>,
    pub serial: Option<String>,
    pub slack_ns: u64,
    pub time_unit: TimeUnit,
    pub format: Option<&'static str>,
    /// What is written; else it depends on whether the source is live.
    pub on_backward_time: Option<OnBadEvent>,
    pub on_outside_sensor: Option<OnBadEvent>,
    pub hot_pixels: Option<HotPixelsSection>,
    pub filters: Filters,
    pub street: Street,
    pub frames: FrameSource,
}

/// `[source]`; its kind is known though other keys of it may be bad.
pub(super) fn source(table: Table<'_>) -> (Option<SourceKind>, Option<SourceSection>) {
    let kind = table.read(
        key(
            "kind",
            "\"file\", \"street\", \"frames\", \"stdin\", \"tcp\", \"aedat4_tcp\" or \"usb\"",
            Some("\"file\""),
            "What events come from: a recording, the simulated street, or live from standard input, a TCP server, a TCP \
             server of DV software, or a USB camera; or frames, without events.",
        ),
        SourceKind::File,
        |v| v.word(&SOURCE_KINDS),
    );
    let path = table.read_optional(
        key(
            "path",
            "path",
            None,
            "The recording, relative to the directory that evpr is started in. Of frames: a folder of PNG and JPEG files, \
             a list of them (.csv) or a stack (.npy). `--input` takes precedence.",
        ),
        |v| {
            only_with(v, kind, &[SourceKind::File, SourceKind::Frames], |v| path(v, "events.h5"))
        },
    );
    let address = table.read_optional(
        key(
            "address",
            "\"host:port\"",
            None,
            "Where the TCP server of the camera listens. `--input` takes precedence.",
        ),
        |v| {
            only_with(v, kind, SourceKind::CONNECTED, |v| {
                let text = v.text("an address in quotes, such as \"192.168.0.7:7777\"")?;
                v.accept(check_address(text).map(|()| text.to_owned()))
            })
        },
    );
    let serial = table.read_optional(
        key(
            "serial",
            "text",
            None,
            "Serial number of the USB camera; without it, the first one found is taken.",
        ),
        |v| only_with(v, kind, &[SourceKind::Usb], serial),
    );
    let slack_ns = table.read(
        key(
            "slack",
            "duration from \"1ms\" to \"10s\"",
            Some("\"100ms\""),
            "Live sources: while no event comes, a window closes this long after its end; events that come later than \
             that are left out and counted.",
        ),
        SLACK_NS,
        |v| only_with(v, kind, SourceKind::LIVE, slack),
    );
    let pace = table.read(
        key(
            "pace",
            "\"unpaced\", \"realtime\" or a number from 0.001 to 1000000",
            Some("\"unpaced\""),
            "How fast a recording is replayed: as fast as the graph takes it, as recorded, or so many times as fast.",
        ),
        Pace::Unpaced,
        |v| only_with(v, kind, SourceKind::REPLAYED, pace),
    );
    let time_unit = table.read(
        key(
            "time_unit",
            "\"auto\", \"s\", \"ms\", \"us\" or \"ns\"",
            Some("\"auto\""),
            "Unit of times in text recordings; auto: a decimal point means seconds, else decided by magnitude. Of a list of \
             frames auto means seconds.",
        ),
        TimeUnit::Auto,
        |v| only_with(v, kind, OF_TIMES, |v| v.word(&TIME_UNITS)),
    );
    let format = table.read(
        key(
            "format",
            "\"auto\", \"evt2\", \"evt21\", \"evt21_legacy\", \"evt3\" or \"dat\"",
            Some("\"auto\""),
            "What the bytes are: auto, as their beginning says; else the bare words of a Prophesee sensor, whose header may \
             be missing.",
        ),
        None,
        |v| only_with(v, kind, SourceKind::ANY_FORMAT, |v| v.word(&RAW_FORMATS)),
    );
    let on_backward_time = table.read_optional(
        key(
            "on_backward_time",
            "\"error\", \"drop\" or \"clamp\"",
            Some("\"error\""),
            "An event earlier than its forerunner: stop, leave it out, or treat it as at the latest time so far. Of live \
             sources the default is \"drop\".",
        ),
        |v| only_with(v, kind, OF_EVENTS, |v| v.word(&ON_BACKWARD_TIME)),
    );
    let on_outside_sensor = table.read_optional(
        key(
            "on_outside_sensor",
            "\"error\" or \"drop\"",
            Some("\"error\""),
            "An event outside the sensor: stop, or leave it out. Of live sources the default is \"drop\".",
        ),
        |v| only_with(v, kind, OF_EVENTS, |v| v.word(&ON_OUTSIDE_SENSOR)),
    );
    check_source(&table, kind);
    let hot_pixels = noise::hot_pixels(&table);
    let filters = noise::filters(table.section("filters"));
    let street = street(table.section("street"), kind);
    let frames = frames(table.section("frames"), kind);
    table.close();
    let section = || {
        Some(SourceSection {
            kind: kind?,
            path: path?,
            address: address?,
            serial: serial?,
            slack_ns: slack_ns?,
            pace: pace?,
            time_unit: time_unit?,
            format: format?,
            on_backward_time: on_backward_time?,
            on_outside_sensor: on_outside_sensor?,
            hot_pixels: hot_pixels?,
            filters: filters?,
            street: street?,
            frames: frames?,
        })
    };
    (kind, section())
}

/// `[source.street]`: its sensor is filled in later.
fn street(table: Table<'_>, kind: Option<SourceKind>) -> Option<Street> {
    let default = Street::default();
    let pass = table.read(
        key(
            "pass",
            "\"day\", \"day2\" or \"night\"",
            Some("\"day\""),
            "The drive: by day, or, with half a metre of offset, other speeds and a stop, by day again or by night. \
             `--input` takes precedence.",
        ),
        default.pass,
        |v| only_with(v, kind, &[SourceKind::Street], |v| v.word(&STREET_PASSES)),
    );
    let seed = table.read(
        key(
            "seed",
            "whole number from 0 to 4294967295",
            Some("1"),
            "What the street and the camera's pixels are drawn from: the same in all passes of one seed.",
        ),
        default.seed as i64,
        |v| {
            only_with(v, kind, &[SourceKind::Street], |v| {
                v.integer(0..=i64::from(u32::MAX))
            })
        },
    );
    let length_m = table.read(
        key(
            "length_m",
            "number from 20 to 5000",
            Some("400.0"),
            "Length of the drive, metres.",
        ),
        default.length_m,
        |v| only_with(v, kind, &[SourceKind::Street], |v| v.number(LENGTHS_M)),
    );
    let speed_m_s = table.read(
        key(
            "speed_m_s",
            "number from 1 to 40",
            Some("5.0"),
            "Speed of the pass \"day\", metres per second; the others go at 0.9 times of it, with variation.",
        ),
        default.speed_m_s,
        |v| only_with(v, kind, &[SourceKind::Street], |v| v.number(SPEEDS_M_S)),
    );
    let step_ns = table.read(
        key(
            "step",
            "duration from \"500us\" to \"10ms\"",
            Some("\"4ms\""),
            "Time between two pictures of the street; what moves by more than a pixel in it loses events.",
        ),
        default.step_ns,
        |v| only_with(v, kind, &[SourceKind::Street], step),
    );
    table.close();
    Some(Street {
        pass: pass?,
        seed: seed? as u64,
        length_m: length_m?,
        speed_m_s: speed_m_s?,
        step_ns: step_ns?,
        ..default
    })
}

/// Kinds of sources that have events.
const OF_EVENTS: &[SourceKind] = &[
    SourceKind::File,
    SourceKind::Street,
    SourceKind::Stdin,
    SourceKind::Tcp,
    SourceKind::Aedat4Tcp,
    SourceKind::Usb,
];
/// Kinds of sources whose times may be in any unit.
const OF_TIMES: &[SourceKind] = &[
    SourceKind::File,
    SourceKind::Frames,
    SourceKind::Stdin,
    SourceKind::Tcp,
];

/// Reads a key that only some kinds of sources have. While the kind is not known it is read as well.
pub(super) fn only_with<'r, T>(
    value: &Value<'r>,
    kind: Option<SourceKind>,
    wanted: &[SourceKind],
    read: impl FnOnce(&Value<'r>) -> Option<T>,
) -> Option<T> {
    match kind {
        Some(kind) if !wanted.contains(&kind) => {
            let names: Vec<String> = wanted.iter().map(|k| format!("\"{}\"", k.name())).collect();
            value.refuse(format!(
                "has no effect with source.kind = \"{}\"; remove it, or write kind = {}",
                kind.name(),
                one_of(&names)
            ))
        }
        _ => read(value),
    }
}

/// An address `host:port`.
pub(super) fn check_address(text: &str) -> Result<(), String> {
    let right = text.rsplit_once(':').is_some_and(|(host, port)| {
        !host.is_empty()
            && !host.contains(|c: char| c.is_whitespace() || c.is_control())
            && port.parse::<u16>().is_ok_and(|port| port > 0)
    });
    if right {
        return Ok(());
    }
    Err(format!(
        "\"{text}\" is no address; write host and port, such as \"192.168.0.7:7777\""
    ))
}

fn serial(value: &Value<'_>) -> Option<String> {
    let text = value.text("a serial number in quotes")?;
    if text.is_empty() || text.len() > MAX_SERIAL || text.contains(char::is_control) {
        return value.refuse(format!(
            "is no serial number; write the camera's, of at most {MAX_SERIAL} characters"
        ));
    }
    Some(text.to_owned())
}

fn slack(value: &Value<'_>) -> Option<u64> {
    match value.duration_ns()? {
        ns if SLACKS_NS.contains(&ns) => Some(ns),
        _ => value.refuse("cannot be the slack; write a duration from \"1ms\" to \"10s\""),
    }
}

fn step(value: &Value<'_>) -> Option<u64> {
    const HELP: &str = "write whole microseconds from \"500us\" to \"10ms\", such as \"4ms\"";
    match value.duration_ns()? {
        ns if STEPS_NS.contains(&ns) && ns % 1_000 == 0 => Some(ns),
        _ => value.refuse(format!("cannot be the step; {HELP}")),
    }
}

/// A path; `example` is one to write.
pub(super) fn path(value: &Value<'_>, example: &str) -> Option<PathBuf> {
    match value.text(&format!("a path in quotes, such as \"{example}\""))? {
        "" => value.refuse(format!("is empty; write a path, such as \"{example}\"")),
        text if text.contains('\0') => value.refuse("has a zero character in it; write a path"),
        text => Some(PathBuf::from(text)),
    }
}

fn pace(value: &Value<'_>) -> Option<Pace> {
    match value.as_number() {
        Some(factor) => value.accept(pace_of_factor(factor)),
        None => {
            let text = value.text(PACE_HELP.trim_start_matches("write "))?;
            value.accept(parse_pace(text))
        }
    }
}
