//! Frames of one window per tick as a `.npy` array, written as they come.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// NumPy's format 1.0: a multiple of 64, with room for four axes.
const HEADER_BYTES: usize = 128;

/// Writes frames in order of ticks; ticks without a frame become black. Until it is finished a file is called
/// `<name>.partial`; dropped before, it leaves nothing behind.
pub(crate) struct FramesWriter {
    file: BufWriter<File>,
    height: usize,
    width: usize,
    channels: usize,
    ticks: u64,
    /// Its name, and the one it has until it is finished.
    path: PathBuf,
    partial: PathBuf,
}

impl FramesWriter {
    pub(crate) fn create(path: &Path, height: usize, width: usize, channels: usize) -> io::Result<Self> {
        let mut partial = path.as_os_str().to_owned();
        // A device or a pipe is written to as it is.
        if !path.exists() || path.is_file() {
            partial.push(".partial");
        }
        let partial = PathBuf::from(partial);
        let mut file = BufWriter::new(File::create(&partial)?);
        file.write_all(&[0; HEADER_BYTES])?;
        Ok(Self {
            file,
            height,
            width,
            channels,
            ticks: 0,
            path: path.to_owned(),
            partial,
        })
    }

    fn frame_bytes(&self) -> usize {
        self.height * self.width * self.channels
    }

    /// Black frames up to this tick.
    fn fill_to(&mut self, tick: u64) -> io::Result<()> {
        while self.ticks < tick {
            io::copy(
                &mut io::Read::take(io::repeat(0), self.frame_bytes() as u64),
                &mut self.file,
            )?;
            self.ticks += 1;
        }
        Ok(())
    }

    /// The frame of this tick; ticks never go back.
    pub(crate) fn write(&mut self, tick: u64, frame: &[u8]) -> io::Result<()> {
        self.fill_to(tick)?;
        self.file.write_all(frame)?;
        self.ticks += 1;
        Ok(())
    }

    /// Completes the file with exactly this many ticks.
    pub(crate) fn finish(mut self, ticks: u64) -> io::Result<()> {
        self.fill_to(ticks)?;
        let shape = match self.channels {
            1 => format!("({ticks}, {}, {})", self.height, self.width),
            n => format!("({ticks}, {}, {}, {n})", self.height, self.width),
        };
        let mut header = b"\x93NUMPY\x01\x00".to_vec();
        header.extend_from_slice(&(HEADER_BYTES as u16 - 10).to_le_bytes());
        header.extend_from_slice(
            format!("{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}").as_bytes(),
        );
        header.resize(HEADER_BYTES - 1, b' ');
        header.push(b'\n');
        let bytes = HEADER_BYTES as u64 + ticks * self.frame_bytes() as u64;
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(&header)?;
        self.file.flush()?;
        self.file.get_ref().set_len(bytes)?;
        if self.partial == self.path {
            return Ok(());
        }
        std::fs::rename(&self.partial, &self.path)
    }
}

impl Drop for FramesWriter {
    fn drop(&mut self) {
        // Once it has its real name it is no longer there.
        if self.partial != self.path {
            let _ = std::fs::remove_file(&self.partial);
        }
    }
}
