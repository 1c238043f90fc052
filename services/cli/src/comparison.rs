//! Whether a replay gives the answers that a run gave.

use serde_json::Value;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

/// Fields of an answer, in the order in which differences are told.
const FIELDS: [&str; 10] = [
    "start_us",
    "end_us",
    "reference",
    "reason",
    "position",
    "score",
    "confidence",
    "top",
    "members",
    "missing",
];

/// Reads the answers of a run beside those of its replay, tick by tick.
pub(crate) struct Comparison {
    path: PathBuf,
    lines: BufReader<File>,
    next: Option<Value>,
    /// How many ticks before a tick have a say in its answer; `None` when all of them have.
    history: Option<u64>,
    /// Answers below this tick may differ, as something was dropped.
    excused_below: u64,
    verdict: Verdict,
}

/// What came of it.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Verdict {
    /// Ticks whose answers are the same.
    pub(crate) same: u64,
    /// Ticks that were not compared, as in one of the two something is missing, at them or in their history.
    pub(crate) excused: u64,
    /// Ticks that only the run, or only the replay, answered.
    pub(crate) only_run: u64,
    pub(crate) only_replay: u64,
    /// The first tick that differs, and how.
    pub(crate) difference: Option<String>,
}

impl Comparison {
    pub(crate) fn open(path: &Path, history: Option<u64>) -> Result<Self, String> {
        let file = File::open(path).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
        let mut comparison = Self {
            path: path.to_owned(),
            lines: BufReader::new(file),
            next: None,
            history,
            excused_below: 0,
            verdict: Verdict::default(),
        };
        comparison.advance()?;
        Ok(comparison)
    }

    /// Reads the run's next answer. A last line that is cut off is no answer.
    fn advance(&mut self) -> Result<(), String> {
        let mut line = String::new();
        let read = self.lines.read_line(&mut line);
        read.map_err(|e| format!("cannot read {}: {e}", self.path.display()))?;
        self.next = match line.ends_with('\n') {
            true => Some(serde_json::from_str(&line).map_err(|e| {
                format!(
                    "{}: not a line of matches ({e}); it is damaged",
                    self.path.display()
                )
            })?),
            false => None,
        };
        Ok(())
    }

    /// Takes an answer of the replay.
    pub(crate) fn answer(&mut self, replayed: &Value) -> Result<(), String> {
        let tick = tick_of(replayed);
        while self.next.as_ref().is_some_and(|run| tick_of(run) < tick) {
            self.verdict.only_run += 1;
            self.advance()?;
        }
        let Some(run) = self.next.take_if(|run| tick_of(run) == tick) else {
            self.verdict.only_replay += 1;
            self.excuse(tick);
            return Ok(());
        };
        self.advance()?;
        if let Some(true) = something_dropped(&run, replayed) {
            self.excuse(tick);
        }
        if tick < self.excused_below {
            self.verdict.excused += 1;
            return Ok(());
        }
        match FIELDS
            .iter()
            .find(|field| run.get(**field) != replayed.get(**field))
        {
            None => self.verdict.same += 1,
            Some(field) => {
                let text = |answer: &Value| answer.get(*field).map_or("none".to_owned(), Value::to_string);
                self.verdict.difference.get_or_insert_with(|| {
                    format!(
                        "tick {tick} differs: {field} {}, in the run {}",
                        text(replayed),
                        text(&run)
                    )
                });
            }
        }
        Ok(())
    }

    /// From this tick on, answers may differ until it is no longer in their history.
    fn excuse(&mut self, tick: u64) {
        let until = self
            .history
            .map_or(u64::MAX, |history| tick.saturating_add(history).saturating_add(1));
        self.excused_below = self.excused_below.max(until);
    }

    pub(crate) fn finish(mut self) -> Result<Verdict, String> {
        while self.next.is_some() {
            self.verdict.only_run += 1;
            self.advance()?;
        }
        Ok(self.verdict)
    }
}

