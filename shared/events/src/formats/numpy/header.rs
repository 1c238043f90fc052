//! Headers of `.npy` files, format versions 1.0 to 3.0
//! (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>).

use super::literal::{self, Literal};
use crate::{Input, SourceError};

pub(in crate::formats) const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read, bytes.
const MAX_HEADER_BYTES: usize = 64 << 10;
/// Largest item that is read, bytes.
const MAX_ITEM_BYTES: usize = 64 << 10;

/// What the bytes of a number mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Class {
    Bool,
    Signed,
    Unsigned,
    Float,
}

/// The type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Scalar {
    pub(super) class: Class,
    /// 1, 2, 4 or 8 bytes.
    pub(super) bytes: usize,
    pub(super) big_endian: bool,
}

/// A field of a structured array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) offset: usize,
    /// `None` when it is no number.
    pub(super) scalar: Option<Scalar>,
}

/// What an item of an array is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Item {
    Number(Scalar),
    Fields { fields: Vec<Field>, bytes: usize },
}

/// What a header says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) item: Item,
    /// Whether the first axis varies fastest.
    pub(super) fortran_order: bool,
    pub(super) shape: Vec<u64>,
}

impl Header {
    /// Takes the header at the start of the input; the array's first byte comes next.
    pub(super) fn read(input: &mut Input) -> Result<Self, SourceError> {
        let wrong = |input: &Input, what: &str| SourceError::malformed(input.path(), what);
        let start = input.peek(12)?;
        let (at, len) = match start {
            [m @ .., _, _, _, _, _, _] if !m.starts_with(MAGIC) => (0, 0),
            [_, _, _, _, _, _, 1, _, a, b, ..] => (10, usize::from(u16::from_le_bytes([*a, *b]))),
            [_, _, _, _, _, _, 2 | 3, _, a, b, c, d, ..] => {
                (12, u32::from_le_bytes([*a, *b, *c, *d]) as usize)
            }
            _ => (0, 0),
        };
        if at == 0 {
            return Err(wrong(
                input,
                "has no .npy header of version 1, 2 or 3; save it again with numpy.save",
            ));
        }
        if len > MAX_HEADER_BYTES {
            let what = format!("has a .npy header of {len} bytes; at most {MAX_HEADER_BYTES} are read");
            return Err(wrong(input, &what));
        }
        let Some(text) = input.peek(at + len)?.get(at..at + len) else {
            return Err(wrong(input, "ends within its .npy header; it is cut short"));
        };
        let header = literal::parse(text).ok_or("is no Python literal".to_owned());
        let header = header.and_then(|l| Self::of(&l));
        let header = header.map_err(|what| wrong(input, &format!("has a .npy header that {what}")))?;
        input.consume(at + len);
        Ok(header)
    }

    fn of(literal: &Literal) -> Result<Self, String> {
        let Literal::Dict(entries) = literal else {
            return Err("is no dictionary".to_owned());
        };
        let entry = |name: &str| {
            let found = entries
                .iter()
                .find(|(key, _)| matches!(key, Literal::Text(t) if t == name));
            found
                .map(|(_, value)| value)
                .ok_or_else(|| format!("has no entry '{name}'"))
        };
        let Literal::Bool(fortran_order) = entry("fortran_order")? else {
            return Err("has an entry 'fortran_order' that is not True or False".to_owned());
        };
        let not_a_shape = || "has an entry 'shape' that is not a tuple of lengths".to_owned();
        let Literal::List(axes) = entry("shape")? else {
            return Err(not_a_shape());
        };
        let axis = |axis: &Literal| match axis {
            Literal::Number(n) => Ok(*n),
            _ => Err(not_a_shape()),
        };
        Ok(Self {
            item: item(entry("descr")?)?,
            fortran_order: *fortran_order,
            shape: axes.iter().map(axis).collect::<Result<_, _>>()?,
        })
    }
}

