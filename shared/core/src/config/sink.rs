//! What has been found wrong so far, and every key that has been asked for, with its documentation.

use super::error::{ConfigError, ConfigErrors, Lines, one_line};
use super::syntax::SyntaxError;
use super::words::{nearest, one_of};
use std::cell::RefCell;
use std::collections::BTreeSet;
use toml::de::DeTable;

/// A key of the configuration, described where it is read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Key {
    /// As [`KeyDoc::key`].
    pub name: &'static str,
    /// As [`KeyDoc::kind`].
    pub kind: &'static str,
    /// As [`KeyDoc::default`].
    pub default: Option<&'static str>,
    /// As [`KeyDoc::doc`].
    pub doc: &'static str,
}

/// A line of the reference of all keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeyDoc {
    /// The table it is in, such as `slicing` or `fuse.sequence`.
    pub section: String,
    /// Its name.
    pub key: &'static str,
    /// What values it takes.
    pub kind: &'static str,
    /// The value it has when it is not there, as TOML; none when `doc` says what happens then.
    pub default: Option<&'static str>,
    /// What it does.
    pub doc: &'static str,
}

/// A place in the configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct At {
    /// Dotted path.
    pub key: String,
    /// Byte offset.
    pub offset: usize,
}

struct Report {
    at: At,
    message: String,
    /// It says that something is not there, which a mistake in the syntax may have caused.
    absence: bool,
}

/// A key nobody asked for.
pub(super) struct Stranger {
    /// Where it is.
    pub at: At,
    /// Its name.
    pub name: String,
    /// Whether it is a table or stanzas.
    pub is_table: bool,
    /// The table it is in.
    pub section: String,
    /// The keys that this table may have.
    pub known: Vec<String>,
}

/// What has been found so far.
pub(super) struct Sink<'r> {
    file: &'r str,
    lines: Lines<'r>,
    pub(super) empty: DeTable<'r>,
    reports: RefCell<Vec<Report>>,
    keys: RefCell<Vec<KeyDoc>>,
    strangers: RefCell<Vec<Stranger>>,
}

impl<'r> Sink<'r> {
    pub(super) fn new(text: &'r str, file: &'r str) -> Self {
        Self {
            file,
            lines: Lines::new(text),
            empty: DeTable::new(),
            reports: RefCell::default(),
            keys: RefCell::default(),
            strangers: RefCell::default(),
        }
    }

    /// Reports a mistake.
    pub(super) fn report(&self, at: &At, message: impl Into<String>) {
        self.push(at, message.into(), false);
    }

    /// Reports that something needed is not there. Left out when the syntax is broken, which may be the reason.
    pub(super) fn report_absence(&self, at: &At, message: impl Into<String>) {
        self.push(at, message.into(), true);
    }

    fn push(&self, at: &At, message: String, absence: bool) {
        let at = at.clone();
        self.reports.borrow_mut().push(Report { at, message, absence });
    }

    /// Notes that a key has been asked for.
    pub(super) fn document(&self, doc: KeyDoc) {
        let mut keys = self.keys.borrow_mut();
        if !keys.contains(&doc) {
            keys.push(doc);
        }
    }

    /// Notes a key that nobody asked for. What is said about it depends on the keys of all sections.
    pub(super) fn stranger(&self, stranger: Stranger) {
        self.strangers.borrow_mut().push(stranger);
    }

    /// All keys that were asked for.
    pub(super) fn keys(self) -> Vec<KeyDoc> {
        self.keys.into_inner()
    }

    /// A mistake that is not in the syntax, placed in the file.
    pub(super) fn error(&self, at: &At, message: &str) -> ConfigError {
        ConfigError {
            file: self.file.to_owned(),
            line: self.lines.line(at.offset),
            column: self.lines.column(at.offset),
            key: one_line(&at.key),
            message: one_line(message),
        }
    }

    /// All mistakes. Of a line with broken syntax only the first mistake in the syntax is kept, and none from where
    /// the tables are not to be trusted.
    pub(super) fn into_errors(self, syntax: &[SyntaxError], trusted_until: usize) -> Option<ConfigErrors> {
        self.judge_strangers();
        let mut errors: Vec<ConfigError> = Vec::new();
        let mut broken = BTreeSet::new();
        let mut in_order: Vec<&SyntaxError> = syntax.iter().collect();
        in_order.sort_by_key(|e| e.offset);
        for e in in_order {
            let at = At {
                key: String::new(),
                offset: e.offset,
            };
            let error = self.error(&at, &e.message);
            if broken.insert(error.line) {
                errors.push(error);
            }
        }
        for report in self.reports.borrow().iter() {
            let error = self.error(&report.at, &report.message);
            let doubtful = report.absence && !syntax.is_empty();
            if !doubtful && report.at.offset < trusted_until && !broken.contains(&error.line) {
                errors.push(error);
            }
        }
        (!errors.is_empty()).then(|| ConfigErrors::new(errors))
    }

    /// Says of each key that nobody asked for what was most likely meant.
    fn judge_strangers(&self) {
        for stranger in self.strangers.take() {
            let Stranger {
                at,
                name,
                is_table,
                section,
                known,
            } = stranger;
            let what = if is_table && section.is_empty() {
                "table"
            } else {
                "key"
            };
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            let keys = self.keys.borrow();
            let home = keys.iter().find(|k| k.key == name && k.section != section);
            let quoted: Vec<String> = known.iter().map(|k| format!("`{k}`")).collect();
            let hint = match (nearest(&name, &known), home) {
                (Some(near), _) => format!("did you mean `{near}`?"),
                (None, Some(home)) => format!("it belongs in [{}]", home.section),
                (None, None) if known.is_empty() => "nothing can be set here".to_owned(),
                (None, None) => format!("write {}", one_of(&quoted)),
            };
            self.report(&at, format!("unknown {what} `{name}`; {hint}"));
        }
    }
}
