//! AEDAT4 that grows under its own name: whatever happens to its writer, everything up to the last commit can be read.

use super::WriteError;
use super::aedat4::{Packets, check_sensor};
use crate::RawEvent;
use evpr_core::plan::Sensor;
use std::fs::File;
use std::io::{Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// How far a file is whole.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Committed {
    /// Bytes of the file.
    pub bytes: u64,
    /// Events in them.
    pub events: u64,
}

/// See the module. It has no table of packets until [`AppendedAedat4::finish`], as a recording that was interrupted.
pub struct AppendedAedat4 {
    packets: Packets<File>,
    path: PathBuf,
    committed: Committed,
    /// Whether all packets are in the table.
    from_the_start: bool,
}

impl std::fmt::Debug for AppendedAedat4 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AppendedAedat4")
            .field("path", &self.path)
            .field("committed", &self.committed)
            .finish_non_exhaustive()
    }
}

impl AppendedAedat4 {
    /// Begins a file that does not exist yet.
    ///
    /// # Errors
    /// When it exists or cannot be written, or the sensor is too large for the format.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self, WriteError> {
        check_sensor(path, sensor)?;
        let file = File::create_new(path).map_err(|e| WriteError::write(path, e))?;
        let packets = Packets::begin(file, path, sensor)?;
        Ok(Self::over(packets, path, true))
    }

    /// Goes on with a file behind what was committed; what is behind it is cut off.
    ///
    /// # Errors
    /// When the file is shorter than that, or cannot be written.
    pub fn resume(path: &Path, from: Committed) -> Result<Self, WriteError> {
        let failed = |e| WriteError::write(path, e);
        let mut file = File::options().write(true).open(path).map_err(failed)?;
        let len = file.metadata().map_err(failed)?.len();
        if len < from.bytes {
            return Err(WriteError::Unfit {
                path: path.to_owned(),
                what: format!("has {len} bytes, fewer than the {} that were written", from.bytes),
            });
        }
        file.set_len(from.bytes).map_err(failed)?;
        file.seek(SeekFrom::End(0)).map_err(failed)?;
        let packets = Packets::resume(file, path, from.bytes, from.events);
        Ok(Self::over(packets, path, false))
    }

    fn over(packets: Packets<File>, path: &Path, from_the_start: bool) -> Self {
        let committed = Committed {
            bytes: packets.at,
            events: packets.index,
        };
        Self {
            packets,
            path: path.to_owned(),
            committed,
            from_the_start,
        }
    }

    /// What is committed.
    pub fn committed(&self) -> Committed {
        self.committed
    }

    /// Takes events. Their times do not go back.
    ///
    /// # Errors
    /// When the system fails to write, or an event does not fit the format.
    pub fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        self.packets.write(events)
    }

    /// Hands everything taken so far to the system.
    ///
    /// # Errors
    /// When the system fails to write.
    pub fn commit(&mut self) -> Result<Committed, WriteError> {
        self.packets.end_packet()?;
        self.committed = Committed {
            bytes: self.packets.at,
            events: self.packets.index,
        };
        Ok(self.committed)
    }

    /// Brings what is committed to the disk.
    ///
    /// # Errors
    /// When the system fails to.
    pub fn sync(&self) -> Result<(), WriteError> {
        let synced = self.packets.out.sync_data();
        synced.map_err(|e| WriteError::write(&self.path, e))
    }

    /// Gives up: cuts off what is not committed.
    ///
    /// # Errors
    /// When the system fails to.
    pub fn cut(self) -> Result<(), WriteError> {
        let cut = self.packets.out.set_len(self.committed.bytes);
        cut.map_err(|e| WriteError::write(&self.path, e))
    }

    /// Commits, and adds the table of packets where all of them are known.
    ///
    /// # Errors
    /// When the system fails to write.
    pub fn finish(mut self) -> Result<Committed, WriteError> {
        let committed = self.commit()?;
        if self.from_the_start {
            self.packets.end()?;
        }
        self.sync()?;
        Ok(committed)
    }
}
