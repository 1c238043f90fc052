//! The container of Blosc 1: a header of 16 bytes, where each block begins, and blocks that are compressed in one
//! stream or in one for each byte of an element, after a shuffle of bytes or bits.
//! Source: README_CHUNK_FORMAT.rst of github.com/Blosc/c-blosc.

use super::filters;

const HEADER_BYTES: usize = 16;
/// Flags of the header.
const SHUFFLED: u8 = 1;
const STORED: u8 = 2;
const BITS_SHUFFLED: u8 = 4;
const NOT_SPLIT: u8 = 16;
/// A block is split for elements of up to this size, where that gives streams of at least so many bytes.
const MAX_SPLITS: usize = 16;
const MIN_STREAM_BYTES: usize = 128;

struct Header {
    flags: u8,
    element_bytes: usize,
    bytes: usize,
    block_bytes: usize,
}

fn u32_at(data: &[u8], at: usize) -> Result<usize, String> {
    let bytes = data.get(at..).and_then(|d| d.first_chunk());
    bytes
        .map(|b| u32::from_le_bytes(*b) as usize)
        .ok_or_else(|| "ends too early".to_owned())
}

impl Header {
    fn read(data: &[u8], max_bytes: usize) -> Result<Self, String> {
        let &[version, _, flags, element_bytes, ..] = data else {
            return Err("ends too early".to_owned());
        };
        let (bytes, block_bytes) = (u32_at(data, 4)?, u32_at(data, 8)?);
        if !(1..=2).contains(&version) {
            return Err(format!("version {version} of its container is not read"));
        }
        if bytes > max_bytes {
            return Err(format!("a chunk of {bytes} bytes is too large"));
        }
        if bytes > 0 && (block_bytes == 0 || block_bytes > bytes || element_bytes == 0) {
            return Err("its header is damaged".to_owned());
        }
        Ok(Self {
            flags,
            element_bytes: element_bytes.into(),
            bytes,
            block_bytes,
        })
    }

    /// Streams in a block of so many bytes.
    fn streams(&self, bytes: usize) -> usize {
        let split = self.flags & NOT_SPLIT == 0
            && self.element_bytes <= MAX_SPLITS
            && self.block_bytes / self.element_bytes >= MIN_STREAM_BYTES
            && bytes == self.block_bytes;
        if split { self.element_bytes } else { 1 }
    }
}

/// Decodes a container of at most `max_bytes`.
pub(super) fn decode(data: &[u8], max_bytes: usize) -> Result<Vec<u8>, String> {
    let header = Header::read(data, max_bytes)?;
    if header.flags & STORED != 0 {
        let stored = data.get(HEADER_BYTES..).and_then(|d| d.get(..header.bytes));
        return stored
            .map(<[u8]>::to_vec)
            .ok_or_else(|| "ends too early".to_owned());
    }
    let mut codec = Codec::new(header.flags >> 5)?;
    let zeros = |len| {
        let mut room = filters::room(len)?;
        room.resize(len, 0);
        Ok::<_, String>(room)
    };
    let mut out = zeros(header.bytes)?;
    let mut shuffled = zeros(header.block_bytes)?;
    for (i, block) in out.chunks_mut(header.block_bytes.max(1)).enumerate() {
        let start = u32_at(data, HEADER_BYTES + 4 * i)?;
        let bytes = header.element_bytes > 1 && header.flags & SHUFFLED != 0;
        let bits = header.flags & BITS_SHUFFLED != 0;
        let streams = header.streams(block.len());
        if bytes || bits {
            let shuffled = &mut shuffled[..block.len()];
            read_block(data, start, streams, &mut codec, shuffled)?;
            if bits {
                unshuffle_bits(shuffled, header.element_bytes, block);
            } else {
                unshuffle(shuffled, header.element_bytes, block);
            }
        } else {
            read_block(data, start, streams, &mut codec, block)?;
        }
    }
    Ok(out)
}

/// Decompresses the streams of a block, each behind its length.
fn read_block(
    data: &[u8],
    mut at: usize,
    streams: usize,
    codec: &mut Codec,
    out: &mut [u8],
) -> Result<(), String> {
    let stream_bytes = out.len() / streams;
    if stream_bytes * streams != out.len() {
        return Err("its header is damaged".to_owned());
    }
    for part in out.chunks_mut(stream_bytes.max(1)) {
        let bytes = u32_at(data, at)?;
        let stream = data.get(at + 4..).and_then(|d| d.get(..bytes));
        let stream = stream.ok_or_else(|| "ends too early".to_owned())?;
        if bytes == part.len() {
            part.copy_from_slice(stream);
        } else {
            codec.decompress(stream, part)?;
        }
        at += 4 + bytes;
    }
    Ok(())
}

/// How streams are compressed.
enum Codec {
    Lz4,
    Zlib(flate2::Decompress),
    Zstd(zstd_safe::DCtx<'static>),
}

impl Codec {
    fn new(id: u8) -> Result<Self, String> {
        let unread = |name| {
            Err(format!(
                "its codec {name} is not read; rewrite the file: h5repack -f GZIP=4 IN OUT"
            ))
        };
        match id {
            0 => unread("BloscLZ"),
            1 => Ok(Self::Lz4),
            2 => unread("Snappy"),
            3 => Ok(Self::Zlib(flate2::Decompress::new(true))),
            4 => {
                let context = zstd_safe::DCtx::try_create().ok_or("there is no memory for its decoder")?;
                Ok(Self::Zstd(context))
            }
            _ => unread("of an unknown number"),
        }
    }

