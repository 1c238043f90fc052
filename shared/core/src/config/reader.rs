//! A cursor over the tables of a configuration: it reports every mistake to the [`Sink`] instead of stopping at the
//! first. What cannot be used reads as none, once that has been reported.

use super::sink::{At, Key, KeyDoc, Sink, Stranger};
use super::words::{Words, one_of};
use crate::time::parse_duration_ns;
use std::cell::RefCell;
use std::ops::RangeInclusive;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table, and which of its keys have been asked for.
pub(super) struct Table<'r> {
    pub(super) sink: &'r Sink<'r>,
    pub(super) at: At,
    table: &'r DeTable<'r>,
    known: RefCell<Vec<String>>,
}

impl<'r> Table<'r> {
    fn new(sink: &'r Sink<'r>, at: At, table: &'r DeTable<'r>) -> Self {
        Self {
            sink,
            at,
            table,
            known: RefCell::default(),
        }
    }

    /// The whole document.
    pub(super) fn root(sink: &'r Sink<'r>, table: &'r DeTable<'r>) -> Self {
        let at = At {
            key: String::new(),
            offset: 0,
        };
        Self::new(sink, at, table)
    }

    /// The value of a key, if it is there.
    pub(super) fn value(&self, name: &str) -> Option<Value<'r>> {
        self.known.borrow_mut().push(name.to_owned());
        let value = self.table.get(name)?;
        Some(Value {
            sink: self.sink,
            at: self.below(name, value.span().start),
            value,
        })
    }

    /// Whether the key is there.
    pub(super) fn has(&self, name: &str) -> bool {
        self.table.contains_key(name)
    }

    /// Every key with its value, whatever its name.
    pub(super) fn entries(&self) -> Vec<(&'r str, Value<'r>)> {
        let entry = |(key, value): (&'r Spanned<_>, &'r Spanned<_>)| {
            let name: &'r std::borrow::Cow<'r, str> = key.get_ref();
            self.known.borrow_mut().push(name.to_string());
            let at = self.below(name, key.span().start);
            let sink = self.sink;
            (name.as_ref(), Value { sink, at, value })
        };
        self.table.iter().map(entry).collect()
    }

    /// Reads a key that may be left out: then it is `default`. None when it is there but cannot be used, which has
    /// then been reported.
    pub(super) fn read<T>(
        &self,
        key: Key,
        default: T,
        read: impl FnOnce(&Value<'r>) -> Option<T>,
    ) -> Option<T> {
        match self.documented(key) {
            Some(value) => read(&value),
            None => Some(default),
        }
    }

    /// Reads a key that has no default.
    pub(super) fn read_optional<T>(
        &self,
        key: Key,
        read: impl FnOnce(&Value<'r>) -> Option<T>,
    ) -> Option<Option<T>> {
        match self.documented(key) {
            Some(value) => read(&value).map(Some),
            None => Some(None),
        }
    }

    /// Reads a key that must be there; `help` says what to write when it is not.
    pub(super) fn require<T>(
        &self,
        key: Key,
        help: &str,
        read: impl FnOnce(&Value<'r>) -> Option<T>,
    ) -> Option<T> {
        match self.documented(key) {
            Some(value) => read(&value),
            None => {
                let at = self.below(key.name, self.at.offset);
                self.sink.report_absence(&at, format!("is missing; {help}"));
                None
            }
        }
    }

    fn documented(&self, key: Key) -> Option<Value<'r>> {
        let doc = KeyDoc {
            section: self.section_name(),
            key: key.name,
            kind: key.kind,
            default: key.default,
            doc: key.doc,
        };
        self.sink.document(doc);
        self.value(key.name)
    }

    /// The path without indices: `reconstruction[1].params` is `reconstruction.params`.
    fn section_name(&self) -> String {
        let mut name = String::new();
        let mut depth = 0usize;
        for c in self.at.key.chars() {
            match c {
                '[' => depth += 1,
                ']' => depth = depth.saturating_sub(1),
                c if depth == 0 => name.push(c),
                _ => {}
            }
        }
        name
    }

    /// The table under this key; an empty one when there is none or it is no table (which is then reported).
    pub(super) fn section(&self, name: &str) -> Table<'r> {
        let value = self.value(name);
        let found = value.and_then(|v| match v.value.get_ref() {
            DeValue::Table(table) => Some(Table::new(v.sink, v.at, table)),
            _ => v.wrong(&format!("a table: a line [{}], and its keys below", v.at.key)),
        });
        found.unwrap_or_else(|| Table::new(self.sink, self.below(name, self.at.offset), &self.sink.empty))
    }

    /// The stanzas under this key, in order. None when it is something else, which is then reported.
    pub(super) fn stanzas(&self, name: &str) -> Option<Vec<Table<'r>>> {
        let Some(value) = self.value(name) else {
            return Some(Vec::new());
        };
        let help = format!("stanzas: a line [[{name}]] for each, and its keys below");
        let DeValue::Array(items) = value.value.get_ref() else {
            return value.wrong(&help);
        };
        let stanza = |(index, item): (usize, &'r Spanned<DeValue<'r>>)| {
            let item = value.item(index, item);
            match item.value.get_ref() {
                DeValue::Table(table) => Some(Table::new(item.sink, item.at, table)),
                _ => item.wrong(&help),
            }
        };
        let stanzas: Vec<Option<Table<'r>>> = items.iter().enumerate().map(stanza).collect();
        stanzas.into_iter().collect()
    }

    /// The place of a key in this table.
    pub(super) fn below(&self, name: &str, offset: usize) -> At {
        let bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        let name = match name.is_empty() || !name.chars().all(bare) {
            true => format!("{name:?}"),
            false => name.to_owned(),
        };
        let key = match self.at.key.as_str() {
            "" => name,
            path => format!("{path}.{name}"),
        };
        At { key, offset }
    }

    /// Ends the reading: keys that nobody asked for are mistakes.
    pub(super) fn close(self) {
        let known = self.known.take();
        for (key, value) in self.table.iter() {
            let name: &str = key.get_ref();
            if !known.iter().any(|k| k == name) {
                self.sink.stranger(Stranger {
                    at: self.below(name, key.span().start),
                    name: name.to_owned(),
                    is_table: value.get_ref().is_table() || is_stanzas(value.get_ref()),
                    section: self.section_name(),
                    known: known.clone(),
                });
            }
        }
    }
}

