//! Values that are words, and the nearest word to a mistaken one. The command line reads its options with the same
//! functions as the configuration.

use crate::plan::{
    Align, Crop, Delivery, Filter, FrameTicks, MaskedBy, OnBadEvent, OnOtherSize, Origin, Pace,
    PositionCompat, PositionKind, Provider, RowType, Rule, SeqSlam, SequenceMethod, Similarity, SliceMode,
    StackOrder, StreetPass, TimeUnit,
};
use crate::time::parse_duration_ns;

/// Words and what they stand for.
#[derive(Debug, Clone, Copy)]
pub struct Words<'w, T>(&'w [(&'static str, T)]);

impl<'w, T: Copy> Words<'w, T> {
    /// These words.
    pub const fn new(words: &'w [(&'static str, T)]) -> Self {
        Self(words)
    }

    /// What the word stands for.
    ///
    /// # Errors
    /// That it is not one of the words, with the nearest one and all of them.
    pub fn parse(&self, text: &str) -> Result<T, String> {
        let found = self.0.iter().find(|(word, _)| *word == text);
        found
            .map(|(_, value)| *value)
            .ok_or_else(|| not_one_of(text, &self.all()))
    }

    /// The words.
    pub fn all(&self) -> Vec<&'static str> {
        self.0.iter().map(|(word, _)| *word).collect()
    }
}

/// `record.rows`.
pub const ROW_TYPES: Words<'static, RowType> = Words(&[("f32", RowType::F32), ("f16", RowType::F16)]);
/// `inference.providers`.
pub const PROVIDERS: Words<'static, Provider> = Words(&[
    ("tensorrt", Provider::Tensorrt),
    ("cuda", Provider::Cuda),
    ("openvino", Provider::Openvino),
    ("xnnpack", Provider::Xnnpack),
    ("cpu", Provider::Cpu),
]);
/// `slicing.mode`.
pub const SLICE_MODES: Words<'static, SliceMode> =
    Words(&[("time", SliceMode::Time), ("count", SliceMode::Count)]);
/// `slicing.align`.
pub const ALIGNS: Words<'static, Align> = Words(&[("start", Align::Start), ("end", Align::End)]);
/// `source.time_unit`.
pub const TIME_UNITS: Words<'static, TimeUnit> = Words(&[
    ("auto", TimeUnit::Auto),
    ("s", TimeUnit::S),
    ("ms", TimeUnit::Ms),
    ("us", TimeUnit::Us),
    ("ns", TimeUnit::Ns),
]);
/// `source.format`: nothing for "auto", else the name of an encoding.
pub const RAW_FORMATS: Words<'static, Option<&'static str>> = Words(&[
    ("auto", None),
    ("evt2", Some("evt2")),
    ("evt21", Some("evt21")),
    ("evt21_legacy", Some("evt21_legacy")),
    ("evt3", Some("evt3")),
    ("dat", Some("dat")),
]);
/// `source.on_backward_time`.
pub const ON_BACKWARD_TIME: Words<'static, OnBadEvent> = Words(&[
    ("error", OnBadEvent::Error),
    ("drop", OnBadEvent::Drop),
    ("clamp", OnBadEvent::Clamp),
]);
/// `source.on_outside_sensor`.
pub const ON_OUTSIDE_SENSOR: Words<'static, OnBadEvent> =
    Words(&[("error", OnBadEvent::Error), ("drop", OnBadEvent::Drop)]);
/// `source.hot_pixels.apply`.
pub const MASKED_BY: Words<'static, MaskedBy> =
    Words(&[("all", MaskedBy::Ingest), ("e2vid", MaskedBy::Reconstruction)]);
/// `source.street.pass`.
pub const STREET_PASSES: Words<'static, StreetPass> = Words(&[
    ("day", StreetPass::Day),
    ("day2", StreetPass::Day2),
    ("night", StreetPass::Night),
]);
/// `source.frames.ticks`.
pub const FRAME_TICKS: Words<'static, FrameTicks> =
    Words(&[("frame", FrameTicks::Frame), ("time", FrameTicks::Time)]);
/// `source.frames.on_other_size`.
pub const ON_OTHER_SIZE: Words<'static, OnOtherSize> =
    Words(&[("error", OnOtherSize::Error), ("resize", OnOtherSize::Resize)]);
/// `source.frames.stack_order`.
pub const STACK_ORDERS: Words<'static, StackOrder> =
    Words(&[("bgr", StackOrder::Bgr), ("rgb", StackOrder::Rgb)]);