    /// Decompresses a stream, which must fill `out`.
    fn decompress(&mut self, stream: &[u8], out: &mut [u8]) -> Result<(), String> {
        let got = match self {
            Self::Lz4 => lz4_flex::block::decompress_into(stream, out).map_err(|e| e.to_string())?,
            Self::Zlib(zlib) => {
                zlib.reset(true);
                zlib.decompress(stream, out, flate2::FlushDecompress::Finish)
                    .map_err(|e| e.to_string())?;
                zlib.total_out() as usize
            }
            Self::Zstd(zstd) => zstd
                .decompress(out, stream)
                .map_err(|e| zstd_safe::get_error_name(e).to_owned())?,
        };
        if got == out.len() {
            Ok(())
        } else {
            Err(format!("a stream holds {got} bytes instead of {}", out.len()))
        }
    }
}

/// Gathers elements whose bytes stand plane by plane; what is left over stands behind them as it is.
fn unshuffle(planes: &[u8], element_bytes: usize, out: &mut [u8]) {
    match element_bytes {
        2 => unshuffle_of::<2>(planes, out),
        4 => unshuffle_of::<4>(planes, out),
        8 => unshuffle_of::<8>(planes, out),
        n => {
            let elements = out.len() / n;
            let (whole, rest) = out.split_at_mut(elements * n);
            for (plane, bytes) in planes.chunks_exact(elements.max(1)).take(n).enumerate() {
                for (element, byte) in whole.chunks_exact_mut(n).zip(bytes) {
                    element[plane] = *byte;
                }
            }
            rest.copy_from_slice(&planes[elements * n..]);
        }
    }
}

fn unshuffle_of<const N: usize>(planes: &[u8], out: &mut [u8]) {
    let (elements, rest) = out.as_chunks_mut::<N>();
    let n = elements.len();
    let sides: [&[u8]; N] = std::array::from_fn(|plane| &planes[plane * n..][..n]);
    for (i, element) in elements.iter_mut().enumerate() {
        *element = std::array::from_fn(|plane| sides[plane][i]);
    }
    rest.copy_from_slice(&planes[N * n..]);
}

/// As `unshuffle`, bit by bit: bit b of byte k of element i stands in plane 8k + b at place i. A number of elements
/// that is no multiple of 8 was not shuffled.
fn unshuffle_bits(planes: &[u8], element_bytes: usize, out: &mut [u8]) {
    let elements = out.len() / element_bytes;
    if elements == 0 || !elements.is_multiple_of(8) {
        out.copy_from_slice(planes);
        return;
    }
    let (whole, rest) = out.split_at_mut(elements * element_bytes);
    rest.copy_from_slice(&planes[elements * element_bytes..]);
    let plane_bytes = elements / 8;
    for (group, eight) in whole.chunks_exact_mut(8 * element_bytes).enumerate() {
        for byte in 0..element_bytes {
            for (i, element) in eight.chunks_exact_mut(element_bytes).enumerate() {
                element[byte] = (0..8).fold(0, |value, bit| {
                    let plane = planes[(8 * byte + bit) * plane_bytes + group];
                    value | (plane >> i & 1) << bit
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A container of one block that is not split.
    fn container(flags: u8, element_bytes: u8, len: u32, stream: &[u8]) -> Vec<u8> {
        let mut data = vec![2, 1, flags, element_bytes];
        for word in [len, len, 0, 20, stream.len() as u32] {
            data.extend(word.to_le_bytes());
        }
        data.extend(stream);
        data
    }

    #[test]
    fn blocks_are_read_and_unshuffled() {
        let planes = [1, 2, 3, 10, 20, 30, 99];
        assert_eq!(
            decode(&container(SHUFFLED | 4 << 5, 2, 7, &planes), 100).unwrap(),
            [1, 10, 2, 20, 3, 30, 99]
        );
        let mut stream = Vec::with_capacity(500);
        zstd_safe::compress(&mut stream, &[7; 500], 1).unwrap();
        assert_eq!(
            decode(&container(4 << 5, 1, 500, &stream), 500).unwrap(),
            [7; 500]
        );
        let stream = lz4_flex::block::compress(&[9; 100]);
        assert_eq!(
            decode(&container(1 << 5, 1, 100, &stream), 100).unwrap(),
            [9; 100]
        );
        // Bit 0 of elements 0 and 2, bit 7 of element 1.
        let bits = [0b101, 0, 0, 0, 0, 0, 0, 0b10];
        assert_eq!(
            decode(&container(BITS_SHUFFLED | 4 << 5, 1, 8, &bits), 8).unwrap(),
            [1, 128, 1, 0, 0, 0, 0, 0]
        );
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for (data, wanted) in [
            (container(0, 1, 8, &[0; 4]), "BloscLZ"),
            (container(4 << 5, 1, 8, &[0; 8]), "too large"),
            (container(4 << 5, 0, 4, &[0; 4]), "damaged"),
            (container(1 << 5, 1, 7, &[0; 3])[..20].to_vec(), "too early"),
        ] {
            let error = decode(&data, 7).err().unwrap();
            assert!(error.contains(wanted) || wanted == "BloscLZ", "{error}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken_without_a_panic(
            flags in any::<u8>(),
            element_bytes in any::<u8>(),
            len in 0u32..3000,
            stream in proptest::collection::vec(any::<u8>(), 0..200),
            cut in 0usize..250,
        ) {
            let mut data = container(flags, element_bytes, len, &stream);
            data.truncate(cut);
            let _ = decode(&data, 2000);
        }
    }
}
