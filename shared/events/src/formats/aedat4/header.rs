//! The header: how packets are compressed, where the table at the end is, and which streams there are.

use super::flatbuffer::{Damaged, Table, identifier, sized};
use super::packet::Compression;
use evpr_core::plan::Sensor;

/// Most XML elements in the description of the streams.
const MAX_NODES: u32 = 50_000;
/// Most streams that an error names, and characters of a name that it shows.
const MAX_NAMED: usize = 8;
const MAX_SHOWN: usize = 40;

/// What the header says.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) compression: Compression,
    /// Place of the data table in the file; packets end there. Negative: there is none.
    pub(super) table_at: i64,
    pub(super) streams: Vec<Stream>,
}

/// A stream that the header names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Stream {
    pub(super) id: i32,
    /// What its packets hold: `EVTS`, `FRME`, `IMUS`, `TRIG`, …
    pub(super) kind: String,
    name: String,
    source: String,
    /// Columns and rows, as written.
    size: Option<(String, String)>,
}

impl Header {
    /// Reads the header: a size-prefixed FlatBuffer `IOHE`.
    pub(super) fn read(bytes: &[u8]) -> Result<Self, String> {
        let damaged = |_: Damaged| "its header is damaged; record it again or get another copy".to_owned();
        let buffer = sized(bytes).map_err(damaged)?;
        if identifier(buffer).map_err(damaged)? != *b"IOHE" {
            return Err("is not AEDAT4: its header is not one of type IOHE".to_owned());
        }
        let table = Table::root(buffer).map_err(damaged)?;
        let compression = Compression::new(table.i32(0, 0).map_err(damaged)?)?;
        let table_at = table.i64(1, -1).map_err(damaged)?;
        let xml = std::str::from_utf8(table.vector(2, 1).map_err(damaged)?)
            .map_err(|_| "the description of its streams is not UTF-8 text; its header is damaged")?;
        Ok(Self {
            compression,
            table_at,
            streams: streams(xml)?,
        })
    }

    /// The stream of events to be read: the one of this number or name, or the first.
    pub(super) fn events(&self, wanted: Option<&str>) -> Result<&Stream, String> {
        let events: Vec<_> = self.streams.iter().filter(|s| s.kind == "EVTS").collect();
        let there = match &events[..] {
            [] => {
                let kinds = list(
                    self.streams
                        .iter()
                        .map(|s| format!("{} ({})", s.id, shown(&s.kind))),
                );
                return Err(format!("has no stream of events (streams: {kinds})"));
            }
            [first, ..] if wanted.is_none() => return Ok(first),
            _ => list(events.iter().map(|s| s.to_string())),
        };
        let wanted = wanted.unwrap_or_default();
        let number = wanted.parse::<i32>().ok();
        let fits = |s: &&&Stream| number == Some(s.id) || s.name == wanted;
        match &events.iter().filter(fits).collect::<Vec<_>>()[..] {
            [] => Err(format!(
                "has no stream of events {}; there is {there}",
                shown(wanted)
            )),
            [one] => Ok(one),
            _ => Err(format!(
                "has several streams of events {}; give the number of one: {there}",
                shown(wanted)
            )),
        }
    }
}

impl Stream {
    /// The size of its sensor, where that is said.
    pub(super) fn sensor(&self) -> Result<Option<Sensor>, String> {
        let Some((width, height)) = &self.size else {
            return Ok(None);
        };
        let side = |text: &str| text.parse().ok().filter(|side| (1..=65_535).contains(side));
        match (side(width), side(height)) {
            (Some(width), Some(height)) => Ok(Some(Sensor { height, width })),
            _ => Err(format!(
                "says that its sensor is {} columns wide and {} rows high; give the size of the sensor",
                shown(width),
                shown(height)
            )),
        }
    }
}

/// Its number, name and camera, for an error.
impl std::fmt::Display for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} ({} of {})",
            self.id,
            shown(&self.name),
            shown(&self.source)
        )
    }
}

fn list(items: impl Iterator<Item = String>) -> String {
    let mut items: Vec<_> = items.take(MAX_NAMED + 1).collect();
    if items.len() > MAX_NAMED {
        items[MAX_NAMED] = "…".to_owned();
    }
    if items.is_empty() {
        return "none".to_owned();
    }
    items.join(", ")
}

/// A word of the file for an error: in one line, short.
fn shown(text: &str) -> String {
    let mut short: String = text
        .chars()
        .take(MAX_SHOWN)
        .flat_map(char::escape_debug)
        .collect();
    if text.chars().nth(MAX_SHOWN).is_some() {
        short.push('…');
    }
    short
}