/// `positions.kind`.
pub const POSITION_KINDS: Words<'static, PositionKind> = Words(&[
    ("auto", PositionKind::Auto),
    ("nmea", PositionKind::Nmea),
    ("csv", PositionKind::Csv),
    ("applanix", PositionKind::Applanix),
]);
/// `positions.compat`.
pub const POSITION_COMPATS: Words<'static, PositionCompat> =
    Words(&[("none", PositionCompat::None), ("paper", PositionCompat::Paper)]);
/// `positions.crop`.
pub const CROPS: Words<'static, Crop> = Words(&[
    ("none", Crop::None),
    ("track", Crop::Track),
    ("first_loop", Crop::FirstLoop),
    ("first_motion", Crop::FirstMotion),
]);
/// `fuse.similarity`.
pub const SIMILARITIES: Words<'static, Similarity> = Words(&[
    ("l2", Similarity::L2),
    ("l2_squared", Similarity::L2Squared),
    ("cosine", Similarity::Cosine),
    ("sad", Similarity::Sad),
]);
/// `fuse.sequence.method`, with the parameters that an unnamed one is.
pub const SEQUENCE_METHODS: Words<'static, SequenceMethod> = Words(&[
    ("paper", SequenceMethod::Paper),
    ("rows", SequenceMethod::Rows),
    ("seqslam", SequenceMethod::SeqSlam(SeqSlam::AUTHORS)),
    ("filter", SequenceMethod::Filter(Filter::DEFAULT)),
    ("none", SequenceMethod::None),
]);
/// `fuse.rule`, with the trim that an unnamed one is.
pub const RULES: Words<'static, Rule> = Words(&[
    ("sum", Rule::Sum),
    ("mean", Rule::Mean),
    ("max", Rule::Max),
    ("median", Rule::Median),
    ("product", Rule::Product),
    ("trimmed_mean", Rule::TrimmedMean { trim: Rule::TRIM }),
]);
/// `runtime.delivery`.
pub const DELIVERIES: Words<'static, Delivery> =
    Words(&[("lossless", Delivery::Lossless), ("latest", Delivery::Latest)]);

/// Slowest and fastest replay, as factors of the recorded speed.
pub(super) const PACE_FACTORS: (f64, f64) = (0.001, 1_000_000.0);
/// How to write a pace.
pub(super) const PACE_HELP: &str =
    "write \"unpaced\", \"realtime\" or a factor from 0.001 to 1000000, such as 2.0";

/// Reads a pace: `unpaced`, `realtime`, or how many times as fast as recorded.
///
/// # Errors
/// What is wrong and what to write instead.
pub fn parse_pace(text: &str) -> Result<Pace, String> {
    match text {
        "unpaced" => Ok(Pace::Unpaced),
        "realtime" => Ok(Pace::Factor(1.0)),
        _ => match text.parse::<f64>() {
            Ok(factor) => pace_of_factor(factor),
            Err(_) => Err(format!("\"{text}\" is not a pace; {PACE_HELP}")),
        },
    }
}

/// The pace of so many times as fast as recorded.
pub(super) fn pace_of_factor(factor: f64) -> Result<Pace, String> {
    let (slowest, fastest) = PACE_FACTORS;
    if (slowest..=fastest).contains(&factor) {
        Ok(Pace::Factor(factor))
    } else {
        Err(format!("{factor} is out of range; {PACE_HELP}"))
    }
}

/// How to write an origin.
pub(super) const ORIGIN_HELP: &str =
    "write \"first_event\", \"grid:100ms\" or a sensor time in whole nanoseconds";

/// Reads an origin of ticks: `first_event`, `grid:` with a duration, or a sensor time in whole nanoseconds.
///
/// # Errors
/// What is wrong and what to write instead.
pub fn parse_origin(text: &str) -> Result<Origin, String> {
    if text == "first_event" {
        return Ok(Origin::FirstEvent);
    }
    if let Some(step) = text.strip_prefix("grid:") {
        return match parse_duration_ns(step)? {
            0 => Err(format!(
                "\"{text}\" is a grid without a step; write a step above 0, such as \"grid:100ms\""
            )),
            step_ns => Ok(Origin::Grid(step_ns)),
        };
    }
    let ns = text.parse::<u64>().map(Origin::At);
    ns.map_err(|_| format!("\"{text}\" is not an origin; {ORIGIN_HELP}"))
}

/// `"x" is not known; did you mean "y"? Available: …`.
pub(super) fn not_one_of(text: &str, words: &[&str]) -> String {
    let near = match nearest(text, words) {
        Some(word) if words.len() > 1 => format!("did you mean \"{word}\"? "),
        _ => String::new(),
    };
    let all: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
    format!("\"{text}\" is not known here; {near}write {}", one_of(&all))
}

