//! AEDAT4 with LZ4, as iniVation's software reads it: one stream of events, and the table of packets at the end.
//!
//! Times are µs. The format's facts are those of the reader; offsets here count from the length in front of a
//! FlatBuffer, as alignment does.

use super::new_file::NewFile;
use super::{WriteError, WriteOptions, Writer};
use crate::RawEvent;
use evpr_core::plan::Sensor;
use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const FIRST_LINE: &[u8] = b"#!AER-DAT4.0\r\n";
/// Events in a packet; DV itself writes 10 000.
const PACKET_EVENTS: usize = 16_384;
/// A packet of events in front of the events: length, root, `EVTS`, one table with one vector; its length and the
/// vector's are filled in.
const EVENTS_HEAD: [u8; 32] = [
    0, 0, 0, 0, 16, 0, 0, 0, b'E', b'V', b'T', b'S', 0, 0, 6, 0, 8, 0, 4, 0, 6, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0,
    0,
];
/// Where in the header the place of the table stands.
const TABLE_AT: usize = 40;

/// See the module.
pub(super) struct Aedat4 {
    packets: Packets<NewFile>,
}

impl Aedat4 {
    pub(super) fn create(path: &Path, options: &WriteOptions) -> Result<Self, WriteError> {
        let sensor = options.sensor.ok_or_else(|| WriteError::NoSensor {
            path: path.to_owned(),
            format: "AEDAT4",
        })?;
        check_sensor(path, sensor)?;
        Ok(Self {
            packets: Packets::begin(NewFile::create(path)?, path, sensor)?,
        })
    }
}

impl Writer for Aedat4 {
    fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        self.packets.write(events)
    }

    fn finish(self: Box<Self>) -> Result<(), WriteError> {
        let mut packets = self.packets;
        packets.end()?;
        packets.out.commit()
    }
}

/// Refuses a sensor that is too large for the format.
pub(super) fn check_sensor(path: &Path, sensor: Sensor) -> Result<(), WriteError> {
    let most = i16::MAX as usize + 1;
    if sensor.width <= most && sensor.height <= most {
        return Ok(());
    }
    Err(WriteError::Unfit {
        path: path.to_owned(),
        what: format!(
            "the sensor of {}x{} pixels is too large for AEDAT4 (at most {most} either way); use another format",
            sensor.height, sensor.width
        ),
    })
}

/// Events as the packets of a file.
pub(super) struct Packets<W> {
    pub(super) out: W,
    path: PathBuf,
    /// The packet that is being filled.
    packet: Vec<u8>,
    first_us: u64,
    last_us: u64,
    /// Events taken so far.
    pub(super) index: u64,
    /// Bytes in the file.
    pub(super) at: u64,
    table: Vec<Entry>,
}

/// A packet in the table at the end.
struct Entry {
    /// Where its body begins in the file, and how long that is.
    at: u64,
    size: u32,
    events: u64,
    first_us: u64,
    last_us: u64,
}

impl<W: Write> Packets<W> {
    /// Goes on behind `at` bytes with `index` events.
    pub(super) fn resume(out: W, path: &Path, at: u64, index: u64) -> Self {
        Self {
            out,
            path: path.to_owned(),
            packet: EVENTS_HEAD.to_vec(),
            first_us: 0,
            last_us: 0,
            index,
            at,
            table: Vec::new(),
        }
    }

