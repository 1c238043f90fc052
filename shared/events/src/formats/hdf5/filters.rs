//! Filters that chunks pass, beyond those that `hdf5-reader` has itself (deflate, shuffle, Fletcher-32, LZ4, szip,
//! N-bit, scale-offset): Blosc, Zstandard and LZF. Their numbers: github.com/HDFGroup/hdf5_plugins, registered filters.

use super::blosc;
use hdf5_reader::error::{Error, Result as Hdf5Result};
use hdf5_reader::filters::{FILTER_FLETCHER32, FILTER_LZ4, FILTER_SHUFFLE, FilterRegistry};
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::{Dataset, Hdf5File};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

const LZF: u16 = 32_000;
const BLOSC: u16 = 32_001;
const ZSTD: u16 = 32_015;
const ECF: u16 = 0x8ecf;

/// Highest number of a filter that the format itself defines; all of them are read.
const LAST_OF_FORMAT: u16 = 6;

/// Names of filters for messages.
static NAMES: [(u16, &str); 9] = [
    (307, "bzip2"),
    (LZF, "LZF"),
    (BLOSC, "Blosc"),
    (FILTER_LZ4, "LZ4"),
    (32_008, "Bitshuffle"),
    (32_013, "ZFP"),
    (ZSTD, "Zstandard"),
    (32_026, "Blosc2"),
    (ECF, "Prophesee's ECF"),
];

fn name(id: u16) -> &'static str {
    NAMES.iter().find(|(n, _)| *n == id).map_or("", |(_, name)| *name)
}

/// A chunk that is not compressed may be longer than it was before by one byte in so many, and by some more.
const EXPANDS_ONE_IN: usize = 64;
const EXPANDS_BY: usize = 4096;

/// The filters that can be read. What they decode to is bounded by the chunks of the datasets that were checked: what
/// the data themselves say of their length is not believed.
#[derive(Clone, Default)]
pub(super) struct Filters {
    /// Bytes.
    largest: Arc<AtomicUsize>,
}

impl Filters {
    /// All of them.
    pub(super) fn registry(&self) -> FilterRegistry {
        let mut registry = FilterRegistry::new();
        let failed = |id| move |what: String| Error::FilterError(format!("{}: {what}", name(id)));
        let largest = || {
            let largest = self.largest.clone();
            move || largest.load(Ordering::Relaxed)
        };
        let most = largest();
        registry.register(
            BLOSC,
            Box::new(move |_, data, _| blosc::decode(data, most()).map_err(failed(BLOSC))),
        );
        let most = largest();
        registry.register(
            ZSTD,
            Box::new(move |_, data, _| zstd(data, most()).map_err(failed(ZSTD))),
        );
        let most = largest();
        registry.register(
            LZF,
            Box::new(move |filter, data, _| -> Hdf5Result<Vec<u8>> {
                let len = filter.client_data.get(2).map_or(0, |n| *n as usize);
                lzf(data, len, most()).map_err(failed(LZF))
            }),
        );
        registry
    }

    /// Whether the chunks of a dataset can be decoded; else which filter cannot, and a way out.
    pub(super) fn check(&self, file: &Hdf5File, path: &str, dataset: &Dataset) -> Result<(), String> {
        check(file, path, dataset)?;
        let element = dataset.raw_element_size().unwrap_or(0);
        let bytes = dataset
            .chunks()
            .unwrap_or_default()
            .iter()
            .fold(element, |bytes, side| {
                bytes.saturating_mul(usize::try_from(*side).unwrap_or(usize::MAX))
            });
        let most = bytes
            .saturating_add(bytes / EXPANDS_ONE_IN)
            .saturating_add(EXPANDS_BY);
        self.largest.fetch_max(most, Ordering::Relaxed);
        Ok(())
    }
}

/// Room for a decoded chunk.
pub(super) fn room<T>(len: usize) -> Result<Vec<T>, String> {
    let mut out = Vec::new();
    let made = out.try_reserve_exact(len);
    made.map_err(|_| format!("there is no memory for a chunk of {len} values"))?;
    Ok(out)
}

