//! As much of the structure of an HDF5 file as columns in a group need: superblock version 2, object headers version 2,
//! links within the header, chunks indexed by a B-tree of version 1. It is what libhdf5 from 1.8 on reads.
//! Source: "HDF5 File Format Specification Version 3.0", docs.hdfgroup.org.

use hdf5_reader::checksum::jenkins_lookup3;

pub(super) const SUPERBLOCK_BYTES: usize = 48;
/// As h5py's default.
pub(super) const DEFLATE_LEVEL: u32 = 4;

/// No address.
const NOWHERE: u64 = u64::MAX;
/// Most children of a node of a B-tree over chunks: twice the default K of 32.
const NODE_CHILDREN: usize = 64;
/// A key: stored bytes, filters left out, first element and place within the element.
const KEY_BYTES: usize = 24;
const NODE_BYTES: usize = 24 + (NODE_CHILDREN + 1) * KEY_BYTES + NODE_CHILDREN * 8;

/// Types of header messages.
const DATASPACE: u8 = 1;
const LINK_INFO: u8 = 2;
const DATATYPE: u8 = 3;
const FILL_VALUE: u8 = 5;
const LINK: u8 = 6;
const LAYOUT: u8 = 8;
const GROUP_INFO: u8 = 10;
const FILTERS: u8 = 11;
const ATTRIBUTE: u8 = 12;

/// A chunk that is written.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    /// Where it stands.
    pub(super) at: u64,
    /// How long it is there.
    pub(super) bytes: u32,
}

/// A dataset of one dimension of unsigned whole numbers, that can grow.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    pub(super) bytes_each: u32,
    pub(super) len: u64,
    pub(super) chunk_len: u32,
    /// Where its chunk index begins; `None` without chunks.
    pub(super) index: Option<u64>,
}

/// Appends numbers, little-endian.
macro_rules! put {
    ($out:expr, $($value:expr),+ $(,)?) => {$( $out.extend_from_slice(&$value.to_le_bytes()); )+};
}

fn with_checksum(mut out: Vec<u8>) -> Vec<u8> {
    let sum = jenkins_lookup3(&out);
    put!(out, sum);
    out
}

/// The superblock of a file of `end` bytes.
pub(super) fn superblock(root: u64, end: u64) -> Vec<u8> {
    let mut out = b"\x89HDF\r\n\x1a\n".to_vec();
    // Version; bytes of addresses and of lengths; flags.
    out.extend([2, 8, 8, 0]);
    put!(out, 0u64, NOWHERE, end, root);
    with_checksum(out)
}

/// An object header of these messages: type, flags, content.
fn header(messages: &[(u8, u8, Vec<u8>)]) -> Vec<u8> {
    let bytes: usize = messages.iter().map(|(_, _, content)| 4 + content.len()).sum();
    let mut out = b"OHDR".to_vec();
    // Version; flags: the size that follows has four bytes.
    out.extend([2, 2]);
    put!(out, bytes as u32);
    for (kind, flags, content) in messages {
        out.push(*kind);
        put!(out, content.len() as u16);
        out.push(*flags);
        out.extend(content);
    }
    with_checksum(out)
}

fn whole_number(bytes: u32, signed: bool) -> Vec<u8> {
    // Version 1, class 0; little-endian, and whether there is a sign.
    let mut out = vec![0x10, u8::from(signed) << 3, 0, 0];
    put!(out, bytes, 0u16, (8 * bytes) as u16);
    out
}

/// A group of objects by name and place, with whole numbers as attributes.
pub(super) fn group(members: &[(&str, u64)], attributes: &[(&str, i64)]) -> Vec<u8> {
    let mut info = vec![0, 0];
    put!(info, NOWHERE, NOWHERE);
    let mut messages = vec![(LINK_INFO, 0, info), (GROUP_INFO, 0, vec![0, 0])];
    for (name, at) in members {
        // Version; flags: a hard link whose name's length has one byte.
        let mut link = vec![1, 0, name.len() as u8];
        link.extend(name.as_bytes());
        put!(link, *at);
        messages.push((LINK, 0, link));
    }
    for (name, value) in attributes {
        let (datatype, scalar) = (whole_number(8, true), [2, 0, 0, 0]);
        let mut attribute = vec![3, 0];
        put!(
            attribute,
            name.len() as u16 + 1,
            datatype.len() as u16,
            scalar.len() as u16
        );
        attribute.push(0);
        attribute.extend(name.as_bytes());
        attribute.push(0);
        attribute.extend(datatype);
        attribute.extend(scalar);
        put!(attribute, *value);
        messages.push((ATTRIBUTE, 0, attribute));
    }
    header(&messages)
}

