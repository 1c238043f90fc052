//! The sections of the configuration: every key, with its meaning, its default and its checks, in one place.
//! The larger sections are in files of their own.

use super::reader::{Table, Value};
use super::sink::Key;
use super::words::{DELIVERIES, ROW_TYPES};
use crate::message::Event;
use crate::plan::{Delivery, RowType, Sensor};

/// The longest instance name: it is part of names in shared memory and of sockets.
pub(super) const MAX_RUN_NAME: usize = 20;
/// The longest id of a stage.
pub(super) const MAX_ID: usize = 64;
/// The largest height and width, pixels.
pub(super) const MAX_SIDE: usize = 8192;
const _: () = assert!(MAX_SIDE <= Event::Y_MAX as usize + 1);
/// The deadline when the configuration names none, ns.
const DEFAULT_DEADLINE_NS: u64 = 1_000_000_000;

pub(super) const fn key(
    name: &'static str,
    kind: &'static str,
    default: Option<&'static str>,
    doc: &'static str,
) -> Key {
    Key {
        name,
        kind,
        default,
        doc,
    }
}

/// Checks a name that goes into topics and file names.
pub(super) fn check_name(text: &str, longest: usize) -> Result<String, String> {
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-';
    if (1..=longest).contains(&text.len()) && text.chars().all(allowed) {
        Ok(text.to_owned())
    } else {
        Err(format!(
            "\"{text}\" cannot be a name; write 1 to {longest} of a-z, 0-9, _ and -"
        ))
    }
}

pub(super) fn name(value: &Value<'_>, longest: usize) -> Option<String> {
    let text = value.text("a name in quotes")?;
    value.accept(check_name(text, longest))
}

/// `[run]`: the name of the instance.
pub(super) fn run(table: Table<'_>) -> Option<String> {
    let run = table.read(
        key(
            "name",
            "name, 1 to 20 of a-z, 0-9, _ and -",
            Some("\"evpr\""),
            "Name of the instance; two that run at the same time need different ones.",
        ),
        "evpr".to_owned(),
        |v| name(v, MAX_RUN_NAME),
    );
    table.close();
    run
}

/// `[sensor]`: its size, when it is given.
pub(super) fn sensor(table: Table<'_>) -> Option<Option<Sensor>> {
    let range = 1..=MAX_SIDE as i64;
    let height = table.read_optional(
        key(
            "height",
            "whole number from 1 to 8192",
            None,
            "Rows of the sensor, pixels. Asked of the recording when it is not given.",
        ),
        |v| v.integer(range.clone()),
    );
    let width = table.read_optional(
        key(
            "width",
            "whole number from 1 to 8192",
            None,
            "Columns of the sensor, pixels. Asked of the recording when it is not given.",
        ),
        |v| v.integer(range.clone()),
    );
    let sensor = match (height?, width?) {
        (None, None) => Some(None),
        (Some(height), Some(width)) => Some(Some(Sensor {
            height: height as usize,
            width: width as usize,
        })),
        (height, _) => {
            let (there, missing) = match height {
                Some(_) => ("height", "width"),
                None => ("width", "height"),
            };
            let at = table.below(missing, table.at.offset);
            let message =
                format!("is missing; write it beside {there}, or leave out both to ask the recording");
            table.sink.report_absence(&at, message);
            None
        }
    };
    table.close();
    sensor
}

/// `[record]`: how rows are kept.
pub(super) fn record(table: Table<'_>) -> Option<RowType> {
    let rows = table.read(
        key(
            "rows",
            "\"f32\" or \"f16\"",
            Some("\"f32\""),
            "Numbers of recorded rows: as they are, or rounded to 16 bits, which takes half the room on disk.",
        ),
        RowType::F32,
        |v| v.word(&ROW_TYPES),
    );
    table.close();
    rows
}

/// `[runtime]` as written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RuntimeSection {
    pub delivery: Delivery,
    pub deadline_ns: u64,
}

/// `[runtime]`.
pub(super) fn runtime(table: Table<'_>) -> Option<RuntimeSection> {
    let delivery = table.read(
        key(
            "delivery",
            "\"lossless\" or \"latest\"",
            Some("\"lossless\""),
            "lossless: every stage waits for the next (replay). latest: the newest data wins (live).",
        ),
        Delivery::Lossless,
        |v| v.word(&DELIVERIES),
    );
    let deadline_ns = table.read(
        key(
            "deadline",
            "duration",
            Some("\"1s\""),
            "Latest delivery: the answer is due this long after the tick's last window closed.",
        ),
        DEFAULT_DEADLINE_NS,
        |v| v.duration_ns(),
    );
    table.close();
    Some(RuntimeSection {
        delivery: delivery?,
        deadline_ns: deadline_ns?,
    })
}
