//! A source of frames: `[source.frames]`, and what does not go together with it.

use super::reader::Table;
use super::schema::key;
use super::sink::{At, Sink};
use super::source::{SourceKind, only_with};
use super::words::{FRAME_TICKS, ON_OTHER_SIZE, STACK_ORDERS};
use crate::plan::{FRAMES, FrameSource, FrameTicks, OnOtherSize, StackOrder};

/// `[source.frames]`: the size is filled in later.
pub(super) fn frames(table: Table<'_>, kind: Option<SourceKind>) -> Option<FrameSource> {
    const FRAMES_ONLY: &[SourceKind] = &[SourceKind::Frames];
    let ticks = table.read(
        key(
            "ticks",
            "\"frame\" or \"time\"",
            Some("\"frame\""),
            "Every frame is a tick; or ticks are as long as slicing.tick and have the first of their frames (with \
             slicing.align = \"end\" the last).",
        ),
        FrameTicks::Frame,
        |v| only_with(v, kind, FRAMES_ONLY, |v| v.word(&FRAME_TICKS)),
    );
    let on_other_size = table.read(
        key(
            "on_other_size",
            "\"error\" or \"resize\"",
            Some("\"error\""),
            "A frame of another size than the first (or than [sensor]): stop, or resize it.",
        ),
        OnOtherSize::Error,
        |v| only_with(v, kind, FRAMES_ONLY, |v| v.word(&ON_OTHER_SIZE)),
    );
    let stack_order = table.read(
        key(
            "stack_order",
            "\"bgr\" or \"rgb\"",
            Some("\"bgr\""),
            "Order of the channels in a .npy stack of colour frames. PNG and JPEG files say it themselves.",
        ),
        StackOrder::Bgr,
        |v| only_with(v, kind, FRAMES_ONLY, |v| v.word(&STACK_ORDERS)),
    );
    table.close();
    Some(FrameSource {
        ticks: ticks?,
        on_other_size: on_other_size?,
        stack_order: stack_order?,
        size: None,
    })
}

/// Reports the sections of `[source]` that are about events.
pub(super) fn check_source(table: &Table<'_>, kind: Option<SourceKind>) {
    for name in ["hot_pixels", "filters"] {
        if let Some(value) = table.value(name).filter(|_| kind == Some(SourceKind::Frames)) {
            let _: Option<()> = value.refuse(format!(
                "has no effect with source.kind = \"{FRAMES}\"; remove it: there are no events"
            ));
        }
    }
}

/// Reports the keys of `[slicing]` that mean nothing with this source.
pub(super) fn check_slicing(table: &Table<'_>, ticks: Option<FrameTicks>) {
    let Some(ticks) = ticks else { return };
    let refuse = |name: &str, what: &str| {
        if let Some(value) = table.value(name) {
            let _: Option<()> =
                value.refuse(format!("has no effect with source.kind = \"{FRAMES}\"; {what}"));
        }
    };
    refuse("windows", "remove it: the one window is the tick");
    refuse("mode", "remove it: there are no events to count");
    if ticks == FrameTicks::Frame {
        let what = "remove it, or write source.frames.ticks = \"time\"";
        refuse("align", what);
        refuse("origin", what);
    }
}

/// Reports a reconstruction whose input this source does not have.
pub(super) fn check_reconstruction(sink: &Sink<'_>, at: &At, kind: &str, source: Option<SourceKind>) {
    let message = match (source, kind) {
        (Some(SourceKind::Frames), FRAMES) | (None, _) => return,
        (Some(SourceKind::Frames), kind) => format!(
            "{kind} is made of events, and source.kind = \"{FRAMES}\" has none; write id = \"{FRAMES}\" alone"
        ),
        (Some(_), FRAMES) => format!(
            "{FRAMES} come from a source of frames; write source.kind = \"{FRAMES}\", or another reconstruction"
        ),
        _ => return,
    };
    sink.report(at, message);
}
