//! Frames of ordinary cameras, and frames that were made elsewhere.
//!
//! [`FrameList::open`] takes one of three things:
//! - A folder of PNG and JPEG files, in the order of their names, runs of digits compared as numbers (`f9.png` comes
//!   before `f10.png`). Other files and subfolders are left out. A name `@easting@northing@…`, in metres, as in data
//!   sets for place recognition (<https://github.com/gmberton/VPR-datasets-downloader>), gives the position.
//! - A list: a `.csv` whose first line names its columns: `file` (relative to the list), and where they are known `t`
//!   (ascending) and `east_m,north_m`. Its order counts. Without columns for positions, names give them as above.
//! - A stack: a `.npy` of `uint8`, (N, H, W) or (N, H, W, 3), in C order.
//!
//! Grey files give one channel, colour files blue, green and red; alpha is dropped; 16 bits per channel are refused.
//! [`Timeline`] says which frame belongs to which tick. Nothing is kept but the list itself.

mod error;
mod folder;
mod header;
mod list;
mod picture;
mod resize;
mod stack;
mod timeline;

pub use error::FrameError;
pub use picture::Picture;
pub use timeline::{FrameTick, Timeline};

use evpr_core::plan::{OnOtherSize, Sensor, Source, StackOrder};
use picture::Decoder;
use std::path::{Path, PathBuf};

/// Largest decoded frame, and largest file of one, bytes.
const MAX_FRAME_BYTES: usize = 64 << 20;
/// Most that a list of files may hold, bytes: its text, or the names of a folder's files.
const MAX_LIST_BYTES: usize = 64 << 20;

/// A file of a folder or list.
#[derive(Debug, Clone, PartialEq)]
struct Entry {
    path: PathBuf,
    /// When it was taken, ns.
    t_ns: Option<u64>,
    /// Where: metres east and north.
    position: Option<[f64; 2]>,
}

#[derive(Debug)]
enum Entries {
    Files(Vec<Entry>),
    Stack(stack::Stack),
}

/// A source of frames, opened: what it holds is known, the frames themselves are read one by one.
#[derive(Debug)]
pub struct FrameList {
    path: PathBuf,
    entries: Entries,
    resize: bool,
    stack_order: StackOrder,
    size: Option<Sensor>,
    decoder: Decoder,
}

impl FrameList {
    /// Opens the plan's source of frames.
    ///
    /// # Errors
    /// When it is none, does not exist, cannot be read, holds no frames, or is not as its kind wants it.
    pub fn open(source: &Source) -> Result<Self, FrameError> {
        let path = source.path.as_path();
        let options = source.frames.clone().unwrap_or_default();
        let kind = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let metadata = std::fs::metadata(path).map_err(|e| FrameError::read(path, e))?;
        let entries = match kind.as_deref() {
            _ if metadata.is_dir() => Entries::Files(folder::read(path)?),
            Some("csv") => Entries::Files(list::read(path, source.time_unit)?),
            Some("npy") => Entries::Stack(stack::Stack::open(path)?),
            _ => {
                let what = "is neither a folder of PNG and JPEG files, nor a list (.csv), nor a stack (.npy)";
                return Err(FrameError::new(path, what));
            }
        };
        Ok(Self {
            path: path.to_owned(),
            entries,
            resize: options.on_other_size == OnOtherSize::Resize,
            stack_order: options.stack_order,
            size: options.size,
            decoder: Decoder::default(),
        })
    }

    /// What it was opened as.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of frames, at least 1.
    pub fn len(&self) -> usize {
        match &self.entries {
            Entries::Files(files) => files.len(),
            Entries::Stack(stack) => stack.len(),
        }
    }

    /// Never: a source without frames is refused.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The size that all frames have or are resized to: the configuration's, or the first frame's.
    ///
    /// # Errors
    /// When the first frame is not one.
    pub fn size(&self) -> Result<Sensor, FrameError> {
        match (self.size, &self.entries) {
            (Some(size), _) => Ok(size),
            (None, Entries::Stack(stack)) => Ok(stack.size()),
            (None, Entries::Files(files)) => match files.first() {
                Some(file) => Ok(header::read(&file.path)?.size),
                None => Err(FrameError::new(&self.path, "holds no frames")),
            },
        }
    }

    /// Looks at a frame without decoding it: whether it is there, of a kind that can be read, of this size (or may be
    /// resized), and not cut short.
    ///
    /// # Errors
    /// What is wrong with it. What only decoding shows is told by [`FrameList::read`].
    pub fn check(&self, frame: usize, size: Sensor) -> Result<(), FrameError> {
        match &self.entries {
            Entries::Stack(stack) => self.check_size(&self.path, stack.size(), size),
            Entries::Files(files) => {
                let file = self.entry(files, frame)?;
                let header = header::read(&file.path)?;
                self.check_size(&file.path, header.size, size)?;
                header::check_end(&file.path, header.format)
            }
        }
    }

    /// Reads a frame into `picture`, which is reused.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(&mut self, frame: usize, size: Sensor, picture: &mut Picture) -> Result<(), FrameError> {
        let found = match &self.entries {
            Entries::Stack(stack) => {
                self.check_size(&self.path, stack.size(), size)?;
                stack.read(frame, self.stack_order, picture)?;
                stack.size()
            }
            Entries::Files(files) => {
                let file = self.entry(files, frame)?;
                let header = header::read(&file.path)?;
                self.check_size(&file.path, header.size, size)?;
                self.decoder.decode(&file.path, &header, picture)?;
                header.size
            }
        };
        if found != size {
            resize::area(picture, found, size);
        }
        Ok(())
    }

    fn entry<'f>(&self, files: &'f [Entry], frame: usize) -> Result<&'f Entry, FrameError> {
        files
            .get(frame)
            .ok_or_else(|| FrameError::new(&self.path, format!("has no frame {frame} any more")))
    }

    fn check_size(&self, path: &Path, found: Sensor, wanted: Sensor) -> Result<(), FrameError> {
        if found == wanted || self.resize {
            return Ok(());
        }
        let what = format!(
            "is {found} pixels, but the frames before are {wanted}; leave it out, or write on_other_size = \"resize\" \
             in [source.frames]"
        );
        Err(FrameError::new(path, what))
    }

    /// When each frame was taken, ns, if that is known.
    fn times(&self) -> Option<Vec<u64>> {
        match &self.entries {
            Entries::Files(files) => files.iter().map(|f| f.t_ns).collect(),
            Entries::Stack(_) => None,
        }
    }

    fn position(&self, frame: usize) -> Option<[f64; 2]> {
        match &self.entries {
            Entries::Files(files) => files.get(frame)?.position,
            Entries::Stack(_) => None,
        }
    }
}
