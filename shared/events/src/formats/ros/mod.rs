//! Recordings of ROS: bags of ROS 1, and MCAP and SQLite, which ROS 2 writes.
//!
//! One topic is read: the one that is asked for, else the first that holds events. Its messages are of type
//! `dvs_msgs/EventArray` or `prophesee_event_msgs/EventArray`, whose events have ROS time; or of type
//! `event_camera_msgs/EventPacket`, in one of several encodings. With `evt3`, events have the time of the sensor, as
//! nothing says how it relates to ROS time: the driver stamps packets with the time of their arrival, and their time
//! base is undefined. With the others, events have the time base of their packet plus the time since; that is ROS time
//! with `libcaer` and `libcaer_cmp`.

mod bag;
mod bag2;
mod chunk;
mod codec;
mod container;
mod fields;
mod mcap;
mod message;
mod sqlite;

use crate::{BATCH_EVENTS, Input, RawEvent, ReadOptions, Recording, Skipped, SourceError, SourceInfo};
use codec::Codec;
use container::{Container, Next};
use evpr_core::plan::Sensor;
use message::{Kind, Message, TYPES};
use std::ops::Range;
use std::path::Path;

pub(super) use bag::MAGIC as BAG_MAGIC;
pub(super) use bag2::{is_folder, storage};
pub(super) use mcap::MAGIC as MCAP_MAGIC;
pub(super) use sqlite::MAGIC as SQLITE_MAGIC;

/// A batch is full when less room than this is left: more than what one word of any encoding gives.
const MIN_ROOM: usize = 64;

/// See the module.
pub(super) struct Ros {
    container: Box<dyn Container>,
    format: &'static str,
    /// Topic that is asked for.
    asked: Option<String>,
    /// Topic that is read, by its number.
    topic: Option<usize>,
    sensor: Option<Sensor>,
    codec: Option<Codec>,
    /// Events of the message that are not given yet, bytes of the chunk's `message`.
    message: Range<usize>,
    left: Range<usize>,
    /// Number and stamp of the last packet.
    last: Option<(u64, u64)>,
    /// Packets that are missing before one that is there.
    lost: u64,
    /// Triggers, and events before the start, of codecs that are done with.
    passed_over: (u64, u64),
    /// Messages read of the topic.
    messages: u64,
    ended: bool,
}

impl Ros {
    /// A bag of ROS 1.
    pub(super) fn bag(input: Input, options: &ReadOptions) -> Result<Self, SourceError> {
        Self::open(Box::new(bag::Bag::open(input)?), "rosbag", options)
    }

    /// MCAP.
    pub(super) fn mcap(input: Input, options: &ReadOptions) -> Result<Self, SourceError> {
        Self::open(Box::new(mcap::Mcap::open(input)?), "MCAP", options)
    }

    /// The storage of a bag of ROS 2 in SQLite.
    pub(super) fn bag2(path: &Path, options: &ReadOptions) -> Result<Self, SourceError> {
        Self::open(Box::new(bag2::Bag2::open(path)?), "rosbag2", options)
    }

    fn open(
        container: Box<dyn Container>,
        format: &'static str,
        options: &ReadOptions,
    ) -> Result<Self, SourceError> {
        let mut ros = Self {
            container,
            format,
            asked: options.stream.clone(),
            topic: None,
            sensor: None,
            codec: None,
            message: 0..0,
            left: 0..0,
            last: None,
            lost: 0,
            passed_over: (0, 0),
            messages: 0,
            ended: false,
        };
        // The first message says the size of the sensor.
        while ros.messages == 0 {
            ros.next_message(true)?;
            if ros.ended {
                return Err(ros.no_events());
            }
        }
        Ok(ros)
    }

    fn no_events(&mut self) -> SourceError {
        let listed = self.container.topics().listed();
        let what = match &self.asked {
            Some(asked) => format!(
                "holds no messages of topic {}, but {listed}",
                asked.escape_debug()
            ),
            None => format!("holds no messages of type {TYPES}, but {listed}"),
        };
        SourceError::malformed(self.container.path(), what)
    }

    /// Whether this topic, with this message, is the one that is read.
    fn chooses(&mut self, topic: usize, place: &Range<usize>) -> Result<bool, String> {
        if self.topic.is_some() {
            return Ok(self.topic == Some(topic));
        }
        let Some(found) = self.container.topics().0.get(topic) else {
            return Ok(false);
        };
        let known = Kind::of(&found.kind).zip(found.layout);
        if let Some(asked) = &self.asked {
            if found.name != *asked {
                return Ok(false);
            }
            if known.is_none() {
                return Err(format!(
                    "topic {} has messages of type {}; {TYPES} are read",
                    found.name, found.kind
                ));
            }
        }
        let Some((kind, layout)) = known else {
            return Ok(false);
        };
        // Cameras send their triggers on a topic of their own, of the same type.
        let bytes = self.container.chunk().get(place.clone()).unwrap_or_default();
        let packet = message::read(bytes, layout, kind).ok().and_then(|m| m.packet);
        if self.asked.is_none() && packet.is_some_and(|p| p.encoding == b"trigger") {
            return Ok(false);
        }
        self.topic = Some(topic);
        Ok(true)
    }

