//! Chunks of messages: their decompression, in memory of bounded size.

use bzip2_rs::DecoderReader;
use lz4_flex::frame::FrameDecoder;
use std::io::Read;

/// Most bytes of a chunk that is read, as it is in the file and decompressed; and so of a message. The tools write
/// chunks of less than 1 MiB or little more than one message.
pub(super) const MAX_CHUNK_BYTES: usize = 64 << 20;

/// The names of compressions in bags and in MCAP.
pub(super) const BAG: &[&[u8]] = &[b"none", b"bz2", b"lz4"];
pub(super) const MCAP: &[&[u8]] = &[b"", b"lz4", b"zstd"];

/// Puts what `body` holds, said to be `size` bytes, in place of what is in `out`.
pub(super) fn decompress(
    compression: &[u8],
    known: &[&[u8]],
    body: &[u8],
    size: u64,
    out: &mut Vec<u8>,
) -> Result<(), String> {
    out.clear();
    let Some(size) = usize::try_from(size).ok().filter(|size| *size <= MAX_CHUNK_BYTES) else {
        return Err(format!(
            "says that it has {size} bytes, more than {} MiB; it is damaged, or write it with smaller chunks",
            MAX_CHUNK_BYTES >> 20
        ));
    };
    if !known.contains(&compression) {
        return Err(format!(
            "has the compression \"{}\", which is unknown",
            super::printable(compression)
        ));
    }
    match compression {
        b"lz4" => read(FrameDecoder::new(body), "an LZ4 frame", size, out)?,
        b"bz2" => read(DecoderReader::new(body), "bzip2 data", size, out)?,
        b"zstd" => zstd(body, size, out)?,
        _ => out.extend_from_slice(body),
    }
    if out.len() != size {
        return Err(format!(
            "has {} bytes, but should have {size}; it is damaged",
            out.len()
        ));
    }
    Ok(())
}

/// Reads one byte more than there should be, so that it is seen.
fn read(reader: impl Read, what: &str, size: usize, out: &mut Vec<u8>) -> Result<(), String> {
    out.reserve(size);
    reader
        .take(size as u64 + 1)
        .read_to_end(out)
        .map(|_| ())
        .map_err(|e| format!("is not {what}: {}; it is damaged", one_line(&e.to_string())))
}

fn zstd(body: &[u8], size: usize, out: &mut Vec<u8>) -> Result<(), String> {
    // Not less than one, as there is no room for a claim otherwise.
    out.reserve(size.max(1));
    zstd_safe::decompress(out, body).map(|_| ()).map_err(|code| {
        let why = zstd_safe::get_error_name(code);
        format!("is not a ZSTD frame: {}; it is damaged", one_line(why))
    })
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
