//! How a command fails: one line per mistake on stderr, and the exit code.

use std::fmt::Display;
use std::process::ExitCode;

/// Most lines that are printed: a file that is no configuration at all has a mistake in each of its lines.
const MAX_LINES: usize = 50;

/// Why a command failed.
#[derive(Debug)]
pub(crate) struct Failure {
    lines: Vec<String>,
    code: u8,
}

impl Failure {
    /// The input, the machine or the run: exit code 1.
    pub(crate) fn new(line: impl Display) -> Self {
        Self {
            lines: vec![line.to_string()],
            code: 1,
        }
    }

    /// What was asked for makes no sense: exit code 2.
    pub(crate) fn usage(line: impl Display) -> Self {
        Self {
            lines: vec![line.to_string()],
            code: 2,
        }
    }

    /// Somebody else has said why already: exit code 1.
    pub(crate) fn said_already() -> Self {
        Self {
            lines: Vec::new(),
            code: 1,
        }
    }

    /// What is wrong, in one line.
    pub(crate) fn text(&self) -> String {
        self.lines.join("; ")
    }

    /// Prints the lines and gives the exit code.
    pub(crate) fn report(self) -> ExitCode {
        let lines: Vec<&str> = self.lines.iter().flat_map(|text| text.lines()).collect();
        for line in lines.iter().take(MAX_LINES) {
            eprintln!("error: {line}");
        }
        if let Some(more) = lines.len().checked_sub(MAX_LINES).filter(|more| *more > 0) {
            eprintln!("error: and {more} more");
        }
        ExitCode::from(self.code)
    }
}

/// Any error of a library becomes its own line.
impl<E: std::error::Error> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::new(error)
    }
}