fn is_stanzas(value: &DeValue<'_>) -> bool {
    value
        .as_array()
        .is_some_and(|items| items.iter().any(|item| item.get_ref().is_table()))
}

/// A value, with where it is.
pub(super) struct Value<'r> {
    pub(super) sink: &'r Sink<'r>,
    pub(super) at: At,
    value: &'r Spanned<DeValue<'r>>,
}

impl<'r> Value<'r> {
    /// Reports that this is of the wrong type.
    fn wrong<T>(&self, expected: &str) -> Option<T> {
        let what = match self.value.get_ref() {
            DeValue::String(_) => "is a string",
            DeValue::Integer(_) | DeValue::Float(_) => "is a number",
            DeValue::Boolean(_) => "is a truth value",
            DeValue::Datetime(_) => "is a date or time",
            DeValue::Array(_) => "is a list",
            DeValue::Table(_) => "is a table",
        };
        self.refuse(format!("{what}; write {expected}"))
    }

    /// Reports a mistake in this value.
    pub(super) fn refuse<T>(&self, message: impl Into<String>) -> Option<T> {
        self.sink.report(&self.at, message);
        None
    }

    /// Takes a result, or reports its error.
    pub(super) fn accept<T>(&self, result: Result<T, String>) -> Option<T> {
        result.map_or_else(|message| self.refuse(message), Some)
    }

