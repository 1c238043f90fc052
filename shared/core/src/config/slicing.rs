//! `[slicing]`: ticks and windows, checked against each other.

use super::frames::check_slicing;
use super::reader::{Table, Value};
use super::schema::key;
use super::sink::{At, Key};
use super::words::{ALIGNS, ORIGIN_HELP, SLICE_MODES, parse_origin};
use crate::member::MAX_WINDOWS;
use crate::plan::{Align, FrameTicks, Origin, SliceMode, Slicing};
use crate::time::format_duration;

/// The most ticks that a window may reach back over.
const MAX_WINDOW_TICKS: u64 = 64;
/// The shortest tick and window: times of events are kept in whole µs.
const MIN_LENGTH_NS: u64 = 1_000;
/// The most events in a tick or window.
const MAX_COUNT: i64 = 1_000_000_000_000;

/// `[slicing]`; `frames` says what a tick is, when the source has frames.
pub(super) fn slicing(table: Table<'_>, frames: Option<FrameTicks>) -> Option<Slicing> {
    check_slicing(&table, frames);
    let mode = table.read(
        key(
            "mode",
            "\"time\" or \"count\"",
            Some("\"time\""),
            "What tick and windows are measured in: time, or events.",
        ),
        SliceMode::Time,
        |v| v.word(&SLICE_MODES),
    );
    let length = |value: &Value<'_>| length(value, mode?);
    const TICK: Key = key(
        "tick",
        "duration, or a number of events",
        Some("\"1s\""),
        "The query period: one answer each. Required with mode = \"count\".",
    );
    let tick = match mode {
        Some(SliceMode::Count) => {
            let help = "write the number of events in a tick, such as tick = 100000";
            table.require(TICK, help, length)
        }
        _ => table.read(TICK, 1_000_000_000, length),
    };
    let windows = table.read_optional(
        key(
            "windows",
            "list of durations, or of numbers of events",
            None,
            "Lengths of the windows; a member has one of them. One window of the whole tick when not given.",
        ),
        |v| {
            let help = "a list, such as [\"250ms\", \"1s\"]";
            v.list(help, |item| length(&item).map(|len| (len, item.at.clone())))
                .map(|list| (list, v.at.clone()))
        },
    );
    let align = table.read(
        key(
            "align",
            "\"start\" or \"end\"",
            Some("\"start\""),
            "Where in its tick a window lies: at the start (the paper), or at the end (freshest).",
        ),
        Align::Start,
        |v| v.word(&ALIGNS),
    );
    let origin = table.read(
        key(
            "origin",
            "\"first_event\", \"grid:\" with a duration, or whole ns",
            Some("\"first_event\""),
            "Where tick 0 begins: at the first event, at a multiple of a duration, or at a sensor time.",
        ),
        Origin::FirstEvent,
        |v| origin(v, mode),
    );
    let windows = match windows {
        Some(Some((list, at))) => check_windows(&table, tick, align, &list, &at),
        Some(None) => tick.map(|tick| vec![tick]),
        None => None,
    };
    table.close();
    Some(Slicing {
        mode: mode?,
        tick: tick?,
        windows: windows?,
        align: align?,
        origin: origin?,
    })
}

/// Length of a tick or window: ns or events.
fn length(value: &Value<'_>, mode: SliceMode) -> Option<u64> {
    match mode {
        SliceMode::Count => value.integer(1..=MAX_COUNT).map(|count| count as u64),
        SliceMode::Time => match value.duration_ns()? {
            ns if ns < MIN_LENGTH_NS => value.refuse(format!(
                "{} is shorter than events are timed; write at least \"1us\"",
                format_duration(ns)
            )),
            ns => Some(ns),
        },
    }
}

fn origin(value: &Value<'_>, mode: Option<SliceMode>) -> Option<Origin> {
    let origin = match value.as_number() {
        Some(_) => Origin::At(value.integer(0..=i64::MAX)? as u64),
        None => {
            let text = value.text(ORIGIN_HELP.trim_start_matches("write "))?;
            value.accept(parse_origin(text))?
        }
    };
    if matches!(origin, Origin::Grid(_)) && mode == Some(SliceMode::Count) {
        return value.refuse("a grid needs mode = \"time\"; write \"first_event\" to count from there");
    }
    Some(origin)
}

/// Checks windows against the tick and each other; ascending.
fn check_windows(
    table: &Table<'_>,
    tick: Option<u64>,
    align: Option<Align>,
    list: &[Option<(u64, At)>],
    at: &At,
) -> Option<Vec<u64>> {
    let mut good = list.iter().all(Option::is_some);
    let mut report = |at: &At, message: String| {
        table.sink.report(at, message);
        good = false;
    };
    if list.is_empty() {
        report(
            at,
            "is empty; leave it out for one window of the whole tick".to_owned(),
        );
    }
    if list.len() > MAX_WINDOWS {
        report(
            at,
            format!("has {} windows; write at most {MAX_WINDOWS}", list.len()),
        );
    }
    for (index, (window, at)) in list
        .iter()
        .enumerate()
        .filter_map(|(i, w)| Some((i, w.as_ref()?)))
    {
        if list[..index]
            .iter()
            .flatten()
            .any(|(earlier, _)| earlier == window)
        {
            report(at, "is in the list already; remove one of the two".to_owned());
        }
        let Some(tick) = tick else { continue };
        if *window > tick && align == Some(Align::Start) {
            let message = "is longer than the tick; write a shorter one, or align = \"end\" for windows that reach \
                           back into the ticks before";
            report(at, message.to_owned());
        } else if window.div_ceil(tick) > MAX_WINDOW_TICKS {
            let message = format!(
                "reaches back over more than {MAX_WINDOW_TICKS} ticks; write a shorter one, or a longer tick"
            );
            report(at, message);
        }
    }
    let mut windows: Vec<u64> = list.iter().flatten().map(|(window, _)| *window).collect();
    windows.sort_unstable();
    good.then_some(windows)
}
