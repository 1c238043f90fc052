//! The sections `[source.hot_pixels]` and `[source.filters]`.

use super::reader::{Table, Value};
use super::schema::key;
use super::sink::{At, Sink};
use super::source::path;
use super::words::MASKED_BY;
use crate::plan::{Filters, HotPixelRule, HotPixels, HotPixelsFrom, MaskedBy, Reconstruction};
use std::ops::RangeInclusive;

/// How long may be learned, ns: shorter says nothing of a pixel's rate.
const PERIODS_NS: RangeInclusive<u64> = 100_000_000..=3_600_000_000_000;
/// Factors and rates of the rule.
const FACTORS: RangeInclusive<f64> = 1.1..=1000.0;
const RATES_HZ: RangeInclusive<f64> = 0.001..=100_000.0;

/// `[source.hot_pixels]` as written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct HotPixelsSection {
    pub mask: HotPixels,
    /// Where `apply` is.
    apply_at: At,
}

/// `[source.hot_pixels]`, if there is one.
pub(super) fn hot_pixels(source: &Table<'_>) -> Option<Option<HotPixelsSection>> {
    let there = source.has("hot_pixels");
    let table = source.section("hot_pixels");
    let file = table.read_optional(
        key(
            "file",
            "path",
            None,
            "Text file of the pixels to mask, a line `x,y` for each (column and row, from 0; `#` begins a comment), \
             relative to the directory that evpr is started in.",
        ),
        |v| path(v, "hot_pixels.txt"),
    );
    let mut learn_at = table.at.clone();
    let learn = table.read_optional(
        key(
            "learn",
            "duration from \"100ms\" to \"1h\"",
            None,
            "Instead of a file: the first so much of the recording decides which pixels are hot. They are masked from \
             the first event on; in a live stream, from the end of this time on.",
        ),
        |v| {
            learn_at = v.at.clone();
            period(v)
        },
    );
    let learns = learn != Some(None);
    let factor = table.read_optional(
        key(
            "factor",
            "number from 1.1 to 1000",
            Some("3.0"),
            "Only with learn: a pixel is hot when it has more than so many times the events of the third busiest of the \
             24 pixels around it.",
        ),
        |v| learned(v, learns, |v| v.number(FACTORS)),
    );
    let min_rate_hz = table.read_optional(
        key(
            "min_rate_hz",
            "number from 0.001 to 100000",
            Some("5.0"),
            "Only with learn: and at least so many events per second (and 20 in all).",
        ),
        |v| learned(v, learns, |v| v.number(RATES_HZ)),
    );
    let mut apply_at = table.at.clone();
    let apply = table.read(
        key(
            "apply",
            "\"all\" or \"e2vid\"",
            Some("\"all\""),
            "Who leaves the masked pixels out: ingest, so that nobody sees them; or only the reconstructions that do it \
             by themselves (the authors' code).",
        ),
        MaskedBy::Ingest,
        |v| {
            apply_at = v.at.clone();
            v.word(&MASKED_BY)
        },
    );
    let from = match (file, learn) {
        (Some(file), Some(learn)) => match (file, learn) {
            (Some(_), Some(_)) => {
                table
                    .sink
                    .report(&learn_at, "does not go with file; remove one of the two");
                None
            }
            (Some(file), None) => Some(Some(HotPixelsFrom::File(file))),
            (None, Some(period_ns)) => {
                let default = HotPixelRule::default();
                factor.zip(min_rate_hz).map(|(factor, min_rate_hz)| {
                    let rule = HotPixelRule {
                        factor: factor.unwrap_or(default.factor),
                        min_rate_hz: min_rate_hz.unwrap_or(default.min_rate_hz),
                    };
                    Some(HotPixelsFrom::Learn { period_ns, rule })
                })
            }
            (None, None) if there => {
                let message =
                    "says not which pixels; write file = \"hot_pixels.txt\" or learn = \"5s\" into it";
                table.sink.report_absence(&table.at, message);
                None
            }
            (None, None) => Some(None),
        },
        _ => None,
    };
    table.close();
    let masked_by = apply?;
    factor.zip(min_rate_hz)?;
    from.map(|from| {
        from.map(|from| HotPixelsSection {
            mask: HotPixels {
                from,
                masked_by,
                pixels: None,
            },
            apply_at,
        })
    })
}

fn learned<T>(value: &Value<'_>, learns: bool, read: impl FnOnce(&Value<'_>) -> Option<T>) -> Option<T> {
    if learns {
        read(value)
    } else {
        value.refuse("has no effect without learn; remove it, or write learn = \"5s\"")
    }
}

fn period(value: &Value<'_>) -> Option<u64> {
    let ns = value.duration_ns()?;
    if PERIODS_NS.contains(&ns) {
        Some(ns)
    } else {
        value.refuse("cannot be learned from; write a duration from \"100ms\" to \"1h\", such as \"5s\"")
    }
}

/// `[source.filters]`.
pub(super) fn filters(table: Table<'_>) -> Option<Filters> {
    let refractory_ns = table.read_optional(
        key(
            "refractory",
            "duration",
            None,
            "Leaves out events that come earlier than this after their pixel's last one that was kept. Off when not \
             given.",
        ),
        |v| v.duration_ns(),
    );
    let background_activity_ns = table.read_optional(
        key(
            "background_activity",
            "duration",
            None,
            "Leaves out events unless one of the eight neighbours of their pixel had an event at most this long before. \
             Off when not given.",
        ),
        |v| v.duration_ns(),
    );
    table.close();
    Some(Filters {
        refractory_ns: refractory_ns?,
        background_activity_ns: background_activity_ns?,
    })
}

/// Masking that is left to the reconstructions needs one that masks.
pub(super) fn check_masking(
    sink: &Sink<'_>,
    section: Option<&HotPixelsSection>,
    reconstructions: &[Reconstruction],
) {
    let Some(section) = section.filter(|s| s.mask.masked_by == MaskedBy::Reconstruction) else {
        return;
    };
    if !reconstructions.iter().any(|r| r.masks_hot_pixels) {
        let message = "\"e2vid\" has no effect: no reconstruction here masks by itself; write \"all\"";
        sink.report(&section.apply_at, message);
    }
}
