//! A sequence method or a fusion rule as one word, with its parameters: `seqslam:window=10:velocities=0.9..1.1`,
//! `filter:transition=0.1/0.9`, `trimmed_mean:trim=0.1`. Parameters that are not named have their defaults, and are not
//! named by what writes such words.

use super::words::{RULES, SEQUENCE_METHODS, not_one_of};
use crate::plan::{Filter, Rule, SeqSlam, SequenceMethod, Transition};
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// The method with its parameters.
///
/// # Errors
/// What of it is no method, none of its parameters, or out of range.
pub fn parse_method(text: &str) -> Result<SequenceMethod, String> {
    let (name, parameters) = parts(text)?;
    match SEQUENCE_METHODS.parse(name)? {
        SequenceMethod::SeqSlam(mut seqslam) => {
            for (key, value) in parameters {
                match key {
                    "window" => seqslam.window = within(key, value, SeqSlam::WINDOWS)?,
                    "velocities" => {
                        let numbers = numbers(key, value, "..")?;
                        seqslam.velocities = SeqSlam::velocities_from(&numbers).map_err(|_| {
                            format!(
                                "velocities={value}: give the least and the greatest in references per tick, each from {} to \
                                 {}, as 0.8..1.2",
                                SeqSlam::VELOCITIES.start(),
                                SeqSlam::VELOCITIES.end()
                            )
                        })?;
                    }
                    "velocity_steps" => {
                        seqslam.velocity_steps = within(key, value, SeqSlam::VELOCITY_STEPS)?;
                    }
                    _ => return Err(not_one_of(key, &["window", "velocities", "velocity_steps"])),
                }
            }
            Ok(SequenceMethod::SeqSlam(seqslam))
        }
        SequenceMethod::Filter(mut filter) => {
            for (key, value) in parameters {
                match key {
                    "beta" => filter.beta = within(key, value, Filter::BETAS)?,
                    "restart" => filter.restart = within(key, value, Filter::RESTARTS)?,
                    "transition" => {
                        let numbers = numbers(key, value, "/")?;
                        filter.transition = Transition::new(&numbers).map_err(|_| {
                            format!(
                                "transition={value}: give 1 to {} probabilities that add up to 1, as 0.2/0.5/0.2/0.1",
                                Transition::MOST
                            )
                        })?;
                    }
                    _ => return Err(not_one_of(key, &["beta", "transition", "restart"])),
                }
            }
            Ok(SequenceMethod::Filter(filter))
        }
        method => without(name, &parameters).map(|()| method),
    }
}

/// What [`parse_method`] reads as this method.
pub fn method_label(method: &SequenceMethod) -> String {
    let mut label = method.name().to_owned();
    match method {
        SequenceMethod::SeqSlam(is) => {
            let default = SeqSlam::AUTHORS;
            let [least, greatest] = is.velocities;
            add(&mut label, "window", is.window, is.window != default.window);
            let velocities = format!("{least}..{greatest}");
            add(
                &mut label,
                "velocities",
                velocities,
                is.velocities != default.velocities,
            );
            let other = is.velocity_steps != default.velocity_steps;
            add(&mut label, "velocity_steps", is.velocity_steps, other);
        }
        SequenceMethod::Filter(is) => {
            let default = Filter::DEFAULT;
            add(&mut label, "beta", is.beta, is.beta != default.beta);
            let steps: Vec<String> = is.transition.probabilities().iter().map(f64::to_string).collect();
            add(
                &mut label,
                "transition",
                steps.join("/"),
                is.transition != default.transition,
            );
            add(&mut label, "restart", is.restart, is.restart != default.restart);
        }
        SequenceMethod::Paper | SequenceMethod::Rows | SequenceMethod::None => {}
    }
    label
}

/// The rule with its parameter.
///
/// # Errors
/// What of it is no rule, not its parameter, or out of range.
pub fn parse_rule(text: &str) -> Result<Rule, String> {
    let (name, parameters) = parts(text)?;
    match RULES.parse(name)? {
        Rule::TrimmedMean { mut trim } => {
            for (key, value) in parameters {
                match key {
                    "trim" => trim = within(key, value, Rule::TRIMS)?,
                    _ => return Err(not_one_of(key, &["trim"])),
                }
            }
            Ok(Rule::TrimmedMean { trim })
        }
        rule => without(name, &parameters).map(|()| rule),
    }
}

