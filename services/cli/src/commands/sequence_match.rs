//! `evpr sequence-match`: the matcher alone.

use crate::args::{SequenceMatchArgs, SequenceMethodArg};
use crate::failure::Failure;
use evpr_core::plan::SequenceMethod;
use ndarray::Array2;
use ndarray_npy::{ReadNpyError, read_npy, write_npy};
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

/// `evpr sequence-match`.
pub(crate) fn sequence_match(args: &SequenceMatchArgs) -> Result<ExitCode, Failure> {
    if args.length == 0 {
        return Err(Failure::usage(
            "--length 0 makes no sense; give a number of ticks of 1 or more",
        ));
    }
    let similarity = read_matrix(&args.similarity)?;
    if let Some(((q, r), value)) = similarity.indexed_iter().find(|(_, v)| !v.is_finite()) {
        return Err(Failure::new(format!(
            "{}: the similarity of query {q} and reference {r} is {value}; all must be finite",
            args.similarity.display()
        )));
    }
    let method = match args.method {
        SequenceMethodArg::Paper => SequenceMethod::Paper,
        SequenceMethodArg::None => SequenceMethod::None,
    };
    let matched = evpr_fuse::sequence_match(similarity.view(), args.length, method);
    write_npy(&args.out, &matched)
        .map_err(|e| Failure::new(format!("cannot write {}: {e}", args.out.display())))?;
    Ok(ExitCode::SUCCESS)
}
