//! Python literals, as far as headers of `.npy` files have them.

/// How deep brackets may stand in one another.
const MAX_DEPTH: usize = 8;

/// A literal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Literal {
    Text(String),
    Number(u64),
    Bool(bool),
    /// A tuple or a list.
    List(Vec<Literal>),
    Dict(Vec<(Literal, Literal)>),
}

/// Reads one literal, with blanks around it.
pub(super) fn parse(text: &[u8]) -> Option<Literal> {
    let mut rest = text;
    let literal = value(&mut rest, 0)?;
    blanks(&mut rest);
    rest.is_empty().then_some(literal)
}

fn blanks(rest: &mut &[u8]) {
    *rest = rest.trim_ascii_start();
}

/// Takes this byte if it comes next, after blanks.
fn takes(rest: &mut &[u8], byte: u8) -> bool {
    blanks(rest);
    let stripped = rest.strip_prefix(&[byte]);
    *rest = stripped.unwrap_or(rest);
    stripped.is_some()
}

fn value(rest: &mut &[u8], depth: usize) -> Option<Literal> {
    if depth > MAX_DEPTH {
        return None;
    }
    blanks(rest);
    let first = *rest.first()?;
    match first {
        b'\'' | b'"' => text(rest, first),
        b'(' => Some(Literal::List(items(rest, b'(', b')', depth)?)),
        b'[' => Some(Literal::List(items(rest, b'[', b']', depth)?)),
        b'{' => dict(rest, depth),
        b'0'..=b'9' => number(rest),
        _ => {
            let words: [(&[u8], bool); 2] = [(b"True", true), (b"False", false)];
            let (word, value) = words.into_iter().find(|(word, _)| rest.starts_with(word))?;
            *rest = &rest[word.len()..];
            Some(Literal::Bool(value))
        }
    }
}

/// No escapes: names of fields that need them are no names of columns.
fn text(rest: &mut &[u8], quote: u8) -> Option<Literal> {
    let inner = rest.get(1..)?;
    let end = inner.iter().position(|b| *b == quote)?;
    let text = Literal::Text(String::from_utf8_lossy(&inner[..end]).into_owned());
    *rest = &inner[end + 1..];
    Some(text)
}

fn number(rest: &mut &[u8]) -> Option<Literal> {
    let end = rest
        .iter()
        .position(|b| !b.is_ascii_digit())
        .unwrap_or(rest.len());
    let (digits, after) = rest.split_at(end);
    let number = std::str::from_utf8(digits).ok()?.parse().ok()?;
    // Python 2 wrote long integers with an L.
    *rest = after.strip_prefix(b"L").unwrap_or(after);
    Some(Literal::Number(number))
}

fn items(rest: &mut &[u8], open: u8, close: u8, depth: usize) -> Option<Vec<Literal>> {
    let mut items = Vec::new();
    takes(rest, open);
    while !takes(rest, close) {
        items.push(value(rest, depth + 1)?);
        if !takes(rest, b',') {
            return takes(rest, close).then_some(items);
        }
    }
    Some(items)
}

fn dict(rest: &mut &[u8], depth: usize) -> Option<Literal> {
    let mut entries = Vec::new();
    takes(rest, b'{');
    while !takes(rest, b'}') {
        let key = value(rest, depth + 1)?;
        if !takes(rest, b':') {
            return None;
        }
        entries.push((key, value(rest, depth + 1)?));
        if !takes(rest, b',') {
            return takes(rest, b'}').then_some(Literal::Dict(entries));
        }
    }
    Some(Literal::Dict(entries))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn literals_are_read() {
        let text = |t: &str| Literal::Text(t.to_owned());
        let one = Literal::List(vec![Literal::Number(1)]);
        assert_eq!(
            parse(b" {'a': [('t', \"<i8\"), ()], 'b': True, 'c': (1L,), }\n"),
            Some(Literal::Dict(vec![
                (
                    text("a"),
                    Literal::List(vec![
                        Literal::List(vec![text("t"), text("<i8")]),
                        Literal::List(vec![])
                    ])
                ),
                (text("b"), Literal::Bool(true)),
                (text("c"), one),
            ]))
        );
        for bad in [
            "", "{", "{'a' 1}", "(1 2)", "[1)", "'a", "-1", "None", "1 1", "{1:}",
        ] {
            assert_eq!(parse(bad.as_bytes()), None, "{bad}");
        }
        assert_eq!(parse("(".repeat(100_000).as_bytes()), None);
    }

    proptest! {
        #[test]
        fn any_text_is_taken_without_a_panic(text in "[\\[\\](){}':,0-9 Truea\"]{0,60}") {
            let _ = parse(text.as_bytes());
        }
    }
}
