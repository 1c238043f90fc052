//! What is wrong with a configuration, and where.

use std::fmt;

/// One mistake in a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigError {
    /// The file, as it was named to [`super::parse`]; `command line` for a mistake in an option.
    pub file: String,
    /// Line, from 1; 0 when the mistake is not in the file.
    pub line: usize,
    /// Column in characters, from 1; 0 when the mistake is not in the file.
    pub column: usize,
    /// Dotted path of the key, such as `slicing.windows[2]`; empty when the text is not TOML there.
    pub key: String,
    /// What is wrong, and what to write instead. One line.
    pub message: String,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if self.line > 0 {
            write!(f, ":{}", self.line)?;
        }
        if !self.key.is_empty() {
            write!(f, ": {}", self.key)?;
        }
        write!(f, ": {}", self.message)
    }
}

/// All mistakes in a configuration, by line. It displays as one line for each, without a line feed at the end.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.lines())]
pub struct ConfigErrors {
    /// The mistakes; at least one.
    pub errors: Vec<ConfigError>,
}

impl ConfigErrors {
    /// These mistakes, sorted by line and column, each named once.
    pub(super) fn new(mut errors: Vec<ConfigError>) -> Self {
        errors.sort_by(|a, b| (a.line, a.column, &a.key).cmp(&(b.line, b.column, &b.key)));
        errors.dedup();
        Self { errors }
    }

    fn lines(&self) -> String {
        let lines: Vec<String> = self.errors.iter().map(ConfigError::to_string).collect();
        lines.join("\n")
    }
}

/// Finds lines and columns of byte offsets.
#[derive(Debug)]
pub(super) struct Lines<'a> {
    text: &'a str,
    /// Offsets at which lines begin, ascending; the first is 0.
    starts: Vec<usize>,
}

impl<'a> Lines<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        let after_feeds = text.match_indices('\n').map(|(at, _)| at + 1);
        Self {
            text,
            starts: std::iter::once(0).chain(after_feeds).collect(),
        }
    }

    /// Line of a byte offset, from 1. An offset behind the end is on the last line.
    pub(super) fn line(&self, offset: usize) -> usize {
        self.starts.partition_point(|start| *start <= offset)
    }

    /// Column of a byte offset in characters, from 1.
    pub(super) fn column(&self, offset: usize) -> usize {
        let start = self.starts[self.line(offset) - 1];
        let line = self.text.get(start..).unwrap_or_default();
        1 + line
            .char_indices()
            .take_while(|(at, _)| start + at < offset)
            .count()
    }
}

/// Makes any text fit one line: control characters are escaped, and what is too long is cut.
pub(super) fn one_line(text: &str) -> String {
    const LONGEST: usize = 400;
    let mut out = String::with_capacity(text.len().min(LONGEST));
    for (count, c) in text.chars().enumerate() {
        if count == LONGEST {
            out.push('…');
            break;
        }
        if c.is_control() || matches!(c, '\u{2028}' | '\u{2029}') {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_and_columns_count_from_one_and_in_characters() {
        let lines = Lines::new("ab\nµx = 1\n\nlast");
        let place = |offset| (lines.line(offset), lines.column(offset));
        assert_eq!(place(0), (1, 1));
        assert_eq!(place(2), (1, 3));
        assert_eq!(place(3), (2, 1));
        assert_eq!(place("ab\nµ".len()), (2, 2));
        assert_eq!(place("ab\nµx = 1\n".len()), (3, 1));
        assert_eq!(lines.line(usize::MAX), 4);
        assert_eq!(Lines::new("").column(7), 1);
    }

    #[test]
    fn errors_are_sorted_and_named_once() {
        let error = |line, key: &str| ConfigError {
            file: "f".to_owned(),
            line,
            column: usize::from(line > 0),
            key: key.to_owned(),
            message: "bad".to_owned(),
        };
        let errors = ConfigErrors::new(vec![
            error(3, "b"),
            error(1, ""),
            error(3, "b"),
            error(0, "--name"),
        ]);
        assert_eq!(errors.to_string(), "f: --name: bad\nf:1: bad\nf:3: b: bad");
    }

    #[test]
    fn a_message_stays_on_its_line() {
        assert_eq!(one_line("a\nb\u{2028}\t"), "a\\nb\\u{2028}\\t");
        assert_eq!(one_line(&"x".repeat(999)).chars().count(), 401);
    }
}