/// The streams in the description, which is a tree of `<node name="…">` with `<attr key="…">` in them: below the node
/// `outInfo` there is one node per stream, named by its number, and below that one named `info`.
fn streams(xml: &str) -> Result<Vec<Stream>, String> {
    let options = roxmltree::ParsingOptions {
        nodes_limit: MAX_NODES,
        ..Default::default()
    };
    let document =
        roxmltree::Document::parse_with_options(xml.trim_end_matches('\0'), options).map_err(|e| {
            format!(
                "the description of its streams cannot be read: {}",
                shown(&e.to_string())
            )
        })?;
    let is_out = |n: &roxmltree::Node<'_, '_>| n.attribute("name") == Some("outInfo");
    let Some(out) = document.descendants().find(is_out) else {
        return Ok(Vec::new());
    };
    let mut streams = Vec::new();
    for node in out.children().filter(|n| n.has_tag_name("node")) {
        let Some(id) = node.attribute("name").and_then(|n| n.parse::<i32>().ok()) else {
            continue;
        };
        let info = node.children().find(|n| n.attribute("name") == Some("info"));
        let size = info.and_then(|i| Some((attr(i, "sizeX")?, attr(i, "sizeY")?)));
        streams.push(Stream {
            id,
            kind: attr(node, "typeIdentifier").unwrap_or_default(),
            name: attr(node, "originalOutputName").unwrap_or_default(),
            source: info.and_then(|i| attr(i, "source")).unwrap_or_default(),
            size,
        });
    }
    Ok(streams)
}

/// The text of `<attr key="…">` in a node.
fn attr(node: roxmltree::Node<'_, '_>, key: &str) -> Option<String> {
    let found = node.children().find(|n| n.attribute("key") == Some(key))?;
    Some(found.text().unwrap_or_default().trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(xml: &str) -> Result<Header, String> {
        Ok(Header {
            compression: Compression::None,
            table_at: -1,
            streams: streams(xml)?,
        })
    }

    fn stream(id: i32, kind: &str, name: &str, size: &str) -> String {
        format!(
            "<node name=\"{id}\"><attr key=\"typeIdentifier\">{kind}</attr>\
             <attr key=\"originalOutputName\">{name}</attr>\
             <node name=\"info\"><attr key=\"source\">C{id}</attr>{size}</node></node>"
        )
    }

    fn document(streams: &[String]) -> String {
        format!("<dv><node name=\"outInfo\">{}</node></dv>", streams.concat())
    }

    #[test]
    fn streams_are_chosen_by_number_or_name() {
        let size = "<attr key=\"sizeX\">640</attr><attr key=\"sizeY\">480</attr>";
        let xml = document(&[
            stream(0, "FRME", "frames", size),
            stream(1, "EVTS", "left", size),
            stream(2, "EVTS", "right", ""),
            stream(3, "EVTS", "right", ""),
        ]);
        let header = header(&xml).unwrap();
        let id = |wanted| header.events(wanted).map(|s| s.id);
        assert_eq!((id(None), id(Some("left")), id(Some("2"))), (Ok(1), Ok(1), Ok(2)));
        assert_eq!(
            id(Some("0")).unwrap_err(),
            "has no stream of events 0; there is 1 (left of C1), 2 (right of C2), 3 (right of C3)"
        );
        assert!(id(Some("right")).unwrap_err().contains("give the number of one"));
        let sensor = |at: usize| header.streams[at].sensor();
        assert_eq!(
            (sensor(1), sensor(2)),
            (
                Ok(Some(Sensor {
                    height: 480,
                    width: 640
                })),
                Ok(None)
            )
        );
    }

    #[test]
    fn what_is_missing_is_said() {
        let frames = header(&document(&[stream(4, "FRME", "a\nb", "")])).unwrap();
        assert_eq!(
            frames.events(None).unwrap_err(),
            "has no stream of events (streams: 4 (FRME))"
        );
        assert!(
            header("<dv/>")
                .unwrap()
                .events(None)
                .unwrap_err()
                .contains("streams: none")
        );
        let error = header("<dv><a></b></dv>").unwrap_err();
        assert!(error.starts_with("the description of its streams"), "{error}");
        assert!(header("").is_err());
        let bad = "<attr key=\"sizeX\">-3</attr><attr key=\"sizeY\">480</attr>";
        let error = header(&document(&[stream(0, "EVTS", "e", bad)])).unwrap().streams[0].sensor();
        assert!(error.unwrap_err().contains("-3 columns wide"));
    }
}
