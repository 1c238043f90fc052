//! Parquet: columns `t_ns` (INT64, ns), `x`, `y` (unsigned 16 bits) and `p` (BOOLEAN), compressed by snappy. The name
//! of the time says its unit, as it does in NumPy files: a plain integer keeps each nanosecond in every reader, while a
//! `TIMESTAMP` would make a date of what a sensor's clock says. `pandas.read_parquet` gives int64, uint16 and bool.
//!
//! Times are delta-coded: events follow closely upon one another. Every 2^18 events are a row group, of which
//! the memory holds one.

use super::new_file::NewFile;
use super::{WriteError, Writer};
use crate::RawEvent;
use parquet::basic::{Compression, Encoding};
use parquet::data_type::{BoolType, DataType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnPath;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const SCHEMA: &str = "message events { required int64 t_ns; required int32 x (INTEGER(16,false)); \
                      required int32 y (INTEGER(16,false)); required boolean p; }";
/// Events in a row group.
const GROUP_EVENTS: usize = 1 << 18;

/// See the module.
pub(super) struct Parquet {
    path: PathBuf,
    writer: SerializedFileWriter<NewFile>,
    /// The row group that is being filled.
    t_ns: Vec<i64>,
    x: Vec<i32>,
    y: Vec<i32>,
    p: Vec<bool>,
    written: u64,
}

fn failed(path: &Path, error: ParquetError) -> WriteError {
    let error = match error {
        ParquetError::External(error) => match error.downcast::<std::io::Error>() {
            Ok(error) => *error,
            Err(error) => std::io::Error::other(error),
        },
        other => std::io::Error::other(other),
    };
    WriteError::write(path, error)
}

fn put<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, NewFile>,
    values: &mut Vec<T::T>,
) -> Result<(), ParquetError> {
    if let Some(mut column) = group.next_column()? {
        column.typed::<T>().write_batch(values, None, None)?;
        column.close()?;
    }
    values.clear();
    Ok(())
}

impl Parquet {
    pub(super) fn create(path: &Path) -> Result<Self, WriteError> {
        let file = NewFile::create(path)?;
        let times = ColumnPath::from("t_ns");
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_column_dictionary_enabled(times.clone(), false)
            .set_column_encoding(times.clone(), Encoding::DELTA_BINARY_PACKED)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_column_statistics_enabled(times, EnabledStatistics::Chunk)
            .set_created_by(concat!("evpr ", env!("CARGO_PKG_VERSION")).to_owned())
            .build();
        let schema = parse_message_type(SCHEMA).map_err(|e| failed(path, e))?;
        let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties));
        Ok(Self {
            path: path.to_owned(),
            writer: writer.map_err(|e| failed(path, e))?,
            t_ns: Vec::new(),
            x: Vec::new(),
            y: Vec::new(),
            p: Vec::new(),
            written: 0,
        })
    }

    fn write_group(&mut self) -> Result<(), ParquetError> {
        if self.t_ns.is_empty() {
            return Ok(());
        }
        let mut group = self.writer.next_row_group()?;
        put::<Int64Type>(&mut group, &mut self.t_ns)?;
        put::<Int32Type>(&mut group, &mut self.x)?;
        put::<Int32Type>(&mut group, &mut self.y)?;
        put::<BoolType>(&mut group, &mut self.p)?;
        group.close()?;
        Ok(())
    }
}

impl Writer for Parquet {
    fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        for event in events {
            let t_ns = i64::try_from(event.t_ns).map_err(|_| WriteError::Event {
                path: self.path.clone(),
                index: self.written,
                what: "lies beyond the year 2262; check the unit of its time".to_owned(),
            })?;
            self.t_ns.push(t_ns);
            self.x.push(i32::from(event.x));
            self.y.push(i32::from(event.y));
            self.p.push(event.on);
            self.written += 1;
            if self.t_ns.len() == GROUP_EVENTS {
                self.write_group().map_err(|e| failed(&self.path, e))?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), WriteError> {
        self.write_group().map_err(|e| failed(&self.path, e))?;
        let file = self.writer.into_inner().map_err(|e| failed(&self.path, e))?;
        file.commit()
    }
}
