//! `[fuse]`: similarity, sequence matching and fusion.

use super::reader::{Table, Value};
use super::schema::key;
use super::sink::Key;
use super::words::{RULES, SEQUENCE_METHODS, SIMILARITIES};
use crate::plan::{Filter, Fuse, Rule, SeqSlam, SequenceMethod, Similarity, Transition};
use std::ops::RangeInclusive;

/// The longest sequence, ticks.
const MAX_SEQUENCE: i64 = 1_000;
/// L when the configuration names none.
const DEFAULT_LENGTH: usize = 10;

/// `[fuse]`.
pub(super) fn fuse(table: Table<'_>) -> Option<Fuse> {
    let similarity = table.read(
        key(
            "similarity",
            "\"l2\", \"l2_squared\", \"cosine\" or \"sad\"",
            Some("\"l2\""),
            "How alike a query row q and a map row r are: -|q-r|, -|q-r|^2, q.r/(|q||r|) or -sum|q-r|.",
        ),
        Similarity::L2,
        |v| v.word(&SIMILARITIES),
    );
    let sequence = sequence(table.section("sequence"));
    let rule = rule(&table, sequence.map(|(method, _)| method));
    let top = table.read(
        key(
            "top",
            "whole number from 1 to 100",
            Some("5"),
            "Candidates in an answer.",
        ),
        5,
        |v| v.integer(1..=100),
    );
    let exclusion = table.read(
        key(
            "exclusion",
            "whole number from 0 to 1000000",
            Some("5"),
            "Candidates within so many references of the best are no rivals when confidence is measured.",
        ),
        5,
        |v| v.integer(0..=1_000_000),
    );
    let min_confidence = table.read(
        key(
            "min_confidence",
            "number from 0 to 1",
            Some("0.0"),
            "An answer of less confidence is null, with the reason \"low confidence\"; evpr evaluate finds a threshold.",
        ),
        0.0,
        |v| v.number(0.0..=1.0),
    );
    table.close();
    let (sequence, length) = sequence?;
    Some(Fuse {
        similarity: similarity?,
        sequence,
        length,
        rule: rule?,
        top: top? as usize,
        exclusion: exclusion? as usize,
        min_confidence: min_confidence?,
    })
}

/// `fuse.rule` and its parameter.
fn rule(table: &Table<'_>, sequence: Option<SequenceMethod>) -> Option<Rule> {
    let rule = table.read(
        key(
            "rule",
            "\"sum\", \"mean\", \"max\", \"median\", \"product\" or \"trimmed_mean\"",
            Some("\"sum\""),
            "How members' scores become one; all but max heed weights. With sequence.method = \"filter\" the default is \
             \"mean\".",
        ),
        Rule::default_with(sequence),
        |v| v.word(&RULES),
    );
    let trim = table.read_optional(
        key(
            "trim",
            "number from 0 to 0.49",
            None,
            "rule = \"trimmed_mean\": share of the members left out at either end, rounded down; 0.25 if not given.",
        ),
        |v| match rule {
            Some(rule) if !matches!(rule, Rule::TrimmedMean { .. }) => v.refuse(format!(
                "has no effect with rule = \"{}\"; remove it, or write rule = \"trimmed_mean\"",
                rule.name()
            )),
            _ => v.number(Rule::TRIMS),
        },
    );
    match (rule?, trim?) {
        (Rule::TrimmedMean { .. }, Some(trim)) => Some(Rule::TrimmedMean { trim }),
        (rule, _) => Some(rule),
    }
}

/// A key of `fuse.sequence` that only some methods have.
struct Parameter {
    key: Key,
    /// Whether the method has it.
    of: fn(&SequenceMethod) -> bool,
    /// A method that has it.
    instead: &'static str,
}

