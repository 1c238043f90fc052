//! Prophesee: `/CD/events`, a compound of `x`, `y`, `p` and `t` (µs), `/EXT_TRIGGER/events`, attribute `geometry`
//! (`640x480`, width first) on the root. Source: docs.prophesee.ai, "HDF5 Event File Format".
//!
//! As the vendor's tools write it, it is compressed by their own filter (ECF), which is not read here.

use super::column::Column;
use super::stored::Stored;
use super::type_name;
use crate::{MAX_TIME_NS, RawEvent};
use hdf5_reader::error::{Error, Result as Hdf5Result};
use hdf5_reader::group::Group;
use hdf5_reader::{ByteOrder, Datatype, H5Type};

pub(super) const FORMAT: &str = "HDF5 (Prophesee layout)";
pub(super) const PATH: &str = "/CD/events";

/// The events of the compound; its type is checked.
pub(super) fn column(stored: Stored) -> Result<Column<RawEvent>, String> {
    if Fields::of(stored.dtype()).is_none() {
        return Err(format!(
            "{PATH} has type {}, not a compound of the whole numbers x, y, p and t; convert it",
            type_name(stored.dtype())
        ));
    }
    let load = |stored: &mut Stored, part, out: &mut Vec<RawEvent>| {
        out.clear();
        let mut wrong = None;
        stored.read::<Cd>(part, |read| {
            let room = out.try_reserve(read.len());
            room.map_err(|e| Error::ResourceLimit(e.to_string()))?;
            let start = out.len();
            out.extend(read.iter().map_while(|cd| match cd {
                Cd::Event(event) => Some(*event),
                Cd::Wrong(..) => None,
            }));
            if let Some(Cd::Wrong(name, value)) = read.get(out.len() - start) {
                wrong = Some(format!("{name} {value}; {name} cannot be that"));
            }
            Ok(wrong.is_none())
        })?;
        Ok(wrong)
    };
    Ok(Column::new(PATH.to_owned(), stored, Box::new(load)))
}

/// Number of external triggers.
pub(super) fn triggers(root: &Group) -> u64 {
    let events = root.group("EXT_TRIGGER").and_then(|g| g.dataset("events"));
    events.map_or(0, |d| d.shape().first().copied().unwrap_or(0))
}

/// One element of the compound.
#[derive(Clone, Copy)]
enum Cd {
    Event(RawEvent),
    /// Which field, and its value.
    Wrong(&'static str, i64),
}

/// Where a whole number stands in a compound.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Field {
    offset: usize,
    bytes: usize,
    signed: bool,
    big_endian: bool,
}

impl Field {
    fn of(fields: &[hdf5_reader::CompoundField], name: &str, size: usize) -> Option<Self> {
        let field = fields.iter().find(|f| f.name == name)?;
        let Datatype::FixedPoint {
            size: bytes,
            signed,
            byte_order,
        } = field.datatype
        else {
            return None;
        };
        let (offset, bytes) = (field.byte_offset as usize, usize::from(bytes));
        let fits = matches!(bytes, 1 | 2 | 4 | 8) && offset.checked_add(bytes)? <= size;
        fits.then_some(Self {
            offset,
            bytes,
            signed,
            big_endian: byte_order == ByteOrder::BigEndian,
        })
    }

    /// Its value in an element; what is too large for `i64` counts as its largest, which no field may be.
    #[inline]
    fn read(self, element: &[u8]) -> i64 {
        let mut value = [0; 8];
        for (i, byte) in element.iter().skip(self.offset).take(self.bytes).enumerate() {
            let at = if self.big_endian { self.bytes - 1 - i } else { i };
            value[at] = *byte;
        }
        let value = i64::from_le_bytes(value);
        let unused = 64 - 8 * self.bytes as u32;
        if self.signed {
            value << unused >> unused
        } else {
            // A sign here is the highest bit of 64 without one.
            if value < 0 { i64::MAX } else { value }
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
struct Fields {
    size: usize,
    x: Field,
    y: Field,
    p: Field,
    t: Field,
}

impl Fields {
    fn of(dtype: &Datatype) -> Option<Self> {
        let Datatype::Compound { size, fields } = dtype else {
            return None;
        };
        let size = *size as usize;
        let field = |name| Field::of(fields, name, size);
        Some(Self {
            size,
            x: field("x")?,
            y: field("y")?,
            p: field("p")?,
            t: field("t")?,
        })
    }

    /// As the vendor's tools write it.
    fn usual() -> Self {
        let field = |offset, bytes, signed| Field {
            offset,
            bytes,
            signed,
            big_endian: false,
        };
        Self {
            size: 16,
            x: field(0, 2, false),
            y: field(2, 2, false),
            p: field(4, 2, true),
            t: field(8, 8, true),
        }
    }

    #[inline]
    fn read(self, element: &[u8]) -> Cd {
        cd(
            self.x.read(element),
            self.y.read(element),
            self.p.read(element),
            self.t.read(element),
        )
    }
}

#[inline]
fn cd(x: i64, y: i64, p: i64, t_us: i64) -> Cd {
    let coordinate = |v: i64| u16::try_from(v).unwrap_or(u16::MAX);
    let t_ns = u64::try_from(t_us).ok().and_then(|t| t.checked_mul(1_000));
    match t_ns {
        _ if x < 0 => Cd::Wrong("x", x),
        _ if y < 0 => Cd::Wrong("y", y),
        _ if !(-1..=1).contains(&p) => Cd::Wrong("polarity", p),
        Some(t_ns) if t_ns <= MAX_TIME_NS => Cd::Event(RawEvent {
            t_ns,
            x: coordinate(x),
            y: coordinate(y),
            on: p == 1,
        }),
        _ => Cd::Wrong("time", t_us),
    }
}

/// An element of the usual layout.
#[inline]
fn usual(element: &[u8; 16]) -> Cd {
    let [x0, x1, y0, y1, p0, p1, _, _, t @ ..] = *element;
    cd(
        u16::from_le_bytes([x0, x1]).into(),
        u16::from_le_bytes([y0, y1]).into(),
        i16::from_le_bytes([p0, p1]).into(),
        i64::from_le_bytes(t),
    )
}

impl H5Type for Cd {
    fn hdf5_type() -> Datatype {
        Datatype::Compound {
            size: 16,
            fields: Vec::new(),
        }
    }

    fn from_bytes(bytes: &[u8], dtype: &Datatype) -> Hdf5Result<Self> {
        let fields = Fields::of(dtype).filter(|f| f.size <= bytes.len());
        fields
            .map(|f| f.read(bytes))
            .ok_or_else(|| Error::InvalidData("not a compound of events".to_owned()))
    }

    fn element_size(dtype: &Datatype) -> usize {
        match dtype {
            Datatype::Compound { size, .. } => *size as usize,
            _ => 0,
        }
    }

    fn decode_vec(raw: &[u8], dtype: &Datatype, count: usize) -> Option<Hdf5Result<Vec<Self>>> {
        let fields = Fields::of(dtype)?;
        let raw = raw.get(..count.checked_mul(fields.size)?)?;
        Some(Ok(if fields == Fields::usual() {
            raw.as_chunks().0.iter().map(usual).collect()
        } else {
            raw.chunks_exact(fields.size.max(1))
                .map(|e| fields.read(e))
                .collect()
        }))
    }
}
