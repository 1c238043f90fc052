//! The messages that hold events.

use super::fields::{Fields, Layout, Short};
use std::ops::Range;

const NS_PER_S: u64 = 1_000_000_000;

/// What a type of messages holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// `dvs_msgs/EventArray`, and others of its layout: an event is {u16 x, u16 y, {u32 s, u32 ns} t, u8 on}.
    Array,
    /// `event_camera_msgs/EventPacket`, called `event_array_msgs/EventArray` before: bytes in an encoding.
    Packet,
}

/// Types that are read, for messages.
pub(super) const TYPES: &str =
    "dvs_msgs/EventArray, prophesee_event_msgs/EventArray or event_camera_msgs/EventPacket";

impl Kind {
    /// By the name of the type, as ROS 1 writes it or (`a/msg/B`) as ROS 2 does.
    pub(super) fn of(name: &str) -> Option<Self> {
        match name.replacen("/msg/", "/", 1).as_str() {
            "dvs_msgs/EventArray" | "prophesee_event_msgs/EventArray" => Some(Self::Array),
            "event_camera_msgs/EventPacket" | "event_array_msgs/EventArray" => Some(Self::Packet),
            _ => None,
        }
    }
}

/// What a message says, and where in it its events are.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Message<'a> {
    pub(super) height: u32,
    pub(super) width: u32,
    pub(super) events: Range<usize>,
    pub(super) packet: Option<Packet<'a>>,
}

/// What an `EventPacket` says besides.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Packet<'a> {
    /// Of its header: the time of the computer, ns.
    pub(super) stamp_ns: u64,
    /// Counts packets.
    pub(super) seq: u64,
    /// What is added to the times of events in most encodings, ns.
    pub(super) time_base_ns: u64,
    pub(super) encoding: &'a [u8],
}

const SHORT: &str = "says that it is longer than it is; the recording is damaged";

/// Reads all but the events.
pub(super) fn read(bytes: &[u8], layout: Layout, kind: Kind) -> Result<Message<'_>, String> {
    let mut fields = Fields::message(bytes, layout)?;
    let (message, big_endian) = read_fields(&mut fields, layout, kind).map_err(|Short| SHORT.to_owned())?;
    if big_endian {
        return Err("was packed by a big-endian machine, which is not read; convert it there".to_owned());
    }
    Ok(message)
}

fn read_fields<'a>(
    fields: &mut Fields<'a>,
    layout: Layout,
    kind: Kind,
) -> Result<(Message<'a>, bool), Short> {
    if layout == Layout::Ros1 {
        fields.u32()?;
    }
    let stamp_ns = time_ns(fields)?;
    fields.text()?;
    let (height, width) = (fields.u32()?, fields.u32()?);
    let (packet, big_endian, len) = match kind {
        Kind::Array => {
            let count = fields.u32()? as usize;
            (None, false, array_len(count, layout))
        }
        Kind::Packet => {
            let (seq, time_base_ns) = (fields.u64()?, fields.u64()?);
            let encoding = fields.text()?;
            let big_endian = fields.u8()? != 0;
            let packet = Packet {
                stamp_ns,
                seq,
                time_base_ns,
                encoding,
            };
            (Some(packet), big_endian, fields.u32()? as usize)
        }
    };
    if len > fields.left() {
        return Err(Short);
    }
    let events = fields.at()..fields.at() + len;
    let message = Message {
        height,
        width,
        events,
        packet,
    };
    Ok((message, big_endian))
}

/// Bytes of so many events. In CDR one takes 13 bytes, and with the gaps before it and inside of it 16.
fn array_len(count: usize, layout: Layout) -> usize {
    match layout {
        Layout::Ros1 => count.saturating_mul(ARRAY_EVENT_BYTES),
        Layout::Cdr => count.saturating_mul(16).saturating_sub(16 - ARRAY_EVENT_BYTES),
    }
}

/// {u16 x, u16 y, u32 s, u32 ns, u8 on} without gaps.
pub(super) const ARRAY_EVENT_BYTES: usize = 13;

/// A time of ROS. Always before [`crate::MAX_TIME_NS`].
pub(super) fn time_ns(fields: &mut Fields<'_>) -> Result<u64, Short> {
    let (s, ns) = (fields.u32()?, fields.u32()?);
    Ok(u64::from(s) * NS_PER_S + u64::from(ns))
}