impl Parameter {
    /// Reads the key; reports it where the method has no use for it.
    fn read<T>(
        self,
        table: &Table<'_>,
        method: Option<SequenceMethod>,
        default: T,
        read: impl FnOnce(&Value<'_>) -> Option<T>,
    ) -> Option<T> {
        table.read(self.key, default, |v| {
            let value = read(v)?;
            match method.filter(|method| !(self.of)(method)) {
                None => Some(value),
                Some(method) => v.refuse(format!(
                    "has no effect with method = \"{}\"; remove it, or write method = \"{}\"",
                    method.name(),
                    self.instead
                )),
            }
        })
    }
}

/// `fuse.sequence`: the method with its parameters, and its length; 1 where it has none.
fn sequence(table: Table<'_>) -> Option<(SequenceMethod, usize)> {
    let method = table.read(
        key(
            "method",
            "\"paper\", \"rows\", \"seqslam\", \"filter\" or \"none\"",
            Some("\"paper\""),
            "How similarities over time become one score per place; none: this tick's alone.",
        ),
        SequenceMethod::Paper,
        |v| v.word(&SEQUENCE_METHODS),
    );
    let length = Parameter {
        key: key(
            "length",
            "whole number from 1 to 1000",
            Some("10"),
            "Sequence length L in ticks; only with method = \"paper\", \"rows\" or \"seqslam\".",
        ),
        of: SequenceMethod::has_length,
        instead: "paper",
    };
    let length = length.read(&table, method, None, |v| {
        v.integer(1..=MAX_SEQUENCE).map(|length| Some(length as usize))
    });
    let seqslam = seqslam(&table, method);
    let filter = filter(&table, method);
    table.close();
    let (method, length) = match (method?, length?, seqslam?, filter?) {
        (SequenceMethod::SeqSlam(_), length, seqslam, _) => (SequenceMethod::SeqSlam(seqslam), length),
        (SequenceMethod::Filter(_), length, _, filter) => (SequenceMethod::Filter(filter), length),
        (method, length, ..) => (method, length),
    };
    let default = if method.has_length() { DEFAULT_LENGTH } else { 1 };
    Some((method, length.unwrap_or(default)))
}

/// The parameters of `seqslam`.
fn seqslam(table: &Table<'_>, method: Option<SequenceMethod>) -> Option<SeqSlam> {
    let parameter = |key| Parameter {
        key,
        of: |method| matches!(method, SequenceMethod::SeqSlam(_)),
        instead: "seqslam",
    };
    let window = parameter(key(
        "window",
        "whole number from 2 to 10000",
        None,
        "method = \"seqslam\": references around a place that its contrast is measured against; 20 if not given.",
    ));
    let velocities = parameter(key(
        "velocities",
        "list of two numbers from 0 to 10",
        None,
        "method = \"seqslam\": least and greatest velocity, references per tick; [0.8, 1.2] if not given.",
    ));
    let velocity_steps = parameter(key(
        "velocity_steps",
        "whole number from 1 to 100",
        None,
        "method = \"seqslam\": how many velocities are tried, the least and the greatest included; 10 if not given.",
    ));
    let window = window.read(table, method, SeqSlam::AUTHORS.window, |v| {
        whole(v, SeqSlam::WINDOWS)
    });
    let velocities = velocities.read(table, method, SeqSlam::AUTHORS.velocities, |v| {
        let numbers = numbers(v, "a list of two numbers, such as [0.8, 1.2]")?;
        v.accept(SeqSlam::velocities_from(&numbers))
    });
    let steps = SeqSlam::AUTHORS.velocity_steps;
    let steps = velocity_steps.read(table, method, steps, |v| whole(v, SeqSlam::VELOCITY_STEPS));
    Some(SeqSlam {
        window: window?,
        velocities: velocities?,
        velocity_steps: steps?,
    })
}

/// The parameters of `filter`.
fn filter(table: &Table<'_>, method: Option<SequenceMethod>) -> Option<Filter> {
    let parameter = |key| Parameter {
        key,
        of: |method| matches!(method, SequenceMethod::Filter(_)),
        instead: "filter",
    };
    let beta = parameter(key(
        "beta",
        "number from 0 to 100",
        None,
        "method = \"filter\": how much a z-score of 1 speaks for a place; 1.5 if not given.",
    ));
    let transition = parameter(key(
        "transition",
        "list of 1 to 16 numbers that add up to 1",
        None,
        "method = \"filter\": probabilities that a tick moves on by 0, 1, 2, … references; [0.2, 0.5, 0.2, 0.1] if not \
         given.",
    ));
    let restart = parameter(key(
        "restart",
        "number from 0 to 1",
        None,
        "method = \"filter\": probability that a tick starts anywhere anew; 0.02 if not given.",
    ));
    let beta = beta.read(table, method, Filter::DEFAULT.beta, |v| v.number(Filter::BETAS));
    let transition = transition.read(table, method, Filter::DEFAULT.transition, |v| {
        let numbers = numbers(v, "a list of numbers, such as [0.2, 0.5, 0.2, 0.1]")?;
        v.accept(Transition::new(&numbers))
    });
    let restart = restart.read(table, method, Filter::DEFAULT.restart, |v| {
        v.number(Filter::RESTARTS)
    });
    Some(Filter {
        beta: beta?,
        transition: transition?,
        restart: restart?,
    })
}

fn whole(value: &Value<'_>, range: RangeInclusive<usize>) -> Option<usize> {
    let range = *range.start() as i64..=*range.end() as i64;
    value.integer(range).map(|number| number as usize)
}

fn numbers(value: &Value<'_>, expected: &str) -> Option<Vec<f64>> {
    let numbers = value.list(expected, |item| match item.as_number() {
        Some(number) => Some(number),
        None => item.refuse("is no number; write one without quotes"),
    })?;
    numbers.into_iter().collect()
}
