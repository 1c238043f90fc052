//! `evpr sequence-match`: the matcher alone.

use crate::args::{MethodArgs, SequenceMatchArgs, SequenceMethodArg};
use crate::failure::Failure;
use evpr_core::plan::{Filter, SeqSlam, SequenceMethod, Transition};
use evpr_store::NpyHeader;
use ndarray::{Array2, ShapeBuilder};
use ndarray_npy::write_npy;
use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::ops::RangeInclusive;
use std::path::Path;
use std::process::ExitCode;

/// Longest header of a matrix, bytes.
const MAX_HEADER_BYTES: u64 = 64 << 10;

/// Reads a matrix of f64, or of f32 and widens it.
fn read_matrix(path: &Path) -> Result<Array2<f64>, Failure> {
    try_read(path).map_err(|e| {
        Failure::new(format!(
            "cannot read {}: {e}; a .npy array (queries × references) of f64 or f32 is needed",
            path.display()
        ))
    })
}

fn try_read(path: &Path) -> Result<Array2<f64>, String> {
    let failed = |e: std::io::Error| e.to_string();
    let mut head = Vec::new();
    let mut file = File::open(path).map_err(failed)?;
    file.by_ref()
        .take(MAX_HEADER_BYTES)
        .read_to_end(&mut head)
        .map_err(failed)?;
    let (header, start) = NpyHeader::decode(&head)?;
    let &[queries, references] = header.shape.as_slice() else {
        return Err(format!("it has {} axes", header.shape.len()));
    };
    let (item_bytes, of): (u64, fn(&[u8]) -> f64) = match header.descr.as_str() {
        "<f8" => (8, |b| f64::from_le_bytes(*b.first_chunk().unwrap_or(&[0; 8]))),
        ">f8" => (8, |b| f64::from_be_bytes(*b.first_chunk().unwrap_or(&[0; 8]))),
        "<f4" => (4, |b| {
            f32::from_le_bytes(*b.first_chunk().unwrap_or(&[0; 4])).into()
        }),
        ">f4" => (4, |b| {
            f32::from_be_bytes(*b.first_chunk().unwrap_or(&[0; 4])).into()
        }),
        other => return Err(format!("its items are {}", other.escape_debug())),
    };
    // No memory for more than there is.
    let found = file.metadata().map_err(failed)?.len();
    let wanted = queries
        .checked_mul(references)
        .and_then(|n| n.checked_mul(item_bytes))
        .and_then(|n| n.checked_add(start as u64));
    if wanted != Some(found) {
        return Err(format!(
            "it has {found} bytes, which is not what its shape {:?} needs",
            header.shape
        ));
    }
    let mut rest = BufReader::new(Cursor::new(head.split_off(start)).chain(file));
    let mut values = Vec::with_capacity((queries * references) as usize);
    let mut item = [0; 8];
    let item = &mut item[..item_bytes as usize];
    for _ in 0..queries * references {
        rest.read_exact(item).map_err(failed)?;
        values.push(of(item));
    }
    let shape = (queries as usize, references as usize).set_f(header.fortran_order);
    Array2::from_shape_vec(shape, values).map_err(|e| e.to_string())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_is_read_as_it_is_and_never_larger_than_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.npy");
        let matrix = ndarray::array![[1.0, 2.0, -3.0], [3.0, 4.5, 0.25]];
        write_npy(&path, &matrix).unwrap();
        assert_eq!(try_read(&path).unwrap(), matrix);
        write_npy(&path, &matrix.mapv(|v| v as f32)).unwrap();
        assert_eq!(try_read(&path).unwrap(), matrix);
        // The same numbers, transposed, stand there for the other order.
        write_npy(&path, &ndarray::array![[1.0, 3.0], [2.0, 4.5], [-3.0, 0.25]]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let changed = |from: &str, to: &str| {
            let text = String::from_utf8_lossy(&bytes[10..128]).replace(from, to);
            let new = [&bytes[..10], &text.as_bytes()[..118], &bytes[128..]].concat();
            std::fs::write(&path, new).unwrap();
            try_read(&path)
        };
        assert_eq!(changed("(3, 2)", "(2, 3)").unwrap().shape(), [2, 3]);
        let fortran = changed("False, 'shape': (3, 2)", "True, 'shape': (2, 3) ").unwrap();
        assert_eq!(fortran, matrix);
        for (from, to, wanted) in [
            ("'<f8'", "'<i8'", "its items are <i8"),
            (
                "(3, 2)",
                "(3, 99999999999)",
                "which is not what its shape [3, 99999999999] needs",
            ),
            ("(3, 2)", "(3, 3)", "it has 176 bytes, which is not what"),
            ("(3, 2)", "(6,)  ", "it has 1 axes"),
        ] {
            let error = changed(from, to).unwrap_err();
            assert!(error.contains(wanted), "{error}");
        }
    }
}