fn tick_of(answer: &Value) -> u64 {
    answer.get("tick").and_then(Value::as_u64).unwrap_or(0)
}

/// Whether the rows that went into one of the two answers are not those that went into the other, as some had been
/// dropped on the way.
fn something_dropped(run: &Value, replayed: &Value) -> Option<bool> {
    /// What ingest says itself stands on the tape; these come later, or of a tape that is not whole.
    const DROPPED: [&str; 6] = [
        "late: ",
        "dropped: ",
        "lost ",
        "incomplete ",
        "reconstruction down",
        "extractor down",
    ];
    let (theirs, ours) = (
        run.get("missing")?.as_object()?,
        replayed.get("missing")?.as_object()?,
    );
    let dropped = |reason: &Value| {
        let reason = reason.as_str().unwrap_or_default();
        DROPPED.iter().any(|d| reason.starts_with(d))
    };
    let unlike = |a: &serde_json::Map<String, Value>, b: &serde_json::Map<String, Value>| {
        a.iter()
            .any(|(member, reason)| b.get(member) != Some(reason) && dropped(reason))
    };
    Some(unlike(theirs, ours) || unlike(ours, theirs))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::fmt::Write;

    /// An answer with member `m`, or with the reason why it is missing.
    fn answer(tick: u64, score: f64, missing: Option<&str>) -> Value {
        let missing = missing.map_or(json!({}), |reason| json!({ "m": reason }));
        json!({ "tick": tick, "score": score, "missing": missing, "latency_us": score })
    }

    fn compare(run: &[Value], replay: &[Value], history: Option<u64>) -> Verdict {
        let file = tempfile::NamedTempFile::new().unwrap();
        let text = run.iter().fold(String::new(), |mut text, a| {
            writeln!(text, "{a}").unwrap();
            text
        });
        std::fs::write(file.path(), text + "{\"tick\":").unwrap();
        let mut comparison = Comparison::open(file.path(), history).unwrap();
        replay.iter().for_each(|a| comparison.answer(a).unwrap());
        comparison.finish().unwrap()
    }

    #[test]
    fn what_was_dropped_excuses_its_history_and_nothing_else() {
        let run = [
            answer(0, 1.0, None),
            answer(1, 2.0, Some("late: not there by the deadline")),
            answer(2, 3.0, None),
            answer(3, 4.0, None),
            answer(4, 5.0, None),
        ];
        let replay: Vec<Value> = (0..5).map(|t| answer(t, 10.0 * (t as f64), None)).collect();
        let verdict = compare(&run, &replay, Some(1));
        assert_eq!((verdict.same, verdict.excused), (0, 2));
        assert_eq!(
            verdict.difference.as_deref(),
            Some("tick 0 differs: score 0.0, in the run 1.0")
        );
        let same: Vec<Value> = (0..5).map(|t| answer(t, t as f64 + 1.0, None)).collect();
        let verdict = compare(&run, &same, Some(1));
        assert_eq!((verdict.same, verdict.excused, verdict.difference), (3, 2, None));
        let verdict = compare(&run, &same, None);
        assert_eq!((verdict.same, verdict.excused), (1, 4));
    }

    #[test]
    fn other_reasons_are_differences() {
        let run = [answer(0, 1.0, Some("empty window"))];
        let verdict = compare(&run, &[answer(0, 1.0, None)], Some(0));
        assert!(verdict.difference.unwrap().contains("missing"));
    }

    #[test]
    fn ticks_that_only_one_of_them_has_are_counted() {
        let run: Vec<Value> = [0, 1, 4].map(|t| answer(t, 1.0, None)).into();
        let replay: Vec<Value> = [1, 2, 3].map(|t| answer(t, 1.0, None)).into();
        let verdict = compare(&run, &replay, Some(0));
        assert_eq!((verdict.same, verdict.only_run, verdict.only_replay), (1, 2, 2));
    }
}