fn item(descr: &Literal) -> Result<Item, String> {
    match descr {
        Literal::Text(name) => match simple(name) {
            Some((Some(scalar), _)) => Ok(Item::Number(scalar)),
            _ => Err(format!("has items of type '{name}'; events are of numbers")),
        },
        Literal::List(list) => {
            let (mut fields, mut bytes) = (Vec::new(), 0usize);
            for entry in list {
                let (field, len) = field(entry, bytes)?;
                fields.push(field);
                bytes = bytes.saturating_add(len);
                if bytes > MAX_ITEM_BYTES {
                    return Err(format!("has items of more than {MAX_ITEM_BYTES} bytes"));
                }
            }
            if bytes == 0 {
                return Err("has items of no bytes".to_owned());
            }
            Ok(Item::Fields { fields, bytes })
        }
        _ => Err("has an entry 'descr' that is no type".to_owned()),
    }
}

/// One field, and how many bytes it takes: `('x', '<u2')`, `(('title', 'x'), '<u2')` or `('x', '<u2', (1,))`.
fn field(entry: &Literal, offset: usize) -> Result<(Field, usize), String> {
    let no_field = || "has an entry 'descr' with a field that is not (name, type)".to_owned();
    let Literal::List(parts) = entry else {
        return Err(no_field());
    };
    let (name, kind, shape) = match parts.as_slice() {
        [name, kind] => (name, kind, [].as_slice()),
        [name, kind, Literal::List(shape)] => (name, kind, shape.as_slice()),
        _ => return Err(no_field()),
    };
    let name = match name {
        Literal::Text(name) => name,
        Literal::List(titled) => match titled.as_slice() {
            [_, Literal::Text(name)] => name,
            _ => return Err(no_field()),
        },
        _ => return Err(no_field()),
    };
    let Literal::Text(kind) = kind else {
        return Err(format!("has a field '{name}' that has fields of its own"));
    };
    let (scalar, bytes) =
        simple(kind).ok_or_else(|| format!("has a field '{name}' of the unknown type '{kind}'"))?;
    let items = shape.iter().try_fold(1usize, |n, axis| match axis {
        Literal::Number(len) => Some(n.saturating_mul(usize::try_from(*len).unwrap_or(usize::MAX))),
        _ => None,
    });
    let items = items.ok_or_else(no_field)?;
    let field = Field {
        name: name.clone(),
        offset,
        scalar: scalar.filter(|_| items == 1),
    };
    Ok((field, bytes.saturating_mul(items)))
}

/// A type that is no structure: as a number, if it is one that is read; and how many bytes it takes.
fn simple(name: &str) -> Option<(Option<Scalar>, usize)> {
    let (order, rest) = match name.as_bytes() {
        [order @ (b'<' | b'>' | b'|' | b'='), ..] => (*order, &name[1..]),
        _ => (b'=', name),
    };
    let kind = *rest.as_bytes().first()?;
    // What stands in brackets is the unit of a date.
    let digits = rest.get(1..)?.split('[').next()?;
    let number: usize = digits.parse().ok()?;
    let (class, bytes) = match kind {
        b'b' => (Some(Class::Bool), number),
        b'i' => (Some(Class::Signed), number),
        b'u' => (Some(Class::Unsigned), number),
        b'f' => (Some(Class::Float), number),
        b'U' => (None, number.checked_mul(4)?),
        b'S' | b'a' | b'V' | b'c' | b'm' | b'M' => (None, number),
        _ => return None,
    };
    let known = match class {
        Some(Class::Bool) => bytes == 1,
        Some(Class::Float) => matches!(bytes, 2 | 4 | 8),
        Some(_) => matches!(bytes, 1 | 2 | 4 | 8),
        None => false,
    };
    let scalar = class.filter(|_| known).map(|class| Scalar {
        class,
        bytes,
        big_endian: order == b'>',
    });
    Some((scalar, bytes))
}
