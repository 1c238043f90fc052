//! A dataset of one dimension, part by part.

use super::{Opened, filters};
use hdf5_reader::error::{Error, Result as Hdf5Result};
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::messages::layout::DataLayout;
use hdf5_reader::{Dataset, Datatype, H5Type, SliceInfo, SliceInfoElem};
use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::sync::Arc;

/// Values that are decoded at once where they stand in the file as they are: they stay in the nearest cache.
const PIECE: usize = 1024;
/// Longest element that is read as it stands in the file, bytes.
const MAX_PLAIN_BYTES: usize = 64;

/// See the module.
pub(super) struct Stored {
    dataset: Dataset,
    plain: Option<Plain>,
}

/// Where values stand one after the other in the file, without filters: they are read into one buffer that is kept.
struct Plain {
    file: Arc<File>,
    /// Byte of the file at which they begin.
    at: u64,
    element_bytes: usize,
    bytes: Vec<u8>,
}

impl Plain {
    fn of(opened: &Opened, dataset: &Dataset) -> Option<Self> {
        let header = opened.hdf5.get_or_parse_header(dataset.address()).ok()?;
        let find = |message: &HdfMessage| match message {
            HdfMessage::DataLayout(found) => Some(found.layout.clone()),
            _ => None,
        };
        let Some(DataLayout::Contiguous { address, size }) = header.messages.iter().find_map(find) else {
            return None;
        };
        let elsewhere = |message: &HdfMessage| matches!(message, HdfMessage::ExternalFiles(_));
        let element_bytes = dataset.raw_element_size().ok()?;
        let at = address.checked_add(opened.hdf5.superblock().base_address)?;
        let whole = dataset.num_elements().ok()?.checked_mul(element_bytes as u64)?;
        // What is anything else is left to the crate, which says what is wrong with it.
        let sound = whole == size
            && at.checked_add(size)? <= opened.file.metadata().ok()?.len()
            && (1..=MAX_PLAIN_BYTES).contains(&element_bytes)
            && !header.messages.iter().any(elsewhere);
        sound.then(|| Self {
            file: opened.file.clone(),
            at,
            element_bytes,
            bytes: Vec::new(),
        })
    }

    /// Reads these values as bytes.
    fn read(&mut self, part: &Range<u64>) -> Hdf5Result<&[u8]> {
        let len = (part.end - part.start) as usize * self.element_bytes;
        self.bytes.resize(len, 0);
        let at = self.at + part.start * self.element_bytes as u64;
        self.file.read_exact_at(&mut self.bytes, at)?;
        Ok(&self.bytes)
    }
}

impl Stored {
    pub(super) fn new(opened: &Opened, dataset: Dataset) -> Self {
        Self {
            plain: Plain::of(opened, &dataset),
            dataset,
        }
    }

    pub(super) fn dtype(&self) -> &Datatype {
        self.dataset.dtype()
    }

    pub(super) fn len(&self) -> u64 {
        self.dataset.shape().first().copied().unwrap_or(0)
    }

    /// Values in a chunk; 1 where there are no chunks.
    pub(super) fn chunk(&self) -> u64 {
        let chunk = self.dataset.chunks().and_then(|c| c.first().copied());
        chunk.map_or(1, u64::from).max(1)
    }

    /// Gives `each` these values, in order and in pieces of any length, for as long as it wants more. Of plain values
    /// `part` is at most a batch, as there are no chunks.
    pub(super) fn read<S: H5Type>(
        &mut self,
        part: Range<u64>,
        mut each: impl FnMut(&[S]) -> Hdf5Result<bool>,
    ) -> Hdf5Result<()> {
        let Some(plain) = &mut self.plain else {
            let selections = vec![SliceInfoElem::Slice {
                start: part.start,
                end: part.end,
                step: 1,
            }];
            let read = self.dataset.read_slice::<S>(&SliceInfo { selections })?;
            return each(&read.into_raw_vec_and_offset().0).map(|_| ());
        };
        let element_bytes = plain.element_bytes;
        for piece in plain.read(&part)?.chunks(PIECE * element_bytes) {
            let count = piece.len() / element_bytes;
            let dtype = self.dataset.dtype();
            let values = S::decode_vec(piece, dtype, count).unwrap_or_else(|| {
                let mut values = filters::room(count).map_err(Error::ResourceLimit)?;
                for element in piece.chunks_exact(element_bytes) {
                    values.push(S::from_bytes(element, dtype)?);
                }
                Ok(values)
            })?;
            if !each(&values)? {
                break;
            }
        }
        Ok(())
    }
}