fn check(file: &Hdf5File, path: &str, dataset: &Dataset) -> Result<(), String> {
    let Ok(header) = file.get_or_parse_header(dataset.address()) else {
        return Ok(());
    };
    let mut unbounded = false;
    for message in &header.messages {
        let HdfMessage::FilterPipeline(pipeline) = message else {
            continue;
        };
        for filter in &pipeline.filters {
            match filter.id {
                ECF => {
                    return Err(format!(
                        "{path} is compressed by Prophesee's ECF filter (36559), which is not read; rewrite it with \
                         their plugin (github.com/prophesee-ai/hdf5_ecf): h5repack -f GZIP=4 IN OUT, or record RAW"
                    ));
                }
                BLOSC | ZSTD | LZF => unbounded = true,
                // What stands behind such a filter is decoded before it, without a known bound.
                id if unbounded && !matches!(id, FILTER_SHUFFLE | FILTER_FLETCHER32) => {
                    return Err(format!(
                        "{path} has filter {id} behind a compression; rewrite it: h5repack -f GZIP=4 IN OUT"
                    ));
                }
                ..=LAST_OF_FORMAT | FILTER_LZ4 => {}
                id => {
                    let called = filter.name.as_deref().unwrap_or_default();
                    let called: String = called.chars().filter(|c| !c.is_control()).take(40).collect();
                    let called = if called.is_empty() { name(id) } else { &called };
                    return Err(format!(
                        "{path} is compressed by filter {id} ({called}), which is not read; \
                         rewrite it with that filter's plugin: h5repack -f GZIP=4 IN OUT"
                    ));
                }
            }
        }
    }
    Ok(())
}

fn zstd(data: &[u8], most: usize) -> Result<Vec<u8>, String> {
    let len = zstd_safe::get_frame_content_size(data).ok().flatten();
    let len = len.ok_or("is not a frame of known size")?;
    let len = usize::try_from(len).unwrap_or(usize::MAX);
    if len > most {
        return Err(format!("a chunk of {len} bytes is too large"));
    }
    let mut out = room(len)?;
    zstd_safe::decompress(&mut out, data).map_err(|e| zstd_safe::get_error_name(e).to_owned())?;
    Ok(out)
}

/// LibLZF: a byte below 32 announces that many literals and one more; else its upper three bits are a length (7: the
/// next byte is added), its lower five and the next byte a distance, both counted from 2 and 1.
fn lzf(data: &[u8], len: usize, most: usize) -> Result<Vec<u8>, String> {
    if len > most {
        return Err(format!("a chunk of {len} bytes is too large"));
    }
    let mut out = room(len)?;
    let mut rest = data.iter();
    let ended = || "ends too early".to_owned();
    while let Some(control) = rest.next().map(|b| usize::from(*b)) {
        if control < 32 {
            let bytes = rest.as_slice();
            let literals = bytes.get(..=control).ok_or_else(ended)?;
            out.extend_from_slice(literals);
            rest = bytes[control + 1..].iter();
        } else {
            let mut next = || rest.next().map(|b| usize::from(*b)).ok_or_else(ended);
            let more = if control >> 5 == 7 { next()? } else { 0 };
            let copied = (control >> 5) + more + 2;
            let distance = ((control & 31) << 8) + next()? + 1;
            let from = out.len().checked_sub(distance).ok_or("points before its start")?;
            for at in from..from + copied {
                let byte = out[at];
                out.push(byte);
            }
        }
        if out.len() > len {
            return Err(format!("decodes to more than {len} bytes"));
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lzf_copies_what_it_points_to() {
        // "abc", then 9 + 2 bytes from 3 back by way of the added byte, then 3 bytes from 1 back.
        let data = [2, b'a', b'b', b'c', 7 << 5, 2, 2, 1 << 5, 0];
        assert_eq!(lzf(&data, 17, 17).unwrap(), b"abcabcabcabcabbbb"[..].to_vec());
        assert!(lzf(&data, 16, 17).unwrap_err().contains("more than 16"));
        assert!(lzf(&data, 17, 16).unwrap_err().contains("too large"));
        assert!(lzf(&[5, 1], 10, 10).unwrap_err().contains("too early"));
        assert!(
            lzf(&[1 << 5, 0], 10, 10)
                .unwrap_err()
                .contains("before its start")
        );
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken_without_a_panic(data in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = lzf(&data, 1_000, 1_000);
            let _ = zstd(&data, 1_000);
        }
    }
}