    fn item(&self, index: usize, value: &'r Spanned<DeValue<'r>>) -> Value<'r> {
        let at = At {
            key: format!("{}[{index}]", self.at.key),
            offset: value.span().start,
        };
        let sink = self.sink;
        Value { sink, at, value }
    }

    /// A string; `expected` says what to write instead of something else.
    pub(super) fn text(&self, expected: &str) -> Option<&'r str> {
        match self.value.get_ref() {
            DeValue::String(text) => Some(text.as_ref()),
            _ => self.wrong(expected),
        }
    }

    /// A string, if this is one.
    pub(super) fn as_text(&self) -> Option<&'r str> {
        self.value.get_ref().as_str()
    }

    /// One of these words.
    pub(super) fn word<T: Copy>(&self, words: &Words<'_, T>) -> Option<T> {
        let quoted: Vec<String> = words.all().iter().map(|w| format!("{w:?}")).collect();
        let text = self.text(&one_of(&quoted))?;
        self.accept(words.parse(text))
    }

    /// A span of time above 0 and at most a day, in nanoseconds.
    pub(super) fn duration_ns(&self) -> Option<u64> {
        /// Longer ones are mistakes; it also keeps sums of durations far from the end of 64 bits.
        const LONGEST_NS: u64 = 24 * 3_600_000_000_000;
        let text = self.text("a duration: a number with a unit in quotes, such as \"250ms\" or \"1s\"")?;
        match self.accept(parse_duration_ns(text))? {
            0 => self.refuse(format!(
                "\"{text}\" is no time at all; write a duration above 0, such as \"250ms\""
            )),
            ns if ns > LONGEST_NS => self.refuse(format!("\"{text}\" is too long; write at most \"24h\"")),
            ns => Some(ns),
        }
    }

    /// True or false.
    pub(super) fn boolean(&self) -> Option<bool> {
        match self.value.get_ref() {
            DeValue::Boolean(value) => Some(*value),
            _ => self.wrong("true or false"),
        }
    }

    /// A whole number in this range.
    pub(super) fn integer(&self, range: RangeInclusive<i64>) -> Option<i64> {
        let (low, high) = (range.start(), range.end());
        let help = format!("a whole number from {low} to {high}");
        match self.value.get_ref() {
            DeValue::Integer(digits) => match i64::from_str_radix(digits.as_str(), digits.radix()) {
                Ok(value) if range.contains(&value) => Some(value),
                _ => self.refuse(format!("{digits} is out of range; write {help}")),
            },
            DeValue::Float(digits) => self.refuse(format!("{digits} is not a whole number; write {help}")),
            _ => self.wrong(&help),
        }
    }

    /// A finite number in this range.
    pub(super) fn number(&self, range: RangeInclusive<f64>) -> Option<f64> {
        let (low, high) = (*range.start(), *range.end());
        let help = match (low, high) {
            (low, f64::MAX) => format!("a finite number of at least {low}"),
            _ => format!("a number from {low} to {high}"),
        };
        let Some(value) = self.as_number() else {
            return self.wrong(&help);
        };
        if range.contains(&value) {
            Some(value)
        } else {
            self.refuse(format!("{value} is out of range; write {help}"))
        }
    }

    /// A number, if this is one; it may be infinite or no number.
    pub(super) fn as_number(&self) -> Option<f64> {
        match self.value.get_ref() {
            DeValue::Integer(digits) => {
                let whole = i64::from_str_radix(digits.as_str(), digits.radix());
                Some(whole.map_or(f64::INFINITY, |whole| whole as f64))
            }
            DeValue::Float(digits) => Some(digits.as_str().parse().unwrap_or(f64::NAN)),
            _ => None,
        }
    }

    /// A list, each item read by `read`: none for each item that cannot be used.
    pub(super) fn list<T>(
        &self,
        expected: &str,
        read: impl FnMut(Value<'r>) -> Option<T>,
    ) -> Option<Vec<Option<T>>> {
        let DeValue::Array(items) = self.value.get_ref() else {
            return self.wrong(expected);
        };
        let items = items
            .iter()
            .enumerate()
            .map(|(index, item)| self.item(index, item));
        Some(items.map(read).collect())
    }

    /// A table in braces, or a section of its own.
    pub(super) fn table(&self, expected: &str) -> Option<Table<'r>> {
        match self.value.get_ref() {
            DeValue::Table(table) => Some(Table::new(self.sink, self.at.clone(), table)),
            _ => self.wrong(expected),
        }
    }
}