/// A dataset whose chunks passed shuffle and deflate.
pub(super) fn dataset(column: &Column) -> Vec<u8> {
    // Version, one dimension, its limit is given, simple; length and limit: none.
    let mut dataspace = vec![2, 1, 1, 1];
    put!(dataspace, column.len, u64::MAX);
    // Version 3, chunked; the dimensions of a chunk and, as one more, the bytes of a value.
    let mut layout = vec![3, 2, 2];
    put!(
        layout,
        column.index.unwrap_or(NOWHERE),
        column.chunk_len,
        column.bytes_each
    );
    // Version 2, two filters: number, flags (may be left out), count of values, value.
    let mut filters = vec![2, 2];
    put!(filters, 2u16, 1u16, 1u16, column.bytes_each);
    put!(filters, 1u16, 1u16, 1u16, DEFLATE_LEVEL);
    header(&[
        (DATASPACE, 0, dataspace),
        (DATATYPE, 1, whole_number(column.bytes_each, false)),
        // Version 3; space is given chunk by chunk, and filled with 0.
        (FILL_VALUE, 1, vec![3, 0b1011]),
        (LAYOUT, 0, layout),
        (FILTERS, 1, filters),
    ])
}

/// What a node of the index refers to: a chunk or another node, and the first element there.
#[derive(Clone, Copy)]
struct Child {
    first: u64,
    bytes: u32,
    at: u64,
}

/// The B-tree over chunks, to be written at `at`, and where its root stands then; none without chunks.
pub(super) fn chunk_index(chunks: &[Chunk], chunk_len: u64, at: u64) -> (Vec<u8>, Option<u64>) {
    let first = |i: usize| i as u64 * chunk_len;
    let mut children: Vec<_> = chunks
        .iter()
        .enumerate()
        .map(|(i, chunk)| Child {
            first: first(i),
            bytes: chunk.bytes,
            at: chunk.at,
        })
        .collect();
    let behind = Child {
        first: first(chunks.len()),
        bytes: 0,
        at: NOWHERE,
    };
    let mut out = Vec::new();
    for level in 0u8.. {
        let nodes = children.len().div_ceil(NODE_CHILDREN);
        let begin = at + out.len() as u64;
        let place = |i: usize| begin + (i * NODE_BYTES) as u64;
        let mut parents = Vec::with_capacity(nodes);
        for (i, node) in children.chunks(NODE_CHILDREN).enumerate() {
            let next = children.get((i + 1) * NODE_CHILDREN).unwrap_or(&behind);
            let left = if i == 0 { NOWHERE } else { place(i - 1) };
            let right = if i + 1 == nodes { NOWHERE } else { place(i + 1) };
            out.extend(index_node(level, node, next, left, right));
            if let Some(child) = node.first() {
                parents.push(Child {
                    at: place(i),
                    ..*child
                });
            }
        }
        children = parents;
        if children.len() <= 1 {
            break;
        }
    }
    (out, children.first().map(|root| root.at))
}

fn index_node(level: u8, children: &[Child], next: &Child, left: u64, right: u64) -> Vec<u8> {
    let mut out = Vec::with_capacity(NODE_BYTES);
    out.extend(b"TREE");
    // Over chunks.
    out.extend([1, level]);
    put!(out, children.len() as u16, left, right);
    for child in children {
        put!(out, child.bytes, 0u32, child.first, 0u64, child.at);
    }
    put!(out, next.bytes, 0u32, next.first, 0u64);
    out.resize(NODE_BYTES, 0);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_index_of_many_chunks_has_levels() {
        let chunk = Chunk { at: 48, bytes: 10 };
        for (chunks, nodes) in [(0, 0), (1, 1), (64, 1), (65, 3), (4096, 65), (4097, 68)] {
            let (bytes, root) = chunk_index(&vec![chunk; chunks], 100, 1_000);
            assert_eq!(bytes.len(), nodes * NODE_BYTES, "{chunks}");
            let last = (nodes > 0).then(|| 1_000 + ((nodes - 1) * NODE_BYTES) as u64);
            assert_eq!(root, last, "{chunks}");
        }
    }
}
