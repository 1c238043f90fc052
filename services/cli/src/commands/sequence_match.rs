//! `evpr sequence-match`: the matcher alone.

use crate::args::{MethodArgs, SequenceMatchArgs, SequenceMethodArg};
use crate::failure::Failure;
use evpr_core::plan::{Filter, SeqSlam, SequenceMethod, Transition};
use ndarray::Array2;
use ndarray_npy::{ReadNpyError, read_npy, write_npy};
use std::ops::RangeInclusive;
use std::path::Path;
use std::process::ExitCode;

/// Reads a matrix of f64, or of f32 and widens it.
fn read_matrix(path: &Path) -> Result<Array2<f64>, Failure> {
    let wide: Result<Array2<f64>, ReadNpyError> = read_npy(path);
    match wide {
        Ok(matrix) => Ok(matrix),
        Err(ReadNpyError::WrongDescriptor(_)) => read_npy::<_, Array2<f32>>(path).map(|m| m.mapv(f64::from)),
        Err(e) => Err(e),
    }
    .map_err(|e| {
        Failure::new(format!(
            "cannot read {}: {e}; a .npy array (queries × references) of f64 or f32 is needed",
            path.display()
        ))
    })
}

/// An option's value, where it lies in its range.
fn within<T: PartialOrd + std::fmt::Display>(
    option: &str,
    value: Option<T>,
    default: T,
    range: RangeInclusive<T>,
) -> Result<T, Failure> {
    let value = value.unwrap_or(default);
    if range.contains(&value) {
        return Ok(value);
    }
    let (low, high) = (range.start(), range.end());
    Err(Failure::usage(format!(
        "{option} {value} is out of range; give a number from {low} to {high}"
    )))
}

fn seqslam(args: &MethodArgs) -> Result<SeqSlam, Failure> {
    let authors = SeqSlam::AUTHORS;
    let velocities = args.velocities.as_deref().unwrap_or(&authors.velocities);
    let velocities = SeqSlam::velocities_from(velocities)
        .map_err(|problem| Failure::usage(format!("--velocities: {problem}")))?;
    let steps = (args.velocity_steps, authors.velocity_steps);
    Ok(SeqSlam {
        window: within("--window", args.window, authors.window, SeqSlam::WINDOWS)?,
        velocities,
        velocity_steps: within("--velocity-steps", steps.0, steps.1, SeqSlam::VELOCITY_STEPS)?,
    })
}

fn filter(args: &MethodArgs) -> Result<Filter, Failure> {
    let default = Filter::DEFAULT;
    let transition = args.transition.as_deref();
    let transition = transition.map_or(Ok(default.transition), Transition::new);
    Ok(Filter {
        beta: within("--beta", args.beta, default.beta, Filter::BETAS)?,
        transition: transition.map_err(|problem| Failure::usage(format!("--transition: {problem}")))?,
        restart: within("--restart", args.restart, default.restart, Filter::RESTARTS)?,
    })
}

/// The method with its parameters, and L.
fn method(args: &SequenceMatchArgs) -> Result<(SequenceMethod, usize), Failure> {
    let parameters = &args.parameters;
    let method = match args.method {
        SequenceMethodArg::Paper => SequenceMethod::Paper,
        SequenceMethodArg::Rows => SequenceMethod::Rows,
        SequenceMethodArg::Seqslam => SequenceMethod::SeqSlam(seqslam(parameters)?),
        SequenceMethodArg::Filter => SequenceMethod::Filter(filter(parameters)?),
        SequenceMethodArg::None => SequenceMethod::None,
    };
    let of_seqslam = matches!(method, SequenceMethod::SeqSlam(_));
    let of_filter = matches!(method, SequenceMethod::Filter(_));
    let strangers = [
        ("--window", parameters.window.is_some(), of_seqslam),
        ("--velocities", parameters.velocities.is_some(), of_seqslam),
        (
            "--velocity-steps",
            parameters.velocity_steps.is_some(),
            of_seqslam,
        ),
        ("--beta", parameters.beta.is_some(), of_filter),
        ("--transition", parameters.transition.is_some(), of_filter),
        ("--restart", parameters.restart.is_some(), of_filter),
    ];
    if let Some((option, ..)) = strangers.iter().find(|(_, given, used)| *given && !used) {
        return Err(Failure::usage(format!(
            "{option} has no effect with --method {}; leave it out",
            method.name()
        )));
    }
    match args.length {
        Some(0) => Err(Failure::usage(
            "--length 0 makes no sense; give a number of ticks of 1 or more",
        )),
        None if method.has_length() => Err(Failure::usage(format!(
            "--method {} needs a sequence length; give it with --length",
            method.name()
        ))),
        length => Ok((method, length.unwrap_or(1))),
    }
}

/// `evpr sequence-match`.
pub(crate) fn sequence_match(args: &SequenceMatchArgs) -> Result<ExitCode, Failure> {
    let (method, length) = method(args)?;
    let similarity = read_matrix(&args.similarity)?;
    if let Some(((q, r), value)) = similarity.indexed_iter().find(|(_, v)| !v.is_finite()) {
        return Err(Failure::new(format!(
            "{}: the similarity of query {q} and reference {r} is {value}; all must be finite",
            args.similarity.display()
        )));
    }
    let matched = evpr_fuse::sequence_match(similarity.view(), length, method);
    write_npy(&args.out, &matched)
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", args.out.display())))?;
    Ok(ExitCode::SUCCESS)
}