/// What [`parse_rule`] reads as this rule.
pub fn rule_label(rule: &Rule) -> String {
    let mut label = rule.name().to_owned();
    if let Rule::TrimmedMean { trim } = rule {
        add(&mut label, "trim", trim, *trim != Rule::TRIM);
    }
    label
}

fn add(label: &mut String, key: &str, value: impl Display, other: bool) {
    if other {
        *label += &format!(":{key}={value}");
    }
}

/// A parameter's name and its value.
type Parameter<'a> = (&'a str, &'a str);

/// The name, and the parameters with their values.
fn parts(text: &str) -> Result<(&str, Vec<Parameter<'_>>), String> {
    let mut parts = text.split(':');
    let name = parts.next().unwrap_or_default();
    let mut parameters: Vec<Parameter<'_>> = Vec::new();
    for part in parts {
        let parameter = part
            .split_once('=')
            .ok_or_else(|| format!("{part} names no parameter; write {name}:PARAMETER=VALUE"))?;
        if parameters.iter().any(|(key, _)| *key == parameter.0) {
            return Err(format!("{} is given twice; give it once", parameter.0));
        }
        parameters.push(parameter);
    }
    Ok((name, parameters))
}

fn without(name: &str, parameters: &[Parameter<'_>]) -> Result<(), String> {
    match parameters.first() {
        None => Ok(()),
        Some((key, _)) => Err(format!("{name} has no parameter {key}; leave it out")),
    }
}

fn within<T: FromStr + PartialOrd + Display>(
    key: &str,
    value: &str,
    range: RangeInclusive<T>,
) -> Result<T, String> {
    let number = value.parse().ok().filter(|n| range.contains(n));
    let (least, most) = (range.start(), range.end());
    number.ok_or_else(|| format!("{key}={value}: give a number from {least} to {most}"))
}

fn numbers(key: &str, value: &str, between: &str) -> Result<Vec<f64>, String> {
    let one = |text: &str| {
        let number = text.parse().ok().filter(|n: &f64| n.is_finite());
        number.ok_or_else(|| format!("{key}={value}: {text:?} is no number"))
    };
    value.split(between).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        for text in [
            "paper",
            "rows",
            "none",
            "seqslam",
            "filter",
            "seqslam:window=10:velocities=0.9..1.1:velocity_steps=3",
            "seqslam:velocities=1..1",
            "filter:beta=1:transition=0.1/0.9:restart=0.05",
        ] {
            assert_eq!(method_label(&parse_method(text).unwrap()), text);
        }
        for text in ["sum", "median", "trimmed_mean", "trimmed_mean:trim=0.1"] {
            assert_eq!(rule_label(&parse_rule(text).unwrap()), text);
        }
        assert_eq!(
            parse_method("seqslam:window=20"),
            SEQUENCE_METHODS.parse("seqslam")
        );
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, words) in [
            ("seqslm", "seqslam"),
            ("paper:window=3", "paper has no parameter window"),
            ("seqslam:windw=3", "window"),
            (
                "seqslam:window",
                "window names no parameter; write seqslam:PARAMETER=VALUE",
            ),
            ("seqslam:window=1", "window=1: give a number from 2 to 10000"),
            ("seqslam:window=3:window=4", "window is given twice"),
            ("seqslam:velocities=0.8", "as 0.8..1.2"),
            ("seqslam:velocities=a..b", "\"a\" is no number"),
            ("filter:beta=NaN", "beta=NaN: give a number from 0 to 100"),
            ("filter:transition=0.5/0.4", "add up to 1"),
            ("filter:transition=", "\"\" is no number"),
        ] {
            let error = parse_method(text).unwrap_err();
            assert!(
                error.contains(words) && error.lines().count() == 1,
                "{text}: {error}"
            );
        }
        for (text, words) in [
            ("average", "\"average\" is not known here"),
            ("sum:trim=0.1", "sum has no parameter trim"),
            ("trimmed_mean:trim=0.5", "trim=0.5: give a number from 0 to 0.49"),
        ] {
            let error = parse_rule(text).unwrap_err();
            assert!(
                error.contains(words) && error.lines().count() == 1,
                "{text}: {error}"
            );
        }
    }
}
