//! Arrays inside an `.npz`, which is a zip archive of `.npy` files.

use super::decode::Column;
use super::header::{Header, Item};
use super::{Numpy, Rows};
use crate::formats::unit::{self, NAMES};
use crate::zip::Member;
use crate::{Input, SourceError};
use evpr_core::plan::TimeUnit;
use std::path::Path;

impl Numpy {
    /// The events of an archive: its only array, or four of one axis each that are called t, x, y and p.
    pub(in crate::formats) fn open_archive(
        path: &Path,
        members: &[Member],
        unit: TimeUnit,
    ) -> Result<Self, SourceError> {
        let stem = |m: &Member| m.file_name().strip_suffix(".npy").map(str::to_owned);
        let arrays: Vec<(&Member, String)> = members.iter().filter_map(|m| Some((m, stem(m)?))).collect();
        if let [(only, _)] = arrays.as_slice() {
            return Self::open(only.open()?, unit);
        }
        let mut named = None;
        let mut found = Vec::new();
        for (wanted, (name, names)) in NAMES.iter().enumerate() {
            let mut hits = arrays
                .iter()
                .filter_map(|(m, stem)| unit::column(stem).filter(|c| c.0 == wanted).map(|c| (m, c.1)));
            let wrong = |what: &str| {
                let have: Vec<&str> = arrays.iter().take(8).map(|(_, stem)| stem.as_str()).collect();
                let what = format!(
                    "{what} array {name} among {}; name one {}",
                    have.join(", ").escape_debug(),
                    names.join(" or ")
                );
                SourceError::malformed(path, what)
            };
            let (member, unit) = hits.next().ok_or_else(|| wrong("has no"))?;
            if hits.next().is_some() {
                return Err(wrong("has more than one"));
            }
            named = named.or(unit);
            found.push((member, Array::open(path, member)?));
        }
        let Ok([t, x, y, p]) = <[(&&Member, Array); 4]>::try_from(found) else {
            return Err(SourceError::malformed(path, "has not four arrays"));
        };
        let events = t.1.events;
        if let Some((member, array)) = [&x, &y, &p].into_iter().find(|a| a.1.events != events) {
            let what = format!(
                "has arrays of unequal length: {} of {events}, {} of {}",
                t.0.name, member.name, array.events
            );
            return Err(SourceError::malformed(path, what));
        }
        let arrays = [t.1, x.1, y.1, p.1];
        let mut at = 0;
        let columns = arrays.each_ref().map(|array| {
            at += 1;
            (at - 1, array.column)
        });
        let rows = arrays.map(Array::rows).into();
        Self::start(rows, columns, events, (unit, named))
    }
}

/// One array of one axis.
struct Array {
    input: Input,
    column: Column,
    events: u64,
}

impl Array {
    fn open(path: &Path, member: &Member) -> Result<Self, SourceError> {
        let mut input = member.open()?;
        let header = Header::read(&mut input)?;
        let (Item::Number(scalar), [events]) = (&header.item, header.shape.as_slice()) else {
            let what = format!("has an array {} that is not one axis of numbers", member.name);
            return Err(SourceError::malformed(path, what));
        };
        Ok(Self {
            input,
            column: Column {
                offset: 0,
                row_bytes: scalar.bytes,
                scalar: *scalar,
            },
            events: *events,
        })
    }

    fn rows(self) -> Rows {
        Rows {
            start: self.input.position(),
            row_bytes: self.column.row_bytes,
            input: self.input,
        }
    }
}