    /// Reads on to the next message of events; false where it would have to wait although it must not.
    fn next_message(&mut self, may_wait: bool) -> Result<bool, SourceError> {
        let (topic, message) = match self.container.next(may_wait)? {
            Next::Later => return Ok(false),
            Next::End => {
                self.ended = true;
                return Ok(true);
            }
            Next::Message(topic, message) => (topic, message),
        };
        let outcome = match self.chooses(topic, &message) {
            Ok(true) => self.begin(topic, message),
            Ok(false) => {
                if let Some(other) = self.container.topics_mut().0.get_mut(topic) {
                    other.count += 1;
                }
                Ok(())
            }
            Err(what) => Err(what),
        };
        outcome.map_err(|what| SourceError::malformed(self.container.path(), what))?;
        Ok(true)
    }

    fn begin(&mut self, topic: usize, place: Range<usize>) -> Result<(), String> {
        let Some(from) = self.container.topics().0.get(topic) else {
            return Ok(());
        };
        let (Some(kind), Some(layout)) = (Kind::of(&from.kind), from.layout) else {
            return Ok(());
        };
        let name = from.name.clone();
        let number = self.messages;
        let in_message = |what: String| format!("message {number} (from 0) of topic {name} {what}");
        let bytes = self.container.chunk().get(place.clone()).unwrap_or_default();
        let message = message::read(bytes, layout, kind).map_err(in_message)?;
        let (sensor, left) = (sensor(&message), message.events.clone());
        match (&message.packet, &mut self.codec) {
            (None, codec) => {
                codec.get_or_insert(Codec::Array(layout));
            }
            (Some(packet), codec) => {
                let codec = match codec.take() {
                    Some(known) if known.encoding() == packet.encoding => codec.insert(known),
                    other => {
                        let (triggers, before_start) = other.map_or((0, 0), |o| o.passed_over());
                        self.passed_over.0 += triggers;
                        self.passed_over.1 += before_start;
                        codec.insert(Codec::new(packet.encoding).map_err(in_message)?)
                    }
                };
                if left.len() % codec.unit_bytes() != 0 {
                    return Err(in_message(format!(
                        "has {} bytes of events, no whole number of {}; the recording is damaged",
                        left.len(),
                        codec.unit_bytes()
                    )));
                }
                let gap = self.last.and_then(|(seq, stamp_ns)| {
                    let lost = packet.seq.wrapping_sub(seq).wrapping_sub(1);
                    (lost != 0).then(|| (lost, packet.stamp_ns.saturating_sub(stamp_ns)))
                });
                // A number that is smaller is that of a driver that was started again.
                let forward = self.last.is_some_and(|(seq, _)| packet.seq > seq);
                self.lost = self
                    .lost
                    .saturating_add(gap.filter(|_| forward).map_or(0, |(lost, _)| lost));
                codec
                    .begin(packet, gap.map(|(_, since)| since))
                    .map_err(in_message)?;
                self.last = Some((packet.seq, packet.stamp_ns));
            }
        }
        if self.sensor.is_none() {
            self.sensor = sensor;
        }
        (self.message, self.left) = (place, left);
        self.messages += 1;
        Ok(())
    }

    fn give(&mut self, out: &mut Vec<RawEvent>) {
        let chunk = self.container.chunk();
        let message = chunk.get(self.message.clone()).unwrap_or_default();
        match &mut self.codec {
            Some(codec) => codec.decode(message, &mut self.left, BATCH_EVENTS - out.len(), out),
            None => self.left = 0..0,
        }
    }
}

/// The size that a message says; `None` where it is 0 or none that events could have.
fn sensor(message: &Message<'_>) -> Option<Sensor> {
    let in_range = |n: u32| u16::try_from(n).ok().filter(|n| *n > 0);
    Some(Sensor {
        height: usize::from(in_range(message.height)?),
        width: usize::from(in_range(message.width)?),
    })
}

impl Recording for Ros {
    fn sensor(&self) -> Option<Sensor> {
        self.sensor
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        while BATCH_EVENTS - out.len() > MIN_ROOM {
            if !self.left.is_empty() {
                self.give(out);
                continue;
            }
            if self.ended {
                break;
            }
            match self.next_message(out.is_empty()) {
                Ok(true) => {}
                Ok(false) => break,
                Err(e) => {
                    self.ended = true;
                    return Err(e);
                }
            }
        }
        Ok(!out.is_empty() || !self.ended)
    }

    fn progress_permille(&self) -> u64 {
        // What is behind the last message is not read.
        if self.ended && self.left.is_empty() {
            1000
        } else {
            self.container.progress_permille()
        }
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: self.format,
            path: self.container.path().to_owned(),
            time_unit: self.codec.as_ref().map_or("ns", Codec::time_unit),
            time_unit_from: "format",
            events: None,
        }
    }

    fn skipped(&self) -> Vec<Skipped> {
        let now = self.codec.as_ref().map_or((0, 0), Codec::passed_over);
        let of_topic = [
            ("external triggers", self.passed_over.0 + now.0),
            (
                "events before the first full time and place",
                self.passed_over.1 + now.1,
            ),
            ("packets that are missing (gaps in their numbers)", self.lost),
        ];
        let of_topic = of_topic.into_iter().map(|(what, count)| (what.to_owned(), count));
        let others = self
            .container
            .topics()
            .0
            .iter()
            .map(|t| (format!("messages of topic {} ({})", t.name, t.kind), t.count));
        let all = of_topic.chain(others).filter(|(_, count)| *count > 0);
        all.map(|(what, count)| Skipped { what, count }).collect()
    }
}

/// Names in a file may hold anything.
fn printable(name: &[u8]) -> String {
    String::from_utf8_lossy(name).escape_debug().to_string()
}