/// `a`, `a or b`, `a, b or c`.
pub(super) fn one_of<S: AsRef<str>>(words: &[S]) -> String {
    let words: Vec<&str> = words.iter().map(AsRef::as_ref).collect();
    match words.split_last() {
        None => "nothing".to_owned(),
        Some((last, [])) => (*last).to_owned(),
        Some((last, rest)) => format!("{} or {last}", rest.join(", ")),
    }
}

/// The word that is most likely meant, if one is near: at most a third of its letters are to be changed.
pub(super) fn nearest<'w>(text: &str, words: &[&'w str]) -> Option<&'w str> {
    /// Words longer than this are not typing mistakes of ours.
    const LONGEST: usize = 80;
    let typed: Vec<char> = text.chars().take(LONGEST).flat_map(char::to_lowercase).collect();
    let scored = words.iter().map(|word| {
        let wanted: Vec<char> = word.chars().collect();
        (edits(&typed, &wanted), wanted.len().max(typed.len()), *word)
    });
    let near = scored.filter(|(edits, len, _)| *edits <= (len / 3).max(1) && edits < len);
    near.min_by_key(|(edits, _, _)| *edits).map(|(_, _, word)| word)
}

/// Insertions, deletions, replacements and swaps of neighbours that turn one word into the other
/// (optimal string alignment distance).
fn edits(a: &[char], b: &[char]) -> usize {
    let mut before: Vec<usize> = Vec::new();
    let mut above: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.iter().enumerate() {
        let mut row = Vec::with_capacity(b.len() + 1);
        row.push(i + 1);
        for (j, cb) in b.iter().enumerate() {
            let mut least = (above[j] + usize::from(ca != cb))
                .min(above[j + 1] + 1)
                .min(row[j] + 1);
            if i > 0 && j > 0 && *ca == b[j - 1] && a[i - 1] == *cb {
                least = least.min(before[j - 1] + 1);
            }
            row.push(least);
        }
        before = std::mem::replace(&mut above, row);
    }
    above[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_edits() {
        let edits = |a: &str, b: &str| {
            let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
            super::edits(&a, &b)
        };
        for (a, b, n) in [
            ("", "", 0),
            ("", "abc", 3),
            ("tick", "tick", 0),
            ("windws", "windows", 1),
            ("tikc", "tick", 1),
            ("kitten", "sitting", 3),
        ] {
            assert_eq!((edits(a, b), edits(b, a)), (n, n), "{a} {b}");
        }
    }

    #[test]
    fn suggests_the_nearest_word_only_when_it_is_near() {
        let words = ["tick", "windows", "align"];
        assert_eq!(nearest("windws", &words), Some("windows"));
        assert_eq!(nearest("Tick", &words), Some("tick"));
        assert_eq!(nearest("tik", &words), Some("tick"));
        assert_eq!(nearest("zebra", &words), None);
        assert_eq!(nearest("", &words), None);
        assert_eq!(nearest("x", &["s"]), None);
    }

    #[test]
    fn reads_paces() {
        assert_eq!(parse_pace("unpaced"), Ok(Pace::Unpaced));
        assert_eq!(parse_pace("realtime"), Ok(Pace::Factor(1.0)));
        assert_eq!(parse_pace("2.5"), Ok(Pace::Factor(2.5)));
        for bad in ["", "fast", "0", "-1", "inf", "NaN", "1e-300"] {
            assert!(
                parse_pace(bad).unwrap_err().contains("write \"unpaced\""),
                "{bad}"
            );
        }
    }

    #[test]
    fn reads_origins() {
        assert_eq!(parse_origin("first_event"), Ok(Origin::FirstEvent));
        assert_eq!(parse_origin("grid:100ms"), Ok(Origin::Grid(100_000_000)));
        assert_eq!(
            parse_origin("1587452582350000000"),
            Ok(Origin::At(1_587_452_582_350_000_000))
        );
        for bad in ["", "grid", "grid:", "grid:0s", "grid:1", "-5", "1.5"] {
            assert!(parse_origin(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn names_all_words_and_the_nearest() {
        let message = ALIGNS.parse("strat").unwrap_err();
        assert_eq!(
            message,
            "\"strat\" is not known here; did you mean \"start\"? write \"start\" or \"end\""
        );
        assert!(!ALIGNS.parse("middle").unwrap_err().contains("did you mean"));
        assert_eq!(TIME_UNITS.parse("us"), Ok(TimeUnit::Us));
        assert_eq!(one_of(&["a", "b", "c"]), "a, b or c");
    }
}
