//! Text to TOML, with every mistake in its syntax and as much of the tables as can be had in spite of them.

use toml::de::{DeTable, DeValue, Error};

/// A mistake in the syntax.
#[derive(Debug)]
pub(super) struct SyntaxError {
    /// Byte offset.
    pub offset: usize,
    /// What is wrong and what to write instead.
    pub message: String,
}

/// What can be had of a text.
pub(super) struct Document<'t> {
    /// The tables.
    pub table: DeTable<'t>,
    /// Mistakes.
    pub errors: Vec<SyntaxError>,
    /// Byte offset from which on the tables are not to be trusted, as a bracket was never closed.
    pub trusted_until: usize,
}

/// Parses a text. Never fails: what cannot be read is in `errors`.
pub(super) fn parse(text: &str) -> Document<'_> {
    let (table, raw) = DeTable::parse_recoverable(text);
    let table = table.into_inner();
    let offset = |e: &Error| e.span().map_or(0, |span| span.start);
    let mut errors: Vec<SyntaxError> = Vec::new();
    let mut trusted_until = usize::MAX;
    if let Some((opened, bracket)) = unclosed_bracket(text, &table, &raw) {
        trusted_until = opened;
        let close = if bracket == '[' { ']' } else { '}' };
        errors.push(SyntaxError {
            offset: opened,
            message: format!(
                "not valid TOML: this `{bracket}` is never closed; write `{close}` where it ends"
            ),
        });
    }
    for error in raw.iter().filter(|e| offset(e) < trusted_until) {
        errors.push(SyntaxError {
            offset: offset(error),
            message: format!("not valid TOML: {}", explain(text, error)),
        });
    }
    Document {
        table,
        errors,
        trusted_until,
    }
}

/// A bracket that is never closed swallows the rest of the text, with a mistake reported at every key there. Finds
/// the place and kind of the outermost such bracket.
fn unclosed_bracket(text: &str, table: &DeTable<'_>, errors: &[Error]) -> Option<(usize, char)> {
    let swallowed = |e: &&Error| {
        let message = e.message();
        message.starts_with("unclosed array")
            || message.starts_with("unclosed inline table")
            || message.starts_with("unexpected `=` in array")
    };
    let at = errors
        .iter()
        .filter(swallowed)
        .filter_map(Error::span)
        .map(|s| s.start)
        .min()?;
    outermost_bracket(text, table, at)
}

fn outermost_bracket(text: &str, table: &DeTable<'_>, at: usize) -> Option<(usize, char)> {
    table.iter().find_map(|(_, value)| {
        let span = value.span();
        let holds = span.start < at && at <= span.end;
        let first = text.get(span.start..).and_then(|rest| rest.chars().next());
        match (value.get_ref(), first) {
            (DeValue::Array(_), Some('[')) if holds => Some((span.start, '[')),
            (DeValue::Table(_), Some('{')) if holds => Some((span.start, '{')),
            (DeValue::Table(inner), _) => outermost_bracket(text, inner, at),
            // Stanzas: an array of tables, whose span is its first header.
            (DeValue::Array(items), _) => items.iter().find_map(|item| match item.get_ref() {
                DeValue::Table(inner) => outermost_bracket(text, inner, at),
                _ => None,
            }),
            _ => None,
        }
    })
}

/// The parser's words, made to say what to write.
fn explain(text: &str, error: &Error) -> String {
    let span = error.span().unwrap_or_default();
    let token = text.get(span).unwrap_or_default();
    match error.message() {
        m if m.starts_with("string values must be quoted") => match token {
            "" => "there is no value after `=`; write one, or remove the key".to_owned(),
            token => format!("`{token}` is not a value; put it in quotes: \"{token}\""),
        },
        "duplicate key" => format!("`{token}` is there twice; remove one of them"),
        m if m.starts_with("invalid unquoted key") => format!("{m}; put the key in quotes"),
        m => m.to_owned(),
    }
}
