//! Results on stdout. A reader that hangs up early (`evpr map info … | head -1`) is no failure.

use std::fmt::Arguments;
use std::io::Write;

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
