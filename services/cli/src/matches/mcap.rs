//! Answers as MCAP, for Foxglove and for ROS 2's tools: channels of JSON with their JSON schemas.
//!
//! Every answer is a chunk of its own, so that a reader which follows the file, or takes up one that was cut short, has all
//! answers so far. Times are those of the sensor: the end of the tick.

use super::MatchLine;
use mcap::records::MessageHeader;
use mcap::{McapResult, WriteOptions, Writer};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;

/// The frame that positions are in.
const MAP_FRAME: &str = "map";

/// A file that is being written.
pub(super) struct McapMatches {
    writer: Writer<BufWriter<File>>,
    answer: u16,
    pose: u16,
    stats: u16,
    answers: u32,
    matched: u64,
    poses: u32,
}

/// Adds a channel of JSON.
fn channel(
    writer: &mut Writer<BufWriter<File>>,
    topic: &str,
    name: &str,
    properties: &Value,
) -> McapResult<u16> {
    let schema = json!({ "title": name, "type": "object", "properties": properties });
    let schema = writer.add_schema(name, "jsonschema", schema.to_string().as_bytes())?;
    writer.add_channel(schema, topic, "json", &BTreeMap::new())
}

fn match_schema() -> Value {
    let integer = json!({ "type": "integer" });
    let number_or_null = json!({ "type": ["number", "null"] });
    let place =
        json!({ "type": "object", "properties": { "reference": integer, "score": { "type": "number" } } });
    json!({
        "tick": integer,
        "start_us": integer,
        "end_us": integer,
        "reference": { "type": ["integer", "null"] },
        "reason": { "type": "string" },
        "position": { "type": "array", "items": { "type": "number" } },
        "score": number_or_null,
        "confidence": number_or_null,
        "top": { "type": "array", "items": place },
        "members": { "type": "array", "items": { "type": "string" } },
        "missing": { "type": "object" },
        "latency_us": { "type": "object", "properties": {
            "reconstruct": number_or_null, "extract": number_or_null, "fuse": number_or_null, "total": number_or_null,
        } },
    })
}

/// Of `foxglove.PoseInFrame`.
fn pose_schema() -> Value {
    let numbers = |names: &[&str]| {
        let properties: serde_json::Map<String, Value> = names
            .iter()
            .map(|name| ((*name).to_owned(), json!({ "type": "number" })))
            .collect();
        json!({ "type": "object", "properties": properties })
    };
    json!({
        "timestamp": { "type": "object", "properties": {
            "sec": { "type": "integer", "minimum": 0 },
            "nsec": { "type": "integer", "minimum": 0, "maximum": 999_999_999 },
        } },
        "frame_id": { "type": "string" },
        "pose": { "type": "object", "properties": {
            "position": numbers(&["x", "y", "z"]),
            "orientation": numbers(&["x", "y", "z", "w"]),
        } },
    })
}

fn stats_schema() -> Value {
    let integer = json!({ "type": "integer" });
    json!({
        "tick": integer,
        "answers": integer,
        "matched": integer,
        "members": integer,
        "missing": integer,
        "latency_us": { "type": ["number", "null"] },
    })
}

impl McapMatches {
    /// Begins a file.
    pub(super) fn begin(file: BufWriter<File>) -> McapResult<Self> {
        let options = WriteOptions::new().library(concat!("evpr ", env!("CARGO_PKG_VERSION")));
        let mut writer = options.compression(None).create(file)?;
        let answer = channel(&mut writer, "/evpr/match", "evpr.Match", &match_schema())?;
        let pose = channel(&mut writer, "/evpr/pose", "foxglove.PoseInFrame", &pose_schema())?;
        let stats = channel(&mut writer, "/evpr/stats", "evpr.Stats", &stats_schema())?;
        Ok(Self {
            writer,
            answer,
            pose,
            stats,
            answers: 0,
            matched: 0,
            poses: 0,
        })
    }

    /// Writes one answer, out to the file.
    pub(super) fn write(&mut self, line: &MatchLine<'_>) -> McapResult<()> {
        let time_ns = line.end_us.saturating_mul(1_000);
        self.matched += u64::from(line.reference.is_some());
        let sequence = self.answers;
        self.answers += 1;
        let stats = json!({
            "tick": line.tick,
            "answers": self.answers,
            "matched": self.matched,
            "members": line.members.len(),
            "missing": line.missing.len(),
            "latency_us": line.latency_us.total,
        });
        let answer = serde_json::to_vec(line).map_err(std::io::Error::other)?;
        self.send(self.answer, sequence, time_ns, &answer)?;
        self.send(self.stats, sequence, time_ns, stats.to_string().as_bytes())?;
        if let Some([east_m, north_m]) = line.position {
            let pose = json!({
                "timestamp": { "sec": time_ns / 1_000_000_000, "nsec": time_ns % 1_000_000_000 },
                "frame_id": MAP_FRAME,
                // Which way the camera looks is not known.
                "pose": {
                    "position": { "x": east_m, "y": north_m, "z": 0.0 },
                    "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
                },
            });
            self.send(self.pose, self.poses, time_ns, pose.to_string().as_bytes())?;
            self.poses += 1;
        }
        self.writer.flush()
    }

    fn send(&mut self, channel_id: u16, sequence: u32, time_ns: u64, data: &[u8]) -> McapResult<()> {
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.writer.write_to_known_channel(&header, data)
    }

    /// Ends the file with its indices.
    pub(super) fn finish(mut self) -> McapResult<()> {
        self.writer.finish().map(drop)
    }
}