    /// Begins a file.
    pub(super) fn begin(out: W, path: &Path, sensor: Sensor) -> Result<Self, WriteError> {
        let mut packets = Self::resume(out, path, 0, 0);
        packets.append(FIRST_LINE)?;
        packets.append(&header(sensor))?;
        Ok(packets)
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        let written = self.out.write_all(bytes);
        written.map_err(|e| WriteError::write(&self.path, e))?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    fn compressed(&self, bytes: &[u8]) -> Result<Vec<u8>, WriteError> {
        let info = FrameInfo::new()
            .block_size(BlockSize::Max64KB)
            .block_mode(BlockMode::Linked);
        let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
        let written = encoder.write_all(bytes);
        written.map_err(|e| WriteError::write(&self.path, e))?;
        encoder
            .finish()
            .map_err(|e| WriteError::write(&self.path, e.into()))
    }

    /// Takes events; each packet is written when it is full.
    pub(super) fn write(&mut self, events: &[RawEvent]) -> Result<(), WriteError> {
        for e in events {
            let coordinate = |v: u16| i16::try_from(v).ok();
            let (Some(x), Some(y)) = (coordinate(e.x), coordinate(e.y)) else {
                return Err(WriteError::Event {
                    path: self.path.clone(),
                    index: self.index,
                    what: format!(
                        "lies at x {}, y {}, beyond what AEDAT4 can hold (32767)",
                        e.x, e.y
                    ),
                });
            };
            let t_us = e.t_ns / 1000;
            if self.packet.len() == EVENTS_HEAD.len() {
                self.first_us = t_us;
            }
            self.last_us = t_us;
            let mut bytes = [0; 16];
            put(&mut bytes, 0, &t_us.to_le_bytes());
            put(&mut bytes, 8, &x.to_le_bytes());
            put(&mut bytes, 10, &y.to_le_bytes());
            bytes[12] = u8::from(e.on);
            self.packet.extend_from_slice(&bytes);
            self.index += 1;
            if self.packet.len() == EVENTS_HEAD.len() + 16 * PACKET_EVENTS {
                self.end_packet()?;
            }
        }
        Ok(())
    }

    /// Writes the packet that has been filled, if there is anything in it.
    pub(super) fn end_packet(&mut self) -> Result<(), WriteError> {
        let events = (self.packet.len() - EVENTS_HEAD.len()) / 16;
        if events == 0 {
            return Ok(());
        }
        put(&mut self.packet, 28, &(events as u32).to_le_bytes());
        fill_in_length(&mut self.packet);
        let body = self.compressed(&self.packet)?;
        let size = body.len() as u32;
        self.table.push(Entry {
            at: self.at + 8,
            size,
            events: events as u64,
            first_us: self.first_us,
            last_us: self.last_us,
        });
        self.append(&[&[0; 4], &size.to_le_bytes(), body.as_slice()].concat())?;
        self.packet.truncate(EVENTS_HEAD.len());
        Ok(())
    }
}

impl<W: Write + Seek> Packets<W> {
    /// Writes what is left, and the table.
    pub(super) fn end(&mut self) -> Result<(), WriteError> {
        self.end_packet()?;
        let table_at = self.at;
        let table = self.compressed(&data_table(&self.table))?;
        self.append(&table)?;
        let place = SeekFrom::Start((FIRST_LINE.len() + TABLE_AT) as u64);
        let sought = self.out.seek(place).map(drop);
        sought
            .and_then(|()| self.out.write_all(&table_at.to_le_bytes()))
            .map_err(|e| WriteError::write(&self.path, e))
    }
}

/// The header: a table {compression, place of the data table, description}.
fn header(sensor: Sensor) -> Vec<u8> {
    let attr =
        |key: &str, kind: &str, value: &str| format!("<attr key=\"{key}\" type=\"{kind}\">{value}</attr>\n");
    let xml = [
        "<dv version=\"2.0\">\n<node name=\"outInfo\" path=\"/outInfo/\">\n<node name=\"0\" path=\"/outInfo/0/\">\n",
        &attr("compression", "string", "LZ4"),
        &attr("originalModuleName", "string", "evpr"),
        &attr("originalOutputName", "string", "events"),
        &attr("typeDescription", "string", "Array of events (polarity ON/OFF)."),
        &attr("typeIdentifier", "string", "EVTS"),
        "<node name=\"info\" path=\"/outInfo/0/info/\">\n",
        &attr("sizeX", "int", &sensor.width.to_string()),
        &attr("sizeY", "int", &sensor.height.to_string()),
        &attr("source", "string", "evpr"),
        "</node>\n</node>\n</node>\n</dv>\n",
    ]
    .concat();
    let mut bytes = vec![0; 52];
    put(&mut bytes, 4, &24_u32.to_le_bytes()); // root at 28
    put(&mut bytes, 8, b"IOHE");
    // Fields at 18: lengths of the list and of the table, then where each field stands in the table.
    [10_u16, 20, 4, 12, 8]
        .iter()
        .enumerate()
        .for_each(|(i, v)| put(&mut bytes, 18 + 2 * i, &v.to_le_bytes()));
    put(&mut bytes, 28, &10_i32.to_le_bytes());
    put(&mut bytes, 32, &1_i32.to_le_bytes()); // LZ4
    put(&mut bytes, 36, &12_u32.to_le_bytes()); // the description at 48
    put(&mut bytes, TABLE_AT, &(-1_i64).to_le_bytes()); // until it is written
    put(&mut bytes, 48, &(xml.len() as u32).to_le_bytes());
    bytes.extend_from_slice(xml.as_bytes());
    // A string ends with a zero; the whole is a multiple of 4.
    bytes.resize((bytes.len() + 1).next_multiple_of(4), 0);
    fill_in_length(&mut bytes);
    bytes
}

/// The table of packets: a vector of tables that share one list of fields.
fn data_table(entries: &[Entry]) -> Vec<u8> {
    const OFFSETS: usize = 32;
    const STRIDE: usize = 48;
    let fields = OFFSETS + 4 * entries.len();
    // The 8-byte numbers stand 12 bytes into a table.
    let first = (fields + 14 + 12).next_multiple_of(8) - 12;
    let mut bytes = EVENTS_HEAD.to_vec();
    bytes.resize(first + STRIDE * entries.len(), 0);
    put(&mut bytes, 8, b"FTAB");
    put(&mut bytes, 28, &(entries.len() as u32).to_le_bytes());
    [14_u16, 44, 12, 4, 20, 28, 36]
        .iter()
        .enumerate()
        .for_each(|(i, v)| put(&mut bytes, fields + 2 * i, &v.to_le_bytes()));
    for (i, entry) in entries.iter().enumerate() {
        let (offset, table) = (OFFSETS + 4 * i, first + STRIDE * i);
        put(&mut bytes, offset, &((table - offset) as u32).to_le_bytes());
        put(&mut bytes, table, &((table - fields) as i32).to_le_bytes());
        put(&mut bytes, table + 8, &entry.size.to_le_bytes());
        put(&mut bytes, table + 12, &entry.at.to_le_bytes());
        put(&mut bytes, table + 20, &entry.events.to_le_bytes());
        put(&mut bytes, table + 28, &entry.first_us.to_le_bytes());
        put(&mut bytes, table + 36, &entry.last_us.to_le_bytes());
    }
    fill_in_length(&mut bytes);
    bytes
}

/// Puts the length of what follows into the first four bytes.
fn fill_in_length(bytes: &mut [u8]) {
    let len = (bytes.len() - 4) as u32;
    put(bytes, 0, &len.to_le_bytes());
}

fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}
