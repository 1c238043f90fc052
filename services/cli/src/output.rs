//! Results on stdout. A reader that hangs up early (`evpr map info … | head -1`) is no failure.

use crate::failure::Failure;
use std::fmt::Arguments;
use std::io::Write;
use std::path::Path;

/// Writes one line to stdout.
pub(crate) fn line(text: Arguments<'_>) {
    // Nothing can be done about a stdout that is gone, and nothing needs to be.
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// `println!` for results.
macro_rules! say {
    () => { $crate::output::line(format_args!("")) };
    ($($text:tt)*) => { $crate::output::line(format_args!($($text)*)) };
}
pub(crate) use say;

/// Refuses to write over what the same command reads. `out` need not exist.
pub(crate) fn refuse_input(out: &Path, inputs: &[&Path]) -> Result<(), Failure> {
    let Ok(target) = out.canonicalize() else {
        return Ok(());
    };
    let read = |input: &&&Path| {
        input
            .canonicalize()
            // A folder itself is refused by whoever opens it as a file.
            .is_ok_and(|input| target.starts_with(&input) && (input == target) != input.is_dir())
    };
    match inputs.iter().find(read) {
        Some(input) => Err(Failure::new(format!(
            "{} is (or lies in) {}, which is read; write to another file",
            out.display(),
            input.display()
        ))),
        None => Ok(()),
    }
}
